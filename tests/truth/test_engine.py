"""Every piece of a diagnosis on small planted logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import Diagnosis, Fit, Mechanism, Motion, Noise
from ident.assess.experiment import MoveSlowly, next_experiment
from ident.diagnosis.candidates import Contest, candidates_of
from ident.diagnosis.diagnosis import by_rivals, least_error
from ident.diagnosis.grow import undetermined
from ident.diagnosis.law_search import refined
from ident.diagnosis.null import path_shares, with_noise
from ident.diagnosis.search import NEAR
from ident.diagnosis.selection import Ranking, can_be, rank
from ident.effects import Effect, ReversalPulses, Signals, Unknown
from ident.equations.table import Table
from ident.faults.small_errors import GUARD, away_from_reversals
from ident.information.evidence import Chance
from identification import Planted, motion_log, plant, robot

NOISE = (Noise("tau", 0.01, relative=True), Noise("q", 1e-5))
ELBOW = {"viscous.elbow.Fv": 0.4, "coulomb.elbow.Fc": 0.5}
TWO = {"viscous.shoulder.Fv": 1.0, "coulomb.elbow.Fc": 0.5}
ONE = {
    "coulomb:elbow": {"coulomb.elbow.Fc": 0.5},
    "viscous:shoulder": {"viscous.shoulder.Fv": 1.0},
    "drag:wrist": {"drag.wrist.Fd": 0.05},
    "torque_offset:wrist": {"torque_offset.wrist.c": 0.3},
    "coupling:elbow,wrist": {
        f"coupling.elbow,wrist.{name}": x for name, x in (("Im", 0.02), ("Fvm", 0.2), ("Fcm", 0.2))
    },
}


def planted(
    effects: Sequence[str | Effect] = (), values: Mapping[str, float] | None = None, seed: int = 0,
    name: str = "arm",
) -> Planted:  # fmt: skip
    """A log of a robot with these effects."""
    mechanism = robot(name)
    for effect in effects:
        mechanism = mechanism.with_effect(effect) if isinstance(effect, str) else mechanism + effect
    return plant(mechanism, motion_log(name, 100.0, 8.0), values, noise=NOISE, seed=seed)


def logged(case: Planted, mechanism: Mechanism) -> Motion:
    return ident.complete(mechanism, case.log)


def diagnosed(case: Planted, *present: str) -> Diagnosis:
    """By a model with none of the log's effects but these; progress never runs backward."""
    mechanism, shares = robot("arm"), list[float]()
    for effect in present:
        mechanism = mechanism.with_effect(effect)
    fit = ident.identify(mechanism, logged(case, mechanism))
    found = ident.diagnose(fit, progress=lambda what, share: shares.append(share))
    assert shares == sorted(shares)
    return found


@cache
def clean(seed: int = 0) -> Diagnosis:
    return diagnosed(planted(seed=seed))


def contest_of(case: Planted) -> Contest:
    return Contest.of(case.fit(cutoff="auto"), [], lambda what, share: None, curved=False)


# --- rows and noise ----------------------------------------------------------------------------


def test_rows_at_reversals_are_left_out():
    table = contest_of(planted()).table
    told, e = away_from_reversals(table), table.scenes[0].e
    for u in range(4):  # of a tree each row feels its own joint alone
        turns = np.flatnonzero(np.diff(np.sign(e.yd[:, u])))
        away = np.abs(table.t[:, None] - e.t[turns]).min(axis=1)
        assert told[away > 4 * GUARD, u].all()
        assert not told[away < 0.3 * GUARD, u].any()
        assert 0.5 <= told[:, u].mean() < 1


def test_in_a_loop_a_row_feels_all_joints_that_move_with_it():
    """Not those that turn back because they have no leverage there: their friction is not felt."""
    t = np.arange(800) / 100
    crank = [0.4 * np.sin(3 * t), 1.2 * np.cos(3 * t), -3.6 * np.sin(3 * t)]
    columns = {f"{c}.crank": x for c, x in zip("qva", crank, strict=True)}
    case = plant(robot("four_bar"), ident.Log.from_arrays("to and fro", t, columns), noise=NOISE)
    table = contest_of(case).table
    told, e = away_from_reversals(table), table.scenes[0].e
    assert e.loop is not None
    felt = 0
    for name in ("crank", "coupler", "rocker"):
        j = table.mechanism.joint_index[name]
        lever = np.abs(e.leverage[:, j, 0])
        for at in np.flatnonzero(np.diff(np.sign(e.yd[:, j]))):
            if lever[at] > 0.2 * lever.max():
                felt += 1
                assert not told[np.abs(table.t - e.t[at]) < 0.01].any()
    assert felt > 3


