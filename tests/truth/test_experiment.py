"""The next experiment: motions that tell rivals apart, and an honest no where none does."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid

import ident
from helpers import ROBOTS
from ident import Log, Mechanism, Noise
from ident.assess.experiment import follow_signal, next_experiment, step_of_suggestion
from ident.diagnosis import Diagnosis, diagnose
from ident.diagnosis.experiment import Proposal, attempts, contenders, proposal, questions
from ident.diagnosis.trials import present, trials
from ident.fit.residual_maps import Dependence
from ident.show.experiment import experiment_text, suggestion_words

# presliding refitted at a negative reach overflows on its way; that is not tested here
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
NOISE = (Noise("tau", 0.05, True), Noise("q", 1e-5))


def sines(moves: dict[str, tuple[float, float, float]], seconds: float, rate: float = 200.0) -> Log:
    """Joints about a middle by an amplitude, at an angular frequency: (middle, amplitude, w)."""
    t = np.arange(0.0, seconds, 1 / rate)
    columns = {}
    for joint, (middle, h, w) in moves.items():
        parts = [(0.7, w, 0.0), (0.3, 2.3 * w, 0.4)]
        columns[f"q.{joint}"] = middle + h * sum(a * np.sin(f * t + p) for a, f, p in parts)
        columns[f"v.{joint}"] = h * sum(a * f * np.cos(f * t + p) for a, f, p in parts)
        columns[f"a.{joint}"] = -h * sum(a * f**2 * np.sin(f * t + p) for a, f, p in parts)
    return Log.from_arrays("run.csv", t, columns)


def diagnosed(mechanism: Mechanism, hidden: Mechanism, log: Log, noise=NOISE, seed=0) -> Diagnosis:
    made, _ = ident.simulate(hidden, log, noise=noise, columns=("q", "tau"), seed=seed)
    return diagnose(ident.identify(mechanism, ident.complete(mechanism, made)))


@pytest.fixture(scope="module")
def four_bar() -> Mechanism:
    return ident.load(ROBOTS / "four_bar")


@pytest.fixture(scope="module")
def parallelogram(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """The four-bar with equal opposite sides."""
    folder: Path = tmp_path_factory.mktemp("parallelogram")
    urdf = (ROBOTS / "four_bar" / "four_bar.urdf").read_text()
    toml = (ROBOTS / "four_bar" / "mechanism.toml").read_text()
    pin = '<origin xyz="{} -0.012 0" rpy="0 0 0"/>\n    <axis'
    (folder / "four_bar.urdf").write_text(urdf.replace(pin.format(0.15), pin.format(0.2)))
    toml = re.sub("start = .*", "start = { crank = 1.5, coupler = -1.5, rocker = 1.5 }", toml)
    toml = toml.replace("xyz = [0.41,", "xyz = [0.40,").replace("xyz = [0.25,", "xyz = [0.20,")
    (folder / "mechanism.toml").write_text(toml)
    return ident.load(folder)


@pytest.fixture(scope="module")
def narrow(four_bar: Mechanism) -> Diagnosis:
    """Friction in the rocker's bearing, the crank moved by ±15°."""
    hidden = four_bar.with_effect("coulomb:rocker", {"Fc": 0.03})
    return diagnosed(four_bar, hidden, sines({"crank": (1.2, 0.26, 3.0)}, 6.0))


def propose(d: Diagnosis) -> Proposal | None:
    """The motion that answers the first question that any motion answers."""
    rivals = contenders(d)
    tried = attempts(d, rivals)
    return next(filter(None, (proposal(d, tried, pairs) for pairs in questions(rivals))), None)


def test_a_narrow_motion_asks_for_a_full_turn(narrow: Diagnosis) -> None:
    assert "coulomb:rocker" in {e.label for e in (narrow.best, *narrow.rivals)}
    assert len({e.joints for e in (narrow.best, *narrow.rivals)}) > 1
    found = propose(narrow)
    assert found is not None
    assert found.trial.kind == "turn"
    (move,) = found.trial.changed
    assert move.joint.name == "crank"
    assert 2 * move.half == pytest.approx(2 * np.pi)
    pairs = questions(contenders(narrow))[0]
    same = next(x for x in attempts(narrow, contenders(narrow)) if x.trial.kind == "same")
    assert found.separation > 3 * min(map(same.separation, pairs))
    text = experiment_text(narrow)
    assert "urn crank through a full turn" in text
    assert "rad/s" in text


def test_the_full_turn_names_the_joint(four_bar: Mechanism, narrow: Diagnosis) -> None:
    found = propose(narrow)
    assert found is not None
    (log,) = found.trial.logs
    (speed,) = (move.speed for move in found.trial.changed)
    wide = sines({"crank": (1.2, np.pi, speed / np.pi)}, found.seconds)
    assert log.columns["q.crank"].max() - log.columns["q.crank"].min() > 5.0
    hidden = four_bar.with_effect("coulomb:rocker", {"Fc": 0.03})
    d = diagnosed(four_bar, hidden, wide)
    assert d.verdict == "missing"
    assert {e.joints for e in (d.best, *d.rivals)} == {("rocker",)}


