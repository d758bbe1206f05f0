"""Nearest points within limits that are verified without the solver that found them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.errors import FitError
from ident.fit.bodies import MARGIN, VERIFIED
from ident.information.cone import Limit, Point, nearest, svec
from ident.solve.factor import Factor

EXACT = 1e-7  # of a limit's scale, how well what is no body is kept
TIGHTER = 4  # times that a limit which the solver missed is tightened


def nearest_within(
    A: np.ndarray, b: np.ndarray, limits: Sequence[Limit], W: np.ndarray, inner: np.ndarray | None
) -> Point:
    """argmin ‖A x − b‖² within the limits, counted in units of the metric W, and verified.

    Where the solver's x misses a limit by its own tolerance, that limit is tightened; what is left
    after that is moved towards a point within, `inner`, where it ends at worst: limits are convex.

    Raises:
        FitError: if that does not help, naming the limits that x breaks.
    """
    unit = 1 / np.linalg.norm(W, axis=0)
    factor = Factor.of(A * unit, b)
    strict = [replace(limit, G=limit.G * unit) for limit in limits]
    for _ in range(TIGHTER):
        found = nearest(factor.R, factor.d, strict)
        x = _touching(limits, found.x * unit)
        if holds(limits, x):
            return replace(found, x=x)
        strict = [_tightened(tight, limit, x) for tight, limit in zip(strict, limits, strict=True)]
    for share in 2.0 ** np.arange(-20, 1) if inner is not None else ():
        if holds(limits, moved := x + share * (inner - x)):
            return replace(found, x=moved)
    broken = [limit.name for limit in limits if room(limit, x) < 0]
    raise FitError(f"no consistent fit was found: the solver's result breaks {', '.join(broken)}")


def room(limit: Limit, x: np.ndarray) -> float:
    """How far x is inside a limit, below zero where it is not; looked at without the solver.

    A body must keep half of its margin, all else may be off by 1e-7 of its scale.
    """
    return limit.room(x) + (VERIFIED * MARGIN if limit.kind == "psd" else EXACT)


def holds(limits: Sequence[Limit], x: np.ndarray) -> bool:
    """Whether x (k,) keeps to all limits."""
    return all(room(limit, x) >= 0 for limit in limits)


def _touching(limits: Sequence[Limit], x: np.ndarray) -> np.ndarray:
    """x, exactly at the bounds that it touches."""
    x = x.copy()
    for limit in limits:
        at = np.flatnonzero(limit.G[0])
        if limit.kind != "psd" and len(at) == 1 and abs(limit.value(x)[0]) < EXACT:
            x[at] = -limit.h[0] / limit.G[0, at] + 0.0  # no -0.0
    return x


def _tightened(tight: Limit, limit: Limit, x: np.ndarray) -> Limit:
    """What x breaks, with ten times as much room as x lacks."""
    lacking = -10 * min(room(limit, x), 0.0)
    if limit.kind == "psd":
        return replace(tight, h=tight.h - lacking * svec(np.eye(4)))
    return replace(tight, h=tight.h - lacking) if limit.kind == "nonnegative" else tight


def concerned(limits: Sequence[Limit], x: np.ndarray) -> np.ndarray:
    """(k,) unknowns in limits that x breaks, and all that hang together with them by others."""
    found = np.zeros(len(x), dtype=bool)
    for limit in limits:
        if room(limit, x) < 0:
            found |= limit.G.any(axis=0)
    for _ in limits:
        before = found
        for limit in limits:
            if limit.G[:, found].any():
                found = found | limit.G.any(axis=0)
        if (found == before).all():
            break
    return found


def restricted(limits: Sequence[Limit], fixed: np.ndarray, free: np.ndarray) -> list[Limit]:
    """The limits on some unknowns, with the others at their value in `fixed` (k,)."""
    return [replace(limit, G=limit.G[:, free], h=limit.value(fixed)) for limit in limits]
