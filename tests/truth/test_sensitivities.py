"""Columns of shape parameters: slopes of E c, and of what a correction changes in the equations."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident.effects import KINDS, Correcting
from ident.equations.rows import Scene
from ident.equations.terms import residual
from ident.equations.unknowns import Columns, Point
from ident.fit.shapes import beyond_bounds, working_point
from identification import motion_log, plant, robot


def scene_of(mechanism, log, values):
    """The scene of a log at the working point `values`, and the unknowns there (k,)."""
    (e,) = ident.complete(mechanism, log, cutoff=None).experiments
    columns = Columns.of(mechanism)
    pi = np.array([values[name] for name in mechanism.bodies.names])
    names = [name for effect in mechanism.effects for name in effect.names]
    point = Point(pi, {name: values[name] for name in names})
    return Scene.of(mechanism, columns, e, point), np.array([values[n] for n in columns.names])


# --- of columns --------------------------------------------------------------------------------


SLOPES = {  # ∂(E c)/∂s by hand, of the signals of the joint and the values c, s
    "stribeck:elbow": (
        {"Fs": 0.8, "vs": 0.3}, "vs",
        lambda s: 0.8 * np.sign(s.v) * np.exp(-((s.v / 0.3) ** 2)) * 2 * s.v**2 / 0.3**3,
    ),
    "friction_width:elbow": (
        {"Fw": 0.8, "w": 0.3}, "w",
        lambda s: np.where(np.abs(s.v) < 0.3, -0.8 * s.v / 0.3**2, 0.0),
    ),
    "end_stop:elbow": (
        {"k": 20.0, "q1": 1.2, "side": 1.0}, "q1", lambda s: np.where(s.q > 1.2, -20.0, 0.0),
    ),
    "ripple:elbow": (
        {"A": 0.5, "B": 0.3, "N": 8.0}, "N",
        lambda s: s.q * (0.5 * np.cos(8 * s.q) - 0.3 * np.sin(8 * s.q)),
    ),
    "hysteresis:elbow": ({"sigma": 5.0, "z0": 0.1}, "z0", None),
}  # fmt: skip


def test_every_kind_with_columns_and_shapes_is_here():
    shaped = {k for k, kind in KINDS.items() if kind.shapes and not issubclass(kind, Correcting)}
    assert {text.split(":")[0] for text in SLOPES} == shaped - {
        "curve",  # its knots are not searched
        "tyre_saturation",  # of a frame, not of a joint's signals
    }


@pytest.mark.parametrize("text", SLOPES)
def test_a_shapes_column_is_the_slope_of_the_torque(text):
    given, name, formula = SLOPES[text]
    effect = robot("arm").with_effect(text).effects[0]
    mechanism = robot("arm")
    for needed in effect.required:
        mechanism = mechanism.with_effect(needed)
    mechanism = mechanism.with_effect(text)
    true = {full: given[p.name] for full, p in zip(effect.names, effect.parameters, strict=True)}
    true |= {f"{needed.replace(':', '.')}.Fc": 0.5 for needed in effect.required}
    case = plant(mechanism, motion_log("arm", 100.0), true)
    scene, x = scene_of(mechanism, case.log, case.values)
    found = scene.terms(slice(None))
    place = scene.columns.index[f"{text.replace(':', '.')}.{name}"]
    row = mechanism.joint("elbow").index
    s = scene.samples.reduced(slice(None)).signals(("elbow",))
    if formula is not None:
        slope = formula(s)[:, 0]
    else:  # by a far smaller step than the equations take
        shape = {p.name: given[p.name] for p in effect.shapes}
        h = 1e-6 * given[name]
        reduced = scene.samples.reduced(slice(None))
        beside = [reduced.columns(effect, {**shape, name: given[name] + d}) for d in (h, -h)]
        slope = (beside[0] - beside[1])[:, 0, 0] * given["sigma"] / (2 * h)
    S = found.A[:, row, place]
    smooth = np.abs(s.v[:, 0]) > s.still[0]
    close = 0.1 if text.startswith("friction_width") else 0.05  # samples at its kink
    assert np.linalg.norm((S - slope)[smooth]) < close * np.linalg.norm(slope[smooth])
    others = np.delete(np.arange(mechanism.model.nv), row)
    assert not found.A[:, others, place].any()
    off = np.einsum("ndk,k->nd", found.A, x) - found.b  # S s₀ stands on both sides
    assert np.abs(off).max() < 1e-9 * np.abs(found.b).max()


# --- of corrections ----------------------------------------------------------------------------

CORRECTED = {  # where the equations are linearised, and how far from it the log was made
    ("arm", "encoder_offset:elbow"): {"delta": (0.02, 1e-3)},
    ("four_bar", "encoder_offset:crank"): {"delta": (0.02, 1e-3)},
    ("arm", "gravity_tilt"): {"x": (0.03, 1e-3), "y": (-0.02, 1e-3)},
    ("arm", "gravity_compensation"): {"k": (0.9, 0.01)},
    ("arm", "delay:elbow"): {"d": (0.005, 5e-4)},
    ("arm", "position_delay:elbow"): {"d": (0.005, 5e-4)},
    ("arm", "elasticity:elbow"): {"compliance": (1e-3, 2e-5), "damping": (5.0, 0.1)},
    ("four_bar", "elasticity:crank"): {"compliance": (1e-3, 1e-5), "damping": (1.0, 0.02)},
    ("arm", "backlash:wrist"): {"width": (0.01, 1e-4)},
    ("arm", "geometry:elbow.x"): {"Delta": (0.01, 1e-3)},
    ("five_bar", "geometry:tip.a.x"): {"Delta": (0.01, 1e-4)},
    ("slider_crank", "closure_compliance:ball"): {"C": (2e-5, 1e-6)},
}


def test_every_correcting_kind_is_here():
    # drives follow the log's commands: tests/truth/test_drives.py has their truth
    drives = {"servo", "motor_current", "motor_voltage", "motor_duty", "command_delay"}
    every = {k for k, kind in KINDS.items() if issubclass(kind, Correcting)} - drives
    assert {text.split(":")[0] for _, text in CORRECTED} == every


@pytest.mark.parametrize(("name", "text"), CORRECTED, ids=lambda x: x)
def test_a_corrections_column_is_how_a_log_made_beside_it_differs(name, text):
    """A x = b at s₀ of a log that was simulated at s₁: what is left is S (s₁ − s₀)."""
    kind, _, site = text.partition(":")
    mechanism = robot(name) + ident.effect(kind, site)
    (effect,) = mechanism.effects
    near, true = {}, {}
    for full, parameter in zip(effect.names, effect.parameters, strict=True):
        at, step = CORRECTED[name, text][parameter.name]
        near[full], true[full] = at, at + step
    case = plant(mechanism, motion_log(name, 200.0), true)
    scene, x = scene_of(mechanism, case.log, {**case.values, **near})
    found = scene.terms(slice(None))
    usable = scene.e.usable
    left = found.b - np.einsum("ndk,k->nd", found.A, x)
    moved = x.copy()
    for full, value in true.items():
        moved[scene.columns.index[full]] = value
    explained = found.b - np.einsum("ndk,k->nd", found.A, moved)
    assert np.linalg.norm(left[usable]) > 0
    assert np.linalg.norm(explained[usable]) < 0.05 * np.linalg.norm(left[usable])


SWUNG = {  # a spring, and a body behind it
    ("arm", "elasticity:elbow"): ({"compliance": 0.01, "damping": 1.0}, "hand.Lzz", 1e-2),
    ("five_bar", "elasticity:left"): (
        {"compliance": 0.03, "damping": 0.05},
        "left_distal.mx",
        2e-2,
    ),
}


@pytest.mark.parametrize(("name", "text"), SWUNG, ids=lambda x: x)
def test_columns_of_bodies_have_the_twist_of_the_spring_that_they_load(name, text):
    """Against differences of the residual, of the state that each value leads to."""
    given, unknown, close = SWUNG[name, text]
    mechanism = robot(name) + ident.effect(*text.split(":"))
    (effect,) = mechanism.effects
    at = {effect.full[parameter]: value for parameter, value in given.items()}
    case = plant(mechanism, motion_log(name, 100.0), at)
    if unknown not in Columns.of(mechanism).names:
        mechanism = replace(mechanism, unknown=(*mechanism.unknown, unknown))
    h, scenes = 1e-6, []
    for step in (0.0, h, -h):
        values = {**case.values, unknown: case.values[unknown] + step}
        scenes.append(scene_of(mechanism, case.log, values))
    terms = [scene.terms(slice(None)) for scene, _ in scenes]
    left = [t.b - t.A @ x for t, (_, x) in zip(terms, scenes, strict=True)]
    scene = scenes[0][0]
    assert np.abs(left[0] - residual(scene.samples)).max() < 1e-9 * np.abs(terms[0].b).max()
    place, usable = scene.columns.index[unknown], scene.e.usable.copy()
    usable[-30:] = False  # where the load's rates are not those of its past and future
    slope, column = (left[2] - left[1])[usable] / (2 * h), terms[0].A[usable][:, :, place]
    rigid = scene.samples.reduced(slice(None)).gamma[usable]
    of_body = rigid[:, :, list(mechanism.bodies.names).index(unknown)]
    assert np.linalg.norm(column - slope) < close * np.linalg.norm(slope)
    assert np.linalg.norm(column - of_body) > 0.05 * np.linalg.norm(slope)


# --- where shapes are held ----------------------------------------------------------------------


def test_the_search_of_shapes_makes_no_slopes_where_shapes_are_held(monkeypatch):
    """They would be of no use there: the same point is found."""
    mechanism = robot("arm").with_effect("coulomb").with_effect("stribeck:elbow")
    at = {"stribeck.elbow.Fs": 0.8, "stribeck.elbow.vs": 0.2}
    case = plant(mechanism, motion_log("arm", 100.0), at, seed=1)
    motion, calls = ident.complete(mechanism, case.log, cutoff=None), []
    kind = type(mechanism.effects[-1])
    columns = kind.columns
    monkeypatch.setattr(kind, "columns", lambda own, s: calls.append(1) or columns(own, s))
    found = working_point(mechanism, motion).values
    few = len(calls)
    assert found["stribeck.elbow.vs"] == pytest.approx(0.2, rel=1e-6)
    monkeypatch.setattr(Columns, "with_known_shapes", property(lambda own: own))
    other = working_point(mechanism, motion).values
    assert few < 0.8 * (len(calls) - few)
    assert other["stribeck.elbow.vs"] == pytest.approx(found["stribeck.elbow.vs"], rel=1e-9)


def test_a_tilt_far_outside_its_range_is_no_estimate():
    """Its column is a slope that means nothing there; a value near the range stays."""
    p = plant(robot("arm").with_effect("gravity_tilt"), motion_log("arm"), {"gravity_tilt.x": 0.2})
    fit = p.fit()
    at = fit.columns.index["gravity_tilt.x"]
    for value, outside in ((0.2, False), (-0.9, False), (-1.1, True), (30.0, True)):
        x = fit.estimate.x.copy()
        x[at] = value
        found = beyond_bounds(fit.problem, fit.estimate.at(x))
        assert found[at] == outside, value
