"""What may be wrong with the data behind a fit, before any missing effect is named.

Channels are judged by their own samples (`channel_checks`), torques and motions as hypotheses in
the rows of the fit (`faults.search`); beside these, hints on units and on small errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ident.display import Displayed
from ident.effects import KINDS
from ident.equations.motion_noise import noise_floor
from ident.equations.problem import Problem
from ident.equations.table import Table
from ident.faults import small_errors
from ident.faults.channel_checks import LATE_RATES, log_findings
from ident.faults.channel_fits import DOUBT, SAME_SHAPE, SMALL, columns_of
from ident.faults.disagreements import differing_logs
from ident.faults.fault import exact_factor, fault_finding, log_entry
from ident.faults.search import FaultSearch
from ident.finding import Finding
from ident.information.chance import FEWEST_EQUATIONS
from ident.information.estimate import MATERIAL, Estimate
from ident.information.evidence import (
    BEYOND,
    EXCESS,
    EXPLAINED_BELOW,
    MAIN_CAUSE,
    PARSIMONY,
    credible,
)
from ident.information.hypotheses import Array
from ident.mechanism.parameters import rigid_forces
from ident.motion.torque_class import TorqueVerdict
from ident.text import listed, percent, shortlist, two_digits
from ident.threads import on_one_thread

FAULTS = {  # codes of findings that explain a log better than any effects that were found
    "sign", "swapped", "axis", "position sign", "position scale", "position from",
    "position swapped", "joints swapped", "motors", "time", "gravity", "another run", "units",
    "logs disagree", "changed within the log", "computed",
}  # fmt: skip
MODELS = {  # by cause of a verdict: code, meaning and remedy of torques that are a model's
    "computed": (
        "computed",
        "{terms} of {model} to {left}: computed by the controller's own model or a simulator, not "
        "measured; a fit returns that model",
        "log what sensors or motor currents show, and map these columns in [log]",
    ),
    "open_tree": (
        "computed",
        "what the open tree needs, to {left}: the closures would carry no force, so these were "
        "computed without them, and no drive of this loop has made them",
        "log the torques of the drives, put all other joints among the passive ones, or take the "
        "closures out",
    ),
    "compensated": (
        "compensated",
        "all torques are explained without gravity (to {left}; with it to {before}): the "
        "controller has subtracted its own model of gravity, as robots' interfaces do, or gravity "
        "in mechanism.toml is not that of the machine",
        "log the torque with gravity, or take it into account: --with gravity_compensation, which "
        "subtracts the gravity of the bodies as given, or, where the controller knows the machine "
        "better than that, gravity = [0.0, 0.0, 0.0] at the top of mechanism.toml",
    ),
}
DEAD = {"constant", "zero", "noise_only"}  # codes of findings on channels that measure nothing
TINY = 1e-12  # numerics: of a torque's squares
ABSENT = 1e-9  # numerics: of the largest column, below which an unknown has no effect on any torque
FAR = 10.0  # level: times noise of the sensors, from which values are those of another model
LIKE = 0.9  # level: from there on four fifths of the squares of one are of the other's shape
# level: below, less than half of the squares of one are of the other's shape
UNLIKE = MAIN_CAUSE**0.5
# tuned: of the URDF's torque at one joint, where a rotor behind its gears may be missing
TIMES = 30.0
SAME = 0.03  # tuned: difference of logarithms of factors that are one number, as no masses' are, …
OTHER = 1.15  # tuned: … from which that number is another scale than the URDF's


@dataclass(frozen=True, repr=False)
class Health(Displayed):
    """Errors in the logged data: `findings`, each with a remedy. From `ident.health`."""

    findings: tuple[Finding, ...]

    @property
    def good(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings that explain the log; of factors of a torque those that no effect has."""
        return tuple(
            finding
            for finding in self.findings
            if finding.code in FAULTS
            or (finding.code == "scale" and not 1 / BEYOND < (finding.number or 1.0) < BEYOND)
        )

    def json(self) -> list[dict[str, Any]]:
        """One dictionary a finding."""
        return [asdict(finding) for finding in self.findings]


