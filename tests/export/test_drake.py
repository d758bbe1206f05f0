"""URDFs for Drake: what it holds moves as ident's model without the rest does."""

import numpy as np
import pytest

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
