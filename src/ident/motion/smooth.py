"""One smooth motion fitted to everything that was measured of it.

    min_c Σ_k |x_k − u^(k)(t_k)|² / σ_k²,     u(t) = B(t) c

over the channels k = 0, 1, 2 (position, velocity, acceleration) of each joint, each weighted by its
noise. Time stamps may jitter and channels may have rates of their own: the spline is fitted where
the samples are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from ident.motion.channels import Channel
from ident.motion.spline import DEGREE, Rows, Spline, basis_over, derivative, solved
from ident.solve.basis import Basis

DOUBLINGS = 12
INCONSISTENT = 1.3  # times its noise: a channel that misses the others by more weighs less


def interpolate(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Value, first and second derivative (3, n_at) of the quintic spline through x (n,)."""
    if np.ptp(x) == 0:  # a spline would have rates of rounding, which look like a motion
        return np.stack([np.full(len(at), x[0]), np.zeros(len(at)), np.zeros(len(at))])
    spline = make_interp_spline(t, x, k=DEGREE)
    return np.stack([spline(at, nu) for nu in range(3)])


def filled(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """x (n,) at the times `at` (n_at,): as it is if complete, else a spline's values."""
    return x if len(t) == len(at) else make_interp_spline(t, x, k=DEGREE)(at)


def fitted(basis: Basis, channels: Sequence[Channel], names: Sequence[str]) -> Spline:
    """The spline of the joints `names`, each from its own channels."""
    parts = []
    for name in names:
        rows = []
        for channel in channels:
            if channel.joint == name:
                t = np.clip(channel.t, basis.t0, basis.t_end)
                first, B = basis.window(t, channel.order)
                rows.append(Rows(first, B[:, :, None] / channel.sigma, channel.x / channel.sigma))
        parts.append(solved(basis, rows, 1))
    c = np.concatenate([part.c for part in parts], axis=1)
    return Spline(basis, c, tuple(part.roots[0] for part in parts))


def residuals(
    spline: Spline, channels: Sequence[Channel], names: Sequence[str]
) -> list[np.ndarray]:
    """Measured minus smoothed (n_k,) of each channel."""
    found = []
    for channel in channels:
        i = list(names).index(channel.joint)
        u = derivative(spline.basis, spline.c[:, [i]], channel.t, channel.order)
        found.append(channel.x - u[:, 0])
    return found


def weighted(basis: Basis, channels: Sequence[Channel], names: Sequence[str]) -> list[Channel]:
    """The channels with the noise that residuals show, where that is more than they had.

    Positions are believed. A velocity that a controller has filtered is smooth, but late: where
    positions are missed by more than their noise, rates and accelerations weigh less until they
    are not.

    Args:
        basis: over one run; channels: their samples in it; names: the joints.
    """
    return [each for name in names for each in _agreeing(basis, channels, name)]


def _agreeing(basis: Basis, channels: Sequence[Channel], name: str) -> list[Channel]:
    mine = [channel for channel in channels if channel.joint == name]
    before = mine
    for _ in range(DOUBLINGS):
        rms = _rms(basis, mine, name)
        late = [c.order == 0 and r > INCONSISTENT * c.sigma for c, r in zip(mine, rms, strict=True)]
        if not any(late) or len(mine) == 1:
            break
        mine = [c if c.order == 0 else c.with_noise(2 * c.sigma) for c in mine]
    rms = _rms(basis, mine, name)
    return [
        old.with_noise(max(old.sigma, r)) if r > INCONSISTENT * old.sigma else old
        for old, r in zip(before, rms, strict=True)
    ]


def _rms(basis: Basis, channels: Sequence[Channel], name: str) -> list[float]:
    """Of the residuals of one joint's channels, as if coefficients cost nothing."""
    n = sum(len(channel.x) for channel in channels)
    spare = np.sqrt(n / max(n - basis.count, 1))
    left = residuals(fitted(basis, channels, (name,)), channels, (name,))
    return [spare * float(np.sqrt(np.mean(off**2))) for off in left]


@dataclass(frozen=True, eq=False)
class Smooth:
    """The smooth motion of an experiment in its independent coordinates.

    Attributes:
        names: the joints whose coordinates are splines; spacing: of their knots [s].
        runs: the samples of each run, and its spline.
        channels: what they were fitted to, of these joints and of others that depend on them.
    """

    names: tuple[str, ...]
    spacing: float
    runs: tuple[tuple[slice, Spline], ...]
    channels: tuple[Channel, ...]

    @classmethod
    def of(
        cls,
        channels: Sequence[Channel],
        names: tuple[str, ...],
        runs: Sequence[tuple[slice, np.ndarray]],
        spacing: float,
        origin: float | None = None,
    ) -> Smooth:
        """Splines of all runs (samples, times (n,)), each joint's from its own channels."""
        bases = [basis_over(t[0], t[-1], spacing, origin) for _, t in runs]
        return cls._on(channels, names, runs, bases, spacing)

    def finer(self, t: Sequence[np.ndarray], times: int) -> Smooth:
        """Splines with `times` knots for one, fitted to the own channels; t: (n,) of each run."""
        bases = [
            Basis.with_count(b.t0, b.t_end, times * (b.count - DEGREE) + DEGREE, DEGREE)
            for b in (spline.basis for _, spline in self.runs)
        ]
        runs = [(run, each) for (run, _), each in zip(self.runs, t, strict=True)]
        fine = self._on(self.own, self.names, runs, bases, self.spacing / times)
        return replace(fine, channels=self.channels)

    @classmethod
    def _on(
        cls,
        channels: Sequence[Channel],
        names: tuple[str, ...],
        runs: Sequence[tuple[slice, np.ndarray]],
        bases: Sequence[Basis],
        spacing: float,
    ) -> Smooth:
        splines = tuple(
            (run, fitted(basis, [channel.within(t) for channel in channels], names))
            for (run, t), basis in zip(runs, bases, strict=True)
        )
        return cls(names, spacing, splines, tuple(channels))

    @property
    def own(self) -> tuple[Channel, ...]:
        """The channels of its own joints."""
        return tuple(channel for channel in self.channels if channel.joint in self.names)