class DataChecks(FaultSearch):
    """The questions to one fit's data."""

    @classmethod
    def of(cls, problem: Problem, estimate: Estimate, errors: Mapping[str, float]) -> DataChecks:
        """Make the checks of a fit."""
        point = problem.point_at(estimate.x)
        table = Table.of(problem.mechanism, problem.columns, problem.motion, point)
        return cls(problem, estimate, errors, table, table.informed)

    @on_one_thread
    def health(self) -> Health:
        """Judge the data, gravest first."""
        faults, noise = self.faults
        if of_models := self._of_models():
            measured = {*self.mechanism.measured} - {
                channel.removeprefix("tau.") for x in of_models for channel in x.where
            }
            if not measured:
                return Health(tuple(of_models))
        findings = [*of_models]
        for trial in faults:
            fall = trial.before_fault, trial.error
            named = fault_finding(self.mechanism, trial.fault, *fall, trial.rivals)
            meaning = f"{named.meaning}; standard errors hold what it does to parameters"
            findings.append(replace(named, meaning=meaning))
        channels = [*filter(self._matters, log_findings(self.mechanism, self.problem.motion))]
        channels = [self._latest(x) if x.code == LATE_RATES else x for x in channels]
        if self.mechanism.driven:
            # in one joint alone it is that joint's friction; against late positions all are early
            in_time = not any(
                x.code == LATE_RATES and all(channel.startswith("q.") for channel in x.where)
                for x in channels
            )
            if in_time and all(x.code == "delay" and len(x.where) == 1 for x in findings):
                findings += self._late()
            sizes = [*self._magnitudes()]
            codes = {finding.code for finding in findings}
            if codes <= {"scale"} and any(x.code == "units" for x in sizes):
                findings = sizes
            dead = any(finding.code in DEAD for finding in channels)
            several = len(self.problem.motion.logs) > 1 and not (findings or dead)
            logs = differing_logs(self.problem, lambda: self.reference) if several else ()
            findings = findings or [*logs] or self._torques_of_another_log(noise) or sizes
        return Health((*findings, *channels))

    def _of_models(self) -> list[Finding]:
        """Return the findings on torques that a model has computed or corrected."""
        channels = dict[TorqueVerdict, list[str]]()
        described = {effect.fault for effect in self.mechanism.effects}  # by the model itself
        for joint, verdict in self.problem.motion.torques.items():
            if verdict.cause in MODELS and verdict.cause not in described:
                channels.setdefault(verdict, []).append(f"tau.{joint}")
        name = self.mechanism.urdf.name or "the model"
        findings = []
        for verdict, where in channels.items():
            code, text, remedy = MODELS[verdict.cause]
            kinds = (kind for kind, effect_class in KINDS.items() if effect_class.fault == code)
            values = {"terms": verdict.column, "model": name, "left": percent(verdict.number),
                      "before": percent(verdict.threshold)}  # fmt: skip
            text = f"{listed(where)}: {text.format(**values)}"
            sizes = verdict.number, verdict.threshold
            findings.append(Finding(code, text, remedy, tuple(where), *sizes, tuple(kinds)))
        return findings

    def _matters(self, finding: Finding) -> bool:
        """Whether the steps of a torque, if the finding is of these, have a part in the squared
        error that is left, or in that which all linear effects of the library leave.
        """
        joint = finding.where[0].removeprefix("tau.") if finding.where else ""
        if finding.code == "constant" and self._swings(finding.where):
            return False
        if finding.code != "steps" or joint not in self.errors or finding.number is None:
            return True
        least = np.sqrt(PARSIMONY) * self.errors[joint]
        if finding.number <= least:
            least = np.sqrt(PARSIMONY) * float(self.reference[list(self.errors).index(joint)])
        return finding.number > least

    def _latest(self, finding: Finding) -> Finding:
        """Return a finding on velocities and positions of which one is late, with which of them it
        is: torques are in time with the other.
        """
        equations, lag = self.equations, 1e-3 * (finding.number or 0.0)
        near = equations.lags[: equations.near]
        shift = int(np.abs(near - lag).argmin())
        if not equations.drive_of_coordinate or not shift or abs(near[shift] - lag) > abs(lag) / 2:
            return finding
        with_rates = equations.as_logged.replaced(
            "delay", float(near[shift]), shift=dict.fromkeys(equations.drive_of_coordinate, shift)
        )
        of_position, of_rates = (
            0.5 * float(np.log(equations.errors(x, equations.noise(x)) + TINY).mean())
            for x in (equations.as_logged, with_rates)
        )
        if abs(of_rates - of_position) < np.log(EXCESS):
            return finding
        size = two_digits(1e3 * abs(lag))
        positions = tuple(channel for channel in finding.where if channel.startswith("q."))
        if of_position < of_rates:
            text = (
                f"{finding.meaning}; torques are in time with the positions, so it is the "
                "velocities"
            )
            return replace(finding, meaning=text, remedy="leave out the velocities")
        text = (
            f"{listed(positions)}: {size} ms "
            f"{'early' if lag > 0 else 'late'} against velocities and torques alike, which are in "
            "time with each other: it is the positions"
        )
        remedy = f"shift the positions by {size} ms, or log all channels by one clock"
        return replace(finding, meaning=text, remedy=remedy, where=positions)

    def _swings(self, channels: Sequence[str]) -> bool:
        """Whether torques that are 0 throughout are those of joints that swing freely: gravity and
        inertia of known bodies cancel, but for a small share of gravity.
        """
        problem, table, x = self.problem, self.table, self.estimate.x
        mechanism, independent = problem.mechanism, problem.motion.independent
        pi = problem.point_at(x).pi
        known = np.setdiff1d(np.arange(len(mechanism.prior)), problem.columns.rigid)
        if not mechanism.prior[known].any():  # unknown bodies alone may be 0, as torques are
            return False
        for joint in (channel.removeprefix("tau.") for channel in channels):
            at = mechanism.driven.index(joint)
            zero = not any(np.any(e.tau[:, at]) for e in problem.motion.experiments)
            if joint not in independent or not zero:
                return False
            u, squares = independent.index(joint), list[Array]()
            for scene in table.scenes:
                e, s = scene.e, scene.samples.reduced(slice(None))
                weight = rigid_forces(scene.mechanism.model, e.q, 0 * e.v, 0 * e.a, pi)
                squares.append(s.reduce(weight)[:, u] ** 2)
            rows = self.use[:, u]
            residual = table.b[rows, u] - table.A[rows, u] @ x
            gravity = float(np.sqrt(np.mean(np.concatenate(squares))))
            if not rows.any() or np.sqrt(np.mean(residual**2)) > EXPLAINED_BELOW * gravity:
                return False
        return True

    @property
    def bias(self) -> Array:
        """By how much the unknowns (k,) would change without the faults that are named, or without
        rows that fit worse: a bias that the scatter of residuals does not show.
        """
        if not (trials := self.faults[0]):
            return self.moved_at_reversals
        fault, equations = trials[-1].fault, trials[-1].equations.with_effects(())
        free, size = ~self.estimate.fixed, self.estimate.triangle.column_norms()
        change = np.zeros(len(self.estimate.x))
        change[free] = equations.solution(fault, equations.noise(fault)) - self.estimate.x[free]
        # an unknown of no effect is open
        return np.where(size > ABSENT * size.max(initial=0.0), change, 0.0)

    @property
    def moved_at_reversals(self) -> Array:
        """The same without rows at reversals alone."""
        calm = self.calm_rows | (self.misfit <= small_errors.WORSE)
        return small_errors.moved_by_rows(self.table, calm, self.estimate)[0]

    @cached_property
    def at_limits(self) -> Array:
        """Covariance (n_ind, n_ind) by which torques that stay at their limits widen the errors:
        what all other rows leave open, and the bias against them.
        """
        clear = small_errors.clear_of_limits(self.table)
        faint = small_errors.CLIPPED_WEIGHT
        change, cov = small_errors.moved_by_rows(self.table, clear, self.estimate, faint)
        bias = self.estimate.base.combined(change)
        return np.asarray(cov + np.outer(bias, bias))

    @cached_property
    def misfit(self) -> Array:
        """(d,) squared residual of a row at reversals over that of a row elsewhere, or 0."""
        return small_errors.misfit_at_reversals(self.table, self.calm_rows, self.estimate.x)

    def reversals(self) -> Iterator[Finding]:
        """Report joints whose dry friction is not its sign at reversals."""
        names = zip(self.problem.motion.independent, self.misfit, strict=True)
        worse = tuple(name for name, times in names if times > small_errors.WORSE)
        if worse and not self.faults[0]:
            most = two_digits(np.sqrt(self.misfit.max()))
            text = (
                f"{', '.join(worse)}: near reversals the error is up to {most} times larger: real "
                "friction does not jump; ± include this"
            )
            remedy = "a diagnosis names friction that builds up over speed"
            yield Finding(
                "reversals", text, remedy, worse, float(self.misfit.max()), small_errors.WORSE
            )

    def _late(self) -> Iterator[Finding]:
        """Report a delay of some milliseconds that all torques have in common, unless the effects
        that a diagnosis found explain more, or another cause leaves most of the error of a bad fit.
        """
        if self.mechanism.drives:  # torques that drives supply have a delay of their own
            return
        good = max(self.errors.values(), default=0.0) < DOUBT
        if good and not small_errors.delay_shows(self.estimate, self.table, self.use):
            return
        late = small_errors.common_delay(self.estimate, self.table, self.use, self.common)
        if late is None or (not good and late.after > MAIN_CAUSE * late.before):
            return
        if 2 * np.log(late.after) < np.log(self._unexplained).mean():
            names = self.mechanism.driven
            text = (
                f"all torques are {abs(1e3 * late.delay):.3g} ± {1e3 * late.stderr:.2g} ms "
                f"{'late' if late.delay > 0 else 'early'} against the positions (two clocks, or a "
                "filter of that time constant on one of them): with one common delay the error of "
                f"time left out falls from {percent(late.before)} to {percent(late.after)}"
            )
            effect = f"delay:{','.join(names)}"
            remedy = f"shift the columns, or give --with {effect}"
            where = tuple(f"tau.{name}" for name in names)
            yield Finding("delay", text, remedy, where, 1e3 * late.delay, effects=(effect,))

    def _torques_of_another_log(self, noise: Array) -> list[Finding]:
        varies = self.varying.any(axis=0)
        noise = np.where(varies, noise, np.minimum(noise, EXPLAINED_BELOW))
        names = (
            [f"tau.{name}" for name in self.equations.torques_of_another_log(noise)]
            if noise.any()
            else []
        )
        if not names or self.reference[varies].max() <= EXPLAINED_BELOW:
            return []
        text = (
            f"{', '.join(names)}: explained no better by this motion than at another time of the "
            "log: they are of another run, of another joint, or no measurement"
        )
        return [Finding("another run", text, "check columns and files", tuple(names))]

    def poor(
        self, noise: Mapping[str, float] | None = None, calm: Mapping[str, float] | None = None
    ) -> Iterator[Finding]:
        """Report torques of which EXPLAINED_BELOW is left, DOUBT where sensors leave less, or FAR
        times what these leave.

        Args:
            noise: rms by joint of noise of any colour [N m | N], for FAR; default: white noise.
            calm: rms away from reversals of joints with dry friction [N m | N].
        """
        problem, x, names = self.problem, self.estimate.x, self.problem.motion.independent
        errors = np.array([self.errors[name] for name in names])
        if errors.max(initial=0.0) < MATERIAL or not self.use.any():
            return
        sizes = [t.residual_norm(x) / np.sqrt(max(t.rows, 1)) for t in problem.information.totals]
        states, cutoff = problem.motion.experiments, problem.motion.band.cutoff
        white = noise_floor(problem.mechanism, states, problem.point_at(x), cutoff)
        beyond = np.array(sizes) / np.maximum(white, 1e-150)  # over what noise of the sensors makes
        floor = white if noise is None else np.array([noise[name] for name in names])
        bad = errors > EXPLAINED_BELOW
        far = np.zeros_like(bad)
        if not problem.motion.poses:  # of which friction at rest makes most, not noise of sensors
            bad |= (errors > DOUBT) & (beyond > BEYOND)
            both = zip(names, sizes, strict=True)
            calm_sizes = np.array([min((calm or {}).get(name, size), size) for name, size in both])
            far = (errors > MATERIAL) & (calm_sizes > FAR * np.maximum(floor, 1e-150))
            bad |= far
        if not bad.any():
            return
        where = tuple(f"tau.{name}" for name, x in zip(names, bad, strict=True) if x)
        worst, most = errors[bad].max(), np.argsort(-errors[bad])
        largest_errors = shortlist([f"{percent(errors[bad][i])} of {where[i]}" for i in most], 2)
        least = ", far more than noise of the sensors makes" if worst < EXPLAINED_BELOW else ""
        if self.faults[0]:
            why = ": what is named above explains it"
        else:
            why = (
                f" (with all linear effects {percent(self.reference[bad][most[0]])}): an effect is "
                "missing, or data, a length or a known body is wrong"
            )
            spoilt = worst > EXPLAINED_BELOW or far.any()
            why += "; parameters are not to be trusted, whatever their ±" if spoilt else ""
        text = f"the model leaves {largest_errors}{least}{why}"
        threshold = EXPLAINED_BELOW if worst > EXPLAINED_BELOW else FAR if far.any() else DOUBT
        remedy = "ident diagnose shows where it fails"
        yield Finding("poor fit", text, remedy, where, None, threshold)

    def _magnitudes(self) -> Iterator[Finding]:
        """Report torques of another size or shape than the URDF's bodies need: a hint, for a URDF
        may be wrong; but a fault where factors of several torques explain the log.
        """
        columns, table, gains = self.problem.columns, self.table, dict[str, float]()
        if not self.mechanism.prior.any() or self.mechanism.has_dummy_bodies:
            return  # a URDF without masses needs no torque, and placeholders need any
        if self.mechanism.drives:  # torques are those of stated gains: no column has another unit
            return
        turned = dict[str, float]()  # torques of the URDF's shape with the other sign
        scaled = dict[str, tuple[float, float]]()  # and another size: with how many times that
        # least correlation of the torques of `gains` with what the URDF's bodies need
        correlation = 1.0
        rigid = np.arange(len(columns)) < len(columns.rigid)
        common_columns = [table.effect_columns(effect, [{}]) for effect in self.common]
        for u, name in enumerate(self.problem.motion.independent):
            rows = self.varying[:, u]
            if name not in self.mechanism.driven or not rows.any():
                continue
            tau = table.tau[rows, u]
            if not tau.any():  # no measurement has a shape
                continue
            A, known = table.A[rows, u], tau - table.b[rows, u]  # of known bodies
            then, now = (A[:, rigid] @ x[rigid] + known for x in (columns.prior, self.estimate.x))
            sizes = [float(np.linalg.norm(x)) for x in (now, then)]
            X = columns_of(table, ~rigid, common_columns, u)[rows]  # friction and rotors
            fitted, needed, logged = (
                x - X @ np.linalg.lstsq(X, x, rcond=None)[0] for x in (now, then, tau)
            )
            like = max(_cosine(now, then), _cosine(fitted, needed))  # bodies may stand in for those
            if np.linalg.norm(needed) > SMALL * sizes[1] and (c := _cosine(needed, logged)) > LIKE:
                gains[name] = float(needed @ logged / (needed @ needed))
                correlation = min(correlation, c)
            many = self.estimate.triangle.rows > FEWEST_EQUATIONS * self.estimate.base.rank
            least = EXPLAINED_BELOW * float(np.linalg.norm(tau))
            if not (many and sizes[0] > least and self.errors[name] < EXPLAINED_BELOW):
                continue
            if like < -LIKE and sizes[1] <= least:
                scaled[f"tau.{name}"] = like, sizes[0] / max(sizes[1], 1e-300)
            elif like < -LIKE:
                turned[f"tau.{name}"] = like
            elif like < UNLIKE and sizes[1] > least:
                text = (
                    f"tau.{name}: the bodies that were identified need a torque of another shape "
                    f"than the URDF's (correlation {like:.2f}): gravity, the zero or sign of a "
                    "position or a unit of time is wrong, unless its masses are no real ones"
                )
                remedy = "check gravity, q.… and t against the machine"
                yield Finding("unlike", text, remedy, (f"tau.{name}",), like, UNLIKE)
        times = np.log([x for _, x in scaled.values()])
        if len(scaled) > 1 and np.ptp(times) < np.log(BEYOND):  # in another unit; one: a guess
            turned |= {name: like for name, (like, _) in scaled.items()}
        if turned:
            yield self._turned(turned)
        logs = np.log(list(gains.values()))
        one = len(gains) > 1 and np.ptp(logs) < SAME and correlation > SAME_SHAPE
        # of poses every torque is gravity's, of whatever size: only a unit is told from masses
        least = OTHER if one and not self.problem.motion.poses else BEYOND
        far = {name: x for name, x in gains.items() if max(x, 1 / x) > least}
        several = 2 * len(far) >= len(self.use.T) and len({x > 1 for x in far.values()}) == 1
        if several and len(far) > 1 and (fall := self._scaled_alike(gains)):
            yield self._magnitude("units", gains, BEYOND, fall)
        elif several and len(far) == len(gains):
            yield self._magnitude("magnitude", far, least)
        else:
            alone = ({name: x} for name, x in far.items() if max(x, 1 / x) > TIMES)
            yield from (self._magnitude("magnitude", effect, TIMES) for effect in alone)

    def _turned(self, turned: Mapping[str, float]) -> Finding:
        """Return a finding on torques with the other sign, by channel with the correlation."""
        worst = max(turned.values())
        text = (
            f"{listed(turned)}: the bodies that were identified need a torque of another shape "
            f"than the URDF's, its negative (correlation {worst:.2f}): the sign of these torques, "
            "or of gravity, is wrong, unless its masses are no real ones"
        )
        entry = log_entry(self.mechanism, next(iter(turned)), -1.0)
        gravity = ", ".join(f"{-x or 0:g}" for x in self.mechanism.model.gravity.linear)
        remedy = (
            f"write {entry}, and the same of all torques that have this sign, most likely all; or, "
            f"where the base hangs the other way up, gravity = [{gravity}] at the top of "
            "mechanism.toml"
        )
        return Finding("unlike", text, remedy, tuple(turned), worst, -LIKE)

    def _scaled_alike(self, gains: Mapping[str, float]) -> tuple[float, float] | None:
        """Return the errors without and with torques over their gains, if that explains them."""
        equations = self.equations
        factors = {equations.driven.index(name): 1 / x for name, x in gains.items()}
        scaled = equations.as_logged.replaced("scale", gain=factors)
        rows, both = equations.rows_of(scaled), (equations.as_logged, scaled)
        before, after = (float(np.exp(np.log(equations.noise(x)[rows]).mean())) for x in both)
        explained = credible(before, DOUBT, remaining=after, most=MAIN_CAUSE * before)
        return (before, after) if explained else None

    def _magnitude(
        self, code: str, gains: Mapping[str, float], least: float,
        fall: tuple[float, float] | None = None,
    ) -> Finding:  # fmt: skip
        """Return a finding on gains by joint: a fault with the fall of the error, else a hint."""
        where, sizes = tuple(f"tau.{name}" for name in gains), [*gains.values()]
        several = len(where) == len(self.mechanism.driven) > 2
        ends = dict.fromkeys(two_digits(x) for x in (min(sizes), max(sizes)))
        text = (
            f"{'all torques' if several else ', '.join(where)}: {' to '.join(ends)} times what the "
            "URDF's bodies need, and of the same shape"
        )
        if fall is None:
            gain = float(np.exp(np.mean(np.log(sizes))))
            text += (
                ": a unit, a gear ratio or a torque constant, a wrong unit of time, length or "
                "gravity, unless its masses are no real ones"
            )
            remedy = log_entry(self.mechanism, where[0], exact_factor(float(f"{1 / gain:.2g}")))
            remedy += ", all alike" if len(where) > 1 else ""
            return Finding(code, text, remedy, where, gain, least)
        text += (
            ", by a factor of its own each: currents without their torque constants, or another "
            f"unit? Scaled, the error of the predicted torque falls from {percent(fall[0])} to "
            f"{percent(fall[1])}"
        )
        sources = [self.mechanism.columns.get(item) for item in where]
        constants = [(s.scale if s else 1.0) / x for s, x in zip(sources, sizes, strict=True)]
        about = ", ".join(f"{n} {two_digits(x)}" for n, x in zip(gains, constants, strict=True))
        entry = log_entry(self.mechanism, where[0], float(f"{1 / sizes[0]:.2g}"))
        remedy = f"give each its torque constant, about {about}, as {entry}"
        return Finding(code, text, remedy, where, min(sizes), least)


def _cosine(x: Array, y: Array) -> float:
    return float(x @ y) / max(float(np.linalg.norm(x) * np.linalg.norm(y)), 1e-300)
