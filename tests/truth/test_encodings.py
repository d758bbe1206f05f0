"""Raw numbers of servos and encoders, and units of URDFs: what was planted is undone or named."""

from pathlib import Path

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.mechanism.body_units import verdict_of
from ident.motion.encodings import sign_bit, wrapped_bits


def arm_log() -> ident.Log:
    return ident.read_log(ROBOTS / "arm" / "run.csv")


def changed(log: ident.Log, **columns: np.ndarray) -> ident.Log:
    given = {name.replace("_", "."): x for name, x in columns.items()}
    return ident.Log.from_arrays(log.name, log.t, {**log.columns, **given})


def test_a_sign_in_a_bit_of_its_own_is_restored():
    log, mechanism = arm_log(), ident.load(ROBOTS / "arm")
    x = log.columns["tau.elbow"] - np.median(log.columns["tau.elbow"])  # of both signs
    raw = np.rint(np.clip(1000 * x / np.abs(x).max(), -1000, 1000))
    encoded = np.where(raw < 0, 1024 - raw, raw)
    assert sign_bit(encoded) == 1024
    assert sign_bit(np.abs(raw)) is None
    assert sign_bit(raw) is None
    motion = ident.complete(mechanism, changed(log, tau_elbow=encoded))
    (e,) = motion.experiments
    at = mechanism.driven.index("elbow")
    expected = np.interp(e.t, log.t, raw)
    np.testing.assert_allclose(e.tau[:, at], expected, atol=1e-6)
    assert any("sign and magnitude" in note for note in motion.notes)


@pytest.mark.parametrize("bits", [8, 16])
def test_signed_integers_that_were_read_as_unsigned(bits):
    log, mechanism = arm_log(), ident.load(ROBOTS / "arm")
    x = log.columns["tau.elbow"] - np.median(log.columns["tau.elbow"])
    raw = np.rint(0.8 * 2 ** (bits - 1) * x / np.abs(x).max())
    assert wrapped_bits(raw % 2**bits) == bits
    assert wrapped_bits(raw - raw.min()) is None
    motion = ident.complete(mechanism, changed(log, tau_elbow=raw % 2**bits))
    (e,) = motion.experiments
    expected = np.interp(e.t, log.t, raw)
    np.testing.assert_allclose(e.tau[:, mechanism.driven.index("elbow")], expected, atol=1e-6)
    assert any(f"{bits} bits" in note for note in motion.notes)


@pytest.mark.parametrize("offset", [-8192, 0])
def test_numbers_of_two_s_complement_are_left_alone(offset):
    rng = np.random.default_rng(1)
    raw = np.rint(np.cumsum(rng.standard_normal(500)) * 20) + 9000 + offset
    assert sign_bit(raw - raw.min()) is None


def test_an_encoder_within_one_turn_is_unwrapped():
    log, mechanism = arm_log(), ident.load(ROBOTS / "arm")
    q = log.columns["q.yaw"]
    shift = np.pi - np.median(q)  # so that its middle is the end of a turn
    wrapped = (q + shift + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(np.diff(wrapped)).max() > 6
    straight, jumping = (
        ident.complete(mechanism, changed(log, q_yaw=x), cutoff=6.0) for x in (q + shift, wrapped)
    )
    (a,), (b,) = straight.experiments, jumping.experiments
    off = (a.q - b.q) / (2 * np.pi)
    np.testing.assert_allclose(off, np.rint(off[:1]).repeat(len(off), axis=0), atol=1e-6)
    assert any("2π" in note for note in jumping.notes)


BODY = (2.6, np.array([0.0, 0.0, -0.16]), 0.047, 0.35)  # kg, m, kg m², the machine's m


@pytest.mark.parametrize(
    ("factors", "unit", "zero"),
    [
        ((1, 1, 1), None, ""),
        ((1, 1, 1e6), "kg mm²", "inertia"),
        ((1, 1, 1e9), "g mm²", "inertia"),
        ((1, 1e3, 1), "mm", "centre"),
        ((1e3, 1, 1), "g?", ""),
        ((1, 1, 3 / 0.047), "placeholder", "inertia"),
    ],
)
def test_a_body_of_another_unit_is_named(factors, unit, zero):
    m, centre, trace, length = BODY
    verdict = verdict_of(factors[0] * m, factors[1] * centre, factors[2] * trace, length)
    if unit is None:
        assert verdict is None
        return
    assert unit in verdict.text
    assert (verdict.inertia, verdict.centre) == (zero == "inertia", zero == "centre")


INERTIA = '<inertia ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{0}"/>'


def chain(folder: Path, mass: float, inertia: float, unknown: str) -> ident.Mechanism:
    """Three links of 0.3 m whose bodies have one mass [kg] and inertia [kg m²]."""
    urdf, before = '<robot name="chain"><link name="base"/>', "base"
    for name in "abc":
        urdf += f'<link name="{name}"><inertial><mass value="{mass}"/>{INERTIA.format(inertia)}'
        urdf += f'</inertial></link><joint name="j{name}" type="continuous"><origin xyz="0 0 0.3"/>'
        urdf += f'<parent link="{before}"/><child link="{name}"/><axis xyz="1 0 0"/></joint>'
        before = name
    (folder / "chain.urdf").write_text(urdf + "</robot>")
    text = f'urdf = "chain.urdf"\n[parameters]\nunknown = {unknown}\n'
    (folder / "mechanism.toml").write_text(text)
    return ident.load(folder)


def test_numbers_that_cannot_be_are_no_prior_and_stay_as_known_values(tmp_path):
    """1 kg m² at 0.3 kg on a machine of 0.6 m, as exporters write it, is said once."""
    every = chain(tmp_path, 0.3, 1.0, '["a", "b", "c"]')
    some = chain(tmp_path, 0.3, 1.0, '["a"]')
    (note,) = [note for note in every.notes if "radius of gyration" in note]
    assert "'b'" in note
    assert "'c'" in note
    assert every.prior == pytest.approx(some.prior)  # as it is written
    assert every.prior.reshape(-1, 10)[:, 4] == pytest.approx([1.0] * 3)
    assert every.plausible_prior.reshape(-1, 10)[:, 4] == pytest.approx([0.0] * 3)
    assert some.plausible_prior.reshape(-1, 10)[:, 4] == pytest.approx([0.0, 1.0, 1.0])


def test_the_same_numbers_for_all_bodies_are_placeholders_and_said_once(tmp_path):
    dummies = chain(tmp_path, 0.3, 1e-3, '["a", "b", "c"]')
    assert dummies.has_dummy_bodies
    assert len([note for note in dummies.notes if "placeholders" in note]) == 1
    assert not ident.load(ROBOTS / "arm").has_dummy_bodies
