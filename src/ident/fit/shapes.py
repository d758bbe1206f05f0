"""The search for shape parameters, and for all else that the equations are not linear in.

    s ← s + δs,  [Γ E S] [p; c; s] = b + S s₀        (Gauss-Newton, at most to the bounds, halved
                                                      while the error does not fall)

The error at s is the least over p and c, and S is taken at that p and c (variable projection): far
from the solution the linearised c would be wrong, and S with it. Source: Golub, Pereyra, SIAM J.
Numer. Anal. 10(2), 1973. Effects that depend on the model's prediction (load, gain) converge
meanwhile. A start for every shape comes from its own coarse search, everything else refitted.

Where a load twists its joint, p moves links as s does, and its columns know that: all unknowns make
one step together (`descended`), from the best model in which nothing twists and from the start of
the coarse search.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.display import Progress, no_progress
from ident.effects import Effect
from ident.equations.problem import Problem
from ident.equations.rows import check_needs
from ident.equations.table import Table
from ident.equations.terms import Samples
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, MechanismError
from ident.information import linear
from ident.information.estimate import Estimate, rank_revealing
from ident.information.evidence import CERTAIN
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.text import listed

STEPS = 15  # work
STARTS_TRIED = 5  # work: of a correction that is not linear, with everything refitted
SWINGING_STEPS = 45  # work: where a link swings with a load that is fitted meanwhile
HALVES = 5  # work
PASSES = 2  # work: over what depends on the model's own prediction
FELT = 0.1  # numerics: standard errors by which a step must move shapes to be tried in parts
SETTLED = 1e-4  # numerics: share of the error by which a step that is not the last lowers it
LONGEST = 0.3  # numerics: of a shape's range, the longest step
# numerics: of a value, and of its standard error: a smaller step is the last
OF_VALUE, OF_ERROR = 1e-6, 1e-4
SAME = 1e-12  # numerics: of the sum of squares of all terms, within which two errors are the same


def working_point(
    mechanism: Mechanism,
    motion: Motion,
    start: Point | None = None,
    on_progress: Progress = no_progress,
) -> Point:
    """Search the working point of a mechanism's equations; the prior where they are linear.

    `start` has values of shapes from an earlier search; those it lacks are searched.
    """
    point = Point.prior(mechanism)
    if all(effect.linear for effect in mechanism.effects):
        return point
    for e in motion.experiments:
        check_needs(mechanism, e.name, e.extra)
    if start is not None:
        point = Point(start.pi, {**start.values, **point.values})
    for effect in mechanism.effects:
        if effect.supplies_torque:  # before all that is fitted to what it supplies
            point = _started(mechanism, motion, point, effect)
    supplied = point.values
    linear_ones = (e for e in mechanism.effects if e.linear or e.supplies_torque)
    fewer = replace(mechanism, effects=tuple(linear_ones))
    columns = Columns.of(fewer).with_known_shapes
    if len(columns):
        estimate = Problem.reduced(fewer, motion, point, columns).estimate()
        point = point.at(fewer, columns, estimate.x).with_values(supplied)
        if start is not None:
            point = Point(point.pi, {**start.values, **point.values})
    rigid = replace(mechanism, effects=tuple(e for e in mechanism.effects if not _twists(e)))
    for effect in rigid.effects:
        if not effect.linear:
            point = _started(rigid, motion, point, effect)
    if any(swings(effect) for effect in rigid.effects):  # by as much as is known
        point = descended(rigid, motion, point, on_progress=on_progress)[0]
    elif len(Columns.of(rigid)):
        point = variable_projection(rigid, motion, point, on_progress)
    model = rigid
    for effect in (effect for effect in mechanism.effects if _twists(effect)):
        model = replace(model, effects=(*model.effects, effect))
        point = _twisted(model, motion, point, effect, start)
    return point


def swings(effect: Effect) -> bool:
    """Return whether a link swings or flies behind its motor, with the load that is fitted."""
    return effect.implicit and bool(effect.extent) and effect.whole_log


def _twists(effect: Effect) -> bool:
    """Return whether a link swings or flies by an extent that is searched."""
    return swings(effect) and effect.extent not in effect.values


def _twisted(
    mechanism: Mechanism, motion: Motion, point: Point, effect: Effect, start: Point | None
) -> Point:
    """Return the point of least error with an effect that twists its joint, from one without it: of
    what a descent from there leads to, unless another start leads to less by more than chance.
    """
    # without an extent other shapes do nothing: they are those of the least one that is searched,
    # or it would swing undamped at any frequency as soon as there is some
    signals = Samples(mechanism, motion.experiments[0], slice(None), point).signals(effect.acting)
    least_start = min(reversed(effect.starts(signals)), key=lambda shape: shape[effect.extent])
    shape = {**least_start, effect.extent: 0.0, **effect.values}
    none = {effect.full[s.name]: float(shape[s.name]) for s in effect.shapes}
    stiff = point.with_values(none)
    best, least, weights = descended(mechanism, motion, stiff)
    rigid, before = best, start.values if start is not None else {}
    if none.keys() <= before.keys():
        best, least = _better(
            mechanism, motion, point.with_values({name: before[name] for name in none}), weights,
            (best, least),
        )  # fmt: skip
    other = _started(mechanism, motion, point, effect) if best is rigid else stiff
    if other.of(effect)[1][effect.extent]:
        best, _ = _better(mechanism, motion, other, weights, (best, least))
    return best


def _better(
    mechanism: Mechanism, motion: Motion, start: Point, weights: Weights, best: tuple[Point, float]
) -> tuple[Point, float]:
    """Return the point that a descent from a start leads to, and its error, or the best so far
    where that has no more but by chance: in squares of rows' noise a resonance fits some of it.
    """
    end, error, _ = descended(mechanism, motion, start, weights)
    return (end, error) if error < best[1] - CERTAIN**2 else best


@dataclass(frozen=True, eq=False)
class Weights:
    """By what rows are divided in a search, and what it does not move."""

    sigma: np.ndarray  # (d,) [N m | N], of drives over their scale
    fixed: np.ndarray  # (k,)

    @classmethod
    def of(cls, problem: Problem, like: Weights | None = None) -> Weights:
        """Take the weights of least squares at the point of a problem, or those of another one."""
        estimate = problem.estimate()
        check_scales(problem.columns, estimate)
        scales = drive_scales(problem.mechanism, problem.motion, problem.point)
        return cls(like.sigma if like else estimate.sigma / scales, estimate.fixed)

    def solved(self, problem: Problem, at_ends: Sequence[int] = ()) -> Estimate:
        """Return least squares of a problem, some further unknowns where they are."""
        scales, fixed = drive_scales(problem.mechanism, problem.motion, problem.point), self.fixed
        if len(at_ends):
            fixed = fixed | np.isin(np.arange(len(fixed)), at_ends)
        return problem.estimate(sigma=self.sigma * scales, fixed=fixed)


def descended(
    mechanism: Mechanism,
    motion: Motion,
    point: Point,
    weights: Weights | None = None,
    given: Sequence[str] = (),
    on_progress: Progress = no_progress,
) -> tuple[Point, float, Weights]:
    """Return the point of least error to which steps of all unknowns together lead from a point,
    that error, and its weights: those given, or those of the starting point.

    Shapes stay within their bounds, and those that would leave them from there stay there; `given`
    are names of unknowns that are not moved.
    """
    problem = Problem.reduced(mechanism, motion, point)
    columns, bounds = problem.columns, shape_bounds(problem)
    weights = Weights.of(problem, weights)
    known = [columns.index[name] for name in given]
    now, x = weights.solved(problem, known), point.unknowns(columns)
    error = now.triangle.residual_norm(x) ** 2
    for number in range(SWINGING_STEPS):
        on_progress("searching shapes", number / SWINGING_STEPS)
        target = _within(now, x, bounds, columns)
        at_ends = [i for i, ends in bounds.items() if x[i] in ends and target.x[i] == x[i]]
        if at_ends:  # the others go with those that are not there
            target = _within(weights.solved(problem, [*known, *at_ends]), x, bounds, columns)
        for half in range(HALVES):
            nearer = point.at(mechanism, columns, x + 0.5**half * (target.x - x))
            try:
                following = Problem.reduced(mechanism, motion, nearer)
            except MechanismError:  # a spring that holds its link no longer
                continue
            later, end = weights.solved(following, known), nearer.unknowns(columns)
            after = later.triangle.residual_norm(end) ** 2
            if after < error:
                break
        else:
            break
        last = after > (1 - SETTLED) * error
        now, point, x, error = later, nearer, end, after
        if last:
            break
        bounds = shape_bounds(following)  # of a damping they depend on the compliance
    return point, error, weights


def _within(
    now: Estimate, x: np.ndarray, bounds: Mapping[int, tuple[float, float]], columns: Columns
) -> Estimate:
    """Return least squares with shapes within their bounds and no farther than LONGEST of these
    from x (k,).
    """
    places = columns.shapes
    low, high = np.array([bounds[int(i)] for i in places]).reshape(-1, 2).T
    most = LONGEST * (high - low)
    ends = np.clip(np.clip(now.x[places], x[places] - most, x[places] + most), low, high)
    beyond = ends != now.x[places]
    return now.limited(places[beyond], ends[beyond])


def initial(mechanism: Mechanism, motion: Motion) -> Point:
    """Return the prior, with unknown shapes at a start in the middle of their search."""
    point = Point.prior(mechanism)
    for effect in mechanism.effects:
        if effect.searched:
            samples = Samples(mechanism, motion.experiments[0], slice(None), point)
            starts = effect.starts(samples.signals(effect.acting))
            middle = {effect.full[s]: value for s, value in starts[len(starts) // 2].items()}
            point = point.with_values({**middle, **point.values})
    return point


def _started(mechanism: Mechanism, motion: Motion, point: Point, effect: Effect) -> Point:
    """Return the point with a start for an effect's shapes: the best of its coarse search."""
    _, shape = point.of(effect)
    if len(shape) == len(effect.shapes):
        return point
    u = len(effect.unknowns) or len(effect.searched)
    full = effect.full
    if effect.corrects and not effect.extent:
        samples = Samples(mechanism, motion.experiments[0], slice(None), point)
        start = {**effect.starts(samples.signals(effect.acting))[0], **shape}
        return point.with_values({full[s.name]: start[s.name] for s in effect.shapes})
    others = tuple(
        e for e in mechanism.effects
        if e.label != effect.label and len(point.of(e)[1]) == len(e.shapes)
    )  # fmt: skip
    rest = replace(mechanism, effects=others)
    table = Table.of(rest, Columns.of(rest), motion, point)
    starts = table.starts(effect)
    columns, felt = table.start_columns(effect, starts)
    C = np.zeros((*table.b.shape, len(starts) * u))
    C[:, felt] = columns
    sizes = np.sqrt((table.tau**2).mean(axis=0)), np.sqrt((table.b**2).mean(axis=0))
    sigma = np.where(sizes[0] > 0, sizes[0], np.where(sizes[1] > 0, sizes[1], 1.0))
    inside = table.informed
    A, b = (table.A / sigma[:, None])[inside], (table.b / sigma)[inside]
    C = (C / sigma[:, None])[inside]
    Q = linear.svd(A, full_matrices=False)[0] if A.shape[1] else np.zeros((len(b), 0))
    C, r = C - Q @ (Q.T @ C), b - Q @ (Q.T @ b)
    falls = [
        float(r @ columns @ linear.lstsq(columns, r, rcond=1e-9)[0])
        for columns in np.split(C, len(starts), axis=1)
    ]
    if effect.extent in starts[0] and effect.extent not in effect.values:
        order = np.argsort(falls)[::-1][:STARTS_TRIED]
        return _least(mechanism, motion, point, effect, [starts[i] for i in order])
    best = starts[int(np.argmax(falls))]
    return point.with_values({full[name]: float(value) for name, value in best.items()})


