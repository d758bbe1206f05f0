"""From starts to the least error: shapes, and what depends on the model's own prediction.

    s ← s + δs,  [Γ E S] [p; c; s] = b + S s₀        (Gauss-Newton, at most to the bounds, halved
                                                      while the error does not fall)

The error at s is the least over p and c, and S is taken at that p and c (variable projection): far
from the solution the linearised c would be wrong, and S with it. Source: Golub, Pereyra, SIAM J.
Numer. Anal. 10(2), 1973. Effects that ask for the model's prediction (load, gain) settle meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Effect
from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.samples import Samples
from ident.fit.accumulate import accumulate, coordinates
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.plausible import plausible
from ident.fit.score import squares
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Progress

STEPS = 15
FEWEST = 3
HALVES = 5
PASSES = 2  # over what depends on the model's own prediction
REACH = 0.3  # of a shape's range, the longest step
SETTLED = 1e-7  # of the sum of squares: a smaller fall is the last, if values rest as well
RESTING = 1e-6  # of a value: a smaller change is none
ROUNDING = 1e-12  # of the sum of squares of all terms, within which two errors are the same


@dataclass(frozen=True, eq=False)
class _Trial:
    """A working point, and the least error with its shapes."""

    point: Point
    loss: float


def descended(
    mechanism: Mechanism, motion: Motion, point: Point, progress: Progress | None
) -> Point:
    """The point of least error that is reached from a point whose shapes all have a value."""
    columns = Columns.of(mechanism)
    now = _trial(mechanism, motion, point, solved(mechanism, columns, motion, point))
    first = solved(mechanism, columns, motion, now.point)  # a shape without size has no slope
    bounds = shape_bounds(mechanism, columns, motion, point)
    same = ROUNDING * float(np.sum((first.factor.column_norms() * first.solution.x) ** 2))
    now = _trial(mechanism, motion, now.point, first)
    for step in range(STEPS):
        if progress:
            progress("searching shapes", step / STEPS)
        x, share = _tangent(mechanism, columns, motion, now.point, first), 1.0
        for _ in range(HALVES):
            at = now.point.at(mechanism, columns, stepped(columns, now.point, x, bounds, share))
            after = _trial(mechanism, motion, at, first)
            if after.loss <= now.loss + same:
                break
            share *= 0.5
        if after.loss > now.loss + same:
            break
        fell, rests = now.loss - after.loss, _rests(now.point, after.point)
        now = after
        if step >= FEWEST and fell <= SETTLED * now.loss + same and rests:
            break
    return now.point


def _rests(before: Point, after: Point) -> bool:
    """Whether no effect's parameter changes any more."""
    return all(
        abs(value - before.values.get(name, np.inf)) <= RESTING * abs(value)
        for name, value in after.values.items()
    )


def _trial(mechanism: Mechanism, motion: Motion, point: Point, first: Estimate) -> _Trial:
    """The least error with the shapes where they are, and the point at which it is."""
    fixed = replace(mechanism, effects=tuple(_fixed(e, point) for e in mechanism.effects))
    columns = Columns.of(fixed)
    index = Columns.of(mechanism).index
    held = first.held[[index[name] for name in columns.names]]
    for _ in range(PASSES if any(effect.implicit for effect in mechanism.effects) else 1):
        cells = accumulate(fixed, columns, motion, None, point)
        factors = totals(cells, len(columns), coordinates(mechanism, motion))
        found = estimate(
            factors, columns.prior, np.zeros(len(factors)), sigma=first.sigma, held=held
        )
        point = point.at(fixed, columns, found.solution.x)
    return _Trial(point, found.factor.residual_norm(found.solution.x) ** 2)


def _fixed(effect: Effect, point: Point) -> Effect:
    """The effect with its shapes known."""
    return replace(effect, values={**effect.values, **point.of(effect)[1]})


def _tangent(
    mechanism: Mechanism, columns: Columns, motion: Motion, point: Point, first: Estimate
) -> np.ndarray:
    """x (k,), shapes included, that solves the equations linearised at a point."""
    cells = accumulate(mechanism, columns, motion, None, point)
    factors = totals(cells, len(columns), coordinates(mechanism, motion))
    prior = columns.prior_at(point.values)
    zeros = np.zeros(len(factors))
    return estimate(factors, prior, zeros, sigma=first.sigma, held=first.held).solution.x


def stepped(
    columns: Columns,
    point: Point,
    x: np.ndarray,
    bounds: dict[int, tuple[float, float]],
    share: float,
) -> np.ndarray:
    """The solution x with shapes a share of the way to it, no farther than REACH, in bounds."""
    x, before = x.copy(), columns.prior_at(point.values)
    for i in columns.shapes:
        low, high = bounds[int(i)]
        step = np.clip(share * (x[i] - before[i]), -REACH * (high - low), REACH * (high - low))
        x[i] = np.clip(before[i] + step, low, high)
    return x


def beyond(
    mechanism: Mechanism, columns: Columns, motion: Motion, point: Point, found: Estimate
) -> np.ndarray:
    """(k,) shapes that an estimate at a point puts where their columns mean nothing.

    Those of corrections may be on either side of their bounds: a negative play is noise around 0.
    """
    outside = np.zeros(len(columns), dtype=bool)
    if not len(columns.shapes):
        return outside
    bounds = shape_bounds(mechanism, columns, motion, point)
    for effect, places in columns.effects:
        for at in places[len(effect.unknowns) :]:
            if at >= 0 and effect.unknowns:
                low, high = bounds[int(at)]
                outside[at] = not low <= found.solution.x[at] <= high
    return outside


def shape_bounds(
    mechanism: Mechanism, columns: Columns, motion: Motion, point: Point
) -> dict[int, tuple[float, float]]:
    """Of every unknown shape, by its place in x, over all experiments."""
    found: dict[int, tuple[float, float]] = {}
    for e in motion.experiments:
        for effect, places in columns.effects:
            shapes = places[len(effect.unknowns) :]
            if not (shapes >= 0).any():
                continue
            signals = Samples(mechanism, e, slice(None), point).signals(effect.joints)
            own = effect.bounds(replace(signals, shape=point.of(effect)[1]))
            for shape, place in zip(effect.shapes, shapes, strict=True):
                if place >= 0:
                    low, high = own[shape.name]
                    before = found.get(int(place), (low, high))
                    found[int(place)] = min(low, before[0]), max(high, before[1])
    return found


def solved(mechanism: Mechanism, columns: Columns, motion: Motion, point: Point) -> Estimate:
    """The estimate of the linear equations at a point, weights and held unknowns included."""
    d = coordinates(mechanism, motion)
    cells = accumulate(mechanism, columns, motion, None, point)
    everything = squares(cells, columns.prior, d)
    torque = np.sqrt(everything.torque / np.maximum(everything.rows, 1))
    factors = totals(cells, len(columns), d)
    size = np.sqrt(
        sum((f.column_norms() ** 2 / max(f.rows, 1) for f in factors), np.zeros(len(columns)))
    )
    return estimate(factors, columns.prior, torque, plausible(mechanism, columns, torque, size))
