"""The search for faults of the data: of torques one after the other, then of the motion.

Each hypothesis is tried in the rows of the motion as it would be without the fault (`FaultTrial`).
One is credible if it predicts blocks of time that were left out better than the log as it is, by
more than the best of so many hypotheses would by chance, if it explains half of the error, and if
no missing effect of the library explains as much.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from heapq import nlargest

import numpy as np

from ident.effects import Effect
from ident.equations.problem import Problem
from ident.equations.table import Table
from ident.errors import IdentError
from ident.faults.channel_fits import DOUBT, SMALL, ChannelEquations, limits_of_machines
from ident.faults.fault import (
    CLOCKS,
    Fault,
    StateChange,
    motion_faults,
    scale_of_torque,
    torque_faults,
    turned_positions,
)
from ident.faults.motion_trials import MotionTrials
from ident.faults.motors import WIDTH, motor_faults, nearest_nice
from ident.faults.small_errors import away_from_reversals
from ident.information.estimate import Estimate
from ident.information.evidence import (
    EXCESS,
    EXPLAINED_BELOW,
    MAIN_CAUSE,
    RIVAL,
    credible,
    leaves_as_little,
    rivals_of,
    surely_t,
    zscore,
)
from ident.information.hypotheses import Array
from ident.mechanism.mechanism import Mechanism

LEAST_FACTOR = 1.5  # tuned: a smaller one is an effect's: a gain, a load-dependent friction
POOR = np.sqrt(2) * SMALL  # with SMALL counted in: of a joint that something may be wrong with
CLOSEST = 6  # work: hypotheses that are looked at in detail
# work: between two of these the best factor of a torque is sought
FACTORS = np.geomspace(1e-4, 1e4, 17)
NUMBERED = ("scale", "delay", "time")  # faults of which a number is sought, not one of several


@dataclass(frozen=True, eq=False)
class FaultTrial:
    """A fault, in the equations of the motion as it would be."""

    fault: Fault
    equations: ChannelEquations
    before: Array  # relative errors (d,) without it
    before_fault: float = 1.0  # of a credible one, the error of its joints without it
    rivals: tuple[Fault, ...] = ()  # and faults that do nearly as well

    @classmethod
    def of_log(cls, equations: ChannelEquations) -> FaultTrial:
        """Return the log as it is."""
        return cls(equations.as_logged, equations, np.ones(len(equations.total)))

    @cached_property
    def rows(self) -> np.ndarray:
        """Coordinates (d,) that feel the fault."""
        return self.equations.rows_of(self.fault)

    @cached_property
    def score(self) -> float:
        """Log density of the torques, if the fault is all that is wrong where it is felt."""
        return self.equations.score(self.fault, self.before)

    @cached_property
    def noise(self) -> Array:
        """Relative errors (d,) without the fault."""
        return self.equations.noise(self.fault, self.before)

    @property
    def error(self) -> float:
        """Their mean where the fault is felt."""
        return rms(self.noise[self.rows])

    def ahead_of(self, other: FaultTrial) -> float:
        """Standard errors by which it predicts blocks that were left out better than another."""
        return zscore((self.held_out_density - other.held_out_density).sum(axis=1))

    @cached_property
    def held_out_density(self) -> Array:
        """Log density (blocks, d) of the torques of each block, fitted to the others."""
        return self.equations.left_out(self.fault, self.noise)

    @property
    def evaluated(self) -> FaultTrial:
        """The trial with what it is compared by, without its rows, of which few fit in memory."""
        bare = replace(self, equations=self.equations.without_rows)
        compared = ("rows", "noise", "held_out_density")
        vars(bare).update({name: getattr(self, name) for name in compared})
        return bare


@dataclass(frozen=True, eq=False)
class FaultSearch:
    """The rows of a fit, in which faults of the data are sought."""

    problem: Problem
    estimate: Estimate
    errors: Mapping[str, float]  # relative, by joint, fitted or held out, the larger
    table: Table
    use: np.ndarray  # (N, d) which of its rows count
    # left-out squares (blocks, d) with a diagnosis' effects: a fault must explain more
    explained: Array | None = None
    # of faults of the motion: whatever rows count and whatever is `explained`, these are the same
    scores: dict[Hashable, float] = field(default_factory=dict)

    @property
    def mechanism(self) -> Mechanism:
        """The fitted mechanism."""
        return self.problem.mechanism

    @cached_property
    def effects(self) -> list[Effect]:
        """The library's linear effects at every drive that the model lacks, or of known values."""
        drives = {(name,) for name in self.mechanism.driven}
        changed = [effect.freed for effect in self.mechanism.effects if effect.known]
        every = (*self.mechanism.candidates(), *changed)
        linear = [e for e in every if e.local and e.linear and not e.shapes]
        return [effect for effect in linear if effect.joints in drives]

    @cached_property
    def common(self) -> list[Effect]:
        """Those of them that every machine has."""
        return [effect for effect in self.effects if effect.common]

    @cached_property
    def equations(self) -> ChannelEquations:
        """The fit's rows, with what every machine has."""
        return self._with_common(self.every)

    @cached_property
    def every(self) -> ChannelEquations:
        """The fit's rows, with all linear effects."""
        return ChannelEquations.of(self.estimate, self.table, self.use, self.effects, shifts=True)

    def _with_common(self, every: ChannelEquations, kind: str = "") -> ChannelEquations:
        """Return equations with the effects that every machine has, and those of one kind."""
        return every.with_effects({e.label for e in self.effects if e.common or e.kind == kind})

    @cached_property
    def possible(self) -> bool:
        """Whether the fit is of a machine that can exist: a torque of another sign is not."""
        free = ~self.estimate.fixed
        G, g = limits_of_machines(self.estimate, self.table, [], int(free.sum()))
        return bool((G @ self.estimate.x[free] + g >= 0).all())

    @cached_property
    def reference(self) -> Array:
        """Relative errors (d,) of the log as it is with all linear effects of the library."""
        reference = self.every.noise(self.every.as_logged)
        with_diagnosis = np.sqrt(self._unexplained + SMALL**2)
        return min(reference, with_diagnosis, key=lambda errors: float(np.log(errors).sum()))

    @property
    def _unexplained(self) -> Array:
        """Squares (d,) over the torque's that a diagnosis' effects leave; infinite without one."""
        if self.explained is None:
            return np.full(len(self.errors), np.inf)
        return self.explained.sum(axis=0) / self.equations.torque

    @cached_property
    def varying(self) -> np.ndarray:
        """(N, d) rows that count, but for stretches at rest: these have no shape."""
        return self.use & self.table.vary

    @cached_property
    def calm_rows(self) -> np.ndarray:
        """(N, d) rows away from reversals; all, where the model has no dry friction."""
        effects = self.mechanism.effects
        dry = any(u.acts in ("level", "dry") for effect in effects for u in effect.unknowns)
        return away_from_reversals(self.table) if dry else np.ones_like(self.table.informed)

    # --- the search -------------------------------------------------------------------------------

    @cached_property
    def faults(self) -> tuple[list[FaultTrial], Array]:
        """The faults, and the relative errors (d,) that wrong torques leave."""
        good = max(self.errors.values(), default=0.0) < SMALL and self.possible
        if good or not self.use.any():
            return [], np.zeros(len(self.errors))
        logged = FaultTrial.of_log(self.equations)
        trials = self._torques(logged)
        last = trials[-1] if trials else logged
        if trials and not (self._explains(last, self.every) and self._away_too(last.fault)):
            trials, last = [], logged
        of_motion = self._motion(last.noise)
        return [of_motion] if of_motion else self._with_signs(trials), last.noise

    def _torques(self, now: FaultTrial) -> list[FaultTrial]:
        """Return the faults of torques, each beside those before it."""
        equations, trials = self.equations, list[FaultTrial]()
        measured = [equations.driven.index(name) for name in self.mechanism.measured]
        lags = equations.lags[: equations.near]
        while len(trials) < len(equations.driven):

            def trial(fault: Fault, before: Array = now.noise) -> FaultTrial:
                return FaultTrial(fault, equations, before)

            poor, faults = (now.noise > POOR) & self.varying.any(axis=0), list[Fault]()
            for fault in torque_faults(now.fault, lags, measured):
                if poor[equations.rows_of(fault)].any():
                    faults.append(fault)
            for j in range(len(equations.driven)):  # the factor of each that explains most
                scaled = scale_of_torque(now.fault, j, 1.0)
                if poor[equations.rows_of(scaled)].any():
                    scores = [trial(scale_of_torque(now.fault, j, f)).score for f in FACTORS]
                    i = int(np.clip(np.argmax(scores), 1, len(FACTORS) - 2))
                    scaled = refined(scaled, FACTORS[i - 1 : i + 2 : 2], trial)
                    if max(scaled.number[0], 1 / scaled.number[0]) > LEAST_FACTOR:
                        faults.append(scaled)
            base = now.held_out_density
            if self.explained is not None:
                rival = equations.density(self.explained / equations.torque)
                base = base if base.sum() > rival.sum() else rival
            if (best := self._best(faults, trial, base, now.noise, {})) is None:
                break
            trials.append(best)
            now = best
        return trials

    def _with_signs(self, trials: list[FaultTrial]) -> list[FaultTrial]:
        """Return faults of torques in which a wrong sign is that of the position, or of the axis,
        where that predicts blocks that are left out better; as rivals where it does as well.

        All are fitted to the same filtered rows, in which positions have as little noise as in the
        fit: in rows of single samples it hides what a turned torque leaves.
        """
        names, turned = self.problem.motion.experiments[0].logged, set[str]()
        signs = [x for x in trials if x.fault.kind == "sign" and {*x.fault.places} <= {*names}]
        for trial in signs:
            last, joints = trials[-1], trial.fault.places
            faults = turned_positions(last.fault, joints, names, turned)
            equations = self._equations_in(faults[0])
            if equations is None:
                continue
            others = [FaultTrial(fault, equations, last.before) for fault in faults]
            best = max(others, key=lambda x: float(x.held_out_density.sum()))
            z = best.ahead_of(last)
            rest = [x for x in trials if x is not trial]
            if z >= RIVAL:
                turned |= {*joints}
                trials = [*rest, replace(best, before_fault=rms(trial.before))]
            elif z > -RIVAL:
                as_well = replace(trial, rivals=(*trial.rivals, best.fault))
                trials = [as_well if x is trial else x for x in trials]
        return trials

    def _equations_in(self, fault: Fault) -> ChannelEquations | None:
        """Return the equations of the motion as it would be without a fault of it, filtered as the
        fit's; None where that motion does not have the same rows, as where a loop does not close.
        """
        motion, change = self.problem.motion, fault.state
        assert change is not None
        try:
            states = [change(self.mechanism, e) for e in motion.experiments]
            as_it_would_be = replace(motion, experiments=tuple(e for _, e in states))
            columns, point = self.problem.columns, self.table.point
            table = Table.of(states[0][0], columns, as_it_would_be, point)
        except (IdentError, np.linalg.LinAlgError):
            return None
        same = np.array_equal(table.t, self.table.t) and not (self.use & ~table.informed).any()
        if not same:
            return None
        return ChannelEquations.of(
            self.estimate, table, self.use, self.common, True, self.table.blocks
        )

    def _motion(self, noise: Array) -> FaultTrial | None:
        """Return the fault of the motion that explains the log by far best, if any does better than
        what wrong torques leave, the relative errors `noise` (d,), or a diagnosis.
        """
        if min(noise.max(), np.sqrt(self._unexplained.max())) < DOUBT:
            return None
        trials = MotionTrials(self.problem, self.estimate, self.table, self.common)
        logged, thin, mechanism = trials.logged, trials.states, self.mechanism
        equations_of = lru_cache(maxsize=1)(trials.equations)  # an axis and a sign have one state
        every = ChannelEquations.of(self.estimate, logged, logged.informed, self.effects)
        now = FaultTrial.of_log(self._with_common(every))
        both = zip(self.problem.motion.independent, noise, strict=True)
        poor = {name for name, x in both if x > DOUBT}

        def trial(fault: Fault) -> FaultTrial:
            assert fault.state is not None
            return FaultTrial(fault, equations_of(fault.state), now.noise)

        faults = motion_faults(now.fault, mechanism, thin, poor)
        faults += motor_faults(now.fault, mechanism, thin[0].logged, poor)
        base = now.held_out_density
        by_change = dict[StateChange, list[Fault]]()
        for fault in faults:
            if fault.identity not in self.scores and fault.state is not None:
                by_change.setdefault(fault.state, []).append(fault)
        for change, equations in trials.equations_together([*by_change]):
            for fault in by_change[change]:
                _score(self.scores, FaultTrial(fault, equations, now.noise))
        best = self._best(faults, trial, base, min(now.noise, noise, key=rms), self.scores)
        return best if best and self._explains(best, every) else None

    def _best(
        self, faults: Sequence[Fault], trial: Callable[[Fault], FaultTrial], base: Array,
        before_rows: Array, scores: dict[Hashable, float],
    ) -> FaultTrial | None:  # fmt: skip
        """Return the best of some faults, if it is credible.

        Args:
            faults: all that are tried; trial: a fault in its equations.
            base: log density (blocks, d) of blocks that are left out, without a fault.
            before_rows: relative errors (d,) without a fault.
            scores: by what a fault is; those that are not known are filled in.
        """
        for fault in faults:
            if fault.identity in scores:
                continue
            scores[fault.identity] = -np.inf
            with suppress(IdentError, np.linalg.LinAlgError):  # a motion that does not close
                attempt = trial(fault)
                if len(attempt.equations.rows) == len(base):
                    _score(scores, attempt)
        possible = [fault for fault in faults if scores[fault.identity] > -np.inf]
        closest = nlargest(CLOSEST, possible, key=lambda x: scores[x.identity])
        if not closest:
            return None
        best, others = trial(closest[0]), [trial(fault).evaluated for fault in closest[1:]]
        if best.fault.kind == "motors":  # of several matrices as good the simplest is named
            ratio = "motors", best.fault.number
            same = [x for x in others if (x.fault.kind, x.fault.number) == ratio]
            equal = [best, *rivals_of(best, same, best.ahead_of)]
            simplest = min(equal, key=lambda x: faults.index(x.fault))
            others = [other for other in (best, *others) if other is not simplest]
            best = best if simplest is best else trial(simplest.fault)
        if best.fault.kind == "time":
            at = CLOCKS.index(best.fault.number[0])
            ends = CLOCKS[max(at - 1, 0)], CLOCKS[min(at + 1, len(CLOCKS) - 1)]
            best = trial(refined(best.fault, ends, trial))
        if best.fault.kind == "motors" and best.fault.at is not None:
            x = best.fault.number[0]
            best = trial(refined(best.fault, (x / WIDTH, x * WIDTH), trial))
            usual = trial(best.fault.at(nearest_nice(best.fault.number[0])))  # type: ignore[misc]
            best = usual if best.ahead_of(usual) < surely_t(len(faults), len(base)) else best
        rows, D = best.rows, best.held_out_density - base
        t = min(zscore(D.sum(axis=1)), zscore(D[:, rows].sum(axis=1)))
        identity = best.fault.kind, best.fault.places
        # the best of each kind at the same joints
        rivals_by_kind = dict[tuple[object, ...], Fault]()
        for other in rivals_of(best, others, best.ahead_of):
            rivals_by_kind.setdefault((other.fault.kind, other.fault.places), other.fault)
        if (at_joints := rivals_by_kind.get(identity)) and best.fault.kind == "motors":
            signs = {x.state.signs for x in (best.fault, at_joints)}  # type: ignore[union-attr]
            if len(signs) == 1:  # the same but for a ratio
                del rivals_by_kind[identity]
        if identity[0] in NUMBERED:
            rivals_by_kind.pop(identity, None)
        rivals = tuple(rivals_by_kind.values())
        before = rms(before_rows[rows])
        most = min(EXPLAINED_BELOW, max(MAIN_CAUSE * before, DOUBT))
        if len(before_rows) == 1 or any(rival.kind != best.fault.kind for rival in rivals):
            most = DOUBT  # nothing else holds it, or nobody can tell by which of two faults
        determined = _determined(best, trial)
        chance = surely_t(len(faults), len(base))
        if determined is None or not credible(t, chance, remaining=best.error, most=most):
            return None
        return replace(best, fault=determined, before_fault=before, rivals=rivals)

    def _explains(self, last: FaultTrial, every: ChannelEquations) -> bool:
        """Whether faults leave not much more than all effects of the library together, and less
        than one kind of effect would, missing at all drives: else nobody can tell which it is. Such
        a kind does well in all joints, and where the last fault is felt: by its errors, as standard
        errors of blocks make a name of a small difference (late positions were late torques, too).
        Motors elsewhere have as few unknowns as the log as it is, so that what both predict of
        blocks that were left out is a fair comparison.
        """
        motors, rest = last.fault.kind == "motors", self.reference
        if motors:  # in the same rows: those of a motion have no filter
            rest = every.noise(every.as_logged)
        if not leaves_as_little(last.noise, rest):
            return False

        def as_well(equations: ChannelEquations) -> bool:
            noise = equations.noise(equations.as_logged)
            if motors:
                density = equations.left_out(equations.as_logged, noise)
                return zscore((last.held_out_density - density).sum(axis=1)) < RIVAL
            rows = (slice(None), last.rows)
            return all(rms(noise[u]) < EXCESS * rms(last.noise[u]) for u in rows)

        kinds = sorted({effect.kind for effect in self.effects if not effect.common})
        return not any(as_well(self._with_common(every, kind)) for kind in kinds)

    def _away_too(self, fault: Fault) -> bool:
        """Whether a delay explains rows away from reversals, too: friction that builds up over some
        speed, or is early, looks like torques that are early.
        """
        use = self.use & self.calm_rows
        if fault.kind != "delay" or np.array_equal(use, self.use):
            return True
        calm = ChannelEquations.of(self.estimate, self.table, use, self.common, shifts=True)
        rows = self.equations.rows_of(fault)

        def fall(equations: ChannelEquations) -> float:
            before, after = (equations.noise(x) for x in (equations.as_logged, fault))
            return float(np.log(before[rows] / after[rows]).mean())

        return fall(calm) >= MAIN_CAUSE * fall(self.equations)


