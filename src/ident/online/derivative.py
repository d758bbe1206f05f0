"""Coordinates, rates and accelerations of the logged joints, half a window late.

    min_c Σ_k Σ_i |x_k(t_i) − u^(k)(t_i)|² / σ_k²,    u(t) = Σ_j c_j (t − t₀)^j,   |t_i − t₀| ≤ M dt

over the channels k (position, velocity, acceleration) of a joint: one polynomial a sample, fitted
to the window around it. It is linear in the samples, so its coefficients are made once. Source: A.
Savitzky, M. Golay, Anal. Chem. 36(8), 1964; here with several derivatives measured.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from ident.online.clock import Run
from ident.online.setting import DEGREE, ORDERS, Setting

SHARPEST = 1e-9  # of what a channel of unit size can be trusted to, as complete has it


class Derivative:
    """Motion channels in, coordinates, rates and accelerations out.

    Args:
        setting: which channels there are, and how wide the window is.
        columns: names of the columns of runs.
    """

    def __init__(self, setting: Setting, columns: tuple[str, ...]) -> None:
        self.half = setting.half
        self._at = np.array([columns.index(name) for name in setting.motion_columns])
        self._joint = np.array(
            [i for i, orders in enumerate(setting.channels) for _ in orders], dtype=int
        )
        # (channels, 2 M + 1, 3): what a sample of a channel adds to its joint's q, v, a
        self._weights = np.concatenate(
            [
                _weights(setting, name, orders)
                for name, orders in zip(setting.logged, setting.channels, strict=True)
            ]
        )
        self._waiting: Run | None = None

    def __call__(self, run: Run) -> tuple[Run, np.ndarray]:
        """The samples that have a whole window by now, and their known (3, n, logged)."""
        if not self.half:  # every channel of every joint is there, q, v, a of one after another
            known = run.X[:, self._at].reshape(len(run), -1, len(ORDERS))
            return run, known.transpose(2, 0, 1)
        wide, half = self._joined(run), self.half
        centre = Run(wide.number + half, wide.X[half : len(wide) - half])
        self._waiting = Run(wide.number + max(len(wide) - 2 * half, 0), wide.X[-2 * half :])
        x = wide.X[:, self._at]
        known = np.zeros((int(self._joint[-1]) + 1, len(centre), 3))
        if len(centre):
            windows = np.lib.stride_tricks.sliding_window_view(x, 2 * half + 1, axis=0)
            np.add.at(known, self._joint, windows.transpose(1, 0, 2) @ self._weights)
        return centre, known.transpose(2, 1, 0)

    def _joined(self, run: Run) -> Run:
        before = self._waiting
        if before is None or before.number + len(before) != run.number:
            return run
        return Run(before.number, np.concatenate([before.X, run.X]))


def _weights(setting: Setting, name: str, orders: str) -> np.ndarray:
    """(channels, 2 M + 1, 3) of one joint."""
    M = setting.half
    found = np.zeros((len(orders), 2 * M + 1, 3))
    if name in setting.taken:
        found[range(3), M, range(3)] = 1.0
        return found
    unit = M / setting.rate  # [s], so that powers are of numbers up to 1
    s = np.arange(-M, M + 1) / max(M, 1)
    j = np.arange(min(DEGREE, 2 * M) + 1)
    rows = []
    for order in orders:
        k = ORDERS.index(order)
        fall = np.array([factorial(i) / factorial(i - k) if i >= k else 0.0 for i in j])
        power = s[:, None] ** np.maximum(j - k, 0)
        sigma = max(setting.noise.get(f"{order}.{name}", 0.0), SHARPEST)
        rows.append(fall * power / unit**k / sigma)
    fit = np.linalg.pinv(np.concatenate(rows))  # c = fit · x/σ
    sigmas = np.repeat(
        [max(setting.noise.get(f"{order}.{name}", 0.0), SHARPEST) for order in orders], 2 * M + 1
    )
    fit = fit[:3] / sigmas * (np.array([1.0, 1.0, 2.0]) / unit ** np.arange(3))[:, None]
    return fit.T.reshape(len(orders), 2 * M + 1, 3)
