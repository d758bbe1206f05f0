"""An encoder that is read late is named; a late torque, or torques that are all late, still are."""

from __future__ import annotations

import numpy as np
import pytest

import ident
from ident import Log, Noise
from identification import motion_log, plant, robot

LATE = 0.03  # s


@pytest.fixture(scope="module")
def arm():
    """An arm with friction that the model has, positions and torques with a little noise."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    values = dict.fromkeys((name for e in mechanism.effects for name in e.names), 0.4)
    noise = (Noise("tau", 0.005, relative=True), Noise("q", 2e-5))
    return plant(mechanism, motion_log("arm", 200.0, 16.0, 16.0), values, noise=noise, seed=4)


def named(arm, *channels: str) -> set[str]:
    """Labels of what a diagnosis names where these channels are late."""
    t, columns = arm.log.t, arm.log.columns
    kept = {n: x for n, x in columns.items() if n.startswith(("q.", "tau."))}
    late = {n: np.interp(t - LATE, t, x) if n in channels else x for n, x in kept.items()}
    motion = ident.complete(arm.mechanism, Log.from_arrays("run", t, late))
    diagnosis = ident.diagnose(ident.identify(arm.mechanism, motion))
    group = diagnosis.members_of_group
    return {effect.label for m in group for effect in (m.effect, *(r.effect for r in m.rivals))}


@pytest.mark.parametrize("joint", ["shoulder", "elbow"])
def test_a_late_position_is_named(arm, joint):
    assert named(arm, f"q.{joint}") == {f"position_delay:{joint}"}


def test_of_the_last_joint_it_is_named_beside_its_torque(arm):
    assert "position_delay:wrist" in named(arm, "q.wrist")


def test_a_late_torque_is_no_early_position(arm):
    assert named(arm, "tau.elbow") == {"delay:elbow"}


def test_where_no_channel_is_late_none_is_named(arm):
    assert not named(arm)
