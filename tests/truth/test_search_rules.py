"""Rules of the search for missing effects, each on a log in which it decides."""

from types import SimpleNamespace

import numpy as np
import pytest

import ident
from helpers import ROBOTS, J, tree_urdf, write_mechanism
from ident import Log, Noise
from ident.diagnosis.candidates import Contest, candidates_of
from ident.diagnosis.effect_set import Member, leader, leading
from ident.diagnosis.null import with_noise
from ident.diagnosis.search import Search
from ident.diagnosis.selection import has_mass, may_be_load, sensible
from identification import motion_log, plant, robot

FRICTION = ("viscous", "coulomb")


def grown(*effects):
    """The arm with effects."""
    mechanism = robot("arm")
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    return mechanism


def fitted(truth, model, seconds, values, torque, cutoff="auto"):
    """Of a log of the truth, whose torques have noise of a share `torque` of their rms."""
    sensors = (Noise("tau", torque, relative=True), Noise("q", 1e-5))
    case = plant(truth, motion_log("arm", 200.0, seconds), values, noise=sensors, seed=3)
    return case.fit(mechanism=model, cutoff=cutoff)


def contest_of(fit):
    return Contest.of(fit, candidates_of(fit), lambda what, share: None, curved=False)


# --- rows at reversals ------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "cutoff", "pulsed"), [(0.05, 20.0, True), (0.3, 6.0, False)])
def test_pulses_give_way_to_friction_that_builds_up_over_much_speed(width, cutoff, pulsed):
    """Of the elbow alone, whose top speed is 2.3 rad/s; the other joints have none."""
    values = {"coulomb.elbow.Fc": 3.0, "friction_width.elbow.Fw": 3.0,
              "friction_width.elbow.w": width}  # fmt: skip
    model = grown(*FRICTION)
    fit = fitted(grown(*FRICTION, "friction_width:elbow"), model, 8.0, values, 0.01, cutoff)
    contest = contest_of(fit)
    felt = {p.coordinate for p in contest.regression.parts if p.taken(contest.pulses).any()}
    assert felt == ({fit.motion.independent.index("elbow")} if pulsed else set())


# --- few rows -----------------------------------------------------------------------------------


def missing_friction(seconds, size, torque):
    truth = grown(*FRICTION)
    values = {name: size for effect in truth.effects for name in effect.names}
    return fitted(truth, robot("arm"), seconds, values, torque)


def test_friction_of_all_joints_enters_where_all_that_is_common_is_too_much_for_the_rows():
    contest = with_noise(contest_of(missing_friction(2.2, 0.2, 0.06)))
    search = Search(contest, (), lambda what, share: None)
    search.ranked(search.start)
    every, *_ = search.candidate_groups(search.start)
    assert {m.effect.kind for m in every.members} > {*FRICTION}
    assert not search.beyond_chance(search.start, every)
    found = search.add_common(search.start).members  # of a small joint's, which is not small there
    assert {m.label for m in found} == {"viscous:wrist", "coulomb:wrist"}


def test_what_has_the_columns_of_parameters_that_are_held_is_no_candidate():
    """Missing friction hides an inertia of the shoulder's, which its rotor would have."""
    fit = missing_friction(2.0, 1.0, 0.05)
    assert any(name.endswith(".Lyy") for name in np.array(fit.columns.names)[fit.estimate.fixed])
    contest = contest_of(fit)
    failed = {effect.label: why for effect, why in contest.failed}
    assert "held at their priors" in failed["rotor_inertia:shoulder"]
    left = {each.effect.label for each in contest.candidates}
    assert "rotor_inertia:shoulder" not in left
    assert {f"coulomb:{joint}" for joint in fit.mechanism.driven} <= left


# --- names --------------------------------------------------------------------------------------


def members(*labels):
    """Members of a set, with effects of the library on the arm."""
    effects = (grown(label).effects[-1] for label in labels)
    return [Member(effect, np.array([i])) for i, effect in enumerate(effects)]


@pytest.mark.parametrize(
    ("gains", "first"),
    [
        ((1.0, 0.95, 0.93), "coulomb:elbow"),  # within a tenth of the best
        ((1.0, 0.85, 0.85), "ripple:elbow"),
        ((1.0, 0.0, 0.93), "viscous:elbow"),  # dry friction is not credible alone
    ],
)
def test_what_every_machine_has_is_named_first_where_it_explains_as_much(gains, first):
    named = members("ripple:elbow", "coulomb:elbow", "viscous:elbow")
    alone = [SimpleNamespace(effect=m.effect, gain=g) for m, g in zip(named, gains, strict=True)]
    ranking = SimpleNamespace(credible=[each for each in alone if each.gain])
    assert leader(named, ranking).label == first


