"""The battery of laws itself; `python tests/laws/score.py` runs all of its cases."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("mujoco", reason="rigid-body torques of the battery are MuJoCo's")

from law_cases import SCORE, SETS, TUNE, cases
from law_judge import apart, closed, equal, judge, variables
from law_logs import RATE, Complement, Made, bodies, make, rms

import ident
from ident.display import Progress
from ident.show.laws import plot_curve

MACHINES = ("arm3", "five_bar", "crank_rocker")


def first(machine: str, of: str = "tune") -> Made:
    return make(next(case for case in cases(of) if case.machine == machine))


@pytest.fixture(scope="module", params=MACHINES)
def made(request) -> Made:
    return first(request.param)


def test_there_are_forty_laws_and_no_two_cases_share_a_name_or_a_seed() -> None:
    assert len(TUNE) >= 20
    assert len(SCORE) >= 20
    every = [case for of in SETS for case in cases(of)]
    assert len({case.name for case in every}) == len(every)
    assert len({case.seed for case in every}) == len(every)
    texts = [(each.name, each.machine, each.joint, str(each.constants)) for each in TUNE + SCORE]
    assert len(set(texts)) == len(texts)


def test_pinocchio_moves_the_rigid_bodies_as_mujoco_does(made: Made) -> None:
    """Γ p of the true inertias is the torque; the velocities are the positions' derivatives."""
    import pinocchio as pin
    from law_logs import urdf

    motion = made.motion
    model = pin.buildModelFromXML(urdf(motion.machine, None))
    p = np.concatenate([inertia.toDynamicParameters() for inertia in model.inertias[1:]])
    off = bodies(motion) @ p - motion.rigid
    assert rms(off) < 1e-6 * rms(motion.rigid)
    v = np.gradient(motion.q, 1 / RATE, axis=0)[2:-2]
    assert rms(v - motion.v[2:-2]) < 1e-3 * rms(motion.v)


def test_what_is_added_is_the_law_of_its_size(made: Made) -> None:
    law = made.law
    assert law is not None
    added = made.tau - made.motion.rigid
    for (kind, joint), size in made.known.items():
        text = {"viscous": "v", "coulomb": "sign(v)"}[kind]
        added -= size * made.motion.torque(joint, text, {})
    torque = made.motion.torque(law.joint, law.formula, law.constants)
    assert rms(added - torque) < 1e-9 * rms(torque)
    shares = [rms(torque[:, k]) / rms(made.motion.rigid[:, k]) for k in range(torque.shape[1])]
    assert 0.03 <= max(shares) <= 0.16


def test_the_complement_leaves_nothing_of_the_model_and_does_not_change_twice(made: Made) -> None:
    P = Complement(made)
    X = made.columns(made.motion)
    x = X @ np.random.default_rng(0).normal(size=X.shape[2])
    assert np.linalg.norm(P.of(x)) < 1e-8 * np.linalg.norm(P.rows(x))
    law = made.law
    assert law is not None
    left = P.of(made.motion.torque(law.joint, law.formula, law.constants))
    again = left - P.basis @ (P.basis.T @ left)
    assert np.linalg.norm(again - left) < 1e-10 * np.linalg.norm(left)


def found(made: Made, formula: str | None = None, **constants: float) -> dict[str, object]:
    """An entry of `laws`: the truth, or another formula of the same constants."""
    law = made.law
    assert law is not None
    values = {**law.constants, **constants}
    return {
        "joint": law.joint,
        "signals": sorted(law.signals),
        "formula": formula or law.formula,
        "parameters": [{"name": f"law.{law.joint}.{n}", "value": x} for n, x in values.items()],
    }


def test_the_truth_passes_and_what_the_model_makes_does_not_count(made: Made) -> None:
    law, P = made.law, Complement(made)
    assert law is not None
    true = made.motion.torque(law.joint, law.formula, law.constants)
    told = found(made)
    assert variables(told, made.motion) == law.signals
    assert apart(made, told, P, true) < 1e-9
    assert closed(made, told) > 0.98
    if made.known:
        more = found(made, f"{law.formula} + d*v", d=0.3)
        assert apart(made, more, P, true) < 1e-6


