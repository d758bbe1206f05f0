"""The simplest motion, among some that are tried, that tells rivals apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, compress

import numpy as np

from ident.diagnosis.result import Diagnosis
from ident.diagnosis.selection import Evidence
from ident.diagnosis.trials import Trial, allowed, present, trials
from ident.effects import Effect
from ident.effects.formula import Formula
from ident.equations.table import Table
from ident.equations.terms import Samples, unbalanced
from ident.errors import IdentError
from ident.faults.small_errors import away_from_reversals
from ident.information.estimate import MATERIAL
from ident.information.evidence import APART_SE, SAME_COLUMNS, TINY, TOLD_APART_SE, nearly_best
from ident.information.separation import orthonormal, share_apart, without_columns_of
from ident.motion import Motion, State, complete
from ident.motion.motion import left_out

# --- probe ---------------------------------------------------------------------------------------
# What a trial motion would show: rivals apart from one another, effects beside the model.
#
#     s_A = C_A θ_A     separation² = min_s Σ ((I − P) s_A / σ)²,  P onto [A, C_B(s)]
#
# σ is the noise of the present log; sums are scaled to its length (`information.separation`).


NEARBY = (0.7, 0.85, 1.2, 1.4)  # work: times a formula's constant, where it may do the same
# range: times the log's largest ‖K⁺‖: no trial goes nearer to a singular position
SINGULAR_RATIO = 10.0


@dataclass(frozen=True, eq=False)
class Probe:
    """The rows of a trial, M in all coordinates."""

    table: Table
    rows: tuple[np.ndarray, ...]  # by coordinate
    weight: np.ndarray  # (d,) 1/σ
    Q: np.ndarray  # (M, rank) the model's columns, orthonormal
    memo: dict[str, list[np.ndarray]] = field(default_factory=dict)
    memo_of_spans: dict[str, list[np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of(cls, d: Diagnosis, trial: Trial) -> Probe | None:
        """None where the mechanism cannot follow, or exceeds limits that it keeps now."""
        fit = d.fit
        try:
            motion = complete(fit.mechanism, trial.logs, cutoff=None, torques=False)
            runs = [_loaded(d, e) for e in motion.experiments]
            motion = replace(motion, experiments=tuple(runs), independent=fit.motion.independent)
            if not allowed(fit.mechanism, fit.motion, motion):
                return None
            table = Table.of(fit.mechanism, fit.columns, motion, fit.point)
            use = away_from_reversals(table)
            count = np.maximum(use.sum(axis=0), 1)
            sigma = _noise(d, table) * np.sqrt(count / _length(fit.motion))
            rows = tuple(np.flatnonzero(mask) for mask in use.T)
            A = [table.A[chosen, u] / sigma[u] for u, chosen in enumerate(rows)]
            return cls(table, rows, 1 / sigma, orthonormal(np.concatenate(A)))
        except (IdentError, np.linalg.LinAlgError, ValueError, ArithmeticError):
            return None

    def columns(self, effect: Effect, shapes: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """Weighted columns (M, unknowns) of an effect at shapes given and at its usual starts."""
        if effect.label not in self.memo:
            shapes_tried = [] if effect.corrects else [*shapes]
            if isinstance(effect, Formula):  # of many constants, whose starts are too many
                shapes_tried += [{**s, n: s[n] * by} for s in shapes for n in s for by in NEARBY]
            elif effect.searched or not shapes_tried:
                shapes_tried += self.table.starts(effect)
            C, felt = self.table.effect_columns(effect, shapes_tried)
            dense = np.zeros((*self.table.b.shape, C.shape[2]))
            dense[:, felt] = C * self.weight[felt, None]
            C = np.concatenate([dense[rows, u] for u, rows in enumerate(self.rows)])
            self.memo[effect.label] = np.split(C, len(shapes_tried), axis=1)
        return self.memo[effect.label]

    def separation(self, a: Evidence, b: Evidence) -> tuple[float, float]:
        """Standard errors by which two rivals differ after refitting, and that as a share of what
        they explain: the lesser of both ways, unless one can always do what the other does.
        """
        if a.numbers != b.numbers and a.effect.joints == b.effect.joints:
            a, b = sorted((a, b), key=lambda evidence: -evidence.numbers)
            return self._difference(a, b)
        differences = [self._difference(a, b), self._difference(b, a)]
        return min(one for one, _ in differences), min(share for _, share in differences)

    def _difference(self, a: Evidence, b: Evidence) -> tuple[float, float]:
        C = self.columns(a.effect, [a.shape])[0]
        names = a.effect.unknowns or a.effect.searched
        signal = without_columns_of(self.Q, C @ a.refit.theta[: len(names)])[:, None]
        size = float(np.linalg.norm(signal))
        if b.effect.label not in self.memo_of_spans:  # at every shape
            self.memo_of_spans[b.effect.label] = self.spans(b.effect, [b.shape])
        share = share_apart(signal / max(size, TINY), self.memo_of_spans[b.effect.label])
        return share * size, share

    def spans(self, effect: Effect, shapes: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """What an effect's columns span beside the model, orthonormal, at each shape."""
        return [orthonormal(without_columns_of(self.Q, C)) for C in self.columns(effect, shapes)]

    def visible(self, effect: Effect) -> float:
        """The largest share of an effect's columns that the model does not have; none where the
        largest values that it can have would not show beside the model.
        """
        bounds = self.table.bounds(effect) if effect.searched else {}
        ends = {name: max(map(abs, both)) for name, both in bounds.items()}
        parameters = effect.unknowns or effect.searched
        largest = np.array([min(p.largest, ends.get(p.name, np.inf)) for p in parameters])
        shares = [0.0]
        for C in self.columns(effect, []):
            projected = without_columns_of(self.Q, C)
            size, remaining = (np.linalg.norm(x, axis=0) for x in (C, projected))
            nonzero = remaining > 1e-9 * np.sqrt(len(C))
            if np.any(remaining[nonzero] * largest[nonzero] > TOLD_APART_SE):
                shares.append(float(np.linalg.norm(remaining) / np.linalg.norm(size)))
        return max(shares)


