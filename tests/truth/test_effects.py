"""Each effect's columns against its formula, and what every kind must have."""

from dataclasses import replace

import numpy as np
import pytest

from helpers import J, tree_urdf, write_mechanism
from ident.effects import (
    KINDS,
    Correcting,
    Correction,
    FrameForce,
    FramePath,
    Signals,
    Sites,
    create,
    parse,
)
from ident.effects.effect import SAMPLED
from ident.errors import MechanismError
from ident.mechanism import load

KNOTS = np.linspace(-2.0, 2.0, 6)
SHAPES = {"B": 5.0, "vs": 0.5, "w": 0.5, "z0": 0.1, "q1": 0.3, "side": 1.0, "N": 5.0}
SHAPES |= {f"x{i}": float(x) for i, x in enumerate(KNOTS)}
SITED = {"payload": ("a_link",), "geometry": ("a.x",), "closure_compliance": ("pin",)}
WITH_COLUMNS = [
    k for k in KINDS if not issubclass(KINDS[k], Correcting | FrameForce) and k != "payload"
]
COMMANDS = ("ref", "current", "voltage", "duty", "supply")
TILTED = FramePath(
    ("a",), np.eye(3)[None], np.zeros((1, 3)), np.array([[0.6, 0.0, 0.8]]), np.array([True]),
    (np.eye(3), np.array([0.1, 0.2, 0.3])),
)  # fmt: skip


def made(kind, rotational=True):
    """An effect of a kind on as many joints as it needs."""
    joints = SITED.get(kind, tuple("ab"[: len(KINDS[kind].example().joints)]))
    signal = "q" if KINDS[kind].signals else ""
    effect = create(kind, joints, rotational=rotational, signal=signal)
    return effect.along(TILTED) if isinstance(effect, FrameForce) else effect


def shape_of(effect):
    return {shape.name: SHAPES.get(shape.name, 0.01) for shape in effect.shapes}


def signals(effect, n=60, seed=0):
    """Noise, with some standstill; a torque and a load that the model would predict."""
    rng = np.random.default_rng(seed)
    joints = effect.arity if effect.local else 1
    q, v, a, torque, load = rng.normal(size=(5, n, joints))
    v[:5] *= 1e-3
    return Signals(
        t=3.0 + np.arange(n) / 100,
        q=q,
        v=v,
        a=a,
        still=np.full(joints, 0.02),
        extra={
            **{f"{x}.a": 5 + rng.normal(size=n) for x in ("input", "wheel", "normal")},
            **{f"temperature.{k}": 20 + rng.normal(size=n) for k in "ab"},
            **{f"{x}.{k}": rng.normal(size=n) for k in "ab" for x in COMMANDS},
        },
        shape=shape_of(effect),
        present={"viscous.a.Fv": 0.4},
        predicted=lambda: (torque, load),
    )


@pytest.fixture
def mechanism(tmp_path):
    joints = [
        J("hip"),
        J("slide", "prismatic", "1 0 0", "hip"),
        J("knee", axis="0 1 0", parent="slide"),
    ]
    return load(write_mechanism(tmp_path, tree_urdf(joints)))


# --- every kind, those to come too --------------------------------------------------------------


def test_an_end_stop_is_at_an_end():
    effect = made("end_stop", True)
    s = signals(effect)
    low, high = s.travel[0]
    for share, side, possible in (
        (0.9, 1, True),
        (0.45, 1, False),
        (0.1, -1, True),
        (0.6, -1, False),
    ):
        at = {"q1": low + share * (high - low), "side": float(side)}
        assert effect.possible(replace(s, shape=at)) is possible


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_says_what_it_is(kind):
    effect = made(kind)
    assert effect.kind == kind
    for text in (effect.equation, effect.signature, effect.source, effect.__doc__):
        assert text
        assert text.strip() == text
    assert effect.sits in ("joint", "driven", "mechanism", "link", "closure", "place", "frame")
    assert effect.parameters
    for parameter in effect.parameters:
        assert parameter.name.isidentifier()
        assert parameter.meaning
        assert len(parameter.units) == 2
        assert all(parameter.units)
    names = [parameter.name for parameter in effect.parameters]
    assert len({*names, *effect.settings}) == len(names) + len(effect.settings)
    assert {*effect.nested_in, *effect.needs} <= set(KINDS)