def _score(scores: dict[Hashable, float], attempt: FaultTrial) -> None:
    """Fill in the score of a fault: −∞ where it has none."""
    scores[attempt.fault.identity] = -np.inf
    with suppress(np.linalg.LinAlgError):
        if np.isfinite(attempt.score):
            scores[attempt.fault.identity] = attempt.score


def refined(
    fault: Fault, ends: Sequence[float] | Array, trial: Callable[[Fault], FaultTrial]
) -> Fault:
    """Return a fault with the number between two ends that explains the log best."""
    from scipy.optimize import minimize_scalar  # takes 0.2 s to import

    assert fault.at is not None
    at = fault.at
    optimum = minimize_scalar(
        lambda x: float(np.log(trial(at(float(np.exp(x)))).noise).mean()),
        bounds=np.log(ends), method="bounded", options={"xatol": 0.003, "maxiter": 12},
    )  # fmt: skip
    return at(float(np.exp(optimum.x)))


def _determined(best: FaultTrial, trial: Callable[[Fault], FaultTrial]) -> Fault | None:
    """Return a fault with its number, if it has one; None where the log does not determine it."""
    fault, equations = best.fault, best.equations
    if fault.kind == "delay":
        longest = np.abs(equations.lags[: equations.near]).max()
        if abs(fault.number[0]) == longest:  # a later torque would be better still
            return None
        return replace(fault, number=(equations.refined_delay(fault),))
    for neighbour in (trial(fault.at(f * fault.number[0])) for f in (0.5, 2.0)) if fault.at else ():
        if best.ahead_of(neighbour) < RIVAL:
            # a factor takes the joint out
            return None
        if fault.kind == "time" and neighbour.error < EXCESS * best.error:
            return None
    return fault


def rms(x: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(x**2)))
