"""One smooth motion from everything measured of it: weights, resolution, closures, what is said."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ident
from ident.motion.spline import Channel, basis_over, evaluated, fitted

RATE = 200.0


def moving(t, seed=0):
    """A sum of sines to 2 Hz and its first two derivatives (3, n)."""
    random = np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.3, 0.7, 1.3, 2.0])[:, None]
    size, phase = random.uniform(0.1, 0.4, (4, 1)), random.uniform(0, 6, (4, 1))
    s, c = np.sin(w * t + phase), np.cos(w * t + phase)
    return np.stack([(size * s).sum(0), (size * w * c).sum(0), -(size * w**2 * s).sum(0)])


@pytest.fixture(scope="module")
def crank(robots):
    return ident.load(robots / "four_bar")


def log_of(noise, seed=1, t=None, name="run.csv", shift=0.0):
    """q, v, a of the crank with noise (σ or None for a channel that is not logged)."""
    t = np.arange(0.0, 10.0, 1 / RATE) if t is None else t
    true, random = moving(t), np.random.default_rng(seed)
    columns = {"tau.crank": np.sin(t)}
    for letter, x, sigma in zip("qva", true, noise, strict=True):
        if sigma is not None:
            columns[f"{letter}.crank"] = x + sigma * random.standard_normal(len(t)) + shift
    return ident.Log.from_arrays(name, t, columns), true


def off(mechanism, motion, true):
    """rms of what is wrong with y, ẏ, ÿ of the crank."""
    (e,) = motion.experiments
    at = mechanism.joint_index["crank"]
    found = np.stack([e.y[:, at], e.yd[:, at], e.ydd[:, at]])
    return np.sqrt(np.mean((found - true)[:, e.usable] ** 2, axis=1))


def test_noise_and_residual_of_every_channel_are_said(crank):
    log, _ = log_of((2e-3, 2e-2, 0.5))
    (e,) = ident.complete(crank, log).experiments
    assert [c.column for c in e.channels] == ["q.crank", "v.crank", "a.crank"]
    for channel, sigma in zip(e.channels, (2e-3, 2e-2, 0.5), strict=True):
        assert channel.noise == pytest.approx(sigma, rel=0.1)
        assert channel.residual == pytest.approx(sigma, rel=0.1)
        assert channel.spacing == e.smooth.spacing
        assert "knots" in channel.how


def test_each_further_channel_makes_the_motion_better(crank):
    errors = []
    for noise in ((2e-3, None, None), (2e-3, 2e-2, None), (2e-3, 2e-2, 0.1)):
        log, true = log_of(noise)
        errors.append(off(crank, ident.complete(crank, log), true))
    assert (errors[0] > 1.3 * errors[1]).all()
    assert errors[1][2] > 1.5 * errors[2][2]
    assert errors[0][0] < 2e-3 / 2  # smoothing alone halves the noise of positions


def test_the_resolution_follows_the_noise(crank):
    spacings = []
    for sigma in (1e-5, 1e-4, 1e-3, 1e-2):
        log, _ = log_of((sigma, None, None))
        spacings.append(ident.complete(crank, log).experiments[0].smooth.spacing)
    assert spacings == sorted(spacings)
    assert spacings[-1] > 1.5 * spacings[0]
    assert 0.5 / spacings[-1] > 2.0  # Hz: the motion's fastest sine is still resolved


def test_the_chosen_resolution_is_near_the_best(crank):
    log, true = log_of((1e-3, None, None))
    chosen = off(crank, ident.complete(crank, log), true)
    tried = [off(crank, ident.complete(crank, log, smoothing=h), true)
             for h in (0.03, 0.05, 0.08, 0.12, 0.16, 0.2)]  # fmt: skip
    assert chosen[0] < 1.3 * min(each[0] for each in tried)
    assert chosen[2] < 2.0 * min(each[2] for each in tried)


def test_a_velocity_that_is_late_weighs_less(crank):
    log, true = log_of((1e-3, 1e-3, None))
    late = dict(log.columns)
    late["v.crank"] = np.interp(log.t - 0.05, log.t, late["v.crank"])
    motion = ident.complete(crank, ident.Log.from_arrays("late.csv", log.t, late))
    left = {channel.column: channel.residual for channel in motion.experiments[0].channels}
    assert left["v.crank"] > 0.02  # of 1e-3: what it misses the positions by
    assert left["q.crank"] < 2e-3
    assert sum("v.crank" in note and "positions" in note for note in motion.notes) >= 1
    assert off(crank, motion, true)[0] < 0.02


def test_more_joints_than_needed_are_smoothed_together(robots):
    """The pendulum's x, y and θ: three witnesses of one degree of freedom."""
    mechanism = ident.load(robots / "pendulum")
    clean = ident.read_log(robots / "pendulum" / "run.csv")
    random, sigma = np.random.default_rng(0), {}
    columns = {}
    for name, x in clean.columns.items():
        sigma[name] = 0.02 * float(np.std(x))
        columns[name] = x + sigma[name] * random.standard_normal(len(x))
    motion = ident.complete(mechanism, ident.Log.from_arrays("noisy.csv", clean.t, columns))
    assert motion.closure_error < 1e-10
    (e,) = motion.experiments
    assert {c.column for c in e.channels} == {n for n in clean.columns if n[0] in "qva"}
    for channel in e.channels:
        assert channel.residual == pytest.approx(sigma[channel.column], rel=0.15)
    at = mechanism.joint_index["theta"]
    together = np.std(e.y[:, at] - clean.columns["q.theta"])
    few = {n: x for n, x in columns.items() if n.endswith("theta")}
    alone = ident.complete(mechanism, ident.Log.from_arrays("few.csv", clean.t, few))
    assert together < 0.85 * np.std(alone.experiments[0].y[:, at] - clean.columns["q.theta"])


