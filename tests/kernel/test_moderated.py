"""Noise of an estimate with a prior: rows that are alike, few blocks of unequal weight."""

import numpy as np
import pytest
from scipy.signal import firwin, lfilter

from ident.information.blocks import Block, Information
from ident.information.chance import covariance, long_run, moderated_covariance
from ident.information.estimate import estimate
from ident.information.linear import Triangle
from ident.information.stationary import rows_alike

ROWS, BLOCKS, UNKNOWNS = 800, 10, 20


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.9])
def test_rows_of_an_autoregression_are_alike(correlation):
    found = []
    for seed in range(10):
        white = np.random.default_rng(seed).standard_normal(4000)
        x = lfilter([1.0], [1, -correlation], white)
        x[1000:1100] = np.nan
        found.append(rows_alike([x[:2500], x[2500:]]))
    assert np.median(found) == pytest.approx((1 + correlation) / (1 - correlation), rel=0.2)


def test_filtered_noise_is_alike_by_its_band():
    """White noise below a fifth of the rows' Nyquist frequency."""
    taps = firwin(101, 0.2)
    x = [np.convolve(np.random.default_rng(s).standard_normal(4000), taps, "valid") for s in (0, 1)]
    assert rows_alike(x) == pytest.approx(5.0, rel=0.3)


def test_what_is_short_or_nothing_is_alike_to_nothing():
    assert rows_alike([np.ones(5)]) == 1.0
    assert rows_alike([np.zeros(100)]) == 1.0


def _case(seed, loud=1.0, last=1.0):
    """Rows of which two blocks determine most of some unknowns, with the last of columns that are
    so large; what noise makes of these.
    """
    random = np.random.default_rng(seed)
    A = random.standard_normal((ROWS, UNKNOWNS))
    A[:, -1] *= last
    block = np.arange(ROWS) * BLOCKS // ROWS
    A[(block != 2) & (block != 7), 3:] *= 0.05
    noise = random.standard_normal(ROWS) * np.where(block == 2, loud, 1.0)
    none, support, blocks = Triangle.empty(UNKNOWNS), np.arange(UNKNOWNS), []
    for k in range(BLOCKS):
        rows = Triangle.of(A[block == k], noise[block == k])
        span = float(k), k + 1.0
        blocks.append(Block(0, k, 0, rows, none, none, support, (1.0, 0.0), span))
    information = Information.of(blocks, UNKNOWNS, 1)
    prior = Triangle.of(np.eye(UNKNOWNS), np.zeros(UNKNOWNS))
    one = np.ones(1)
    total = Triangle.merge([information.total(one), prior])
    fitted = estimate([total], np.zeros(UNKNOWNS), one, sigma=one)
    C = fitted.solution.C
    return information, fitted, C @ (A.T @ A) @ C


def test_few_blocks_of_much_weight_do_not_exaggerate_noise():
    z, of_jackknife = [], []
    for seed in range(40):
        information, fitted, white = _case(seed)
        cov = moderated_covariance(information, fitted, white)
        z.append(fitted.x / np.sqrt(np.diag(cov)))
        of_jackknife.append(fitted.x / np.sqrt(np.diag(covariance(information, fitted))))
    moderated, jackknife = (np.sqrt(np.mean(np.square(x))) for x in (z, of_jackknife))
    assert jackknife + 0.1 < moderated < 1.05


def test_a_loud_stretch_is_in_the_blocks_scatter():
    z = []
    for seed in range(40):
        information, fitted, white = _case(seed, loud=4.0)
        z.append(fitted.x / np.sqrt(np.diag(moderated_covariance(information, fitted, white))))
    assert np.sqrt(np.mean(np.square(z))) < 1.6  # of white noise it would be 2.9


@pytest.mark.parametrize("last", [0.0, 1e-11, 1e-9])
def test_an_unknown_of_which_rows_tell_nothing_changes_no_noise(last):
    """Its variance by noise is one of rounding, of either sign."""
    information, fitted, white = _case(0, last=1e-6)
    expected = moderated_covariance(information, fitted, white)[:-1, :-1]
    information, fitted, white = _case(0, last=last)
    white[-1, -1] = -1e-17
    found = moderated_covariance(information, fitted, white)[:-1, :-1]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_noise_that_a_prior_outweighs_is_moderated_all_the_same():
    wider = []
    for size in (1.0, 1e-12):  # the same scatter of blocks is more of less noise
        information, fitted, white = _case(0, loud=3.0)
        small = moderated_covariance(information, fitted, white * size)
        wider.append(np.sqrt(np.diag(small) / np.diag(white) / size))
    assert (wider[1] > 1.01 * wider[0]).all()


def test_lags_are_those_of_what_rows_tell(monkeypatch):
    widths = []

    def recorded(times, deltas, shares):
        widths.append((deltas.shape[1], shares.shape[1]))
        return long_run(times, deltas, shares)

    monkeypatch.setattr("ident.information.chance.long_run", recorded)
    information, fitted, white = _case(0)
    white[-1, -1] = 1e-17 * white[0, 0]
    moderated_covariance(information, fitted, white)
    assert widths == [(UNKNOWNS - 1, UNKNOWNS - 1)]


def test_without_noise_there_is_none():
    information, fitted, white = _case(0)
    none = np.zeros_like(white)
    np.testing.assert_array_equal(moderated_covariance(information, fitted, none), none)
