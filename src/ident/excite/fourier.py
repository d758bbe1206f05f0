"""Finite Fourier series that begin and end every period at rest.

    y(t) = c + Σ_k a_k sin(kωt) + b_k cos(kωt)          ω = 2π/T, k = 1 … H
    ẏ(0) = 0:  Σ k a_k = 0            ÿ(0) = 0:  Σ k² b_k = 0

Source: Swevers, Ganseman, Tükel, De Schutter, Van Brussel, IEEE Trans. Robot. Autom. 13(5), 1997,
eq. 12. Both conditions are linear, so that the series which keep them are a linear space too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import null_space


@dataclass(frozen=True, eq=False)
class Fourier:
    """The series of d joints about where they are at home: y = home + basis(t) x.

    Attributes:
        period: T [s]; harmonics: H, 2 or more.
        home: (d,) [rad | m], the positions at x = 0.
        half: (d,) half of the joints' ranges; speed, acceleration: (d,) the largest allowed.
    """

    period: float
    harmonics: int
    home: np.ndarray
    half: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Of x: d joints, 2 H − 1 numbers each, of which the first moves the centre c."""
        return len(self.home), 2 * self.harmonics - 1

    @property
    def omega(self) -> np.ndarray:
        """k ω (H,) [rad/s]."""
        return 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)

    @cached_property
    def _free(self) -> np.ndarray:
        """(d, 2 H + 1, 2 H − 1): c, a, b of every joint from its x.

        An amplitude counts by the largest that the limits leave to its harmonic alone; the
        search then sees all of them alike.
        """
        H, w = self.harmonics, self.omega
        found = np.zeros((len(self.home), 2 * H + 1, 2 * H - 1))
        for u, out in enumerate(found):
            largest = np.minimum(self.half[u], self.speed[u] / w)
            largest = np.minimum(largest, self.acceleration[u] / w**2)
            out[0, 0] = self.half[u]
            for rows, power, at in ((slice(1, H + 1), 1, 1), (slice(H + 1, None), 2, H)):
                condition = (w**power * largest)[None]
                out[rows, at : at + H - 1] = largest[:, None] * null_space(condition)
        return found

    def coefficients(self, x: np.ndarray) -> np.ndarray:
        """c, a_1 … a_H, b_1 … b_H (d, 2 H + 1) of the series x (d, 2 H − 1) [rad | m]."""
        found = np.einsum("dkp,dp->dk", self._free, x)
        found[:, 0] += self.home
        return found

    def basis(self, t: np.ndarray) -> np.ndarray:
        """(3, n, d, 2 H − 1): what x does to y, ẏ and ÿ at the times t (n,) [s]."""
        w = self.omega
        sin, cos = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        one, none = np.ones((len(t), 1)), np.zeros((len(t), 1))
        waves = np.stack([
            np.hstack([one, sin, cos]),
            np.hstack([none, w * cos, -w * sin]),
            np.hstack([none, -(w**2) * sin, -(w**2) * cos]),
        ])  # fmt: skip
        return np.einsum("cnk,dkp->cndp", waves, self._free)

    def states(self, x: np.ndarray, t: np.ndarray) -> np.ndarray:
        """y, ẏ, ÿ (3, n, d) of the series x (d, 2 H − 1) at the times t (n,) [s]."""
        return self.placed(self.basis(t), x)

    def placed(self, basis: np.ndarray, x: np.ndarray) -> np.ndarray:
        """The same from a basis that is at hand."""
        found = np.einsum("cndp,dp->cnd", basis, x)
        found[0] += self.home
        return found

    def between(self, n: int) -> float:
        """Share of a bound that n even samples a period may reach, so that nothing between them
        exceeds it: cos(π H / n) (Ehlich, Zeller, Math. Z. 86, 1964).
        """
        return float(np.cos(np.pi * self.harmonics / n))