def _least(
    mechanism: Mechanism,
    motion: Motion,
    point: Point,
    effect: Effect,
    starts: Sequence[Mapping[str, float]],
) -> Point:
    """Return the point with that of some starts of an effect, or none of it, with the least error
    when all else is refitted: far from the solution its columns are no more than a hint.
    """
    others = tuple(
        e for e in mechanism.effects
        if e.label == effect.label or len(point.of(e)[1]) == len(e.shapes)
    )  # fmt: skip
    model = replace(mechanism, effects=others)
    columns = Columns.of(model)
    ((_, places),) = (both for both in columns.effects if both[0].label == effect.label)
    given = np.isin(np.arange(len(columns)), places)
    none = {parameter.name: 0.0 for parameter in effect.searched}
    points = [
        point.with_values({effect.full[name]: float(x) for name, x in start.items()})
        for start in ({**starts[0], **none}, *starts)
    ]
    first = Problem.reduced(model, motion, points[0], columns).estimate()
    errors = []
    for at in points:
        estimate = Problem.reduced(model, motion, at, columns).estimate(
            sigma=first.sigma, fixed=first.fixed | given
        )
        errors.append(estimate.triangle.residual_norm(estimate.x) ** 2)
    return points[int(np.argmin(errors))]


def variable_projection(
    mechanism: Mechanism, motion: Motion, point: Point, on_progress: Progress = no_progress
) -> Point:
    """Descend to the point of least error from a point whose shapes all have a value."""
    start = Problem.reduced(mechanism, motion, point)
    columns, bounds = start.columns, shape_bounds(start)
    shapes = np.isin(np.arange(len(columns)), columns.shapes)
    scales = drive_scales(mechanism, motion, point)
    passes = PASSES if any(effect.implicit for effect in mechanism.effects) else 1

    def solved(
        point: Point, first: Estimate, fixed: np.ndarray, columns: Columns = columns
    ) -> Estimate:
        problem = Problem.reduced(mechanism, motion, point, columns)
        return problem.estimate(sigma=scaled(point, first), fixed=fixed)

    def scaled(point: Point, first: Estimate) -> np.ndarray:
        return np.asarray(first.sigma * drive_scales(mechanism, motion, point) / scales)

    def trial(point: Point, first: Estimate) -> tuple[Point, float]:
        """Return the point of least error with the shapes where they are, and that error."""
        shape_values = point.unknowns(columns)
        for _ in range(passes):
            estimate = solved(point, first, first.fixed | shapes, columns.with_known_shapes)
            point = point.at(mechanism, columns, np.where(shapes, shape_values, estimate.x))
        return point, estimate.triangle.residual_norm(estimate.x) ** 2

    point, _ = trial(point, start.estimate())  # a shape without size has no slope
    begun = Problem.reduced(mechanism, motion, point)
    first = begun.estimate()
    check_scales(columns, first)
    now = begun.estimate(sigma=scaled(point, first), fixed=first.fixed)
    same = SAME * float(np.sum((first.triangle.column_norms() * first.x) ** 2))
    loss = np.inf
    for number in range(STEPS):
        on_progress("searching shapes", number / STEPS)
        now = solved(point, first, first.fixed) if number else now
        before = point.unknowns(columns)
        if shapes.any():
            loss = trial(point, first)[1] if np.isinf(loss) else loss
            error_before, error_after = (
                now.triangle.residual_norm(values) ** 2 for values in (before, now.x)
            )
            noise = error_after / max(now.triangle.rows, 1)  # a row's
            felt = error_before - error_after > FELT**2 * noise
            for half in range(HALVES if felt else 1):
                x = now.x.copy()
                for i in columns.shapes:  # no farther than LONGEST, within bounds
                    low, high = bounds[int(i)]
                    most = LONGEST * (high - low)
                    step = np.clip(0.5**half * (x[i] - before[i]), -most, most)
                    x[i] = np.clip(before[i] + step, low, high)
                after, error = trial(point.at(mechanism, columns, x), first)
                if error <= loss + same:
                    break
            else:
                break
            point, loss = after, error
        else:  # the columns depend on the prediction alone
            point = point.at(mechanism, columns, now.x)
        x = point.unknowns(columns)
        stderr = np.zeros(len(x))
        stderr[now.base.independent] = np.sqrt(np.diag(now.solution.C))
        if (np.abs(x - before) <= OF_VALUE * np.abs(x) + OF_ERROR * stderr).all():
            break
    # far from the start a scale may have lost what supported it
    if loss < np.inf and unknown_scales(columns):
        check_scales(columns, solved(point, first, first.fixed))
    return point


