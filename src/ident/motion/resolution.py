"""How fine the smooth motion must be: what the data can tell from noise, and no finer.

    AICc(h) = Σ_j [n_j log Σ_k RSS_jk / σ_jk² + 2 m n_j / (n_j − m − 1)]

over joints j and their channels k, m coefficients and n_j samples each; only the ratio of the
channels' noises need be known (C. Hurvich, C.-L. Tsai, Biometrika 76(2), 1989). The
finest spacing that is tried resolves ten times the motion's bandwidth: real noise (quantised,
jittering, from a controller's filter) is not white, and this criterion would follow it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.motion.channels import Channel, periods
from ident.motion.motion import Band
from ident.motion.smooth import fitted, residuals
from ident.motion.spectrum import CLEAN, SMOOTH_OVER_MOTION
from ident.motion.spline import basis_over
from ident.solve.basis import Basis

RATIO = 2**0.5  # of one spacing that is tried to the next
WORSE = 2  # spacings in a row that must be worse before coarser ones are given up
FEWEST = 6  # knot intervals of a run
LOOKED_AT = 20000  # samples of a channel that decide


def finest(band: Band, channels: Sequence[Channel]) -> float:
    """Knots [s] that resolve ten times the bandwidth, and no finer than the samples allow."""
    several = any(channel.order > 0 for channel in channels)
    samples = (1.0 if several else 2.0) * periods(channels)
    if band.noise <= CLEAN or band.motion <= 0:
        return samples
    return max(1 / (2.0 * SMOOTH_OVER_MOTION * band.motion), samples)


def resolution(channels: Sequence[Channel], t: np.ndarray, band: Band) -> float:
    """The spacing of knots [s] for the channels of one run on the clock t (n,)."""
    t = t[:LOOKED_AT]
    mine = [channel.within(t) for channel in channels]
    names = tuple(dict.fromkeys(channel.joint for channel in mine))
    h = best = finest(band, channels)
    least, worse = np.inf, 0
    while worse < WORSE and (t[-1] - t[0]) / h >= FEWEST:
        value = sum(_criterion(basis_over(t[0], t[-1], h), mine, name) for name in names)
        worse = 0 if value < least else worse + 1
        if value < least:
            least, best = value, h
        h *= RATIO
    return best


def _criterion(basis: Basis, channels: Sequence[Channel], name: str) -> float:
    """AICc of one joint."""
    mine = [channel for channel in channels if channel.joint == name]
    n, m = sum(len(channel.x) for channel in mine), basis.count
    if n - m <= 1:
        return np.inf
    left = residuals(fitted(basis, mine, (name,)), mine, (name,))
    squares = [float(off @ off) / c.sigma**2 for off, c in zip(left, mine, strict=True)]
    return n * float(np.log(sum(squares) + 1e-300)) + 2 * m * n / (n - m - 1)
