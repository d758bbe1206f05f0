"""Everything that could be missing, with its columns in the rows that decide, made in one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.display import part
from ident.effects import Effect, ReversalPulses
from ident.effects.curve import Curve, curves
from ident.equations.rest import FEWEST_RESTS
from ident.equations.table import MadeColumns, Table
from ident.errors import IdentError
from ident.faults.small_errors import WORSE, away_from_reversals
from ident.fit import Fit
from ident.information.blocks import Part
from ident.information.evidence import BEYOND, Decision, zscore
from ident.information.hypotheses import Array, Index, PartialRegression
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.signals import SLOW

STANDS_FOR = 1 / 3  # tuned: share of a joint's samples or squares, that can speak for all of them
HIDDEN = 0.02  # tuned: visible share below which the data cannot speak of an effect
OF_LAWS = 0.6  # shown: share of the columns' progress that laws are
FREE = 30.0  # range: error over torque, from which a joint swings freely
PULSES_SE = 1.0  # level: standard errors over blocks by which pulses lower left-out errors
Shape = Mapping[str, float]
OnProgress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class NoiseDraws:
    """Draws of what the sensors' noise leaves of the torques."""

    rows: Array  # (N, d, DRAWS) in the table's rows [N m | N]
    floor: Array  # (d,) median rms held out in the rows that decide [N m | N]
    ceiling: Array  # (d,) largest


# --- places ------------------------------------------------------------------------------------


def possible(mechanism: Mechanism, motion: Motion) -> list[Effect]:
    """All effects that could be missing, in the library's order; then known ones."""
    first, *others = (e.logged for e in motion.experiments)
    logged = [name for name in first if all(name in names for names in others)]
    dead = {*motion.dead}  # a channel that is no measurement names nothing
    candidates = [
        effect
        for effect in mechanism.candidates(logged, columns_of(motion))
        if not effect.joints or not {*effect.joints} <= dead
    ]
    drives = [effect.rescaled for effect in mechanism.drives.values() if not effect.known]
    known = [effect.freed for effect in mechanism.effects if effect.known]
    return [*candidates, *known, *(drive for drive in drives if drive is not None)]


def columns_of(motion: Motion) -> set[str]:
    """Further columns that all logs have."""
    return set.intersection(*(set(e.extra) for e in motion.experiments))


def absorbed(mechanism: Mechanism, effect: Effect) -> str:
    """Why an effect needs no looking at: its columns are a link's own, all of them unknown."""
    link, bodies = effect.loaded_link, mechanism.bodies
    if link is None or not {*np.array(bodies.names)[bodies.columns(link)]} <= {*mechanism.unknown}:
        return ""
    return f"absorbed: same columns as {link}'s own parameters, all unknown"


def candidates_of(fit: Fit) -> list[Effect]:
    """Effects that could be missing, without those whose columns a link has already."""
    every = possible(fit.mechanism, fit.motion)
    free, resting = swinging_freely(fit), always_at_rest(fit)
    acted_on = any(np.any(e.tau) or np.any(e.wrench) for e in fit.motion.experiments)
    both_ways = moving_both_ways(fit)

    def trivial(effect: Effect) -> bool:
        """Whether it may take all known forces off again, which a torque of zero does not ask."""
        if effect.loaded_link:
            return free == {*fit.motion.independent} or not acted_on
        return bool({"load", "torque"} & {*effect.asks}) and bool(free & {*effect.joints})

    return [
        e
        for e in every
        if not (absorbed(fit.mechanism, e) or trivial(e))
        and not (e.local and e.joints and resting.issuperset(e.joints))
        and not (e.by_direction and not both_ways.issuperset(e.joints))
        # what moves behind a joint of a loop is known of independent ones
        and not (
            fit.mechanism.closures
            and e.extent
            and e.sits == "driven"
            and not {*e.joints} <= {*fit.motion.independent}
        )
    ]


def moving_both_ways(fit: Fit) -> set[str]:
    """Return the joints that move to and fro in some log."""
    joints = set[str]()
    for e in fit.motion.experiments:
        speeds = e.yd[e.usable]
        both = (speeds > e.still).any(axis=0) & (speeds < -e.still).any(axis=0)
        joints |= {name for name, i in fit.mechanism.joint_index.items() if both[i]}
    return joints


def always_at_rest(fit: Fit) -> set[str]:
    """Return the independent joints of a tree that stand still in all logs, in a few stretches: one
    number each, which friction, an offset or any force of the joint's own explains.
    """
    if fit.mechanism.closures:
        return set()
    joints = set[str]()
    for u, blocks in fit.problem.information.by_coordinate.items():
        stretches = sum(block.stretches for block in blocks)
        moving = sum(block.triangle.rows - block.rest_count for block in blocks)
        if 0 < stretches < FEWEST_RESTS and not moving:
            joints.add(fit.motion.independent[u])
    return joints