def _loaded(d: Diagnosis, e: State) -> State:
    """With the torques that the model predicts, and the log's other columns at their medians."""
    mechanism, names = d.fit.mechanism, d.fit.motion.independent
    others = d.fit.motion.experiments[0].extra.items()
    usual = {name: np.full(len(e), float(np.median(x))) for name, x in others}
    e = replace(e, extra={**usual, **e.extra})
    if mechanism.closures:
        bare, e = e, e.transmitted(mechanism, names)
        now, then = (
            max(np.linalg.norm(x.pinv[x.usable], axis=(1, 2)).max() for x in states)
            for states in (d.fit.motion.experiments, [e])
        )
        if left_out(bare, e) or then > SINGULAR_RATIO * now:
            raise ValueError("near a singular position")
    needed = -unbalanced(Samples(mechanism, e, slice(None), d.fit.point).reduced(slice(None)))
    drives = [mechanism.joint_index[name] for name in mechanism.driven]
    return replace(e, tau=e.drive_torques(needed, drives))


def _noise(d: Diagnosis, table: Table) -> np.ndarray:
    """(d,) of the present log's rows, more where the trial's torque is larger [N m | N]."""
    rms = []
    for u, name in enumerate(d.fit.motion.independent):
        torque = float(np.sqrt(np.mean(table.tau[:, u] ** 2)))
        error = d.fit.train[name]
        now = error.rms / error.relative if error.relative else torque
        rms.append(max(d.floor[name] * max(1.0, torque / max(now, 1e-300)), MATERIAL * torque))
    return np.maximum(np.array(rms), 1e-12)


def _length(motion: Motion) -> float:
    """Rows of the present log that are worth an independent one."""
    samples = [float(e.usable.sum()) for e in motion.experiments]
    if motion.band.cutoff is None:
        return sum(samples)
    cut = 2 * motion.band.cutoff
    return sum(n * min(1.0, cut / e.rate) for n, e in zip(samples, motion.experiments, strict=True))


# --- propose -------------------------------------------------------------------------------------
#
#     worth = Σ min(separation, AMPLE)²  over the pairs of a question, within PARSIMONY of the best
#
# First question: at which place, of effects of one kind. Second: of which kind.


AMPLE = 10.0  # work: beyond which more is worth nothing
RIVALS_COMPARED = 12  # work: that are looked at
FORMULAS = 3  # work: rivals of a law, the simplest first
PLACES = ("same", "turn", "limits", "wider", "faster", "speeds", "alone", "strokes")
KINDS = ("same", "faster", "speeds", "turn", "limits", "wider", "alone", "strokes")
KINDS_SLOW = ("same", "strokes", "speeds", "faster", "turn", "limits", "wider", "alone")

Pair = tuple[Evidence, Evidence]


@dataclass(frozen=True, eq=False)
class Proposal:
    """A motion to be logged next, and what it would show."""

    trial: Trial  # the motion
    # standard errors of a log as long as the present one, of the rivals that stay most alike
    separation: float
    apart: tuple[Effect, ...]  # rivals that it tells apart
    similar: tuple[tuple[Effect, Effect], ...]  # pairs that it does not
    seconds: float  # how long a log of it should be to be nearly sure