def test_no_motion_of_a_parallelogram(parallelogram: Mechanism) -> None:
    hidden = parallelogram.with_effect("coulomb:rocker", {"Fc": 0.05})
    d = diagnosed(parallelogram, hidden, sines({"crank": (1.5, 0.8, 3.0)}, 6.0))
    start = time.process_time()
    text = experiment_text(d)
    assert time.process_time() - start < 5.0
    assert {e.joints for e in (d.best, *d.rivals)} >= {("crank",), ("rocker",), ("coupler",)}
    assert text.startswith("No motion can tell ")
    kinds = [label.partition(":")[0] for label in next_experiment(d).step.separate]
    assert len(set(kinds)) == len(kinds)  # no motion is planned that should tell places apart
    assert "open the loop at pin" in text.lower()
    where = questions(contenders(d))[0]
    assert proposal(d, attempts(d, contenders(d)), where) is None


@pytest.fixture(scope="module")
def arm() -> Mechanism:
    return ident.load(ROBOTS / "arm")


def test_viscous_or_drag_asks_for_other_speeds(arm: Mechanism) -> None:
    hidden = arm.with_effect("viscous:elbow", {"Fv": 0.05})
    moves = {"yaw": (0, 0.8, 0.9), "shoulder": (-0.5, 0.4, 1.1), "elbow": (0.9, 0.5, 1.5)}
    d = diagnosed(arm, hidden, sines({**moves, "wrist": (0.2, 0.6, 1.3)}, 12.0))
    (drag,) = (e.effect for e in d.selection.first.evidence if e.effect.label == "drag:elbow")
    best = replace(d.candidates[0], rivals=(drag,))  # as at more noise
    d = replace(d, candidates=(best, *d.candidates[1:]))
    found = propose(d)
    assert found is not None
    assert found.trial.about == ("elbow",)
    assert found.trial.kind in ("faster", "speeds", "strokes")
    if found.trial.kind != "strokes":
        (speed,) = (move.speed for move in found.trial.changed)
        now = present(arm, d.fit.motion)[2].speed
        assert speed == pytest.approx(2 * now)
    assert "elbow" in experiment_text(d)


def test_trials_keep_limits(arm: Mechanism) -> None:
    log = sines({"yaw": (0, 0.8, 1.5), "shoulder": (0, 0.8, 1.5), "elbow": (0, 0.8, 1.5),
                 "wrist": (0, 0.8, 1.5)}, 6.0)  # fmt: skip
    now = present(arm, ident.complete(arm, log, torques=False))
    kinds = set()
    for trial in trials(now, arm.driven):
        kinds.add(trial.kind)
        for made in trial.logs:
            for m in trial.moves:
                q, v, a = (made.columns[f"{c}.{m.joint.name}"] for c in "qva")
                assert trial.reached(m).low <= q.min()
                assert trial.reached(m).high >= q.max()
                assert q.min() >= m.joint.lower
                assert q.max() <= m.joint.upper
                assert np.abs(v).max() <= m.joint.velocity
                assert np.allclose(q[-1] - q[0], trapezoid(v, made.t), atol=0.02)
                assert np.allclose(v[-1] - v[0], trapezoid(a, made.t), atol=0.1)
    assert kinds >= {"same", "faster", "limits", "strokes", "alone"}
    assert "turn" not in kinds


def test_every_verdict_has_an_experiment(narrow: Diagnosis) -> None:
    for verdict in ("nothing", "unexplained"):
        text = experiment_text(replace(narrow, verdict=verdict))
        assert text.endswith(".")
        assert "could be worked out" not in text


@pytest.mark.parametrize("repeats", [False, True])
@pytest.mark.parametrize("signal", ["v.crank", "a.crank", "q.crank", "sign(v).crank", "load.crank"])
def test_half_the_speed_is_advised_where_a_residual_goes_with_it(
    narrow: Diagnosis, signal: str, repeats: bool
) -> None:
    worst = replace(narrow.where[0], depends_on=(Dependence(signal, 0.5),))
    d = replace(narrow, where=(worst,), periods=object() if repeats else None)
    advice = follow_signal(d)
    words = suggestion_words(advice, d.fit.mechanism)
    (planned,) = step_of_suggestion(d, advice).speed
    (top,) = (move.speed for move in present(d.fit.mechanism, d.fit.motion))
    assert ("at least twice" in words) is not repeats
    if signal[0] in "va":
        assert f"Move crank at up to {0.5 * top:.2g} rad/s" in words
    assert planned == ("crank", pytest.approx((0.5 if signal[0] in "va" else 0.1) * top))


def test_no_speed_above_the_urdf_is_advised(arm: Mechanism) -> None:
    log = sines({name: (0, 0.8, 1.5) for name in arm.driven}, 6.0)
    motion = ident.complete(arm, log, torques=False)
    fast = present(arm, motion)
    assert all(move.speed > 0.4 for move in fast)
    slow = replace(arm, joints=tuple(replace(j, velocity=0.4) for j in arm.joints))
    assert all(float(f"{move.speed:.2g}") <= 0.4 for move in present(slow, motion))
