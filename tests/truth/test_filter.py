"""The zero-phase filter: its figures, its reach, and that pieces give the same as one pass."""

import numpy as np
import pytest

from ident.equations.filter import Decimator, multiplied, products

CASES = [(5.0, 200.0), (20.0, 1000.0), (40.0, 5000.0), (30.0, 100.0)]


def response(decimator, rate, f):
    k = np.arange(-decimator.half, decimator.half + 1)
    return decimator.taps @ np.cos(2 * np.pi * f / rate * k)  # symmetric: real, no phase


def through(decimator, x, segment=None):
    """(kept samples, filtered) of an experiment."""
    parts = [*decimator.filtered(segment or slice(0, len(x)), lambda part: [x[part]])]
    return np.concatenate([at for at, _ in parts]), np.concatenate([y for _, (y,) in parts])


@pytest.mark.parametrize(("cutoff", "rate"), CASES)
def test_figures(cutoff, rate):
    decimator = Decimator.of(cutoff, rate)
    np.testing.assert_allclose(decimator.taps, decimator.taps[::-1], atol=1e-17)
    assert decimator.taps.sum() == pytest.approx(1)
    assert response(decimator, rate, cutoff) == pytest.approx(0.5, abs=0.01)  # −6 dB
    passed = [response(decimator, rate, f) for f in np.linspace(0, 0.5 * cutoff, 50)]
    assert np.abs(np.array(passed) - 1).max() < 2.5e-3
    stopped = [response(decimator, rate, f) for f in np.linspace(1.5 * cutoff, rate / 2, 200)]
    assert np.abs(stopped).max() < 2.5e-3  # −52 dB at the edge
    assert np.abs(stopped[len(stopped) // 5 :]).max(initial=0) < 1.5e-3  # −56 dB a little beyond it
    kept = rate / decimator.factor
    assert kept >= 4 * cutoff or decimator.factor == 1
    assert decimator.factor == max(1, int(rate / (4 * cutoff)))


@pytest.mark.parametrize(("cutoff", "rate"), CASES)
def test_constants_and_slopes_pass_unchanged(cutoff, rate):
    # no phase: a straight line comes out as itself, at the same times
    decimator = Decimator.of(cutoff, rate)
    n = 8 * decimator.half + 57
    x = np.stack([np.full(n, 3.7), np.arange(n) * 0.1 - 2], axis=1)
    samples, found = through(decimator, x)
    np.testing.assert_allclose(found, x[samples], rtol=0, atol=1e-10 * n)


def test_a_line_in_the_pass_band_is_not_delayed():
    t = np.arange(4000) / 1000
    decimator = Decimator.of(20.0, 1000.0)
    samples, found = through(decimator, np.sin(2 * np.pi * 7 * t)[:, None])
    np.testing.assert_allclose(found[:, 0], np.sin(2 * np.pi * 7 * t[samples]), atol=2e-3)


@pytest.mark.parametrize("chunk", [1, 100, 333, 2048])
@pytest.mark.parametrize(("cutoff", "rate"), CASES)
def test_pieces_give_the_same_as_one_pass(cutoff, rate, chunk, monkeypatch):
    decimator = Decimator.of(cutoff, rate)
    x = np.random.default_rng(0).normal(size=(14 * decimator.half + 913, 2, 3))
    segment = slice(101, len(x) - 57)
    whole, exact = through(decimator, x, segment)
    monkeypatch.setattr("ident.equations.filter.CHUNK", chunk)
    samples, found = through(decimator, x, segment)
    np.testing.assert_array_equal(samples, whole)
    np.testing.assert_allclose(found, exact, atol=1e-13)
    # against convolution; what is lost at either end is `half` samples and no more
    smooth = np.apply_along_axis(np.convolve, 0, x[segment], decimator.taps, "valid")
    first = segment.start + decimator.half
    np.testing.assert_array_equal(
        samples, np.arange(first, segment.stop - decimator.half, decimator.factor)
    )
    np.testing.assert_allclose(found, smooth[samples - first], atol=1e-13)


def test_a_segment_shorter_than_the_filter_gives_nothing():
    decimator = Decimator.of(5.0, 200.0)
    x = np.ones((2 * decimator.half + 1, 1))
    assert not list(decimator.filtered(slice(0, len(x) - 1), lambda part: [x[part]]))
    assert len(through(decimator, x)[0]) == 1


def test_without_a_cutoff_every_sample_stays():
    decimator = Decimator.of(None, 200.0)
    assert (decimator.half, decimator.factor) == (0, 1)
    x = np.random.default_rng(0).normal(size=(30, 2))
    samples, found = through(decimator, x, slice(3, 25))
    np.testing.assert_array_equal(samples, np.arange(3, 25))
    np.testing.assert_array_equal(found, x[3:25])


def test_the_share_of_open_samples_counts_both_signs():
    decimator = Decimator.of(20.0, 1000.0)
    open_ = np.zeros((2 * decimator.half + 1, 1), dtype=bool)
    share = np.abs(decimator.taps).sum()
    ((_, (found,)),) = decimator.filtered(slice(0, len(open_)), lambda part: [open_[part]])
    assert found.tolist() == [[pytest.approx(share)]]


def test_whole_series_are_filtered_at_any_rows():
    """Two stretches in equal steps, a lone row between them, and the last possible row."""
    filters = Decimator.of(10.0, 1000.0)
    assert filters.taps is not None
    half, x = filters.half, np.random.default_rng(0).standard_normal((6000, 3))
    first = np.arange(half, 2000, filters.factor)
    second = np.arange(3000, 6000 - half, 2 * filters.factor)
    at = np.concatenate([first, [2500], second, [6000 - half - 1]])
    expected = [filters.taps @ x[i - half : i + half + 1] for i in np.unique(at)]
    np.testing.assert_allclose(
        multiplied(products(filters.taps, np.unique(at)), x), expected, atol=1e-12
    )