@dataclass(frozen=True, eq=False)
class Attempt:
    """Separation of all pairs in one trial."""

    trial: Trial
    separations: dict[Pair, tuple[float, float]]  # standard errors, share that differs

    def separation(self, pair: Pair) -> float:
        """Standard errors; none where the columns of both are the same."""
        x, share = self.separations[pair]
        return x if share > SAME_COLUMNS else 0.0

    def worth(self, pairs: Sequence[Pair]) -> float:
        """Value of the trial for these pairs: squared standard errors, up to AMPLE each."""
        return sum(min(self.separation(pair), AMPLE) ** 2 for pair in pairs)


def contenders(d: Diagnosis) -> list[Evidence]:
    """The best and its rivals, then laws that do as well; without a name the laws alone."""
    formulas = [*d.relatives[:FORMULAS]]
    if d.best is None and d.laws:
        formulas = [d.laws[0].found.fitted, *d.laws[0].found.rivals[:FORMULAS]]
    none = np.zeros(0, int)
    formula_evidence = [  # with a kind of its own for each
        Evidence(
            replace(e.formula, name=e.formula.text), e.shape, none, e.C, e.refit,
            np.nan, np.nan, np.nan, np.nan, True, True,
        )
        for e in formulas
    ]  # fmt: skip
    if d.best is None:
        return formula_evidence
    best = d.candidates[0].evidence
    known = [*d.selection.first.evidence, *(candidate.evidence for candidate in d.candidates)]
    of = {evidence.effect.label: evidence for evidence in known}
    rest = [of[effect.label] for effect in d.rivals if effect.label in of]
    rest.sort(key=lambda evidence: evidence.effect.kind != best.effect.kind)
    return [best, *rest, *formula_evidence][:RIVALS_COMPARED]


def questions(rivals: Sequence[Evidence]) -> list[list[Pair]]:
    """Pairs of one kind at several places, then pairs of several kinds; none empty."""
    pairs = list(combinations(rivals, 2))
    where = [(a, b) for a, b in pairs if a.effect.kind == b.effect.kind]
    what = [(a, b) for a, b in pairs if a.effect.kind != b.effect.kind]
    return [group for group in (where, what) if group]


def attempts(d: Diagnosis, rivals: Sequence[Evidence]) -> list[Attempt]:
    """Tries motions out, the likeliest to help first, until one tells all apart with ease."""
    now = present(d.fit.mechanism, d.fit.motion)
    pairs = list(combinations(rivals, 2))
    attempts_made: list[Attempt] = []
    kinds = [rival.effect.kind for rival in rivals]
    order = KINDS_SLOW if any(rival.effect.slow for rival in rivals) else KINDS
    if len(set(kinds)) < len(kinds):
        order = PLACES
    about = concerned(d, [rival.effect for rival in rivals])
    trials_in_order = [trial for trial in trials(now, about) if trial.kind in order]
    for trial in sorted(trials_in_order, key=lambda trial: order.index(trial.kind)):
        probe = Probe.of(d, trial)
        if probe is None:
            continue
        attempts_made.append(Attempt(trial, {(a, b): probe.separation(a, b) for a, b in pairs}))
        ample = min(attempts_made[-1].separation(pair) for pair in pairs) >= AMPLE
        if ample and trial.kind != "same":
            break
    return attempts_made


def concerned(d: Diagnosis, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Independent joints whose motion an effect feels: its own in a tree, all of them in a loop."""
    independent = d.fit.motion.independent
    joints = {name for effect in effects for name in effect.joints if effect.site == "joint"}
    if d.fit.mechanism.closures or not joints & set(independent):
        return independent
    return tuple(name for name in independent if name in joints)


def proposal(
    d: Diagnosis, attempts_made: Sequence[Attempt], pairs: Sequence[Pair]
) -> Proposal | None:
    """The simplest trial that answers a question about as well as the best; None if none does."""
    worth = [
        (attempt.worth(pairs), attempt) for attempt in attempts_made if attempt.trial.kind != "same"
    ]
    good = nearly_best([one for one, _ in worth])
    best = next((attempt for _, attempt in compress(worth, good)), None)
    if best is None or not (pairs_apart := [p for p in pairs if best.separation(p) >= APART_SE]):
        return None
    worst = min(pairs_apart, key=best.separation)
    length = sum(float(e.t[-1] - e.t[0]) for e in d.fit.motion.experiments)
    effects = {rival.effect.label: rival.effect for pair in pairs_apart for rival in pair}
    return Proposal(
        trial=best.trial,
        separation=best.separation(worst),
        apart=tuple(effects.values()),
        similar=tuple((a.effect, b.effect) for a, b in pairs if best.separation((a, b)) < APART_SE),
        seconds=max(
            best.trial.seconds, length * max(1.0, (TOLD_APART_SE / best.separation(worst)) ** 2)
        ),
    )