def test_blocks_are_stretches_of_time():
    contest = contest_of(planted())
    assert (np.diff(contest.table.blocks) >= 0).all()
    regression = contest.regression
    inside = sum(float((y[:, 0] ** 2).sum()) for y in regression.residual)
    assert regression.loss.sum() > inside  # held out is worse than fitted
    G = sum(q.T @ q for q in regression.Q)
    np.testing.assert_allclose(G, np.eye(len(G)), atol=1e-12)


@pytest.mark.parametrize("name", ["arm", "four_bar"])
def test_the_noise_floor_is_that_of_the_true_noise(name):
    """Of logs in which nothing is missing, the residual's own size, averaged over seeds."""
    ratios = []
    for seed in range(6):
        contest = contest_of(planted(name=name, seed=seed))
        regression = contest.regression
        true = np.sqrt(regression.losses.sum(axis=0) / regression.rows) / regression.weight
        ratios.append(with_noise(replace(contest, seed=seed)).draws.floor / true)
    np.testing.assert_allclose(np.exp(np.mean(np.log(ratios), axis=0)), 1.0, atol=0.15)


def test_the_noise_floor_is_reproducible():
    contest = contest_of(planted())
    first, again, other = (with_noise(replace(contest, seed=s)).draws for s in (0, 0, 1))
    np.testing.assert_array_equal(first.rows, again.rows)
    assert not np.array_equal(first.rows, other.rows)


# --- names -------------------------------------------------------------------------------------


def test_presliding_is_named_by_the_reversals_that_it_shows_in():
    """Its residual lies where rows are left out for others, and a late channel looks like it."""
    present, hidden = (
        ("viscous:elbow", "coulomb:elbow"),
        {"sigma": 30.0, "z0": 0.01},
    )  # N m/rad, rad
    values = {**ELBOW, **{f"hysteresis.elbow.{name}": x for name, x in hidden.items()}}
    d = diagnosed(planted([*present, "hysteresis:elbow"], values), *present)
    contest = d.selection.first.contest
    turning = contest.use & ~away_from_reversals(contest.table)
    assert turning.any(axis=0).tolist() == [False, False, True, False]
    assert [each.label for each in d.group] == ["hysteresis:elbow"]


def test_what_only_rows_at_reversals_show_is_undecided():
    """Friction that has fallen before the joint has left the standstill."""
    friction = {"Fs": 4.0, "vs": 0.01}  # N m, rad/s
    values = {**ELBOW, **{f"stribeck.elbow.{name}": x for name, x in friction.items()}}
    present = "viscous:elbow", "coulomb:elbow"
    d = diagnosed(planted([*present, "stribeck:elbow"], values), *present)
    assert (d.verdict, d.reversing, d.loud) == ("undecided", True, ("elbow",))
    (move,) = next_experiment(d).suggestions
    assert isinstance(move, MoveSlowly)
    assert [joint for joint, _ in move.speeds] == ["elbow"]


def test_pulses_at_reversals_are_the_moments_of_friction_that_is_early():
    """∫ (sign(v + T a) − sign(v)) dt = 2 T at a reversal, as of T d/dt sign(v)."""
    t = np.linspace(-1.0, 1.0, 2001)
    v, one = np.sin(3 * t)[:, None], np.ones((2001, 1))
    s = Signals(t=t, q=0 * one, v=v, a=one, still=np.array([0.02]))
    first, second = (ReversalPulses(("a",)).columns(s)[:, 0] * 1e-3).T
    assert first.sum() == pytest.approx(2.0, rel=1e-6)
    assert second.sum() == pytest.approx(0.0, abs=1e-6)
    assert second @ t == pytest.approx(-2.0, rel=1e-3)