@pytest.mark.parametrize("rotational", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_finite_columns_with_names(kind, rotational):
    effect = made(kind, rotational)
    s = signals(effect)
    E, informed = effect.columns(s), effect.informed(s)
    assert E.shape == (*s.q.shape, len(effect.unknowns))
    assert np.isfinite(E).all()
    assert informed.shape == s.q.shape
    assert informed.dtype == bool
    if kind in WITH_COLUMNS:
        assert np.linalg.matrix_rank(E.reshape(-1, E.shape[-1])) == E.shape[-1]
    stem = ".".join(filter(None, (kind, ",".join(effect.joints), effect.signal)))
    assert effect.names == tuple(f"{stem}.{p.name}" for p in effect.parameters)
    assert effect.units == tuple(p.units[0 if rotational else 1] for p in effect.parameters)
    label = ":".join(filter(None, (kind, ",".join(effect.joints), effect.signal)))
    assert effect.label == str(effect) == label
    _, joints, signal, *_ = parse(label)
    assert create(kind, joints, signal=signal) == create(kind, effect.joints, signal=effect.signal)


@pytest.mark.parametrize("rotational", [True, False])
@pytest.mark.parametrize("kind", [k for k in KINDS if KINDS[k].shapes])
def test_shapes_have_bounds_and_starts_within(kind, rotational):
    effect = made(kind, rotational)
    s = signals(effect)
    bounds = effect.bounds(s)
    assert set(bounds) == {shape.name for shape in effect.shapes}
    assert all(low < high for low, high in bounds.values())
    starts = effect.starts(s)
    assert starts
    for start in starts:
        assert set(start) == set(bounds)
        ends = effect.bounds(replace(s, shape=start))
        assert all(ends[k][0] <= x <= ends[k][1] for k, x in start.items()), (start, ends)


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "reversal_pulses"])  # of a jump
def test_columns_of_a_sample_depend_on_that_sample_or_what_was_before(kind):
    effect = made(kind)
    s = signals(effect)
    torque, load = s.predicted()
    part = replace(
        s, t=s.t[:40], q=s.q[:40], v=s.v[:40], a=s.a[:40],
        extra={k: x[:40] for k, x in s.extra.items()},
        predicted=lambda: (torque[:40], load[:40]),
    )  # fmt: skip
    np.testing.assert_allclose(effect.columns(part), effect.columns(s)[:40])
    if not effect.memory:  # of that sample alone
        late = replace(
            s, t=s.t[7:], q=s.q[7:], v=s.v[7:], a=s.a[7:],
            extra={k: x[7:] for k, x in s.extra.items()},
            predicted=lambda: (torque[7:], load[7:]),
        )  # fmt: skip
        np.testing.assert_allclose(effect.columns(late), effect.columns(s)[7:])


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_at_rest_at_its_zero_gives_no_sign(kind):
    # neither +1 nor −1 at standstill: a kind with a sign is continuous through v = 0
    effect = made(kind)
    s = signals(effect)
    one, other = (effect.columns(replace(s, v=x * np.ones_like(s.v))) for x in (-1e-9, 1e-9))
    np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("kind", [k for k in KINDS if issubclass(KINDS[k], Correcting)])
def test_a_correction_of_nothing_is_nothing(kind):
    effect = made(kind)
    s = signals(effect)
    zero = effect.correction(replace(s, shape=dict.fromkeys(s.shape, 0.0)))
    for each in (zero.dq, zero.delay, zero.displaced, zero.gap, zero.torque):
        assert not any(np.any(x) for x in each.values())
    assert zero.tilt == (0.0, 0.0)


# --- formulas -----------------------------------------------------------------------------------


def sign(s, v=None):
    """Continuous through standstill, without a moment ∫ (sign(v) − f(v)) v dv."""
    v = s.v if v is None else v
    x = v / s.still[0]
    return np.where(np.abs(x) < 1, 2.25 * x - 1.25 * x**3, np.sign(v))


def pulses(s):
    """d/dt sign(v) and d²/dt² sign(v), by differences over two steps."""
    first = np.gradient(sign(s), 0.01, axis=0)
    return [first, np.gradient(first, 0.01, axis=0)]


def dahl(s):
    """ż = v − |v| z/z0 over the path q, by many small Euler steps."""
    z, found, fine = 0.0, [0.0], 4000
    for step in np.diff(s.q[:, 0]):
        for _ in range(fine):
            z += step / fine - abs(step / fine) * z / s.shape["z0"]
        found.append(z)
    return np.array(found)[:, None]


