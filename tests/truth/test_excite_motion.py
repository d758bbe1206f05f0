"""An exciting motion keeps what it must; judged by Pinocchio and by the series' own formula."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import CubicSpline

import ident
from helpers import ROBOTS, Series, Truth
from ident import Excitation, Limits
from ident.excite import search
from ident.excite.design import DesignProblem
from ident.fit.values import base_names

SHORT = {"duration": 12.0, "periods": 2, "harmonics": 3, "rate": 50.0, "tries": 1}
ROOM = {"arm": Limits(speed=2.0, acceleration=4.0, torque={"shoulder": 30.0}), "five_bar": Limits()}
SLACK = 1e-6


@pytest.fixture
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that ends soon, where the best motion is not what matters."""
    monkeypatch.setattr(search, "ROUND", 3)
    monkeypatch.setattr(search, "STEPS", 0)


@pytest.fixture(scope="module", params=["arm", "five_bar"])
def found(request: pytest.FixtureRequest) -> tuple[str, Excitation]:
    name = request.param
    mechanism = ident.load(ROBOTS / name)
    return name, ident.excite(mechanism, limits=ROOM[name], **SHORT)


def evaluated(x: Excitation, t: np.ndarray) -> tuple[Series, Series, Series]:
    """y, ẏ, ÿ of the series by its formula."""
    q, v, a = {}, {}, {}
    for name, c in x.series.items():
        H = x.harmonics
        w = 2 * np.pi / x.period * np.arange(1, H + 1)
        sin, cos, s, k = np.sin(np.outer(t, w)), np.cos(np.outer(t, w)), c[1 : H + 1], c[H + 1 :]
        q[name] = c[0] + sin @ s + cos @ k
        v[name] = cos @ (w * s) - sin @ (w * k)
        a[name] = -sin @ (w**2 * s) - cos @ (w**2 * k)
    return q, v, a


@pytest.fixture(scope="module")
def fine(found: tuple[str, Excitation]):
    """One period at other times than the log's, closed by Pinocchio alone: q, v, a, torques."""
    name, x = found
    truth = Truth(name)
    t = np.arange(0.0, x.period, 0.0037)
    Q, V, A = truth.complete(t, *evaluated(x, t))
    order = sorted(truth.index, key=truth.index.__getitem__)
    states = [np.stack([each[j] for j in order], axis=1) for each in (Q, V, A)]
    torque = np.zeros((len(t), len(x.series)))
    size = np.zeros(len(t))
    driven = [truth.index[j] for j in x.series]
    for i, (q, v, a) in enumerate(zip(*states, strict=True)):
        f = pin.rnea(truth.model, truth.data, q, v, a)
        J = truth.rows(q, v)[1]
        W = np.eye(truth.model.nv)[driven]
        K = np.linalg.pinv(np.vstack([J, W]))  # its redundant rows are zero
        torque[i], size[i] = K[:, len(J) :].T @ f, np.linalg.norm(K)
    return Q, V, A, torque, size


def test_limits_hold_between_samples_and_in_passive_joints(found, fine):
    name, x = found
    Q, V, A, torque, _ = fine
    limits = ROOM[name]
    for joint in ident.load(ROBOTS / name).joints:
        q, v, a = Q[joint.name], V[joint.name], A[joint.name]
        assert joint.lower - SLACK <= q.min() < q.max() <= joint.upper + SLACK
        most = min(joint.velocity, limits.speed or np.inf)
        assert np.abs(v).max() <= most + SLACK
        assert np.abs(a).max() <= (limits.acceleration or np.inf) + SLACK
        if joint.name in x.series:
            given = limits.torque or {}
            effort = given.get(joint.name, joint.effort)
            tau = torque[:, list(x.series).index(joint.name)]
            assert np.abs(tau).max() <= 0.8 * effort * (1 + SLACK)


def test_limits_are_used(found):
    _, x = found
    shares = [each.share for each in x.uses]
    assert 0.95 < max(shares) <= 1.0
    assert all(each.lower <= each.low <= each.high <= each.upper for each in x.uses)