@pytest.mark.parametrize("name", ["four_bar", "five_bar"])
def test_positions_of_all_joints_are_better_than_those_of_the_drives(name, robots):
    mechanism = ident.load(robots / name)
    t = np.arange(0.0, 10.0, 1 / RATE)
    centre = {"left": 2.2, "right": 0.94, "crank": 0.5}
    drives = {
        f"q.{joint}": centre[joint] + 0.4 * moving(t, seed=i)[0]
        for i, joint in enumerate(mechanism.driven)
    }
    drives |= {f"tau.{joint}": np.sin(t) for joint in mechanism.driven}
    (true,) = ident.complete(mechanism, ident.Log.from_arrays("exact", t, drives)).experiments
    random, sigma = np.random.default_rng(0), 1e-3
    q = {
        f"q.{joint.name}": true.y[:, i] + sigma * random.standard_normal(len(t))
        for i, joint in enumerate(mechanism.joints)
        if joint.in_tree
    }
    torques = {k: x for k, x in drives.items() if k.startswith("tau.")}
    errors = []
    for columns in (q, {k: x for k, x in q.items() if k in drives}):
        log = ident.Log.from_arrays("noisy", t, {**columns, **torques})
        (e,) = ident.complete(mechanism, log).experiments
        errors.append(np.sqrt(np.mean((e.ydd - true.ydd)[e.usable] ** 2)))
    assert errors[0] < 1.1 * errors[1]
    assert errors[0] < 0.2 * np.std(true.ydd)


def test_as_logged_if_asked_or_clean(crank):
    log, true = log_of((1e-3, 1e-2, 0.1))
    (e,) = ident.complete(crank, log, smoothing=None).experiments
    np.testing.assert_array_equal(e.y[:, crank.joint_index["crank"]], log.columns["q.crank"])
    np.testing.assert_allclose(
        e.ydd[:, crank.joint_index["crank"]], log.columns["a.crank"], rtol=1e-12
    )
    assert e.smooth is None
    log, true = log_of((0.0, 0.0, 0.0))
    motion = ident.complete(crank, log)
    assert motion.experiments[0].smooth is None
    assert (off(crank, motion, true) < 1e-12).all()