def both(x):
    return np.repeat(x.sum(axis=1, keepdims=True), 2, axis=1)


def splines(s):
    """B_k(q) by the recursion of de Boor, constant outside the knots."""
    t = np.concatenate([[-2.0] * 3, KNOTS, [2.0] * 3])
    x = np.clip(s.q, -2.0, 2.0 - 1e-12)
    B = [((t[i] <= x) & (x < t[i + 1])).astype(float) for i in range(len(t) - 1)]
    for p in range(1, 4):
        B = [
            (x - t[i]) / max(t[i + p] - t[i], 1e-300) * B[i]
            + (t[i + p + 1] - x) / max(t[i + p + 1] - t[i + 1], 1e-300) * B[i + 1]
            for i in range(len(B) - 1)
        ]
    return B


FORMULAS = {
    "curve": (splines, ["N m", "N"]),
    "viscous": (lambda s: [s.v], ["N m s/rad", "N s/m"]),
    "coulomb": (lambda s: [sign(s)], ["N m", "N"]),
    "stribeck": (lambda s: [sign(s) * np.exp(-((s.v / 0.5) ** 2))], ["N m", "N"]),
    "friction_width": (lambda s: [np.clip(s.v / 0.5, -1, 1) - sign(s)], ["N m", "N"]),
    "load_friction": (lambda s: [np.abs(s.load) * sign(s)], ["1", "1"]),
    "hysteresis": (lambda s: [dahl(s)], ["N m/rad", "N/m"]),
    "direction_friction": (lambda s: [np.ones_like(s.v), np.abs(s.v)], ["N m", "N"]),
    "position_friction": (lambda s: [s.q * sign(s), s.q**2 * sign(s)], ["N m/rad", "N/m"]),
    "drag": (lambda s: [s.v**2 * np.sign(s.v)], ["N m s²/rad²", "N s²/m²"]),
    "spring": (lambda s: [s.q, np.ones_like(s.q)], ["N m/rad", "N/m"]),
    "cable": (lambda s: [np.ones_like(s.q), s.q, s.q**2, s.q**3], ["N m", "N"]),
    "end_stop": (lambda s: [np.where(s.q > 0.3, s.q - 0.3, 0.0)], ["N m/rad", "N/m"]),
    "rotor_inertia": (lambda s: [s.a], ["kg m²", "kg"]),
    "coupling": (lambda s: [both(s.a), both(s.v), sign(s, both(s.v))], ["kg m²", "kg"]),
    "ripple": (lambda s: [np.sin(5 * s.q), np.cos(5 * s.q)], ["N m", "N"]),
    "torque_offset": (lambda s: [np.ones_like(s.q)], ["N m", "N"]),
    "torque_gain": (lambda s: [s.torque], ["1", "1"]),
    "temperature_friction": (
        lambda s: [0.4 * s.v * (s.extra["temperature.a"][:, None] - 25.0)],
        ["1/K", "1/K"],
    ),
    "reversal_pulses": (lambda s: pulses(s), ["N m s", "N s"]),
    "drift": (lambda s: [(s.t - 3.0)[:, None]], ["N m/s", "N/s"]),
}


@pytest.mark.parametrize("kind", KINDS.values())
def test_what_a_kind_states_refers_to_what_exists(kind):
    related = {*kind.nested_in, *kind.companions, *kind.separated_by, *kind.needs}
    assert related <= {*KINDS} - {kind.kind}
    assert {kind.sits, kind.candidate_sites or kind.sits} <= {
        *vars(Sites()),
        "mechanism",
        "nowhere",
    }
    assert kind.watched in ("always", "request", "never")
    assert {*made(kind.kind).asks} <= {"a", "torque", "load"}
    acts = {unknown.acts for unknown in made(kind.kind).unknowns}
    assert acts <= {"torque", "linear", "inertia", "dry", "level", "state", "body"}


def test_an_effect_of_the_whole_mechanism_is_a_candidate_and_a_curve_is_none():
    assert KINDS["gravity_tilt"].candidates(Sites()) == [()]
    assert KINDS["viscous"].candidates(Sites(joint=("a", "b"))) == [("a",), ("b",)]
    assert KINDS["curve"].candidates(Sites(joint=("a", "b"))) == []


def test_every_kind_with_columns_has_its_formula_here():
    assert set(FORMULAS) == set(WITH_COLUMNS)