def test_loops_stay_on_their_branch_and_away_from_singular_positions(found, fine):
    name, x = found
    Q, *_, size = fine
    truth = Truth(name)
    if not truth.ends:
        pytest.skip("a tree")
    start = Truth(name).start
    J = truth.rows(truth.assemble([truth.index[j] for j in x.series], start[
        [truth.index[j] for j in x.series]], start), np.zeros(4))[1]  # fmt: skip
    W = np.eye(truth.model.nv)[[truth.index[j] for j in x.series]]
    home = np.linalg.norm(np.linalg.pinv(np.vstack([J, W])))
    assert size.max() <= 3.0 * home * (1 + SLACK)
    assert x.home == pytest.approx(size.max() / home, rel=5e-3)  # at 50 Hz
    motion = ident.complete(ident.load(ROBOTS / name), x.log, cutoff=None)
    e = motion.experiments[0]
    assert motion.closure_error < 1e-9
    one = e.t < x.period
    t = np.arange(0.0, x.period, 0.0037)
    for i, joint in enumerate(ident.load(ROBOTS / name).joints):
        there = np.interp(t, e.t[one], e.y[one, i])
        np.testing.assert_allclose(Q[joint.name], there, atol=2e-3)


def test_the_log_is_the_series_and_repeats_it(found, fine):
    _, x = found
    q, v, a = evaluated(x, x.log.t)
    for name in x.series:
        for channel, want in (("q", q), ("v", v), ("a", a)):
            got = x.log.columns[f"{channel}.{name}"]
            np.testing.assert_allclose(got, want[name], atol=1e-9 * (1 + np.abs(got).max()))
        at_rest = np.isclose(x.log.t % x.period, 0.0)
        assert at_rest.sum() == x.periods + 1
        for channel in "va":
            assert np.abs(x.log.columns[f"{channel}.{name}"][at_rest]).max() < 1e-9
        tau = x.log.columns[f"tau.{name}"]
        n = round(x.period * x.log.rate)
        np.testing.assert_allclose(tau[n:], tau[:-n], atol=1e-8)
        torque = fine[3][:, list(x.series).index(name)]
        t = np.arange(0.0, x.period, 0.0037)
        np.testing.assert_allclose(CubicSpline(x.log.t, tau)(t), torque, atol=5e-3)


def test_better_than_random_motions(found):
    """Of the same family and limits; the best of each, which need not be the same motion."""
    name, x = found
    mechanism = ident.load(ROBOTS / name)
    problem = DesignProblem(mechanism, ROOM[name], x.period, x.harmonics, {}, 7)
    criterion, random = problem.criterion(None, 0.0), np.random.default_rng(5)
    det, condition = [], []
    for _ in range(25):
        if (candidate := problem.draw(random, criterion)) is not None:
            other = problem.excitation(candidate.x, 12.0, 2, 25.0, None, 0)
            det.append(other.log_det + len(other.base) * np.log(2.0))  # of as many samples
            condition.append(other.condition_number)
    assert x.log_det > max(det) + 2 * len(x.base) * np.log(1.2)  # errors a fifth larger
    if name == "arm":
        other = ident.excite(mechanism, limits=ROOM[name], balance=3.0, **SHORT)
        assert other.condition_number < min(condition)


def test_same_seed_same_motion(found):
    name, x = found
    if name == "five_bar":
        pytest.skip("the arm's will do")
    again = ident.excite(ident.load(ROBOTS / name), limits=ROOM[name], **SHORT)
    for column, values in x.log.columns.items():
        np.testing.assert_array_equal(values, again.log.columns[column])
    assert str(x) == str(again)