def test_lengths_are_judged_on_several_logs_as_on_one():
    arm = robot("arm")
    fit = ident.identify(arm, ident.complete(arm, [planted(seed=seed).log for seed in (0, 1)]))
    contest = Contest.of(fit, candidates_of(fit), lambda what, share: None, curved=False)
    assert not contest.failed
    lengths = [each for each in contest.candidates if each.effect.kind == "geometry"]
    assert len(lengths) == 3
    assert contest.regression.gains([each.groups[0] for each in lengths]).visible.max() > 0.01


def test_a_candidate_with_impossible_values_hides_no_credible_one():
    """The largest gain is that of viscous friction below zero, which no machine has."""
    values = {"viscous.shoulder.Fv": -3.0, "spring.wrist.k": 1.0, "spring.wrist.b": 0.0}
    case = planted(["viscous:shoulder", "spring:wrist"], values)
    fit = ident.identify(robot("arm"), logged(case, robot("arm")))
    contest = Contest.of(fit, candidates_of(fit), lambda what, share: None, curved=False)
    found = rank(with_noise(contest), curved=False, least=NEAR)
    assert found.evidence[0].effect.label == "viscous:shoulder"
    assert not found.evidence[0].credible
    assert "spring:wrist" in [each.effect.label for each in found.credible]


@pytest.mark.parametrize("label", ONE)
def test_one_missing_effect_is_named_at_its_joint(label):
    d = diagnosed(planted([label], ONE[label]))
    assert d.verdict == "missing"
    assert d.best is not None
    assert d.best.label == label
    for value in d.candidates[0].parameters:
        assert value.stderr is not None
        assert abs(value.value - ONE[label][value.name]) < max(4 * value.stderr, 1e-3)
    concerned = label.partition(":")[2].split(",")
    for joint in concerned:
        assert d.candidates[0].after[joint].rms < 1.3 * d.floor[joint]


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_named_where_nothing_is_missing(seed):
    d = clean(seed)
    assert d.verdict == "nothing"
    assert d.best is None
    assert d.rivals == ()
    assert d.laws == ()
    assert d.curves == ()


def test_growing_stops_when_both_are_found():
    case = planted(["viscous:shoulder", "coulomb:elbow"], TWO)
    told = []
    history = ident.grow(robot("arm"), logged(case, robot("arm")), step=told.append)
    assert [effect.label for effect in history.added] == ["viscous:shoulder", "coulomb:elbow"]
    assert len(history.steps) == len(told) == 3
    assert history.diagnosis.verdict == "nothing"
    sizes = [sum(e.rms**2 for e in step.errors.values()) for step in history.steps]
    assert sizes[0] > sizes[1] > sizes[2]


# --- what is hidden, and what should go --------------------------------------------------------


def test_what_a_link_s_inertia_absorbs_is_invisible():
    hidden = {each.effect.label: each.why for each in clean().invisible}
    assert hidden["rotor_inertia:yaw"] == "absorbed: same columns as turret.Lzz"
    assert hidden["payload:hand"].startswith("absorbed: same columns as hand's own parameters")
    assert "coulomb:elbow" not in hidden
    tried = set(clean().selection.first.gains)
    assert "rotor_inertia:elbow" in tried - set(hidden)


def test_an_effect_that_is_not_there_is_unsupported():
    d = diagnosed(planted(), "coulomb:wrist")
    (idle,) = d.unsupported
    assert idle.effect.label == "coulomb:wrist"
    assert not idle.absurd
    assert idle.why.startswith("without it the held-out error")
    assert "mechanism.without('coulomb:wrist')" in d.text


def test_an_effect_that_is_there_is_supported():
    d = diagnosed(planted(["coulomb:elbow"], ONE["coulomb:elbow"]), "coulomb:elbow")
    assert d.unsupported == ()


def test_negative_friction_is_absurd():
    case = planted(["coulomb:wrist"], {"coulomb.wrist.Fc": -0.3})
    (absurd,) = diagnosed(case, "coulomb:wrist").unsupported
    assert absurd.effect.label == "coulomb:wrist"
    assert absurd.absurd
    assert "coulomb.wrist.Fc is negative beyond its error" in absurd.why


# --- outside the library -----------------------------------------------------------------------