def check_scales(columns: Columns, first: Estimate) -> None:
    """Refuse drives whose torques could all be larger by one factor, with the model as good.

    Raises:
        NoScale: with the drives, and what would give them a scale.
    """
    scales = unknown_scales(columns)
    if not scales:
        return
    base = rank_revealing(first.triangle)
    alone = base.independent[~base.K.any(axis=1)]  # no other column is made from it
    refuse_scales([effect for effect, place in scales if place not in alone])


def unknown_scales(columns: Columns) -> list[tuple[Effect, int]]:
    """Return the drives whose scale is unknown, with its place in x."""
    return [
        (effect, int(place))
        for effect, places in columns.effects
        for shape, place in zip(effect.shapes, places[len(effect.unknowns) :], strict=True)
        if place >= 0 and shape.name == effect.scale
    ]


def refuse_scales(unsupported: Sequence[Effect]) -> None:
    """Refuse drives that nothing gives a scale, if there are any.

    Raises:
        NoScale: with the drives, and what would give them a scale.
    """
    if not unsupported:
        return
    one, names = unsupported[0], listed([effect.joints[0] for effect in unsupported])
    key = f"{one.joints[0]}:{one.scale}"
    raise NoScale(
        f"{one.kind}: nothing gives the torques of {names} a scale: all unknown bodies, frictions "
        f"and gains could be larger by one factor. Give one gain (--drive {key}=…), a known body "
        "that these drives carry ([parameters] unknown without its link), or log once more with a "
        f"known payload; --drive {key}=1 gives everything as a ratio to that gain",
        [effect.joints[0] for effect in unsupported],
    )


