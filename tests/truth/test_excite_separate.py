"""Two named effects told apart, and limits and pairs that leave nothing to do."""

from __future__ import annotations

import numpy as np
import pytest

import ident
from helpers import ROBOTS, J, tree_urdf, write_mechanism
from ident import IdentError, Limits, Log, Noise
from ident.equations.unknowns import Columns
from ident.excite.excitation import Determined, with_rivals
from ident.excite.trajectory import motion_rows
from ident.fit.shapes import initial

PAIR = ("coulomb:crank", "coulomb:rocker")
SHORT = {"duration": 12.0, "periods": 2, "harmonics": 3, "tries": 1, "rate": 50.0}


@pytest.fixture(scope="module")
def four_bar():
    return ident.load(ROBOTS / "four_bar").with_calibration("exact")  # its logs are simulated


@pytest.fixture(scope="module")
def apart(four_bar):
    return ident.excite(four_bar, separate=PAIR, **SHORT)


def swung(half: float) -> Log:
    """The crank by ± half about 90°, as long and as often sampled as the excitation."""
    t = np.arange(0, 12.0, 0.02)
    w = 2 * np.pi * 0.5
    parts = [(0.7, w, 0.0), (0.3, 2.3 * w, 0.4)]
    return Log.from_arrays("swung", t, {
        "q.crank": np.pi / 2 + half * sum(a * np.sin(f * t + p) for a, f, p in parts),
        "v.crank": half * sum(a * f * np.cos(f * t + p) for a, f, p in parts),
        "a.crank": -half * sum(a * f**2 * np.sin(f * t + p) for a, f, p in parts),
    })  # fmt: skip


def separation(mechanism, pair, motion, noise):
    """Of two effects in any motion."""
    mechanism = with_rivals(mechanism, pair)
    columns = Columns.of(mechanism)
    rows = motion_rows(mechanism, columns, initial(mechanism, motion), motion.experiments[0])
    return Determined(columns, rows, np.full(rows.A.shape[1], noise)).separation(pair)


def test_the_cosine_falls_and_so_do_the_errors(four_bar, apart):
    small = ident.complete(four_bar, swung(np.pi / 12), cutoff=None, torques=False)
    (sigma,) = apart.noise.values()
    before, after = separation(four_bar, PAIR, small, sigma), apart.separation
    assert before.cosine > 0.99
    assert after.cosine < 0.9
    assert all(a < b / 20 for a, b in zip(after.stderr, before.stderr, strict=True))


def test_the_hidden_one_is_named_in_a_log_of_it(four_bar, apart):
    true = {"coulomb.crank.Fc": 0.0, "coulomb.rocker.Fc": 0.06}
    both = four_bar.with_effect(PAIR[0]).with_effect(PAIR[1])
    noise = [Noise("tau.crank", 0.005)]
    log, _ = ident.simulate(both, apart.log, values=true, noise=noise)
    fit = ident.identify(both, ident.complete(both, log))
    for name, value in true.items():
        assert abs(fit[name].value - value) < max(4 * fit[name].stderr, 0.002)
        assert fit[name].stderr < 0.002


def test_random_motions_separate_less(four_bar, apart):
    other = ident.excite(four_bar, **SHORT)  # for the base parameters, not for these two
    motion = ident.complete(four_bar, other.log, cutoff=None)
    (sigma,) = apart.noise.values()
    worse = separation(four_bar, PAIR, motion, sigma)
    assert np.prod(apart.separation.stderr) < np.prod(worse.stderr)