def test_what_is_outside_the_library_is_unexplained_with_an_expression():
    odd = ident.user_effect("odd", lambda s: {"A": ca.sin(3 * s.q) * ca.sign(s.v)})
    d = diagnosed(planted([odd(("elbow",))], {"odd.elbow.A": 0.6}))
    assert d.verdict == "unexplained"
    assert d.best is None
    (law,), (curve,) = d.laws, d.curves
    assert law.joint == "elbow"
    assert law.formula == "k1*sin(n*q)*sign(v) + k2*cos(n*q)*sign(v)"
    values = {v.name.rpartition(".")[2]: v for v in law.parameters}
    assert values["n"].value == pytest.approx(3.0, abs=0.1)
    assert np.hypot(values["k1"].value, values["k2"].value) == pytest.approx(0.6, rel=0.05)
    assert curve.effect.label == "curve:elbow:q*sign"
    assert curve.depends == ("q", "v")


def test_a_law_of_the_wrong_form_is_no_name():
    """Dry friction that differs over the turn: Coulomb explains a part, a curve much beside it."""
    odd = ident.user_effect("odd", lambda s: {"A": ca.sin(2 * s.q) ** 2 * ca.sign(s.v)})
    d = diagnosed(planted([odd(("elbow",))], {"odd.elbow.A": 0.8}))
    assert d.verdict == "unexplained"
    assert d.best is None
    assert d.rivals == ()
    assert any(curve.effect.joints[0] == "elbow" for curve in d.curves)


class Late(Effect):
    """Viscous friction of a film that builds up in 0.4 s: a torque that lags behind the speed."""

    kind = "late"
    unknowns = (Unknown("F", ("N m s/rad", "N s/m"), "friction", acts="linear"),)
    equation, signature, source = "F x, 0.4 s ẋ = v − x", "a lag", "a test"
    memory = True

    def columns(self, s: Signals) -> np.ndarray:
        share = -np.expm1(-np.diff(s.t, append=s.t[-1:]) / 0.4)[:, None]
        x = s.v.copy()
        for k in range(len(x) - 1):
            x[k + 1] = x[k] + share[k] * (s.v[k] - x[k])
        return x[:, :, None]


@pytest.mark.parametrize(("joint", "value"), [("elbow", 0.6), ("elbow", 0.2), ("yaw", 1.0)])
def test_a_torque_that_lags_behind_the_speed_is_no_friction_without_memory(joint, value):
    """0.2 N m s/rad in the elbow look like friction of the shoulder."""
    d = diagnosed(planted([Late((joint,))], {f"late.{joint}.F": value}))
    assert d.verdict == "unexplained"
    assert not d.laws
    assert any(m.curve is not None and m.curve.signal == "past v" for m in d.selection.members)


def test_three_effects_at_one_joint_are_found_one_by_one():
    """No expression of signals takes the name from effects that do it together."""
    values = {**ELBOW, "torque_offset.elbow.c": 0.4}
    case = planted(("viscous:elbow", "coulomb:elbow", "torque_offset:elbow"), values)
    history = ident.grow(robot("arm"), logged(case, robot("arm")))
    assert history.added[0].label in ("viscous:elbow", "coulomb:elbow")
    assert {e.label for e in history.added} == {
        "viscous:elbow", "coulomb:elbow", "torque_offset:elbow"
    }  # fmt: skip
    assert history.diagnosis.verdict == "nothing"
    for name, value in values.items():
        assert history.fit[name].value == pytest.approx(value, rel=0.05)


