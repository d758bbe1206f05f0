"""Noise below the band of a motion, from what it is above."""

import numpy as np
import pytest
from scipy.signal import lfilter

from ident.equations.filter import Decimator
from ident.equations.noise_spectrum import _passed

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
    t = np.arange(4000) / RATE
    noise = 0.01 * np.random.default_rng(0).standard_normal(4000)
    taps = Decimator.of(5 * BAND, RATE).taps
    alone = _passed(noise, RATE, taps, BAND)
    waves = sum(np.sin(2 * np.pi * f * t) for f in (0.3, 0.7, 1.1))
    assert _passed(noise + waves, RATE, taps, BAND) == pytest.approx(alone, rel=0.3)
