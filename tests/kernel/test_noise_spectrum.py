"""Noise below the band of a motion, from what it is above."""

import numpy as np
import pytest
from scipy.signal import firwin, lfilter

from ident.equations.filter import Decimator
from ident.equations.noise_spectrum import _passed, has_line

RATE, BAND = 200.0, 1.2


@pytest.mark.parametrize("correlation", [0.0, 0.8, 0.95])
def test_what_a_filter_passes_is_told_from_above_the_motion(correlation):
    taps, ratios = Decimator.of(5 * BAND, RATE).taps, []
    for seed in range(8):
        white = np.random.default_rng(seed).standard_normal(4000)
        r = lfilter([np.sqrt(1 - correlation**2)], [1, -correlation], white)
        true = np.convolve(r, taps, "valid").std()
        ratios.append(np.sqrt(_passed(r, RATE, taps, BAND)) / true)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.15)


def test_what_the_motion_makes_is_no_noise():
    noise = 0.01 * np.random.default_rng(0).standard_normal(4000)
    taps = Decimator.of(5 * BAND, RATE).taps
    alone = _passed(noise, RATE, taps, BAND)
    slow = firwin(801, 0.6 * BAND, fs=RATE)
    made = np.convolve(np.random.default_rng(1).standard_normal(4800), slow, "valid")
    assert _passed(noise + made, RATE, taps, BAND) == pytest.approx(alone, rel=0.3)


def powers(r):
    window = np.hanning(len(r))
    return np.abs(np.fft.rfft((r - r.mean()) * window))[1:] ** 2


def test_noise_of_any_colour_has_no_line():
    lines = 0
    for seed in range(300):
        white = np.random.default_rng(seed).standard_normal(2000)
        lines += has_line(powers(lfilter([1.0], [1.0, -(0.0, 0.6, 0.95)[seed % 3]], white)))
    assert lines <= 2


def test_a_sine_is_a_line_and_no_noise():
    t = np.arange(4000) / RATE
    noise = np.random.default_rng(0).standard_normal(4000)
    disturbed = noise + 0.5 * np.sin(2 * np.pi * 2.345 * t)
    assert has_line(powers(disturbed))
    assert _passed(disturbed, RATE, None, BAND) == 0.0


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_a_constant_residual_has_no_noise(level):
    assert _passed(np.full(2000, level), RATE, None, BAND) == pytest.approx(0.0, abs=1e-25)


def test_a_band_without_any_power_is_none_of_a_spectrum():
    from ident.equations.noise_spectrum import _spectrum

    f, n = np.linspace(2.0, 90.0, 12), np.full(12, 20)
    P = np.where(np.arange(12) == 5, 0.0, 1.0)
    assert np.isfinite(_spectrum(f, P, n, BAND)).all()