def test_another_form_fails_and_another_writing_is_equal(made: Made) -> None:
    law, P = made.law, Complement(made)
    assert law is not None
    true = made.motion.torque(law.joint, law.formula, law.constants)
    assert apart(made, found(made, "k*sin(5*q)"), P, true) > 0.1
    assert not equal(made, found(made, "k*sin(b*q)*c", b=1.1, c=1.0), P, true)
    moved = {name: 1.05 * x for name, x in law.constants.items()}
    other = found(made, f"2*({law.formula})", **{**moved, "k": law.constants["k"] / 2})
    assert apart(made, other, P, true) > 1e-4
    assert equal(made, other, P, true)


def test_a_log_without_a_law_has_nothing_added() -> None:
    made = first("arm3", "clean")
    assert made.law is None
    assert {kind for kind, _ in made.known} == {"viscous", "coulomb"}


ENGINE = (  # of speed, of another joint, of position in a loop
    "tune/arm3/friction_saturating.yaw", "tune/arm3/cross_cam.yaw",
    "check/crank_rocker/coulomb_of_position.crank",
)  # fmt: skip
MORE = (  # of position, beside an offset, past half a turn
    "tune/arm3/magnet_rational.elbow", "check/arm3/shaft.elbow",
    "check/five_bar/cam_rectified.left", "check/arm3/dead_zone.yaw",
)  # fmt: skip


@pytest.mark.parametrize(
    "name", [*ENGINE, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE)]
)
def test_a_hidden_law_is_found(name: str) -> None:
    """Its variables, its form and the prediction of another log; as the contract writes it."""
    of = name.partition("/")[0]
    result = judge(next(case for case in cases(of) if case.name == name))
    assert "error" not in result, result["error"]
    assert result["contract"] == []
    assert result["formula_variables"], result["laws"]
    assert result["apart"] < 0.02, result["laws"]
    assert result["closed"] > 0.95
    assert result["verdict"] == "unexplained"


KEPT = ("clean/arm3/1", "named/arm3/stribeck.yaw", "named/arm3/temperature_friction.yaw")


@pytest.mark.parametrize("name", KEPT)
def test_no_formula_on_clean_data_or_in_place_of_a_name(name: str) -> None:
    of = name.partition("/")[0]
    result = judge(next(case for case in cases(of) if case.name == name))
    assert "error" not in result, result["error"]
    assert result["laws"] == []
    kind = name.rpartition("/")[2].replace(".", ":")
    assert result["best"] == (None if of == "clean" else kind)


def diagnosed(name: str, place: Path, progress: Progress | None = None) -> ident.Diagnosis:
    made = make(next(c for c in cases(name.partition("/")[0]) if c.name == name))
    columns = {name: x for name, x in made.log.items() if name != "t"}
    log = ident.Log.from_arrays("run.csv", made.log["t"], columns)
    mechanism = ident.load(made.folder(place))
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    return ident.diagnose(fit, progress=progress)


def test_the_next_motion_tells_forms_apart(tmp_path: Path) -> None:
    """A wave of position times the sign of speed, over a third of a turn: so are other curves."""
    steps: list[str] = []
    d = diagnosed(
        "score/arm3/coulomb_of_position.yaw", tmp_path, lambda what, share: steps.append(what)
    )
    assert d.laws
    assert d.laws[0].formula in " ".join(d.short.split())
    assert any(step.startswith("law of yaw, so far k") for step in steps)
    assert d.curves[0].effect.signal == "q*sign"
    marks = plot_curve(d.curves[0], d.laws[0]).rows[0][0].marks
    assert d.laws[0].formula in [getattr(mark, "label", "") for mark in marks]
    assert d.laws[0].rivals
    assert d.laws[0].matters(d.decision)
    assert not replace(d.laws[0], after=d.laws[0].before).matters(d.decision)
    assert d.next_experiment.startswith("Turn yaw through a full turn")


def test_a_name_says_which_laws_would_do_as_well(tmp_path: Path) -> None:
    """Over 1.3 rad a linear spring is a spring at a lever, and a full turn tells them apart."""
    d = diagnosed("named/arm3/spring.yaw", tmp_path)
    assert d.best is not None
    assert d.best.label == "spring:yaw"
    known = {each.formula.terms[0].known_as for each in d.relatives}
    assert "spring_counterbalance" in known
    assert {each["nearest"] for each in d.json()["relatives"]} == known
    assert "a spring counterbalance" in d.short
    assert d.next_experiment.startswith("Turn yaw through a full turn")
    assert d.laws == ()
