"""URDFs for Drake: what it holds moves as ident's model without the rest does."""

import numpy as np
import pytest
from public_robots import CENTRE, public_robot

import ident
from ident.export.export import export
from ident.log import Log

pytest.importorskip("pydrake.multibody.parsing")


def test_drake_moves_as_ident_without_what_is_lost(robots):
    mechanism = ident.load(robots / "arm")
    for kind in ("viscous", "rotor_inertia"):
        for joint in mechanism.driven:
            if f"{kind}:{joint}" not in {e.label for e in mechanism.effects}:
                mechanism = mechanism.with_effect(f"{kind}:{joint}")
    values = {full: 0.1 for e in mechanism.effects for full in e.names}
    t = np.arange(0.0, 1.0, 0.005)
    columns = {}
    for i, j in enumerate(mechanism.driven):
        w = 2.0 + i
        columns |= {f"q.{j}": 0.3 * np.sin(w * t), f"v.{j}": 0.3 * w * np.cos(w * t),
                    f"a.{j}": -0.3 * w * w * np.sin(w * t)}  # fmt: skip
    log, _ = ident.simulate(mechanism, Log.from_arrays("run", t, columns), values=values)
    made = export(mechanism, "drake", values=values, log=log, replayed=True)
    assert made.lost == ()
    for run in made.replays.runs["Drake"]:
        assert max(error.rms for error in run.errors.values()) < 1e-3


def test_dry_friction_is_lost_with_its_size(robots):
    mechanism = ident.load(robots / "arm").with_effect("coulomb:elbow")
    values = {full: 0.2 for e in mechanism.effects for full in e.names}
    made = export(mechanism, "drake", values=values)
    lost = {each.label: each for each in made.lost}["coulomb:elbow"]
    assert lost.before == pytest.approx(0.2, rel=0.2)
    assert lost.torque < lost.before


@pytest.mark.parametrize("target", ["drake", "urdf"])
def test_locked_joints_stay_where_they_are(target, tmp_path):
    """The Panda's fingers, of which one mimics the other, are locked, and would fall else."""
    mechanism = ident.load(public_robot("panda", tmp_path / "panda")).with_effect("viscous")
    values = {full: 5.0 for e in mechanism.effects for full in e.names}
    t = np.arange(0.0, 0.3, 0.005)
    columns = {}
    for j, q0 in zip(mechanism.driven, CENTRE["panda"], strict=True):
        columns |= {f"q.{j}": q0 + 0.2 * np.sin(4 * t), f"v.{j}": 0.8 * np.cos(4 * t),
                    f"a.{j}": -3.2 * np.sin(4 * t)}  # fmt: skip
    log, _ = ident.simulate(mechanism, Log.from_arrays("run", t, columns), values=values)
    made = export(mechanism, target, values=values, log=log, replayed=True)
    (run,) = made.replays.runs["MuJoCo" if target == "urdf" else "Drake"]
    assert max(error.rms for error in run.errors.values()) < 1e-3
    assert not any("limits" in note for note in made.notes)


def test_a_log_beyond_the_limits_is_named(robots):
    mechanism = ident.load(robots / "arm")
    t = np.arange(0.0, 0.3, 0.005)
    top = mechanism.joint("elbow").upper
    columns = {f"q.{j}": 0.1 * np.sin(t) for j in mechanism.driven}
    columns["q.elbow"] = top + columns["q.elbow"]
    log, _ = ident.simulate(mechanism, Log.from_arrays("run", t, columns))
    made = export(mechanism, "drake", log=log, replayed=True)
    assert any("elbow" in note and "beyond its limits" in note for note in made.notes)
