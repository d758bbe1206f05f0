"""Noise below the band of a motion, from what it is above; errors held out by phase."""

import numpy as np
import pytest
from scipy.signal import lfilter

from ident.equations.filter import Decimator
from ident.equations.noise_spectrum import _passed
from ident.information.blocks import Block, Information
from ident.information.chance import folds
from ident.information.linear import Triangle

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


def blocks(log, count, length):
    empty = Triangle.empty(1)
    every = np.arange(1)
    return [
        Block(log, k, 0, empty, empty, empty, every, (1.0, 0.0), (k * length, (k + 1) * length))
        for k in range(count)
    ]


def test_phases_of_a_repeated_motion_are_left_out_together():
    """Five blocks to a period: blocks 0, 5, 10, 15 are one phase; without a period, tenths of the
    time are left out.
    """
    information = Information.of(blocks(0, 20, 1.0), 1, 1)
    by_phase = folds(information, 10, {0: 5.0})
    assert [sorted(key.block % 5 for key in part.blocks) for part in by_phase.values()] == [
        [k] * 4 for k in range(5)
    ]
    by_time = folds(information, 10)
    assert [[key.block for key in part.blocks] for part in by_time.values()] == [
        [2 * k, 2 * k + 1] for k in range(10)
    ]
    # a period of few blocks has no parts
    assert len(folds(information, 10, {0: 2.0})) == 10