def test_expected_errors_are_those_found(found):
    """White noise of the stated size on torques, exact motion: σ of the estimates over 25 logs."""
    name, x = found
    mechanism = ident.load(ROBOTS / name)
    exact, random, off = ident.simulate(mechanism, x.log)[0], np.random.default_rng(0), []
    for _ in range(25):
        noisy = {
            f"tau.{joint}": exact.columns[f"tau.{joint}"] + sigma * random.normal(size=len(exact.t))
            for joint, sigma in x.noise.items()
        }
        log = ident.Log.from_arrays("run", exact.t, {**exact.columns, **noisy})
        fit = ident.identify(mechanism, ident.complete(mechanism, log, cutoff=None))
        values = dict(
            zip(base_names(fit.columns, fit.estimate.base), fit.estimate.solution.beta, strict=True)
        )
        off.append([values[b.name] - b.prior for b in x.base])  # no standard error is asked for
    ratio = np.sqrt(np.mean(np.square(off), axis=0)) / [b.stderr for b in x.base]
    assert np.exp(np.mean(np.log(ratio))) == pytest.approx(1.0, abs=0.12)
    assert (ratio < 1.8).all()


def test_effects_are_in_information_and_torque():
    mechanism = ident.load(ROBOTS / "arm").with_effect("coulomb")
    mechanism = mechanism.with_effect("viscous:yaw", {"Fv": 3.0})
    x = ident.excite(mechanism, **SHORT)
    assert {f"coulomb.{j}.Fc" for j in x.series} <= {b.name for b in x.base}
    truth, c = Truth("arm"), x.log.columns
    states = (np.stack([c[f"{k}.{j}"] for j in truth.index], axis=1) for k in "qva")
    rigid = [pin.rnea(truth.model, truth.data, *s) for s in zip(*states, strict=True)]
    friction = c["tau.yaw"] - np.array(rigid)[:, truth.index["yaw"]]
    np.testing.assert_allclose(friction, 3.0 * c["v.yaw"], atol=1e-9)


@pytest.mark.usefixtures("few_steps")
def test_what_has_no_effect_is_not_identified():
    """Gravity does not feel the zero of a joint with a vertical axis."""
    mechanism = ident.load(ROBOTS / "arm").with_effect("encoder_offset:yaw")
    mechanism = mechanism.with_effect("encoder_offset:elbow")
    found = ident.excite(mechanism, duration=8.0, periods=2, harmonics=2, rate=50.0, tries=1)
    assert found.without_effect == ("encoder_offset.yaw.delta",)
    assert not any("encoder_offset.yaw" in value.name for value in found.base)
    (elbow,) = (value for value in found.base if "encoder_offset.elbow" in value.name)
    assert elbow.determined
    assert elbow.largest == np.pi
    said = str(replace(found, base=(replace(elbow, stderr=5.0),)))
    assert "without effect on any torque: encoder_offset.yaw.delta" in said
    assert "identifies 0 base parameters" in said
    assert "above any plausible value: encoder_offset.elbow.delta" in said


def test_prints_and_draws(found, tmp_path):
    _, x = found
    text = str(x)
    for word in (*x.series, "condition number", "of range", "expected ±", "at rest"):
        assert word in text
    page = x._repr_html_()
    assert all(f'<th scope="row">{name}</th>' in page for name in x.series)
    assert page.count('<th scope="row">') >= len(x.base)
    assert len(x.plot().axes) == 4 * len(x.series)
    x.write(tmp_path / "out.csv")
    again = ident.read_log(tmp_path / "out.csv")
    np.testing.assert_array_equal(again.t, x.log.t)


def test_the_search_stays_inside_and_gains():
    problem = DesignProblem(ident.load(ROBOTS / "five_bar"), Limits(), 6.0, 2, {}, 0)
    criterion = problem.criterion(None, 0.5)
    start = problem.draw(np.random.default_rng(0), criterion)
    *steps, found = search.ascent(problem, start, criterion)
    assert found.J > start.J + 0.1
    for each in (*steps, found):
        assert problem.exact.excess(problem.box.z(each.rows.e)).max() < 0