def test_a_machine_takes_up_one_load_at_a_time():
    """Effects of one kind are added together, loads are not."""
    friction = members("coulomb:elbow", "viscous:elbow", "coulomb:wrist")
    assert [m.label for m in leading(friction)] == ["coulomb:elbow", "coulomb:wrist"]
    loads = members("payload:hand", "payload:forearm", "coulomb:elbow")
    assert [m.label for m in leading(loads)] == ["payload:hand"]


def test_a_tilt_beyond_its_range_by_more_than_that_is_wide_is_not_sensible():
    contest = contest_of(missing_friction(2.2, 0.2, 0.06))
    (tilt,) = (e for e in contest.candidates if e.effect.kind == "gravity_tilt")
    for x, possible in ((0.3, True), (0.9, True), (1.2, False), (-32.5, False)):
        values = np.array([x, 0.0])
        assert sensible(contest, tilt.effect, values, np.full(2, 0.01)) == possible


# --- end stops ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("share", "named"), [(0.35, False), (0.75, True)])
def test_an_end_stop_in_the_middle_of_the_travel_is_no_name(tmp_path, share, named):
    """A joint does not pass through a stop."""
    urdf = tree_urdf([J("hinge", axis="0 1 0")])
    mechanism = ident.load(write_mechanism(tmp_path, urdf)).with_effect("viscous")
    t = np.arange(0.0, 6.0, 0.01)
    w = 2 * np.pi * np.array([0.25, 0.6, 1.1])
    q = np.sin(np.outer(t, w)) @ [0.8, 0.4, 0.2]
    at = float(q.min() + share * np.ptp(q))
    stop = {"end_stop.hinge.k": 5.0, "end_stop.hinge.q1": at, "end_stop.hinge.side": 1.0}
    sensors = (Noise("tau", 0.01, relative=True), Noise("q", 1e-5))
    motion = Log.from_arrays("run.csv", t, {"q.hinge": q})
    case = plant(mechanism.with_effect("end_stop:hinge"), motion, stop, noise=sensors, seed=1)
    found = ident.diagnose(case.fit(mechanism=mechanism, cutoff="auto"))
    assert (found.best is not None and found.best.kind == "end_stop") is named
    assert found.verdict == ("missing" if named else "unexplained")


def test_ten_values_are_a_load_where_some_body_has_them():
    """A first moment shows one whose mass is open; not one farther off than the machine reaches."""
    mechanism = ident.load(ROBOTS / "arm")
    mass, lever = 1.5, np.array([0.02, 0.08, -0.05])
    moments = mass * (lever @ lever - lever**2) + 1e-3
    products = -mass * lever[[0, 0, 1]] * lever[[1, 2, 2]]
    inertia = [moments[0], products[0], moments[1], *products[1:], moments[2]]
    values = np.array([mass, *(mass * lever), *inertia])
    stderr = np.full(10, 1e-3)
    assert has_mass(mechanism, values, stderr)
    is_open = stderr.copy()
    is_open[0] = 2.0
    assert has_mass(mechanism, values, is_open)
    far = np.array([0.01, *values[1:]])
    assert not has_mass(mechanism, far, stderr)
    no_inertia = np.where(np.arange(10) < 4, values, 0.0)
    is_open[0], no_inertia[0] = 0.1, 0.1
    assert not has_mass(mechanism, no_inertia, is_open)
    assert may_be_load(values, stderr)
    assert may_be_load(-values, stderr)  # taken off
    light = np.where(np.arange(10) == 6, 1e-3, values)  # Lyy that no mass at that place has
    assert not may_be_load(light, stderr)
    assert may_be_load(light, np.where(np.arange(10) == 6, 0.0, stderr))  # not determined


# --- gravity that a controller has subtracted -----------------------------------------------------


@pytest.mark.parametrize("subtracted", [True, False])
def test_gravity_of_the_given_bodies_that_torques_lack_is_named(subtracted):
    """Of bodies that are a tenth other than the true ones, which neither gravity nor none fits."""
    model = grown(*FRICTION)
    true = model.with_effect("gravity_compensation")
    values = {name: 0.5 for effect in model.effects for name in effect.names}
    values["gravity_compensation.k"] = float(subtracted)
    sensors = (Noise("tau", 0.003, relative=True), Noise("q", 1e-5))
    motion = motion_log("arm", 200.0, 10.0)
    fit = plant(true, motion, values, noise=sensors, seed=3, spread=0.1).fit(mechanism=model)
    diagnosis = ident.diagnose(fit)
    named = diagnosis.best.kind if diagnosis.best else ""
    assert named == ("gravity_compensation" if subtracted else "")
