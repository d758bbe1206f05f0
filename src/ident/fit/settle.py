"""The outer search: shapes and whatever else the equations are not linear in.

A start for every shape comes from its own coarse search, all else refitted; then all descend.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.effects import Correcting, Effect
from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.samples import Samples
from ident.fit.descend import descended, solved
from ident.fit.table import Table
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Progress


def settled(
    mechanism: Mechanism,
    motion: Motion,
    start: Point | None = None,
    progress: Progress | None = None,
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
        x = solved(replace(mechanism, effects=linear), columns, motion, point).solution.x
        point = point.at(replace(mechanism, effects=linear), columns, x)
        if start is not None:
            point = Point(point.pi, {**start.values, **point.values})
    for effect in mechanism.effects:
        if not effect.linear:
            point = _started(mechanism, motion, point, effect)
    return descended(mechanism, motion, point, progress)


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
