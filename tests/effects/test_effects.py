"""Each effect's columns against its formula, and what every kind must have."""

import numpy as np
import pytest

from helpers import J, tree_urdf, write_mechanism
from ident.effects import KINDS, Signals, create, parse
from ident.errors import MechanismError
from ident.mechanism import load

UNITS = {"N m", "N", "N m s/rad", "N s/m", "N m/rad", "N/m", "kg m²", "kg"}


def signals(joints=1, n=60, seed=0):
    rng = np.random.default_rng(seed)
    q, v, a = rng.normal(size=(3, n, joints))
    v[:5] *= 1e-3  # some standstill
    names = [f"temperature.{k}" for k in "ab"[:joints]]
    return Signals(
        t=np.arange(n) / 100,
        q=q,
        v=v,
        a=a,
        still=np.full(joints, 0.02),
        extra={name: 20 + rng.normal(size=n) for name in names},
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


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_says_what_it_is(kind):
    effect = KINDS[kind]
    assert effect.kind == kind
    for text in (effect.equation, effect.signature, effect.source, effect.__doc__):
        assert text
        assert text.strip() == text
    assert effect.unknowns
    for unknown in effect.unknowns:
        assert unknown.name.isidentifier()
        assert unknown.meaning
        assert len(unknown.units) == 2
        assert all(unknown.units)
    names = [unknown.name for unknown in effect.unknowns]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("rotational", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_finite_columns_with_names(kind, rotational):
    joints = tuple("ab"[: KINDS[kind].arity])
    effect = create(kind, joints, rotational=rotational)
    s = signals(max(1, len(joints)))
    E, informed = effect.columns(s), effect.informed(s)
    assert E.shape == (60, len(joints), len(effect.unknowns))
    assert np.isfinite(E).all()
    assert informed.shape == (60, len(joints))
    assert informed.dtype == bool
    assert np.linalg.matrix_rank(E.reshape(-1, E.shape[-1])) == E.shape[-1]
    assert effect.names == tuple(f"{kind}.{','.join(joints)}.{u.name}" for u in effect.unknowns)
    assert effect.units == tuple(u.units[0 if rotational else 1] for u in effect.unknowns)
    assert effect.label == str(effect) == f"{kind}:{','.join(joints)}"


@pytest.mark.parametrize("kind", KINDS)
def test_columns_of_a_sample_depend_on_that_sample_or_what_was_before(kind):
    joints = tuple("ab"[: KINDS[kind].arity])
    effect, s = create(kind, joints), signals(len(joints))
    part = Signals(
        s.t[:40], s.q[:40], s.v[:40], s.a[:40], s.still, {k: x[:40] for k, x in s.extra.items()}
    )
    np.testing.assert_allclose(effect.columns(part), effect.columns(s)[:40])


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_at_rest_at_its_zero_gives_no_sign(kind):
    # neither +1 nor −1 at standstill: a kind with a sign is continuous through v = 0
    joints = tuple("ab"[: KINDS[kind].arity])
    s = signals(len(joints))
    tiny = [Signals(s.t, s.q, x * np.ones_like(s.v), s.a, s.still, s.extra) for x in (-1e-9, 1e-9)]
    one, other = (create(kind, joints).columns(x) for x in tiny)
    np.testing.assert_allclose(one, other, atol=1e-5)


# --- formulas -----------------------------------------------------------------------------------

FORMULAS = {
    "viscous": (lambda s: [s.v], ("N m s/rad",), ("N s/m",)),
    "coulomb": (
        lambda s: [np.where(np.abs(s.v) < s.still, s.v / s.still, np.sign(s.v))],
        ("N m",),
        ("N",),
    ),
    "spring": (lambda s: [s.q, np.ones_like(s.q)], ("N m/rad", "N m"), ("N/m", "N")),
    "rotor_inertia": (lambda s: [s.a], ("kg m²",), ("kg",)),
    "torque_offset": (lambda s: [np.ones_like(s.q)], ("N m",), ("N",)),
}


@pytest.mark.parametrize("kind", FORMULAS)
def test_columns_are_the_formula(kind):
    formula, turning, sliding = FORMULAS[kind]
    s = signals()
    np.testing.assert_allclose(create(kind, "a").columns(s), np.stack(formula(s), axis=-1))
    assert create(kind, "a").units == turning
    assert create(kind, "a", rotational=False).units == sliding


def test_coulomb_is_informed_by_samples_in_motion_only():
    s = signals()
    np.testing.assert_array_equal(create("coulomb", "a").informed(s), np.abs(s.v) >= s.still)


# --- grown by + ---------------------------------------------------------------------------------


def test_a_mechanism_grows_by_an_effect(mechanism):
    effect = create("viscous", "slide")
    grown = mechanism + effect
    assert mechanism.effects == ()
    assert [e.label for e in grown.effects] == ["viscous:slide"]
    assert grown.effects[0].units == ("N s/m",)  # it learnt that the joint slides
    assert "effect:   viscous:slide" in str(grown)
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


@pytest.mark.parametrize(
    ("text", "kind", "joints"),
    [
        ("viscous:hip", "viscous", ("hip",)),
        ("viscous", "viscous", ()),
        ("spring: a , b", "spring", ("a", "b")),
        ("coulomb:closure.pin", "coulomb", ("closure.pin",)),
    ],
)
def test_parse(text, kind, joints):
    assert parse(text) == (kind, joints)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("viscus:hip", "did you mean 'viscous'"),
        ("viscous:", "name is missing"),
        ("", "there is no ''"),
        ("viscous:a,", "name is missing"),
        (":hip", "there is no ''"),
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
    ],
)
def test_create_refuses(kind, joints, values, says):
    with pytest.raises(MechanismError) as caught:
        create(kind, joints, values)
    assert says in str(caught.value)
