"""Signals on which a residual may depend, each with the columns of a small smooth map of it.

    f(x) = Σ_k c_k h_k(x)        h_k: hat functions of evenly spaced knots

The direction of motion has a column of its own, since a step is no smooth map. In the same way a
joint's own load has one for bands that widen with it, |load| sign(v).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ident.fit.residual import Residual, Trace

KNOTS = 9  # of a map
FINE = 41  # of the map of a joint's own position, for waves
SLOW = 4  # of the map of time: fewer than folds, so that what is held out lies between
MOST = 12  # joints whose signals are looked at
STIFF, STIFF_FINE = 1e-2, 1e-3  # weight of the map's bends, in shares of a knot's data


@dataclass(frozen=True, eq=False)
class Candidate:
    """One signal and its map.

    Attributes:
        name: `v.elbow`, `sign(v).elbow`, `t`, …; kind: `v`, `sign(v)`, …, `wave`, `bands`.
        joint: whose, or "" for time.
        unit: of the signal.
        columns: (n, c) of the map; knots: (c,) [unit], empty where columns are not hats.
        stiff: weight of the second differences of the map's values.
    """

    name: str
    kind: str
    joint: str
    unit: str
    columns: np.ndarray
    knots: np.ndarray
    stiff: float = 0.0

    def penalty(self, n: int) -> np.ndarray:
        """(c, c): κ D₂ᵀD₂ + ε, so that the map is determined where there are no data."""
        c = self.columns.shape[1]
        ridge = 1e-6 * n / c * np.eye(c)
        if not self.stiff:
            return ridge
        bends = np.diff(np.eye(c), 2, axis=0)
        return ridge + self.stiff * n / c * bends.T @ bends


def hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """h_k(x) (n, c) of evenly spaced knots (c,); constant beyond the ends."""
    step = max(knots[1] - knots[0], 1e-300)
    at = np.clip((x - knots[0]) / step, 0.0, len(knots) - 1.0)
    left = np.minimum(at.astype(int), len(knots) - 2)
    out = np.zeros((len(x), len(knots)))
    rows = np.arange(len(x))
    out[rows, left], out[rows, left + 1] = 1 - (at - left), at - left
    return out


def stacked(residual: Residual, name: str) -> np.ndarray:
    """An array of all traces, one below the other."""
    return np.concatenate([getattr(trace, name) for trace in residual.traces])


def candidates(residual: Residual) -> list[Candidate]:
    """Every signal's map, on the rows of all experiments."""
    found = [_of_time(residual)]
    q, v, a, direction, load = (
        stacked(residual, name) for name in ("q", "v", "a", "direction", "load")
    )
    for i, joint, unit in _looked_at(residual):
        step = direction[:, i : i + 1]
        found.append(Candidate(f"sign(v).{joint}", "sign(v)", joint, "", step, np.zeros(0)))
        for kind, x, per in (("v", v, f"{unit}/s"), ("q", q, unit), ("a", a, f"{unit}/s²")):
            found += _map(kind, joint, per, x[:, i])
        if joint in residual.joints:
            u = residual.joints.index(joint)
            found += _map("load", joint, residual.units[u], load[:, u])
            bands = np.abs(load[:, u : u + 1]) * step
            found.append(
                Candidate(
                    f"load.{joint}", "bands", joint, residual.units[u],
                    np.hstack([step, bands / max(float(np.abs(bands).max()), 1e-300)]), np.zeros(0),
                )
            )  # fmt: skip
    return [each for each in found if np.ptp(each.columns, axis=0).max() > 1e-9]


def fine(residual: Residual, joint: str) -> list[Candidate]:
    """A map of a joint's own position that is fine enough for a wave."""
    i = residual.signals.index(joint)
    x = stacked(residual, "q")[:, i]
    knots = np.linspace(x.min(), x.max(), FINE)
    if np.ptp(x) < 1e-9:
        return []
    unit = residual.coordinate_units[i]
    return [Candidate(f"q.{joint}", "wave", joint, unit, hats(x, knots), knots, STIFF_FINE)]


def _looked_at(residual: Residual) -> Iterator[tuple[int, str, str]]:
    """(index, name, unit) of joints: independent ones first."""
    others = [name for name in residual.signals if name not in residual.joints]
    for joint in [*residual.joints, *others[: max(0, MOST - len(residual.joints))]]:
        i = residual.signals.index(joint)
        yield i, joint, residual.coordinate_units[i]


def _of_time(residual: Residual) -> Candidate:
    t = np.concatenate([trace.t - trace.t[0] for trace in residual.traces])
    knots = np.linspace(0.0, max(float(t.max()), 1e-9), SLOW)
    return Candidate("t", "t", "", "s", hats(t, knots), knots, STIFF)


def _map(kind: str, joint: str, unit: str, x: np.ndarray) -> list[Candidate]:
    if np.ptp(x) <= 1e-9 * max(float(np.abs(x).max()), 1e-9):
        return []
    knots = np.linspace(x.min(), x.max(), KNOTS)
    return [Candidate(f"{kind}.{joint}", kind, joint, unit, hats(x, knots), knots, STIFF)]


def folds(traces: tuple[Trace, ...], count: int = 10) -> np.ndarray:
    """(n,) stretch of time of every row: whole experiments from three on, else parts of them."""
    if len(traces) >= 3:
        return np.repeat(np.arange(len(traces)), [len(trace) for trace in traces])
    each = -(-count // len(traces))
    found = []
    for number, trace in enumerate(traces):
        share = np.arange(len(trace)) * each // max(len(trace), 1)
        found.append(number * each + share)
    return np.concatenate(found)