def test_of_many_rows_one_in_so_many_decides(monkeypatch):
    case = planted(("coulomb:elbow",), ELBOW)
    fit = ident.identify(robot("arm"), logged(case, robot("arm")))
    whole = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    monkeypatch.setattr("ident.equations.table.TABLE", len(whole.t) // 2)
    some = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    assert len(some.t) < 0.6 * len(whole.t)
    shared = np.isin(whole.sample, some.sample)
    np.testing.assert_array_equal(some.A, whole.A[shared])
    effect = ident.effect("coulomb", "elbow")
    columns = [table.effect_columns(effect, [{}])[0] for table in (some, whole)]
    np.testing.assert_allclose(columns[0], columns[1][shared], atol=1e-12)
    assert ident.diagnose(fit).candidates[0].effect.label == "coulomb:elbow"


@pytest.mark.parametrize("name", ["arm", "five_bar"])
@pytest.mark.parametrize(
    ("kind", "off"),
    [("coulomb", 0.1), ("spring", 0.01), ("ripple", 0.01), ("encoder_offset", 0.01)],
)  # steps are between samples
def test_fewer_samples_make_nearly_the_same_columns(name, kind, off):
    mechanism = ident.load(ROBOTS / name)
    effect = ident.effect(kind, mechanism.driven[1])  # an offset about a vertical axis is nothing
    log = ident.read_log(ROBOTS / name / "run.csv")
    motions = ident.complete(mechanism, [log, log], cutoff=6.0)
    fit = ident.identify(mechanism, motions)
    table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    assert table.coarse.every > 2
    shape = dict(table.starts(effect)[0])
    few, every = (x.effect_columns(effect, [shape])[0] for x in (table.coarse, table))
    assert np.linalg.norm(few - every) < off * np.linalg.norm(every)


def test_three_effects_of_which_none_is_credible_alone_are_found_together():
    """One slow law explains random residuals of that spectrum as well; three do not."""
    labels = ("ripple:elbow", "spring:elbow", "stribeck:elbow")
    values = {
        "ripple.elbow.A": 0.225, "ripple.elbow.B": 0.15, "ripple.elbow.N": 9.0,
        "spring.elbow.k": 0.75, "spring.elbow.b": 0.075,
        "stribeck.elbow.Fs": 0.45, "stribeck.elbow.vs": 0.3,
    }  # fmt: skip
    d = diagnosed(planted(labels, values))
    assert d.selection.first.credible == ()
    assert {m.label for m in d.selection.named} == set(labels)
    path = [m for m in d.selection.named if m.path is not None]
    assert path
    assert {effect.label for effect in d.group} == {m.label for m in path}  # added as a whole
    for m in path:
        assert m.evidence is not None
        assert m.evidence.credible
        assert m.path <= m.evidence.p <= 0.01**2


def test_a_path_explains_what_its_groups_explain_together():
    contest = clean().selection.first.contest
    regression = contest.regression
    laws = [e for e in contest.laws if regression.place(e.groups[0]) == 2]
    groups = [each.groups[0] for each in laws][:12]
    (shares,) = path_shares(regression, 2, [[g] for g in groups], 3, 0).T
    (part,) = (i for i, p in enumerate(regression.parts) if p.coordinate == 2)
    first = max(groups, key=lambda g: regression.refit(g).by[2])
    whole = float((regression.residual[part][:, 0] ** 2).sum())
    assert shares[0] == pytest.approx(regression.refit(first).by[2] / whole, rel=0.05)
    assert shares[0] <= shares[1] <= shares[2] <= 1 + 1e-9


def test_a_searched_shape_is_refined_from_several_starts():
    case = planted(
        ["ripple:elbow"], {"ripple.elbow.A": 0.5, "ripple.elbow.B": 0.1, "ripple.elbow.N": 9.0}
    )
    fit = ident.identify(robot("arm"), logged(case, robot("arm")))
    contest = Contest.of(fit, candidates_of(fit), lambda what, share: None, curved=False)
    regression = contest.regression
    wave = next(e for e in contest.candidates if e.effect.label == "ripple:elbow")
    none = Chance({}, {}, 0.01)
    gains = {wave.effect.label: (1.0, 1.0, 0)}
    ranking = Ranking(contest, (), gains, {}, {}, (), none, none, ())
    falls = regression.explained(regression.gains(wave.groups).by)
    order = np.argsort(-falls).tolist()
    worst, best = order[-1], order[0]
    lost = refined(contest, wave.effect, wave.shapes[worst])
    (found,) = ranking.looked_at([wave], [[worst, best]])
    assert found.shape["N"] == pytest.approx(9.0, rel=0.01)
    assert found.gain > regression.gain(lost[2])


def test_a_rival_stands_in_where_the_first_name_is_no_cause():
    d = diagnosed(planted(["coulomb:elbow"], {"coulomb.elbow.Fc": 0.5}))
    first = d.selection.named[0]
    assert first.evidence is not None
    others = [e for e in d.selection.first.evidence if e.effect.label != first.label][:2]
    several = replace(d.selection, members=(replace(first, rivals=tuple(others)),))
    names = [each.named[0] for each in by_rivals(several)]
    assert [each.label for each in names][:1] == [first.label]
    assert {each.label for each in names} == {first.label, *(e.effect.label for e in others)}
    for each in names:
        assert each.label not in {e.effect.label for e in each.rivals}
    assert not [*by_rivals(replace(d.selection, members=()))]


@pytest.mark.parametrize(
    ("kind", "sites", "exchanged"),
    [("payload", ("forearm", "hand"), True), ("coulomb", ("elbow", "wrist"), False)],
)
def test_the_link_that_leaves_the_least_error_carries_the_load(kind, sites, exchanged):
    """Of other effects chance decides too much of the error for that."""
    d = diagnosed(planted(["coulomb:elbow"], {"coulomb.elbow.Fc": 0.5}))
    one, two = (robot("arm").with_effect(f"{kind}:{site}").effects[-1] for site in sites)
    found = d.selection.named[0].evidence
    assert found is not None
    mine, rival = replace(found, effect=one), replace(found, effect=two)
    first = replace(d.selection.named[0], effect=one, evidence=mine, rivals=(rival,))
    selection, own = replace(d.selection, members=(first,)), replace(d.candidates[0], effect=one)
    halved = {j: replace(e, rms=e.rms / 2) for j, e in own.after.items()}
    other = replace(own, effect=two, evidence=rival, after=halved)
    better = least_error(selection, [own, other])
    assert (better is not None) == exchanged
    if better is not None:
        assert [m.label for m in better.named] == [two.label]
        assert [e.effect.label for e in better.named[0].rivals] == [one.label]
    assert least_error(selection, [own, replace(other, after=own.before)]) is None


@cache
def low_speed() -> Fit:
    """A fit without the shoulder's friction at low speed, most of which is at reversals."""
    friction = robot("arm").with_effect("viscous").with_effect("coulomb")
    values = {f"{kind}.{j}.{c}": 1.0 for kind, c in (("viscous", "Fv"), ("coulomb", "Fc"))
              for j in friction.driven}  # fmt: skip
    own = {"stribeck.shoulder.Fs": 4.0, "stribeck.shoulder.vs": 0.04}
    noise = (Noise("tau", 0.002, relative=True), Noise("q", 1e-5))
    case = plant(friction.with_effect("stribeck:shoulder"), motion_log("arm", 100.0, 16.0),
                 values | own, noise=noise, seed=1)  # fmt: skip
    return ident.identify(friction, logged(case, friction))


def test_what_rows_away_from_reversals_and_rows_at_them_show_is_named(monkeypatch):
    d = ident.diagnose(low_speed())
    assert d.best is not None
    assert d.best.label == "stribeck:shoulder"
    assert d.after["shoulder"].rms < 0.5 * low_speed().held_out["shoulder"].rms
    # by rows at reversals alone it is not
    monkeypatch.setattr("ident.diagnosis.diagnosis.seen_elsewhere", lambda first: set())
    assert ident.diagnose(low_speed()).best is None


def test_grow_adds_what_both_kinds_of_rows_show():
    fit = low_speed()
    assert [e.label for e in ident.grow(fit.mechanism, fit.motion).added] == ["stribeck:shoulder"]


def test_what_the_fit_does_not_determine_is_dropped_first():
    case = planted(["coulomb:elbow"], {"coulomb.elbow.Fc": 0.5})
    model = robot("arm").with_effect("coulomb:elbow").with_effect("torque_offset")
    fit = ident.identify(model, logged(case, model))
    small = {
        e.effect.label
        for e in fit.effects
        if all(abs(v.value) < (v.stderr or 0.0) for v in e.parameters)
    }
    assert small
    assert "coulomb:elbow" not in small
    assert undetermined(fit, [e.effect for e in fit.effects]) in small
    assert undetermined(fit, [e.effect for e in fit.effects if e.effect.label not in small]) == ""


def test_values_that_cannot_be():
    """A length is off by a third at most, and dry friction is not negative beyond its error."""
    arm = ident.load(ROBOTS / "arm")
    place, length = max(arm.lengths.items(), key=lambda pair: abs(pair[1]))
    moved, dry = ident.effect("geometry", place), ident.effect("coulomb", "elbow")
    for effect, value, error, possible in [
        (moved, 0.2 * length, 0.0, True), (moved, 0.4 * length, 0.0, False),
        (dry, -0.1, 0.1, True), (dry, -0.3, 0.1, False),
    ]:  # fmt: skip
        assert can_be(arm, effect, np.array([value]), np.array([error])) == possible
