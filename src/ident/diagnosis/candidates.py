"""Everything that could be missing, with its columns in the rows that decide, made in one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.effects import Effect, ReversalPulses
from ident.effects.curve import Curve, curves
from ident.errors import IdentError
from ident.fit import Fit
from ident.fit.problem import Table
from ident.fit.small_errors import WORSE, away_from_reversals
from ident.information.blocks import Part
from ident.information.chance import BEYOND, zscore
from ident.information.hypotheses import PartialRegression
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.signals import SLOW

STANDS_FOR = 1 / 3  # tuned: share of a joint's samples or squares, that can speak for all of them
HIDDEN = 0.02  # tuned: visible share below which the data cannot speak of an effect
SURE = 1.0  # level: standard errors over blocks by which pulses lower left-out errors
Shape = Mapping[str, float]
Columns = Mapping[int, np.ndarray]  # (m, u) in the rows of each coordinate
OnProgress = Callable[[str, float], None]


# --- places ------------------------------------------------------------------------------------


def possible(mechanism: Mechanism, motion: Motion) -> list[Effect]:
    """All effects that could be missing, in the library's order; then known ones, which could have
    changed.
    """
    first, *others = (e.logged for e in motion.experiments)
    logged = [name for name in first if all(name in names for names in others)]
    found = mechanism.candidates(logged, columns_of(motion))
    return found + [effect.freed for effect in mechanism.effects if effect.known]


def columns_of(motion: Motion) -> set[str]:
    """Further columns that all logs have."""
    return set.intersection(*(set(e.extra) for e in motion.experiments))


def absorbed(mechanism: Mechanism, effect: Effect) -> str:
    """Why an effect needs no looking at: its columns are a link's own, all of them unknown."""
    link = effect.loaded_link
    if link is None:
        return ""
    own = set(np.array(mechanism.bodies.names)[mechanism.bodies.columns(link)])
    if not own <= set(mechanism.unknown):
        return ""
    return f"absorbed: same columns as {link}'s own parameters, all unknown"


def candidates_of(fit: Fit) -> list[Effect]:
    """Effects that could be missing, without those whose columns a link has already."""
    every = possible(fit.mechanism, fit.motion)
    return [each for each in every if not absorbed(fit.mechanism, each)]


# --- rows --------------------------------------------------------------------------------------


def deciding(table: Table, r: np.ndarray) -> np.ndarray:
    """(N, d) rows that decide: those in motion away from reversals, and all in motion of a
    coordinate whose residual r (N, d) is at its reversals for the most part.
    """
    return _most_of(r, away_from_reversals(table), table.moving)


def with_reversals(table: Table, r: np.ndarray) -> np.ndarray:
    """(N, d) rows that decide of effects that act at reversals: all that inform of a coordinate
    whose residual r (N, d) is at its reversals for the most part.
    """
    return _most_of(r, deciding(table, r), table.informed)


