"""q, v and a of the logged joints while samples come: the splines of a batch, a fixed lag later.

A batch fits quintic splines to all samples of a run (`motion/spline.py`). Here they are fitted to
the last samples, on the same knots, whenever the samples of another knot have come. What lies n
knots away moves a spline by 0.67ⁿ (the root of the Euler-Frobenius polynomial of degree 11; C. de
Boor, A Practical Guide to Splines, 1978, ch. XIII). So with `LAG` knots after it the variance of
the noise in an acceleration differs from a batch's by 0.1 %: a smoother with other noise would bias
parameters by more than hours of samples let them scatter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ident.motion.signals import SHORTEST, Channel
from ident.motion.smoothing import ENDS
from ident.motion.spline import basis_over, fitted, interpolate
from ident.streams.setting import EXACT, LAG, ORDERS, Setting

SHARPEST = 1e-9  # of what a channel of unit size can be trusted to, as `complete` has it

Smoothed = tuple[int, np.ndarray, np.ndarray]
"""Number of the first sample, samples (n, columns), and q, v, a (3, n, joints)."""


class FixedLag:
    """Smooths the joints of a stream; nothing is smoothed across a gap.

    Args:
        setting: which channels are logged, their noise, the knots, joints that are not smoothed.
        columns: of a sample, `t` first.
    """

    def __init__(self, setting: Setting, columns: Sequence[str]) -> None:
        self._setting, self._at = setting, {name: i for i, name in enumerate(columns)}
        pairs = enumerate(zip(setting.logged, setting.channels, strict=True))
        self._smooth = [(i, *pair) for i, pair in pairs if pair[0] not in setting.taken]
        rough = any("a" not in orders for *_, orders in self._smooth)
        self._ends = ENDS * setting.knots if rough else 0.0  # [s] not to be trusted
        self._before = max(LAG * setting.spacing, 2 * EXACT / setting.rate)  # [s] that count
        self._running, self._next, self._count = False, 0, 0

    def __call__(self, number: int, X: np.ndarray, logged: np.ndarray) -> Iterator[Smoothed]:
        """Yield the samples that are complete with those that come.

        X (n, columns), from `number` on, are on the clock; `logged` are those of the log itself.
        """
        if not self._smooth:
            yield number, X, self._as_logged(X)
            return
        if not self._running or number != self._next:
            yield from self.finish()
            self._running, self._count, self._t0 = True, 0, float(logged[0, 0])
            self._waiting, self._logged = X[:0], logged[:0]
        self._next, self._count = number + len(X), self._count + len(logged)
        self._logged = np.concatenate([self._logged, logged])
        self._waiting = np.concatenate([self._waiting, X])
        if len(self._waiting) > self._setting.smoothing_lag:
            ahead = self._setting.smoothing_lag - self._setting.together + 1
            yield from self._emitted(len(self._waiting) - ahead)

    def finish(self) -> Iterator[Smoothed]:
        """Yield what is left of the run, which ends here."""
        if self._running and self._count >= SHORTEST and len(self._waiting):
            yield from self._emitted(len(self._waiting), last=True)
        self._running = False

    def _as_logged(self, X: np.ndarray) -> np.ndarray:
        known = np.zeros((len(ORDERS), len(X), len(self._setting.logged)))
        for i, name in enumerate(self._setting.logged):
            if name in self._setting.taken:
                known[:, :, i] = X[:, [self._at[f"{order}.{name}"] for order in ORDERS]].T
        return known

    def _emitted(self, count: int, last: bool = False) -> Iterator[Smoothed]:
        """Yield the first samples that wait; `last`: those of the end of a run."""
        X, number = self._waiting[:count], self._next - len(self._waiting)
        known, t, end = self._as_logged(X), X[:, 0], float(X[-1, 0])
        self._smoothed(t, known)
        self._waiting = self._waiting[count:]
        self._logged = self._logged[self._logged[:, 0] >= end - self._before]
        good = (t >= self._t0 + self._ends - 1e-9) & (t <= end - self._ends * last + 1e-9)
        if good.any():
            yield number + int(good.argmax()), X[good], known[:, good]

    def _smoothed(self, at: np.ndarray, known: np.ndarray) -> None:
        """Fill in q, v, a (3, n, joints) at the times `at` (n,) [s], from the last samples."""
        setting, t = self._setting, self._logged[:, 0]
        basis = basis_over(float(t[0]), float(t[-1]), setting.spacing, self._t0)
        for i, name, orders in self._smooth:
            series = [self._logged[:, self._at[f"{order}.{name}"]] for order in orders]
            if not setting.knots and orders == "q":
                known[:, :, i] = interpolate(t, series[0], at)
                continue
            noise = [max(setting.noise.get(f"{order}.{name}", 0.0), SHARPEST) for order in orders]
            channels = [
                Channel(name, ORDERS.index(order), t, x, sigma, 1.0)
                for order, x, sigma in zip(orders, series, noise, strict=True)
            ]
            known[:, :, i] = fitted(basis, channels, (name,)).at(at)[:, :, 0]
