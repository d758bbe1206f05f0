"""Noise of measured torques that is not white, from the residual above the motion.

Above the band of the motion the residual r = b − A x of a right model is noise. Its power there,

    S(f) = s + a / (1 + (f/f_c)²)        white, and what a first-order low-pass makes of white noise

is fitted by Whittle's likelihood Σ n (ln S + P/S) (Whittle, Arkiv för Matematik 2, 1953) to powers
P of n frequencies each, and what it has below, f_c no lower than a part of the band, is noise there
too. What the rows' filter passes of S, and not of white noise alone, is the rms that noise makes.

Of a model that lacks what the motion determines, S is no noise: ask whether the residual depends on
the motion first. What a motion makes of a wrong gain or length has overtones of its band and dies
away some octaves above, where noise that is slow enough to fill the band is as loud as it was: ask
whether S above overtones of the band says the same. A residual with a line, which a disturbance of
one frequency makes and no noise has, is not taken for noise either.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ident.equations.filter import Decimator
from ident.equations.rows import corrected
from ident.equations.terms import Samples, residual
from ident.equations.unknowns import Point
from ident.mechanism.mechanism import Mechanism
from ident.motion.state import State

FEWEST_IN_BIN = 9  # work: frequencies of a bin, of which a line is less than half
WIDER = 0.3  # work: by which bins grow, of the frequencies before them
CORNERS = 16  # work: values of f_c
LOWEST = 0.25  # range: of the motion's band, that f_c is above: what is slower is not seen
FEWEST = 32  # work: frequencies above the motion, from which a spectrum can be told
ROUNDS = 8  # work: of weights of the likelihood
TINY = 1e-30  # numerics: of the largest power of a spectrum: what is below is none
SAME = 1e-7  # numerics: of a column's size, below which what it has beside another is rounding
# work: frequencies on either side of a line, of which the median is its surrounding
NEIGHBOURS = 10
LEAKED = 2  # numerics: frequencies beside a line that a Hann window's main lobe spreads it over
LINE = 1e-3  # level: chance of a line anywhere in the spectrum of noise without any


def coloured_noise(
    mechanism: Mechanism, experiments: Sequence[State], point: Point,
    cutoff: float | None, bands: Sequence[float],
) -> np.ndarray:  # fmt: skip
    """Return the rms (bands, d) of r that noise makes in the filtered rows, of the spectrum that r
    has above each of some `bands` [Hz], such as that of the motion [N m | N]; 0 where there is too
    little above one.
    """
    squares = []
    for e in experiments:
        r = residual(corrected(Samples(mechanism, e, slice(None), point), cutoff))
        taps = Decimator.of(cutoff, e.rate).taps
        longest = max(e.segments(), key=lambda run: run.stop - run.start, default=slice(0, 0))
        squares.append([[_passed(x, e.rate, taps, f) for x in r[longest].T] for f in bands])
    known = np.count_nonzero(squares, axis=0)  # logs that show it
    return np.asarray(np.sqrt(np.sum(squares, axis=0) / np.maximum(known, 1)))


def _passed(r: np.ndarray, rate: float, taps: np.ndarray | None, band: float) -> float:
    """Return the variance of noise in a series r (n,) that a filter passes."""
    n = len(r)
    if n < FEWEST:
        return 0.0
    f = np.fft.rfftfreq(n, 1 / rate)
    above = (f > band) & (f < rate / 2)
    if above.sum() < FEWEST or (taps is not None and len(taps) > n):
        return 0.0
    window = np.hanning(n)
    P = np.abs(np.fft.rfft((r - r.mean()) * window)) ** 2 / (window @ window)  # variance a sample
    if has_line(P[f > 0]):
        return 0.0
    # the median is not moved by what a few frequencies have more
    edges = [0]
    while edges[-1] + FEWEST_IN_BIN <= above.sum():
        edges.append(edges[-1] + max(FEWEST_IN_BIN, int(WIDER * edges[-1])))
    edges[-1] = int(above.sum())
    bins = [slice(*pair) for pair in pairwise(edges)]
    count = np.array([one.stop - one.start for one in bins])
    power = np.array([np.median(P[above][one]) / np.log(2) for one in bins])
    centre = np.array([f[above][one].mean() for one in bins])
    s, a, corner = _spectrum(centre, power, count, band)
    gain = 1.0 if taps is None else np.abs(np.fft.rfft(taps, n)) ** 2
    S = s + a / (1 + (f / corner) ** 2)
    return float(np.mean(S * gain))


def has_line(P: np.ndarray) -> bool:
    """Return whether one power P (n,) of a Hann-windowed spectrum stands out of its neighbours.

    Power of noise over the mean of m of its neighbours, F(2, 2 m), is above x by chance

        (1 + x/m)^-m        of a median, which a second line does not move, m is half as many
    """
    reach = LEAKED + NEIGHBOURS
    if len(P) <= 2 * reach:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(P, 2 * reach + 1)
    around = np.delete(windows, np.s_[NEIGHBOURS : NEIGHBOURS + 2 * LEAKED + 1], axis=1)
    mean = np.median(around, axis=1) / np.log(2)
    limit = NEIGHBOURS * ((LINE / len(P)) ** (-1 / NEIGHBOURS) - 1)
    return bool((windows[:, reach] > limit * mean).any())


def _spectrum(f: np.ndarray, P: np.ndarray, n: np.ndarray, band: float) -> tuple[float, ...]:
    """Return s, a and f_c of the spectrum of powers P (bins,), of n frequencies each about f."""
    corners, least = np.geomspace(LOWEST * band, f[-1], CORNERS), TINY * float(P.max())
    if not least:
        return 0.0, 0.0, float(corners[0])
    shape = np.stack(np.broadcast_arrays(1.0, 1 / (1 + (f / corners[:, None]) ** 2)))
    S = np.broadcast_to(np.maximum(P, least), shape.shape[1:])
    for _ in range(ROUNDS):
        root = np.sqrt(n) / S
        x = _nonnegative(shape * root, P * root)
        S = np.maximum((x[:, :, None] * shape).sum(axis=0), least)
    best = int((n * (np.log(S) + P / S)).sum(axis=1).argmin())
    return float(x[0, best]), float(x[1, best]), float(corners[best])


def _nonnegative(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the least-squares solutions x (2, c) of two columns A (2, c, n) for b (c, n), x ≥ 0:
    by Gram and Schmidt, or of one column alone.
    """
    squares = np.maximum((A**2).sum(axis=2), 1e-300)
    alone = np.maximum((A * b).sum(axis=2), 0.0) / squares
    share = (A[0] * A[1]).sum(axis=1) / squares[0]
    rest = A[1] - share[:, None] * A[0]
    square = (rest**2).sum(axis=1)
    new = square > SAME**2 * squares[1]
    second = np.where(new, (rest * b).sum(axis=1) / np.where(new, square, 1.0), 0.0)
    both = np.stack([(A[0] * b).sum(axis=1) / squares[0] - share * second, second])
    misfits = ((A * alone[:, :, None] - b) ** 2).sum(axis=2)
    first = misfits[0] <= misfits[1]
    return np.where((both >= 0).all(axis=0), both, alone * np.stack([first, ~first]))
