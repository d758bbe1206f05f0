"""Frames and running averages against their definitions."""

from __future__ import annotations

import numpy as np

from ident.show.view import frames, running_rms


def test_frames_are_even_and_keep_both_ends():
    t = np.linspace(2.0, 12.0, 5000)
    found = frames(t, 100)
    assert (len(found), found[0], found[-1]) == (100, 0, len(t) - 1)
    np.testing.assert_allclose(np.diff(t[found]), 10.0 / 99, atol=10.0 / 4999)


def test_a_short_motion_keeps_what_it_has():
    np.testing.assert_array_equal(frames(np.linspace(0.0, 0.5, 80), 600), np.arange(80))
    np.testing.assert_array_equal(frames(np.zeros(1), 600), [0])


def test_gaps_in_time_repeat_no_sample():
    t = np.concatenate([np.linspace(0, 1, 50), np.linspace(9, 10, 50)])
    found = frames(t, 90)
    assert (np.diff(found) > 0).all()


def test_running_rms_is_the_rms_around_each_sample():
    random = np.random.default_rng(0)
    t = np.sort(random.uniform(0, 3, 200))
    x = random.normal(size=200)
    x[20:80] = np.nan
    found = running_rms(t, x, 0.3)
    for k in range(0, 200, 7):
        near = x[np.abs(t - t[k]) <= 0.15]
        known = near[np.isfinite(near)]
        expected = np.sqrt(np.mean(known**2)) if len(known) else np.nan
        np.testing.assert_allclose(found[k], expected, rtol=1e-9)