def test_a_motion_far_beyond_a_limit_between_its_samples_is_shrunk_until_it_keeps_all():
    """Twenty steps of 1 % are not enough for it: gravity's part of a torque does not shrink."""
    problem = DesignProblem(ident.load(ROBOTS / "arm"), ROOM["arm"], 6.0, 2, {}, 0)
    x, _ = problem.family.draw(problem.box, np.random.default_rng(0))
    found = problem.inside(3.0 * x, 50.0)
    assert 0.1 < np.linalg.norm(found) / np.linalg.norm(3.0 * x) < 0.8
    fine = problem.family.at(6.0 * np.arange(300) / 300)
    motion, _ = fine.grow(found, lambda rows: problem.exact.broken(problem.exact.z(rows.e)) is None)
    np.testing.assert_allclose(motion, found)


@pytest.mark.parametrize(
    ("name", "effect"), [("arm", "coulomb"), ("four_bar", ""), ("arm", "hysteresis:elbow")]
)
def test_slopes_are_those_of_differences(name, effect):
    """Of an effect of the sample alone, a loop, and an effect with a memory."""
    mechanism = ident.load(ROBOTS / name)
    mechanism = mechanism.with_effect(effect) if effect else mechanism
    problem = DesignProblem(mechanism, Limits(), 6.0, 3, {}, 0)
    criterion, random = problem.criterion(None, 0.5), np.random.default_rng(1)
    c = problem.draw(random, criterion)
    dJ, dz = problem.slopes(c, criterion)
    d = 1e-5 * random.normal(size=c.x.shape)
    a, b = (
        problem.candidate(x, problem.family.motion(x, c.rows.e), criterion)
        for x in (c.x + d, c.x - d)
    )
    assert dJ @ d.ravel() == pytest.approx(0.5 * (a.J - b.J), rel=5e-3)
    change = 0.5 * (a.z - b.z)
    np.testing.assert_allclose(dz @ d.ravel(), change.ravel(), atol=1e-3 * np.abs(change).max())


def test_motions_before_the_end_keep_the_limits_too(monkeypatch):
    """All are handed out; each is better than the one before."""
    monkeypatch.setattr(search, "HAND_OUT_INTERVAL", 0.0)
    seen: list[Excitation] = []
    x = ident.excite(ident.load(ROBOTS / "arm"), better=seen.append, **SHORT)
    assert x.finished
    assert not any(each.finished for each in seen)
    assert len(seen) > 3
    assert x.log_det >= max(each.log_det for each in seen) - 0.1 * len(x.base)
    for each in (*seen, x):
        assert all(use.lower <= use.low <= use.high <= use.upper for use in each.uses)


HAND = """<robot name="hand"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="left"><inertial><origin xyz="0.02 0 0.01"/><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="right"><inertial><origin xyz="0.02 0 0.01"/><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3.07" upper="-0.07" effort="50" velocity="2"/></joint>
<joint name="finger" type="prismatic"><parent link="arm"/><child link="left"/>
<origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>
<joint name="other" type="prismatic"><parent link="arm"/><child link="right"/>
<origin xyz="0.4 0 0"/><axis xyz="0 -1 0"/>
<limit lower="0" upper="0.04" effort="20" velocity="0.2"/><mimic joint="finger"/></joint></robot>"""


@pytest.mark.usefixtures("few_steps")
@pytest.mark.parametrize("locked", [{}, {"finger": 0.02}], ids=["driven", "held"])
def test_a_hand_whose_start_is_outside_a_range(tmp_path, locked):
    (tmp_path / "hand.urdf").write_text(HAND)
    mechanism = ident.load(tmp_path / "hand.urdf", locked=locked)
    x = ident.excite(mechanism, duration=4.0, periods=1, harmonics=2, tries=1)
    use = x.use("elbow", "position")
    assert -3.07 < use.low < use.high < -0.07
    assert any("elbow starts outside its range" in note for note in x.notes)


@pytest.mark.usefixtures("few_steps")
def test_a_delay_in_the_model_does_not_stop_the_search():
    """Limits are checked sample by sample, and of one sample no delayed torque is known."""
    mechanism = ident.load(ROBOTS / "arm").with_effect("delay:wrist")
    found = ident.excite(mechanism, duration=6.0, harmonics=2, tries=1)
    assert found.log.columns["tau.wrist"].any()