def swinging_freely(fit: Fit) -> set[str]:
    """Return the independent joints whose measured torque is nothing beside what the known bodies
    need: they swing freely.
    """
    return {
        joint
        for joint, error in fit.train.items()
        if error.rms > 0 and (error.relative is None or error.relative > FREE)
    }


# --- rows --------------------------------------------------------------------------------------


def deciding(table: Table, r: np.ndarray) -> np.ndarray:
    """(N, d) rows that decide: those in motion away from reversals, and all in motion of a
    coordinate whose residual r (N, d) is at its reversals for the most part; and those at rest.
    """
    in_motion = _rows_with_most(r, away_from_reversals(table), table.moving)
    return in_motion | (table.informed & (table.rest > 0))


def _rows_with_most(r: np.ndarray, calm: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The calm rows (N, d), and all `rows` where these hold little of a coordinate's residual r."""
    squares, calm_squares = (np.where(use, r**2, 0.0).sum(axis=0) for use in (rows, calm))
    return calm | rows & (calm_squares < STANDS_FOR * squares)


def residual_in(table: Table, fit: Fit) -> np.ndarray:
    """(N, d) b − A x of a fit in the rows of its table."""
    fixed = fit.estimate.fixed
    x = np.where(fixed, table.columns.prior_at(table.point.values), fit.estimate.solution.x)
    return np.asarray(table.b - table.A @ x)


# --- columns -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CandidateColumns:
    """One effect at one place, with its columns."""

    effect: Effect
    shapes: tuple[Shape, ...]  # shape parameters of each start
    groups: tuple[Index, ...]  # by start, its unknowns' columns; of a correction sensitivities

    @property
    def curve(self) -> bool:
        """Whether it is a curve rather than a law."""
        return isinstance(self.effect, Curve)


@dataclass(frozen=True, eq=False)
class Contest:
    """The rows of a fit with the columns of everything that could be missing."""

    fit: Fit
    table: Table
    use: np.ndarray  # (N, d) rows that decide
    regression: PartialRegression  # with the model projected out: that of the fit, or another one
    pulses: Index  # columns of dry friction's pulses at reversals, part of the model
    candidates: tuple[CandidateColumns, ...]  # laws, then curves
    failed: tuple[tuple[Effect, str], ...]  # what could not be evaluated, with the reason
    decision: Decision
    seed: int  # of the residuals in which nothing is missing
    draws: NoiseDraws | None = None  # of the sensors' noise, once they are made

    @classmethod
    def of(
        cls, fit: Fit, effects: Iterable[Effect], on_progress: OnProgress, curved: bool = True,
        earlier: Contest | None = None,
        use: np.ndarray | None = None, decision: Decision | None = None, seed: int = 0,
    ) -> Contest:  # fmt: skip
        """The rows of a fit and the columns of some effects, all made once.

        Args:
            fit: whose rows; effects: whose columns.
            on_progress: called with (what is being done, share done).
            curved: whether curves are candidates too.
            earlier: of this or another model, from which columns are taken that are the same there.
            use: rows (N, d) that decide, beside which there are no pulses; default: see `deciding`.
        """
        if earlier is not None and earlier.fit is fit:
            table = earlier.table
        else:
            table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
            table.made.update({} if earlier is None else earlier.unchanged(table))
        fixed = fit.estimate.fixed
        pulsed = use is None and bool((fit.checks.misfit > WORSE).any())  # rows at reversals worse
        use = deciding(table, residual_in(table, fit)) if use is None else use
        store = ColumnStore(table, use, fixed)
        # what dry friction that is no step leaves at reversals
        dry = [joint for e in fit.mechanism.effects if e.jumps and pulsed for joint in e.joints]
        pulses = {
            joint: store.add(fit.mechanism.placed(ReversalPulses((joint,))), [{}])
            for joint in dict.fromkeys(dry)
        }
        of_laws = part(on_progress, 0.0, OF_LAWS) if curved else on_progress
        candidates, failed = store.candidates([*effects], of_laws)
        sigma, model = fit.estimate.sigma, np.flatnonzero(~fixed)
        if len(sigma) != table.b.shape[1]:  # a time basis weighs all rows alike
            r = table.b - table.A @ fit.estimate.solution.x
            sigma = np.sqrt((r**2).mean(axis=0)) + 1e-300
        regression = PartialRegression(store.parts(), model, 1.0 / sigma, store.count)
        chosen_pulses = _pulses_that_help(table, regression, pulses, candidates)
        bodies = np.flatnonzero(fixed[: len(fit.columns.rigid)])
        candidates, more = _visible_beside_fixed(regression, bodies, candidates)
        failed += more
        regression = regression.extended(chosen_pulses)
        rule, both = decision or Decision(), (tuple(candidates), tuple(failed))
        contest = cls(fit, table, use, regression, chosen_pulses, *both, rule, seed)
        return contest.with_curves(part(on_progress, OF_LAWS, 1.0)) if curved else contest

    def with_curves(self, on_progress: OnProgress) -> Contest:
        """The contest with curves of all joints that move as candidates too."""
        table, fit = self.table, self.fit
        index, store = table.mechanism.joint_index, ColumnStore(table, self.use)
        store.count = self.regression.columns
        moving = tuple(  # in some log, in the tree or anywhere in a loop
            name
            for name, at in ((joint.name, index[joint.name]) for joint in table.mechanism.joints)
            if any(np.quantile(np.abs(s.e.yd[:, at]), 0.98) > s.e.still[at] for s in table.scenes)
        )
        every = map(fit.mechanism.placed, curves(moving, moving, columns_of(fit.motion)))
        candidates, failed = store.candidates([*every], on_progress)
        return replace(
            self,
            regression=store.added_to(self.regression),
            candidates=(*self.candidates, *candidates),
            failed=(*self.failed, *failed),
        )

    def at_reversals(self, on_progress: OnProgress) -> Contest | None:
        """The contest on all rows that inform of a coordinate whose residual is most at reversals,
        without pulses, which are like effects that act there; None where they are the same rows.
        """
        r = residual_in(self.table, self.fit)
        use = _rows_with_most(r, deciding(self.table, r), self.table.informed)
        if np.array_equal(use, self.use):
            return None
        effects = [law.effect for law in self.laws]
        return Contest.of(
            self.fit, effects, on_progress, earlier=self, use=use, decision=self.decision,
            seed=self.seed,
        )  # fmt: skip

    @property
    def dry(self) -> np.ndarray:
        """(d,) rms of the model's dry friction in the rows that decide [N m | N]."""
        parts = self.regression.parts
        torque = [np.zeros(len(part.Y)) for part in parts]
        for effect in (effect for effect in self.fit.mechanism.effects if effect.jumps):
            c, shape = self.fit.point.of(effect)
            torque = [x + C @ c for x, C in zip(torque, self.columns(effect, shape), strict=True)]
        rms = np.zeros(self.regression.d)
        for p, x in zip(parts, torque, strict=True):
            rms[p.coordinate] = np.sqrt((x**2).sum() / max(len(x), 1))
        return rms

    @cached_property
    def laws(self) -> tuple[CandidateColumns, ...]:
        """Candidates that are no curves."""
        return tuple(candidate for candidate in self.candidates if not candidate.curve)

    def unchanged(self, table: Table) -> dict[str, MadeColumns]:
        """Columns of laws, by label, that are the same in the rows of another table."""
        ours, other = ((x.sample, x.experiment) for x in (self.table, table))
        scenes = zip(table.scenes, self.table.scenes, strict=True)
        same_rows = all(map(np.array_equal, ours, other))
        if not same_rows or not all(a.samples.same_motion(b.samples) for a, b in scenes):
            return {}
        explicit = (x for x in self.laws if not x.effect.implicit and not x.effect.corrects)
        made = self.table.made
        return {x.effect.label: made[x.effect.label] for x in explicit if x.effect.label in made}

    @property
    def columns_alone(self) -> Contest:
        """The contest with what `unchanged` asks for, without the rows that decide."""
        samples = (replace(s, samples=replace(s.samples, memo={})) for s in self.table.scenes)
        table = replace(self.table, scenes=tuple(samples), made_at_shapes={})
        regression = PartialRegression((), self.pulses[:0], self.regression.weight)
        return replace(self, table=table, regression=regression, draws=None)

    def columns(self, effect: Effect, shape: Shape) -> list[np.ndarray]:
        """The columns (m, u) of an effect at a shape in the rows of each part."""
        return self.columns_at(effect, [shape])[0]

    def columns_at(self, effect: Effect, shapes: Sequence[Shape]) -> list[list[np.ndarray]]:
        """Return the columns (m, u) of an effect in the rows of each part, by shape."""
        C, felt = self.table.effect_columns(effect, shapes)
        place = {u: i for i, u in enumerate(felt.tolist())}
        parts = [
            C[rows, place[p.coordinate]]
            if p.coordinate in place
            else np.zeros((len(rows), C.shape[2]))
            for p, rows in zip(self.regression.parts, self._rows, strict=True)
        ]
        split = (np.split(part, len(shapes), axis=1) for part in parts)
        return [list(of_shape) for of_shape in zip(*split, strict=True)]

    @cached_property
    def _rows(self) -> list[Index]:
        """The rows that decide in each part, as numbers of the table's."""
        return [np.flatnonzero(self.use[:, part.coordinate]) for part in self.regression.parts]

    def passed(self, joint: str, waves: float) -> float:
        """Share of the samples at which the filter passes so many waves a radian (a metre)."""
        cutoff, at = self.table.motion.band.cutoff, self.table.mechanism.joint_index[joint]
        speed = np.concatenate([np.abs(s.e.yd[s.e.usable, at]) for s in self.table.scenes])
        return float((waves * speed < 2 * np.pi * (cutoff or np.inf)).mean())

    def possible(self, effect: Effect, shape: Shape) -> bool:
        """Whether an effect can have a shape in this motion."""
        if not effect.shapes:
            return True
        return effect.possible(replace(self.table.pooled(effect), shape=dict(shape)))

    def columns_around(
        self, effect: Effect, shape: Shape, steps: Mapping[str, float]
    ) -> ColumnsAround:
        """Return the columns at a shape and a step to either side along each shape parameter."""
        shifted = [{**shape, n: shape[n] + sign * h} for n, h in steps.items() for sign in (1, -1)]
        C, *ends = self.columns_at(effect, [shape, *shifted])
        return ColumnsAround(C, [*zip(steps.values(), ends[::2], ends[1::2], strict=True)])

    def with_model(self, regression: PartialRegression) -> Contest:
        """The contest with another model."""
        return replace(self, regression=regression)

    def extended(self, C: Sequence[np.ndarray]) -> tuple[Contest, Index]:
        """The contest with further columns C (m, u) of each part in the model, and which."""
        regression, new = self.regression.added(C)
        return self.with_model(regression.extended(new)), new

    @cached_property
    def torque(self) -> Array:
        """(d,) weighted squares of the measured torque in the rows that decide; of a joint that
        swings freely, of what the known bodies need.
        """
        free = swinging_freely(self.fit)
        tau = self.table.tau.copy()
        for u, joint in enumerate(self.fit.motion.independent):
            if joint in free:
                tau[:, u] = self.table.b[:, u]
        tau = np.where(self.use, tau, 0.0)
        return np.asarray((tau**2).sum(axis=0) * self.regression.weight**2)


@dataclass(frozen=True, eq=False)
class ColumnsAround:
    """Columns of an effect at a shape and beside it, (m, u) in each part."""

    C: list[np.ndarray]  # at the shape
    beside: list[tuple[float, list[np.ndarray], list[np.ndarray]]]  # step, columns above and below

    def with_slopes(self, theta: np.ndarray) -> list[np.ndarray]:
        """C(s), then ∂(C θ)/∂s of the shape parameters by central differences."""
        both = self.C
        for h, up, down in self.beside:
            both = [
                np.column_stack([c, (a - b) @ theta / (2 * h)])
                for c, a, b in zip(both, up, down, strict=True)
            ]
        return both


def _pulses_that_help(
    table: Table,
    regression: PartialRegression,
    pulses: Mapping[str, Index],
    candidates: Iterable[CandidateColumns],
) -> np.ndarray:
    """The columns of those pulses, by joint, that lower left-out errors (others have no rows that
    determine them), and by more than friction that builds up over so much speed that it acts far
    from reversals too: a pulse would take its part.
    """
    chosen = [np.zeros(0, dtype=int)]
    gains = regression.gains([*pulses.values()])
    laws = [
        candidate for candidate in candidates if candidate.effect.slow and candidate.effect.needs
    ]
    for (joint, columns), D, by in zip(pulses.items(), gains.D, gains.by, strict=True):
        if zscore(D) <= PULSES_SE:
            continue
        at = table.mechanism.joint_index[joint]
        top = max(np.abs(s.e.yd[s.e.usable, at]).max(initial=0.0) for s in table.scenes)
        wide = [
            group
            for candidate in laws
            for shape, group in zip(candidate.shapes, candidate.groups, strict=True)
            if candidate.effect.joints == (joint,) and max(shape.values()) > BEYOND * SLOW * top
        ]
        if regression.explained(by) > (regression.shares(wide).max() if wide else 0.0):
            chosen.append(columns)
    return np.concatenate(chosen)


def _visible_beside_fixed(
    regression: PartialRegression, fixed: np.ndarray, candidates: Sequence[CandidateColumns]
) -> tuple[list[CandidateColumns], list[tuple[Effect, str]]]:
    """The candidates that have columns of their own beside inertial parameters that are held at
    their priors, and those that have none, with the reason: where friction is missing the residual
    hides an inertia, which then is no effect.
    """
    laws = [candidate for candidate in candidates if not candidate.curve]
    if not len(fixed) or not laws:
        return [*candidates], []
    groups = [group for candidate in laws for group in candidate.groups]
    starts = np.cumsum([0, *(len(candidate.groups) for candidate in laws)])[:-1]
    before, after = (
        np.maximum.reduceat(rows.visible(groups), starts)
        for rows in (regression, regression.extended(fixed))
    )
    hidden = {id(law) for law, a, b in zip(laws, before, after, strict=True) if a > HIDDEN >= b}
    why = "it has the columns of inertial parameters that are held at their priors"
    return [candidate for candidate in candidates if id(candidate) not in hidden], [
        (candidate.effect, why) for candidate in laws if id(candidate) in hidden
    ]


class ColumnStore:
    """Columns of many effects in the rows that decide, by coordinate, beside the model's, of which
    those that are held (k,) are taken off b at their priors; None leaves the model's out.
    """

    def __init__(self, table: Table, use: np.ndarray, fixed: np.ndarray | None = None) -> None:
        self.table, self.b, A = table, table.b, table.A
        if fixed is None:
            A = A[:, :, :0]
        else:
            self.b = self.b - A[:, :, fixed] @ table.columns.prior_at(table.point.values)[fixed]
        self.rows = [np.flatnonzero(mask) for mask in use.T]
        self.blocks = [[A[rows, u]] for u, rows in enumerate(self.rows)]
        self.index = [[np.arange(A.shape[2])] for _ in self.rows]
        self.count = A.shape[2]

    def candidates(
        self, effects: Sequence[Effect], on_progress: OnProgress
    ) -> tuple[list[CandidateColumns], list[tuple[Effect, str]]]:
        """Adds the columns of effects at their starts; returns them, and what could not be made."""
        candidates, failed = [], []
        for i, effect in enumerate(effects):
            on_progress(f"columns of {effect.label}", i / len(effects))
            try:
                shapes = self.table.starts(effect)
                groups = np.split(self.add(effect, shapes), len(shapes))
                candidates.append(CandidateColumns(effect, tuple(shapes), tuple(groups)))
            except (IdentError, np.linalg.LinAlgError) as error:
                failed.append((effect, str(error)))
        return candidates, failed

    def add(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        """Adds the columns of an effect at the starts of its search; returns which they are."""
        if isinstance(effect, Curve):  # which no other rows take from these
            return self._added(*self.table.effect_columns(effect, shapes))
        return self._added(*self.table.start_columns(effect, shapes))

    def add_at(self, effect: Effect, shape: Shape) -> np.ndarray:
        """Adds the columns of an effect at a shape that was found; returns which they are."""
        return self._added(*self.table.effect_columns(effect, [shape]))

    def _added(self, C: np.ndarray, felt: np.ndarray) -> np.ndarray:
        known = {u: C[self.rows[u], place] for place, u in enumerate(felt.tolist())}
        new = np.arange(self.count, self.count + next(iter(known.values())).shape[1])
        for coordinate, block in known.items():
            nonzero = block.any(axis=0)
            self.blocks[coordinate].append(block[:, nonzero])
            self.index[coordinate].append(new[nonzero])
        self.count += len(new)
        return new

    def added_to(self, regression: PartialRegression) -> PartialRegression:
        """The rows of a regression with these columns as further candidates."""
        parts = (
            p.added(*(np.concatenate(x[p.coordinate], axis=-1) for x in (self.blocks, self.index)))
            for p in regression.parts
        )
        return regression.with_candidates(tuple(parts), self.count)

    def parts(self) -> tuple[Part, ...]:
        """One part a coordinate."""
        block = self.table.blocks
        numbers = np.unique(np.concatenate([block[rows] for rows in self.rows]))
        parts = []
        for u, rows in enumerate(self.rows):
            edges = np.searchsorted(block[rows], np.append(numbers, numbers[-1] + 1))
            X = np.concatenate(self.blocks[u], axis=1)
            self.blocks[u] = [X]  # the pieces go, one coordinate after the other
            self.index[u] = [np.concatenate(self.index[u])]
            parts.append(Part(u, self.index[u][0], X, self.b[rows, u][:, None], edges))
        return tuple(parts)
