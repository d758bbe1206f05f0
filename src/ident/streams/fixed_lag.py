"""q, v and a of the logged joints while samples come: the splines of a batch, a fixed lag later.

A batch fits quintic splines to all samples of a run (`motion/spline.py`):

    min_c Σ_k Σ_i |x_k(t_i) − u^(k)(t_i)|² / σ_k²,     u(t) = B(t) c

Here the same normal equations are summed as samples come, one small block an interval between two
knots, and solved for the last intervals only. What lies n knots away moves a spline by 0.67ⁿ (the
root of the Euler-Frobenius polynomial of degree 11; C. de Boor, A Practical Guide to Splines, 1978,
ch. XIII). So with `LAG` knots after it the variance of the noise in an acceleration differs from a
batch's by 0.1 %: a smoother with other noise would bias parameters by more than hours of samples
let them scatter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from ident.information.splines import Basis
from ident.motion.signals import SHORTEST
from ident.motion.smoothing import ENDS
from ident.motion.spline import BRIDGE, DEGREE, HEAVIEST, WIDTH
from ident.streams.setting import EXACT, ORDERS, Setting

BEFORE = 30  # knots before a sample
SHARPEST = 1e-9  # of what a channel of unit size can be trusted to, as `complete` has it
# difference of coefficients that fills missing ones, and its weight: as in a batch, and beyond the
# ends of samples that are interpolated, where rounding over a step squared would be acceleration
SMOOTHED, INTERPOLATED = (3, BRIDGE), (5, 1e-4)

Smoothed = tuple[int, np.ndarray, np.ndarray]
"""Number of the first sample, samples (n, columns), and q, v, a (3, n, joints)."""


class FixedLag:
    """Smooths the joints of a stream; nothing is smoothed across a gap.

    Args:
        setting: which channels are logged, their noise, the knots, joints that are not smoothed.
        columns: of a sample, `t` first.
    """

    def __init__(self, setting: Setting, columns: Sequence[str]) -> None:
        pairs = list(zip(setting.logged, setting.channels, strict=True))
        names = [[f"{order}.{name}" for order in orders] for name, orders in pairs]
        self._columns = [[columns.index(name) for name in own] for own in names]
        noise = [[max(setting.noise.get(name, 0.0), SHARPEST) for name in own] for own in names]
        self._taken = [i for i, name in enumerate(setting.logged) if name in setting.taken]
        self._d = len(pairs)
        self._smooth = [i for i in range(self._d) if i not in self._taken]
        rough = any("a" not in setting.channels[i] for i in self._smooth)
        self._ends = ENDS * setting.knots if rough else 0.0  # [s] not to be trusted
        self._h, self._lag = setting.spacing, setting.smoothing_lag
        order, self._bridge = INTERPOLATED if self._lag == EXACT else SMOOTHED
        self._rough = np.diff(np.eye(order + 1), order, axis=0)[0]
        self._basis = Basis(DEGREE, 0.0, self._h, WIDTH)  # of one interval
        u = np.linspace(0.0, self._h, 200)
        size = [float(np.abs(self._basis.window(u, k)[1]).max()) for k in range(len(ORDERS))]
        self._weight = np.zeros((len(ORDERS), self._d))  # 1/σ, no heavier than rounding allows
        for i in self._smooth:
            own = [ORDERS.index(each) for each in setting.channels[i]]
            most = HEAVIEST * min(size[k] / s for k, s in zip(own, noise[i], strict=True))
            for k, s in zip(own, noise[i], strict=True):
                self._weight[k, i] = min(1.0 / s, most / size[k])
        self._orders = [k for k in range(len(ORDERS)) if self._weight[k].any()]
        self._running, self._next = False, 0  # number of the sample that follows
        self._begin(0.0, np.empty((0, 1)))

    def _begin(self, t0: float, X: np.ndarray) -> None:
        """Begin a run at t0 [s]."""
        self._t0, self._X, self._first = t0, X[:0], 0  # samples that wait; first interval
        self._count = 0  # samples of the log in the run
        self._gram = np.zeros((len(ORDERS), 0, WIDTH, WIDTH))
        self._right = np.zeros((len(ORDERS), 0, WIDTH, self._d))

    def __call__(self, number: int, X: np.ndarray, logged: np.ndarray) -> Iterator[Smoothed]:
        """Yield the samples that are complete with those that come.

        X (n, columns), from `number` on, are on the clock; `logged` are those of the log itself.
        """
        if not self._smooth:
            yield number, X, self._as_logged(X, np.zeros((3, len(X), self._d)))
            return
        if not self._running or number != self._next:
            yield from self.finish()
            self._begin(float(logged[0, 0]), X)
            self._running = True
        self._next = number + len(X)
        self._add(logged)
        self._X = np.concatenate([self._X, X])
        if (ready := len(self._X) - self._lag) > 0:
            yield from self._emitted(ready)

    def finish(self) -> Iterator[Smoothed]:
        """Yield what is left of the run, which ends here."""
        if self._running and self._count >= SHORTEST:
            yield from self._emitted(len(self._X), last=True)
        self._running = False

    def _as_logged(self, X: np.ndarray, known: np.ndarray) -> np.ndarray:
        for i in self._taken:
            known[:, :, i] = X[:, self._columns[i]].T
        return known

    def _interval(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the intervals of times, and the times within them [s]."""
        place = (t - self._t0) / self._h
        whole = np.floor(place + 1e-9).astype(int)
        return whole, np.clip(place - whole, 0.0, 1.0) * self._h

    def _add(self, logged: np.ndarray) -> None:
        """Add samples to the normal equations of their intervals."""
        self._count += len(logged)
        interval, u = self._interval(logged[:, 0])
        more = interval[-1] + 1 - self._first - self._gram.shape[1]
        if more > 0:
            self._gram, self._right = (
                np.concatenate([x, np.zeros((x.shape[0], more, *x.shape[2:]))], axis=1)
                for x in (self._gram, self._right)
            )
        starts = np.flatnonzero(np.diff(interval, prepend=-1))
        at = interval[starts] - self._first
        for k in self._orders:
            B = self._basis.window(u, k)[1]
            self._gram[k, at] += np.add.reduceat(B[:, :, None] * B[:, None, :], starts)
            for i in map(int, np.flatnonzero(self._weight[k])):
                x = logged[:, self._columns[i][self._place(i, k)]]
                self._right[k, at, :, i] += np.add.reduceat(B * x[:, None], starts)

    def _place(self, joint: int, order: int) -> int:
        """Return the place of a channel among those of a joint."""
        return int(np.count_nonzero(self._weight[:order, joint]))

    def _solved(self) -> np.ndarray:
        """Return the coefficients (intervals + 5, joints)."""
        m, c = self._gram.shape[1], np.zeros((self._gram.shape[1] + DEGREE, self._d))
        for i in self._smooth:
            square = self._weight[:, i] ** 2
            gram, right = (
                np.tensordot(square, self._gram, 1),
                square @ self._right[..., i].reshape(len(ORDERS), -1),
            )
            band, b = np.zeros((WIDTH, m + DEGREE)), np.zeros(m + DEGREE)
            for r in range(WIDTH):
                b[r : r + m] += right.reshape(m, WIDTH)[:, r]
                for s in range(r, WIDTH):
                    band[s - r, r : r + m] += gram[:, r, s]
            D = self._rough
            most, n = band[0].max(), m + DEGREE - len(D) + 1
            for k in range(len(D)):
                for r in range(len(D) - k):
                    band[k, r : r + n] += self._bridge * most * D[r] * D[r + k]
            factor = cholesky_banded(band, lower=True, check_finite=False, overwrite_ab=True)
            c[:, i] = cho_solve_banded((factor, True), b, check_finite=False)
        return c

    def _emitted(self, count: int, last: bool = False) -> Iterator[Smoothed]:
        """Yield the first samples that wait; `last`: those of the end of a run."""
        X, number = self._X[:count], self._next - len(self._X)
        if not len(X):
            return
        interval, u = self._interval(X[:, 0])
        c, known = self._solved(), np.zeros((len(ORDERS), len(X), self._d))
        place = np.clip(interval - self._first, 0, len(c) - WIDTH)
        for k in range(len(ORDERS)):
            B = self._basis.window(u, k)[1]
            for r in range(WIDTH):
                known[k] += B[:, r, None] * c[place + r]
        end = float(X[-1, 0]) if last else np.inf
        good = (X[:, 0] >= self._t0 + self._ends - 1e-9) & (X[:, 0] <= end - self._ends + 1e-9)
        self._X = self._X[count:]
        old = int(interval[-1]) - BEFORE - self._first
        if old > 0:
            self._first += old
            self._gram, self._right = self._gram[:, old:], self._right[:, old:]
        if good.any():
            first = int(good.argmax())
            X, known = X[good], self._as_logged(X[good], known[:, good])
            yield number + first, X, known