@pytest.mark.parametrize("value", ["fine", 1e-6, 100.0])
def test_a_bad_spacing_is_refused(crank, value):
    log, _ = log_of((1e-3, None, None))
    with pytest.raises(ident.MotionError, match="valid: knots"):
        ident.complete(crank, log, smoothing=value)


def test_logs_are_smoothed_apart(crank):
    a, _ = log_of((1e-3, None, None), name="a.csv")
    b, _ = log_of((1e-2, None, None), name="b.csv", shift=0.3, seed=2)
    both = ident.complete(crank, [a, b])
    alone = ident.complete(crank, b)
    np.testing.assert_allclose(both.experiments[1].y, alone.experiments[0].y, atol=2e-3)
    assert both.experiments[0].channels[0].noise < 0.3 * both.experiments[1].channels[0].noise


def test_jittering_stamps_are_no_noise(crank):
    t = np.arange(0.0, 10.0, 1 / RATE)
    jitter = t + np.random.default_rng(3).uniform(-0.3, 0.3, len(t)) / RATE
    log, _ = log_of((1e-4, None, None), t=jitter)
    motion = ident.complete(crank, log)
    (e,) = motion.experiments
    true = moving(e.t)
    assert off(crank, motion, true)[0] < 1e-4
    assert e.channels[0].residual == pytest.approx(1e-4, rel=0.2)


def test_what_moving_the_spline_costs():
    """|U (c − ĉ)|² is what the channels' weighted squares rise by."""
    t = np.arange(0.0, 4.0, 1 / RATE)
    random = np.random.default_rng(5)
    channels = [
        Channel("j", k, t, x + s * random.standard_normal(len(t)), s, 1.0)
        for k, x, s in zip((0, 2), moving(t)[[0, 2]], (1e-3, 0.2), strict=True)
    ]
    spline = fitted(basis_over(0.0, t[-1], 0.08), channels, ("j",))

    def squares(c):
        u = evaluated(spline.basis, c, t)
        return sum((((x.x - u[x.order, :, 0]) / x.sigma) ** 2).sum() for x in channels)

    step = 1e-3 * random.standard_normal(spline.c.shape)
    moved = step[spline.first[:, None] + np.arange(6)]
    cost = (np.einsum("nwi,nwi->n", spline.U, moved) ** 2).sum()
    assert squares(spline.c + step) - squares(spline.c) == pytest.approx(cost, rel=1e-6)


def test_clean_rates_beside_noisy_positions(robots):
    """The mean of the position is known from noisy samples alone, its rates nearly exactly."""
    mechanism = ident.load(robots / "slider_crank")
    given = ident.read_log(robots / "slider_crank" / "run.csv")
    noise = [ident.Noise(channel, 0.02, relative=True) for channel in ("q", "tau")]
    log, _ = ident.simulate(mechanism, given, noise=noise, seed=1)
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    for name, value in {"rod.Ixx": 0.0052, "rod.Izz": 0.0052}.items():
        assert fit[name].value == pytest.approx(value, rel=0.02)


def corners(rho):
    """Positions whose accelerations jump at reversals, with noise correlated between samples."""
    t = np.arange(0.0, 16.0, 1 / RATE)
    v = np.cos(2 * t) + 0.4 * np.cos(5.3 * t)
    a = -2 * np.sin(2 * t) - 2.12 * np.sin(5.3 * t) + 3.0 * (np.sign(v) - np.tanh(5 * v))
    q = np.cumsum(np.cumsum(a - a.mean())) / RATE**2
    q = 0.5 * (q - np.polyval(np.polyfit(t, q, 3), t))
    noise = lfilter([np.sqrt(1 - rho**2)], [1, -rho], np.random.default_rng(1).normal(size=len(t)))
    return ident.Log.from_arrays("run.csv", t, {"q.crank": q + 2e-4 * noise, "tau.crank": a})


@pytest.mark.parametrize(("rho", "white"), [(0.0, True), (0.9, False)])
def test_white_noise_lets_positions_choose_knots(crank, rho, white):
    motion = ident.complete(crank, corners(rho))
    (channel,) = motion.experiments[0].channels
    assert motion.band.white is white
    assert not white or channel.residual < 1.1 * channel.noise
