"""The outer search: shapes and whatever else the equations are not linear in.

    s ← s + δs,  [Γ E S] [p; c; s] = b + S s₀        (Gauss-Newton, at most to the bounds, halved
                                                      while the error does not fall)

A start for every shape comes from its own coarse search, all else refitted; effects whose columns
need the model's own prediction (load, gain) settle in the same iterations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Correcting, Effect
from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.samples import Samples
from ident.fit.accumulate import accumulate, coordinates
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.plausible import plausible
from ident.fit.score import squares
from ident.fit.table import Table
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Told

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


def settled(
    mechanism: Mechanism, motion: Motion, start: Point | None = None, progress: Told | None = None
) -> Point:
    """The working point of a mechanism's equations; the prior where they are linear.

    Args:
        mechanism: with its effects.
        motion: that is fitted.
        start: values of shapes from an earlier search; those it lacks are searched.
        progress: called with (what is being done, share done).
    """
    point = Point.prior(mechanism)
    if all(effect.linear for effect in mechanism.effects):
        return point
    if start is not None:
        point = Point(start.pi, {**start.values, **point.values})
    linear = tuple(effect for effect in mechanism.effects if effect.linear)
    columns = Columns.of(replace(mechanism, effects=linear))
    if len(columns):
        x = _solved(replace(mechanism, effects=linear), columns, motion, point).solution.x
        point = point.at(replace(mechanism, effects=linear), columns, x)
        if start is not None:
            point = Point(point.pi, {**start.values, **point.values})
    for effect in mechanism.effects:
        if not effect.linear:
            point = _started(mechanism, motion, point, effect)
    return _descended(mechanism, motion, point, progress)


def initial(mechanism: Mechanism, motion: Motion) -> Point:
    """The prior, with shapes that nobody gave at a start in the middle of their search."""
    point = Point.prior(mechanism)
    for effect in mechanism.effects:
        if effect.searched:
            signals = Samples(mechanism, motion.experiments[0], slice(None), point).signals(
                effect.joints
            )
            starts = effect.starts(signals)
            stem = dict(zip((s.name for s in effect.parameters), effect.names, strict=True))
            middle = {stem[name]: value for name, value in starts[len(starts) // 2].items()}
            point = point.with_values({**middle, **point.values})
    return point


def _solved(mechanism: Mechanism, columns: Columns, motion: Motion, point: Point) -> Estimate:
    d = coordinates(mechanism, motion)
    cells = accumulate(mechanism, columns, motion, None, point)
    everything = squares(cells, columns.prior, d)
    torque = np.sqrt(everything.torque / np.maximum(everything.rows, 1))
    factors = totals(cells, len(columns), d)
    size = np.sqrt(
        sum((f.column_norms() ** 2 / max(f.rows, 1) for f in factors), np.zeros(len(columns)))
    )
    return estimate(factors, columns.prior, torque, plausible(mechanism, columns, torque, size))


def _started(mechanism: Mechanism, motion: Motion, point: Point, effect: Effect) -> Point:
    """The point with a start for an effect's shapes: the best of its coarse search."""
    _, shape = point.of(effect)
    if len(shape) == len(effect.shapes):
        return point
    stem = dict(
        zip((s.name for s in effect.shapes), effect.names[len(effect.unknowns) :], strict=True)
    )
    if isinstance(effect, Correcting):
        return point.with_values({stem[name]: shape.get(name, 0.0) for name in stem})
    others = tuple(
        e for e in mechanism.effects
        if e.label != effect.label and len(point.of(e)[1]) == len(e.shapes)
    )  # fmt: skip
    rest = replace(mechanism, effects=others)
    columns = Columns.of(rest)
    table = Table.of(rest, columns, motion, point)
    starts = table.starts(effect)
    C = np.zeros((*table.b.shape, len(starts) * len(effect.unknowns)))
    C[:, table.felt(effect)] = table.with_effect(effect, starts)
    told = table.informed
    sigma = np.sqrt((table.tau**2).mean(axis=0)) + 1e-300
    A, b = ((x / (sigma[:, None] if x.ndim == 3 else sigma))[told] for x in (table.A, table.b))
    C = (C / sigma[:, None])[told]
    Q = np.linalg.svd(A, full_matrices=False)[0] if A.shape[1] else np.zeros((len(b), 0))
    C, r = C - Q @ (Q.T @ C), b - Q @ (Q.T @ b)
    u = len(effect.unknowns)
    falls = []
    for i in range(len(starts)):
        own = C[:, i * u : (i + 1) * u]
        falls.append(float(r @ own @ np.linalg.lstsq(own, r, rcond=1e-9)[0]))
    best = starts[int(np.argmax(falls))]
    return point.with_values({stem[name]: float(value) for name, value in best.items()})


def _descended(mechanism: Mechanism, motion: Motion, point: Point, progress: Told | None) -> Point:
    columns = Columns.of(mechanism)
    now = _trial(mechanism, motion, point, _solved(mechanism, columns, motion, point))
    first = _solved(mechanism, columns, motion, now.point)  # a shape without size has no slope
    bounds = _bounds(mechanism, columns, motion, point)
    same = ROUNDING * float(np.sum((first.factor.column_norms() * first.solution.x) ** 2))
    now = _trial(mechanism, motion, now.point, first)
    for step in range(STEPS):
        if progress:
            progress("searching shapes", step / STEPS)
        x, share = _tangent(mechanism, columns, motion, now.point, first), 1.0
        for _ in range(HALVES):
            at = now.point.at(mechanism, columns, _stepped(columns, now.point, x, bounds, share))
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
    held = first.held[[Columns.of(mechanism).index[name] for name in columns.names]]
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


def _stepped(
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


def _bounds(
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