@pytest.mark.parametrize("kind", FORMULAS)
def test_columns_are_the_formula(kind):
    formula, units = FORMULAS[kind]
    effect = made(kind)
    s = signals(effect)
    loose = {"rtol": 2e-3, "atol": 1e-5} if kind == "hysteresis" else {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(effect.columns(s), np.stack(formula(s), axis=-1), **loose)
    assert [effect.units[0], made(kind, rotational=False).units[0]] == units


CORRECTIONS = {  # what s = 0.01 corrects
    "delay": lambda s, c: c.delay == {"a": 0.01},
    "encoder_offset": lambda s, c: c.dq == {"a": 0.01},
    "position_delay": lambda s, c: c.position_delay == {"a": 0.01},
    "gravity_tilt": lambda s, c: c.tilt == (0.01, 0.01),
    "gravity_compensation": lambda s, c: c.compensated == 0.01,
    "elasticity": lambda s, c: np.allclose(
        np.array([100.0, 0.01, 1.0]) @ -c.twist["a"],
        s.load[:, 0],  # K δ + D δ̇ + M δ̈, M = 1
    ),
    "backlash": lambda s, c: np.abs(c.twist["a"]).max() == 0.005,
    "geometry": lambda s, c: c.displaced == {"a.x": 0.01},
    "closure_compliance": lambda s, c: c.gap == {"pin": 0.01},
    "command_delay": lambda s, c: c == Correction(),  # drives read it
    "servo": lambda s, c: np.allclose(
        c.torque["a"], 0.01 * (half_late(s, "ref") - s.q[:, 0] - s.v[:, 0])
    ),
    "motor_current": lambda s, c: np.allclose(c.torque["a"], 0.01 * s.extra["current.a"]),
    "motor_duty": lambda s, c: np.allclose(
        c.torque["a"], 0.01 * (half_late(s, "duty") * half_late(s, "supply") - s.v[:, 0])
    ),
    "motor_voltage": lambda s, c: np.allclose(
        c.torque["a"], 0.01 * (half_late(s, "voltage") - s.v[:, 0])
    ),
}


def half_late(s, command):
    """A command that is held from sample to sample is half a sample late on average."""
    x = s.extra[f"{command}.a"]
    return 0.5 * (x + np.concatenate([x[:1], x[:-1]]))


def test_every_correcting_kind_has_its_correction_here():
    assert set(CORRECTIONS) == {k for k in KINDS if issubclass(KINDS[k], Correcting)}


@pytest.mark.parametrize("kind", CORRECTIONS)
def test_corrections_are_the_formula(kind):
    effect = made(kind)
    s = signals(effect)
    assert CORRECTIONS[kind](s, effect.correction(s))


def test_the_other_end_stop_is_below():
    effect = made("end_stop")
    s = replace(signals(effect), shape={"q1": -0.2, "side": -1.0})
    np.testing.assert_allclose(effect.columns(s)[..., 0], np.minimum(s.q + 0.2, 0.0))


@pytest.mark.parametrize("degree", [1, 2, 7])
def test_a_cable_of_another_degree(degree):
    effect = create("cable", "a", {"degree": degree})
    s = signals(effect)
    assert [u.name for u in effect.unknowns] == [f"k{i}" for i in range(degree + 1)]
    np.testing.assert_allclose(effect.columns(s)[..., degree], s.q**degree)


@pytest.mark.parametrize("degree", [0, 8, 2.5])
def test_a_cable_of_no_degree(degree):
    with pytest.raises(MechanismError, match="valid: 1 to 7"):
        create("cable", "a", {"degree": degree})


@pytest.mark.parametrize("kind", ["coulomb", "stribeck", "load_friction"])
def test_dry_friction_is_informed_by_samples_in_motion_only(kind):
    effect = made(kind)
    s = signals(effect)
    np.testing.assert_array_equal(effect.informed(s), np.abs(s.v) >= s.still)


# --- grown by + ---------------------------------------------------------------------------------


def test_a_mechanism_grows_by_an_effect(mechanism):
    effect = create("viscous", "slide")
    grown = mechanism + effect
    assert mechanism.effects == ()
    assert [e.label for e in grown.effects] == ["viscous:slide"]
    assert grown.effects[0].units == ("N s/m",)  # it learnt that the joint slides
    assert "effects   viscous:slide" in str(grown)
    with pytest.raises(MechanismError, match="'viscous:slide' already"):
        grown + create("viscous", "slide", {"Fv": 1.0})
    with pytest.raises(MechanismError, match="no joint 'elbow'"):
        mechanism + create("viscous", "elbow")
    with pytest.raises(TypeError):
        mechanism + "viscous:slide"


def test_effects_by_text(mechanism):
    grown = mechanism.with_effect("coulomb:knee", {"Fc": 0.4})
    assert grown.effects[0].values == {"Fc": 0.4}
    every = grown.with_effect("coulomb")
    assert [e.label for e in every.effects] == ["coulomb:knee", "coulomb:hip", "coulomb:slide"]
    with pytest.raises(MechanismError, match="has 'coulomb' already"):
        every.with_effect("coulomb")
    known = mechanism.with_effect("coulomb", {"Fc": 0.4})
    assert not any(e.known for e in known.with_effect("coulomb").effects)


@pytest.mark.parametrize(
    ("text", "kind", "joints"),
    [
        ("viscous:hip", "viscous", ("hip",)),
        ("viscous", "viscous", ()),
        ("spring: a , b", "spring", ("a", "b")),
        ("coulomb:closure.pin", "coulomb", ("closure.pin",)),
        ("curve:hip:q*sign", "curve", ("hip",)),
    ],
)
def test_parse(text, kind, joints):
    assert parse(text) == (kind, joints, "q*sign" if kind == "curve" else "", {}, "")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("viscus:hip", "did you mean 'viscous'"),
        ("viscous:", "name is missing"),
        ("", "there is no effect ''"),
        ("viscous:a,", "name is missing"),
        (":hip", "there is no effect ''"),
    ],
)
def test_parse_refuses(text, says):
    with pytest.raises(MechanismError) as caught:
        parse(text)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "joints", "values", "says"),
    [
        ("viscus", "a", {}, "did you mean 'viscous'"),
        ("viscous", "a", {"fv": 1.0}, "valid: Fv"),
        ("viscous", "a", {"Fv": np.nan}, "finite"),
        ("viscous", "a,b", {}, "acts on 1 joint"),
        ("viscous", (), {}, "acts on 1 joint"),
        ("coupling", "a", {}, "write coupling:joint,joint"),
        ("coupling", "a,a", {}, "names a joint twice"),
        ("gravity_tilt", "a", {}, "acts on the whole mechanism, given: a; write gravity_tilt"),
        ("geometry", (), {}, "write geometry:place"),
    ],
)
def test_create_refuses(kind, joints, values, says):
    with pytest.raises(MechanismError) as caught:
        create(kind, joints, values)
    assert says in str(caught.value)