class NoScale(FitError):
    """Drives whose torques could all be larger by one factor; `joints`: theirs."""

    def __init__(self, message: str, joints: Sequence[str]) -> None:
        super().__init__(message)
        self.joints = tuple(joints)


def drive_scales(mechanism: Mechanism, motion: Motion, point: Point) -> np.ndarray:
    """Return (d,) scales of the torques that drives supply, by coordinate; 1 where a sensor does.

    A drive's error is one of its command: its rows are weighed by its scale, or a small scale would
    make every error small.
    """
    scales = {
        name: point.of(drive)[1].get(drive.scale, 1.0) for name, drive in mechanism.drives.items()
    }
    return np.array([scales.get(name, 1.0) for name in motion.independent])


def beyond_bounds(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Return (k,) shapes that an estimate puts where their columns mean nothing.

    Those of corrections may be on either side of their bounds, for a negative play is noise around
    0, but no farther from them than these are apart.
    """
    outside = np.zeros(len(problem.columns), dtype=bool)
    bounds = shape_bounds(problem)
    for effect, places in problem.columns.effects:
        for at in bounds.keys() & set(places.tolist()):
            low, high = bounds[at] if effect.unknowns else widened(*bounds[at])
            outside[at] = not low <= estimate.x[at] <= high
    return outside


def widened(low: float, high: float) -> tuple[float, float]:
    """Return bounds of a correction's shape, farther out on either side by what they are apart."""
    return low - (high - low), high + (high - low)


def shape_bounds(problem: Problem) -> dict[int, tuple[float, float]]:
    """Return the bounds of every unknown shape, by its place in x, over all experiments."""
    bounds: dict[int, tuple[float, float]] = {}
    for e in problem.motion.experiments:
        samples = Samples(problem.mechanism, e, slice(None), problem.point)
        for effect, places in problem.columns.effects:
            shapes = places[len(effect.unknowns) :]
            if not (shapes >= 0).any():
                continue
            shape = problem.point.of(effect)[1]
            bounds_here = effect.bounds(replace(samples.signals(effect.acting), shape=shape))
            for shape_parameter, place in zip(effect.shapes, shapes.tolist(), strict=True):
                if place >= 0:
                    ends = *bounds_here[shape_parameter.name], *bounds.get(place, ())
                    bounds[place] = min(ends), max(ends)
    return bounds