def _most_of(r: np.ndarray, calm: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The calm rows (N, d), with all `rows` of a coordinate where calm ones hold few of the squares
    of its residual r.
    """
    squares, few = (np.where(use, r**2, 0.0).sum(axis=0) for use in (rows, calm))
    return calm | rows & (few < STANDS_FOR * squares)


def residual_in(table: Table, fit: Fit) -> np.ndarray:
    """(N, d) b − A x of a fit in the rows of its table."""
    held = fit.estimate.held
    x = np.where(held, table.columns.prior_at(table.point.values), fit.estimate.solution.x)
    return np.asarray(table.b - table.A @ x)


def pulses_of(fit: Fit) -> list[Effect]:
    """What dry friction that is no step leaves at reversals, of each joint that has some, where
    rows at reversals fit worse.
    """
    dry = (effect for effect in fit.mechanism.effects if effect.jumps)
    joints = dict.fromkeys(joint for effect in dry for joint in effect.joints)
    worse = bool((fit.checks.misfit > WORSE).any())
    return [fit.mechanism.placed(ReversalPulses((joint,))) for joint in joints if worse]


# --- columns -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CandidateColumns:
    """One effect at one place, with its columns.

    Attributes:
        effect: which.
        shapes: shape parameters of each start.
        groups: by start, which columns are its unknowns'; of a correction its sensitivities.
    """

    effect: Effect
    shapes: tuple[Shape, ...]
    groups: tuple[np.ndarray, ...]

    @property
    def numbers(self) -> int:
        """Number of its parameters."""
        return len(self.effect.parameters)

    @property
    def curve(self) -> bool:
        """Whether it is a curve rather than a law."""
        return isinstance(self.effect, Curve)


@dataclass(frozen=True, eq=False)
class Contest:
    """The rows of a fit with the columns of everything that could be missing.

    Attributes:
        fit, table: whose rows.
        use: (N, d) rows that decide.
        regression: the rows, with the model projected out; residuals of nothing are no part yet.
        pulses: which columns are of dry friction's pulses at reversals, part of the model.
        candidates: laws, then curves; failed: what could not be evaluated, with the reason.
    """

    fit: Fit
    table: Table
    use: np.ndarray
    regression: PartialRegression
    pulses: np.ndarray
    candidates: tuple[CandidateColumns, ...]
    failed: tuple[tuple[Effect, str], ...]

    @classmethod
    def of(
        cls, fit: Fit, effects: Iterable[Effect], on_progress: OnProgress, curved: bool = True,
        earlier: Contest | None = None,
        deciding: Callable[[Table, np.ndarray], np.ndarray] = deciding,
        pulsed: Callable[[Fit], Sequence[Effect]] = pulses_of,
    ) -> Contest:  # fmt: skip
        """The rows of a fit and the columns of some effects, all made once.

        Args:
            fit: whose rows; effects: whose columns.
            on_progress: called with (what is being done, share done).
            curved: whether curves are candidates too.
            earlier: of another model, from which columns are taken that are the same there.
            deciding: rows (N, d) that decide, of a table and the residuals (N, d).
            pulsed: the pulses at reversals that stand beside the dry friction of a fit.
        """
        table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
        held = fit.estimate.held
        prior = table.columns.prior_at(table.point.values)
        b = table.b - table.A[:, :, held] @ prior[held]
        use = deciding(table, residual_in(table, fit))
        store = ColumnStore(table, use, table.A, b)
        pulses = {each.joints: store.add(each, [{}]) for each in pulsed(fit)}
        known = {} if earlier is None else earlier.unchanged(fit, use)
        moving, columns = _moving(table), columns_of(fit.motion)
        every = curves(moving, moving, columns) if curved else ()
        wanted = [*effects, *map(fit.mechanism.placed, every)]
        found, failed = [], []
        for i, effect in enumerate(wanted):
            on_progress(f"columns of {effect.label}", i / len(wanted))
            try:
                shapes, old, C = table.starts(effect), known.get(effect.label), None
                if earlier and old and old.effect == effect and [*old.shapes] == shapes:
                    at, parts = np.concatenate(old.groups), earlier.regression.parts
                    C = {part.coordinate: part.taken(at) for part in parts}
                groups = np.split(store.add(effect, shapes, C), len(shapes))
                found.append(CandidateColumns(effect, tuple(shapes), tuple(groups)))
            except (IdentError, np.linalg.LinAlgError) as error:
                failed.append((effect, str(error)))
        sigma = weights(fit, table)
        model = np.flatnonzero(~held)
        regression = PartialRegression(store.parts(), model, 1.0 / sigma, store.count)
        some = _at_reversals(table, regression, pulses, found)
        bodies = np.flatnonzero(held[: len(fit.columns.rigid)])
        found, more = _beside_held(regression, bodies, found)
        failed += more
        regression = regression.extended(some)
        return cls(fit, table, use, regression, some, tuple(found), tuple(failed))

    def at_reversals(self, on_progress: OnProgress) -> Contest | None:
        """The contest on rows at reversals too, without pulses, which are like effects that act
        there; None where they are the same rows.
        """
        use = with_reversals(self.table, residual_in(self.table, self.fit))
        if np.array_equal(use, self.use):
            return None
        effects = [each.effect for each in self.laws]
        return Contest.of(
            self.fit, effects, on_progress, deciding=lambda *_: use, pulsed=lambda _: ()
        )

    @property
    def dry(self) -> np.ndarray:
        """(d,) rms of the model's dry friction in the rows that decide [N m | N]."""
        parts = self.regression.parts
        torque = [np.zeros(len(part.Y)) for part in parts]
        for effect in (each for each in self.fit.mechanism.effects if each.jumps):
            c, shape = self.fit.point.of(effect)
            torque = [x + C @ c for x, C in zip(torque, self.columns(effect, shape), strict=True)]
        found = np.zeros(self.regression.d)
        found[[part.coordinate for part in parts]] = [
            np.sqrt((x**2).sum() / max(len(x), 1)) for x in torque
        ]
        return found

    @cached_property
    def laws(self) -> tuple[CandidateColumns, ...]:
        """Candidates that are no curves."""
        return tuple(each for each in self.candidates if not each.curve)

    def unchanged(self, fit: Fit, use: np.ndarray) -> dict[str, CandidateColumns]:
        """Laws, by label, whose columns are the same in the rows (N, d) of another fit: of the same
        motion, on which alone they depend.
        """
        models = self.fit.mechanism, fit.mechanism
        if self.fit.motion is not fit.motion or any(e.corrects for m in models for e in m.effects):
            return {}
        explicit = (e for e in self.laws if not e.effect.implicit and not e.effect.corrects)
        return {e.effect.label: e for e in explicit} if np.array_equal(use, self.use) else {}

    def columns(self, effect: Effect, shape: Shape) -> list[np.ndarray]:
        """The columns (m, u) of an effect at a shape in the rows of each part."""
        C, felt = self.table.effect_columns(effect, [shape])
        whole = np.zeros((*self.table.b.shape, C.shape[2]))
        whole[:, felt] = C
        return [whole[self.use[:, p.coordinate], p.coordinate] for p in self.regression.parts]

    def passed(self, joint: str, waves: float) -> float:
        """Share of the samples at which the rows' filter passes waves of a joint's position, so
        many a radian (a metre).
        """
        cutoff, at = self.table.motion.band.cutoff, self.table.mechanism.joint_index[joint]
        speed = np.concatenate([np.abs(s.e.yd[s.e.usable, at]) for s in self.table.scenes])
        return float((waves * speed < 2 * np.pi * (cutoff or np.inf)).mean())

    def possible(self, effect: Effect, shape: Shape) -> bool:
        """Whether an effect can have a shape in this motion."""
        if not effect.shapes:
            return True
        return effect.possible(replace(self.table.pooled(effect), shape=dict(shape)))

    def with_slopes(
        self, effect: Effect, shape: Shape, C: list[np.ndarray], theta: np.ndarray,
        steps: Mapping[str, float],
    ) -> list[np.ndarray]:  # fmt: skip
        """C(s), then ∂(C θ)/∂s of shape parameters by central differences with these steps."""
        for name, h in steps.items():
            up, down = (
                self.columns(effect, {**shape, name: shape[name] + sign * h}) for sign in (1, -1)
            )
            C = [
                np.column_stack([c, (a - b) @ theta / (2 * h)])
                for c, a, b in zip(C, up, down, strict=True)
            ]
        return C

    def added(self, C: Sequence[np.ndarray]) -> tuple[Contest, np.ndarray]:
        """The contest with further columns C (m, u) of each part, and which they are."""
        regression, new = self.regression.added(C)
        return replace(self, regression=regression), new


def _at_reversals(
    table: Table,
    regression: PartialRegression,
    pulses: Mapping[tuple[str, ...], np.ndarray],
    candidates: Iterable[CandidateColumns],
) -> np.ndarray:
    """The columns of those pulses, by joint, that lower left-out errors (others have no rows that
    determine them) and by more than friction of the joint that builds up over so much speed that it
    acts far from reversals, too: a pulse would take its part.
    """
    some = [np.zeros(0, dtype=int)]
    gains = regression.gains([*pulses.values()])
    laws = [each for each in candidates if each.effect.slow and each.effect.needs]
    for (joints, columns), D, by in zip(pulses.items(), gains.D, gains.by, strict=True):
        if zscore(D) <= SURE:
            continue
        at = table.mechanism.joint_index[joints[0]]
        top = max(np.abs(s.e.yd[s.e.usable, at]).max(initial=0.0) for s in table.scenes)
        wide = [
            group
            for each in laws
            for shape, group in zip(each.shapes, each.groups, strict=True)
            if each.effect.joints == joints and max(shape.values()) > BEYOND * SLOW * top
        ]
        instead = regression.explained(regression.gains(wide).by).max() if wide else 0.0
        if regression.explained(by) > instead:
            some.append(columns)
    return np.concatenate(some)


def _beside_held(
    regression: PartialRegression, held: np.ndarray, candidates: Sequence[CandidateColumns]
) -> tuple[list[CandidateColumns], list[tuple[Effect, str]]]:
    """The candidates that have columns of their own beside inertial parameters that are held at
    their priors, and those that have none, with the reason: where friction is missing the residual
    hides an inertia, which then is no effect.
    """
    laws = [each for each in candidates if not each.curve]
    if not len(held) or not laws:
        return [*candidates], []
    groups = [group for each in laws for group in each.groups]
    own = np.cumsum([0, *(len(each.groups) for each in laws)])[:-1]
    before, beside = (
        np.maximum.reduceat(rows.gains(groups).visible, own)
        for rows in (regression, regression.extended(held))
    )
    hidden = {id(law) for law, a, b in zip(laws, before, beside, strict=True) if a > HIDDEN >= b}
    why = "it has the columns of inertial parameters that are held at their priors"
    return [each for each in candidates if id(each) not in hidden], [
        (each.effect, why) for each in laws if id(each) in hidden
    ]


class ColumnStore:
    """Columns of many effects in the rows that decide, by coordinate, beside A (N, d, k) and b."""

    def __init__(self, table: Table, use: np.ndarray, A: np.ndarray, b: np.ndarray) -> None:
        self.table, self.b = table, b
        self.rows = [np.flatnonzero(each) for each in use.T]
        self.blocks = [[A[rows, u]] for u, rows in enumerate(self.rows)]
        self.index = [[np.arange(A.shape[2])] for _ in self.rows]
        self.count = A.shape[2]

    def add(
        self, effect: Effect, shapes: Sequence[Shape], known: Columns | None = None
    ) -> np.ndarray:
        """Adds the columns of an effect at shapes, or those known; returns which they are."""
        if known is None:
            C, felt = self.table.effect_columns(effect, shapes)
            known = {u: C[self.rows[u], place] for place, u in enumerate(felt.tolist())}
        new = np.arange(self.count, self.count + next(iter(known.values())).shape[1])
        for coordinate, mine in known.items():
            some = mine.any(axis=0)
            self.blocks[coordinate].append(mine[:, some])
            self.index[coordinate].append(new[some])
        self.count += len(new)
        return new

    def parts(self) -> tuple[Part, ...]:
        """One part a coordinate."""
        block = self.table.blocks
        numbers = np.unique(np.concatenate([block[rows] for rows in self.rows]))
        found = []
        for u, rows in enumerate(self.rows):
            edges = np.searchsorted(block[rows], np.append(numbers, numbers[-1] + 1))
            X = np.concatenate(self.blocks[u], axis=1)
            found.append(Part(u, np.concatenate(self.index[u]), X, self.b[rows, u][:, None], edges))
        return tuple(found)


def _moving(table: Table) -> tuple[str, ...]:
    """Joints that move in some log and are in the tree, or anywhere in a loop."""
    index = table.mechanism.joint_index
    return tuple(
        name
        for name, at in ((joint.name, index[joint.name]) for joint in table.mechanism.joints)
        if any(np.quantile(np.abs(s.e.yd[:, at]), 0.98) > s.e.still[at] for s in table.scenes)
    )


def weights(fit: Fit, table: Table) -> np.ndarray:
    """σ (d,) of the fit's rows, or of its residuals where a time basis weighs all rows alike."""
    sigma = fit.estimate.sigma
    if len(sigma) == table.b.shape[1]:
        return sigma
    r = table.b - table.A @ fit.estimate.solution.x
    return np.sqrt((r**2).mean(axis=0)) + 1e-300