def test_joints_share_a_delay():
    """One unknown for all drives, proposed beside one a drive; a single joint's effect stays so."""
    delay = create("delay", "a, b")
    assert delay.names == ("delay.a,b.d",)
    s = signals(delay)
    assert delay.correction(replace(s, shape={"d": 0.01})).delay == {"a": 0.01, "b": 0.01}
    drives = KINDS["delay"].candidates(Sites(driven=("a", "b", "c", "d"), sensed=("a", "b", "c")))
    assert drives == [("a", "b", "c"), ("a",), ("b",), ("c",)]
    assert KINDS["delay"].candidates(Sites(sensed=("a",))) == [("a",)]
    with pytest.raises(MechanismError, match="acts on 1 joint"):
        create("viscous", "a, b")


def test_a_gain_is_a_volt_where_the_supply_is_logged():
    duty = create("motor_duty", "a")
    assert duty.units_with({"duty.a", "q.a"})[0] == "N m"
    assert duty.units_with({"duty.a", "supply.a"})[0] == "N m/V"


def test_dry_friction_beside_a_drive_is_the_mean_over_a_sample():
    h, t = 5e-3, 0.02
    fine = np.linspace(-0.5 * h, 0.5 * h, 10001)
    v, a = np.array([[0.03], [-0.01], [0.4]]), np.array([[20.0], [-30.0], [50.0]])
    step = {SAMPLED + "elbow": np.full(3, h)}
    s = Signals(np.full(3, t), 0 * v, v, a, np.full(1, 1e-3), step)
    coulomb = KINDS["coulomb"](("elbow",))
    mean = np.sign(v + a * fine).mean(axis=1)
    assert np.allclose(coulomb.columns(s)[:, 0, 0], mean, atol=1e-3)
    assert np.array_equal(np.sign(v)[:, 0], coulomb.columns(replace(s, extra={}))[:, 0, 0])