SHAPED = [
    ("coulomb:elbow", "stribeck:elbow"),
    ("payload:hand", "payload:upper_arm"),  # beside known bodies; the second's mass acts nowhere
    pytest.param("encoder_offset:elbow", "spring:elbow", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("first", "second"), SHAPED)
def test_effects_with_shapes_corrections_and_loads(first, second):
    """A shape's sensitivity is zero before there is a value; a correction has shapes alone; loads
    act as the bodies' own parameters do.
    """
    arm = ident.load(ROBOTS / "arm")
    x = ident.excite(arm, separate=(first, second), **{**SHORT, "harmonics": 2})
    assert 0.0 < x.separation.cosine < 1.0
    assert np.isfinite(x.separation.stderr).all()


def test_rivals_that_no_motion_tells_apart(tmp_path):
    """Rotor inertia of a first vertical joint is the link's own Lzz."""
    arm = ident.load(write_mechanism(tmp_path, tree_urdf([J("a")])))
    with pytest.raises(
        IdentError, match=r"no motion separates rotor_inertia:a .* rotor_inertia\.a\.Ia"
    ):
        ident.excite(arm, separate=("rotor_inertia:a", "viscous:a"), **SHORT)


WRONG = {
    "torque below gravity": (
        {"limits": Limits(torque=2.0)},
        r"the torque of shoulder is at .* N m, its range is",
    ),
    "range of nobody": ({"limits": Limits(range={"elbwo": (0, 1)})}, "did you mean 'elbow'"),
    "speed of nobody": ({"limits": Limits(speed={"x": 1.0})}, "no joint 'x'"),
    "one harmonic": ({"harmonics": 1}, "2 harmonics or more"),
    "rate": ({"rate": 3.0}, "the highest harmonic is at"),
    "duration": ({"duration": 0.0}, "numbers above 0"),
    "same rival": ({"separate": ("coulomb:yaw", "coulomb:yaw")}, "two different effects"),
    "no joint": ({"separate": ("coulomb", "viscous:yaw")}, "write coulomb:JOINT"),
    "no effect": ({"separate": ("coulom:yaw", "viscous:yaw")}, "there is no effect 'coulom'"),
    "noise": ({"noise": {"yaww": 1.0}}, "no drive 'yaww'"),
    "no noise": ({"noise": {"yaw": 0.0}}, "a number above 0"),
    "balance": ({"balance": -1.0}, "a number from 0"),
}


@pytest.mark.parametrize(("wrong", "words"), WRONG.values(), ids=WRONG)
def test_bad_input_is_one_line(wrong, words):
    with pytest.raises(IdentError, match=words) as caught:
        ident.excite(ident.load(ROBOTS / "arm"), **{**SHORT, **wrong})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "given",
    [{"speed": 0.0}, {"acceleration": -1.0}, {"torque": {"a": np.inf}}, {"range": {"a": (1, 1)}},
     {"reserve": 1.0}, {"singular": 1.0}],
    ids=str,
)  # fmt: skip
def test_numbers_that_are_no_limits(given):
    with pytest.raises(IdentError, match=r"expected|the lower first"):
        Limits(**given)


def test_limits_of_loops_name_what_excludes_everything(four_bar):
    with pytest.raises(IdentError, match=r"at home rocker is at 1\.219 rad, its range is 2 to 3"):
        ident.excite(four_bar, limits=Limits(range={"rocker": (2.0, 3.0)}), **SHORT)
    with pytest.raises(IdentError, match="start has crank at 0 rad, outside its range"):
        ident.excite(four_bar, limits=Limits(range={"crank": (1.0, 2.0)}), **SHORT)


def test_limits_of_an_exporter_that_knows_none(tmp_path):
    none = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
    bare = ident.load(write_mechanism(tmp_path / "bare", tree_urdf([J("w", inside=none)])))
    with pytest.raises(IdentError, match=r"both limits at 0 rad.*--range w=LOWER:UPPER"):
        ident.excite(bare, **SHORT)


def test_a_spring_and_a_cable_are_told_apart_by_what_is_not_linear():
    """The spring is part of the cable's polynomial."""
    pair = ("cable:elbow", "spring:elbow")
    for separate in (pair, pair[::-1]):
        found = ident.excite(ident.load(ROBOTS / "arm"), separate=separate, **SHORT).separation
        assert found.cosine < 0.99
        assert np.isfinite(found.stderr).all()


def test_without_drives_or_limits(tmp_path):
    with pytest.raises(IdentError, match="theta moves freely"):
        ident.excite(ident.load(ROBOTS / "pendulum"), **SHORT)
    slide = J("s", "prismatic", inside='<limit lower="-1e9" upper="1e9" effort="9" velocity="1"/>')
    bare = ident.load(write_mechanism(tmp_path / "slide", tree_urdf([slide])))
    with pytest.raises(IdentError, match="--range s=LOWER:UPPER"):
        ident.excite(bare, **SHORT)
    turning = J("w", "continuous", axis="1 0 0", inside='<limit effort="9"/>')
    wheel = ident.load(write_mechanism(tmp_path / "wheel", tree_urdf([turning])))
    x = ident.excite(wheel, **SHORT)
    assert x.use("w", "position").upper == pytest.approx(np.pi)
    assert any("half a turn either way" in note for note in x.notes)
    assert any("no limit of speed" in note for note in x.notes)
