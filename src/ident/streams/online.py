"""Identification while samples come: the equations and triangles of a batch, a fixed lag later.

An old equation counts less (`streams/stream.py`). A parameter that no row determines any more stays
at its last value, and its standard error grows by

    exp(Δt/2T)        the root of what an equation's weight exp(−Δt/T) leaves of its information

Standard errors hold errors of the calibration as those of a fit do (`fit.calibration`), which are
fitted within their priors. That budget is made where a snapshot is asked for, of samples that are
kept (`streams.excerpt`), and made anew where a share NEW of the equations is new.

The closures' forces at a sample follow from all of its rows A x = b, without the measured torques
of the independent joints; C is the covariance of the base parameters, σ_s the noise of a further
drive s. What torques do not determine stays at its prior: λ may depend on it, unseen.

    λ = K⁺ᵀ_λ (b − A x),     Var λ = G C Gᵀ + Σ_s (K⁺ᵀ_λ W_s)² σ_s²,     G = −K⁺ᵀ_λ A_I
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ident.display import Displayed, render
from ident.equations.motion_noise import noise_floor
from ident.equations.problem import plausible_of
from ident.equations.rows import Rows, Scene, row_supports
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, IdentError, LogError, MotionError, one_of
from ident.faults.data_checks import TIMES
from ident.finding import Finding
from ident.fit import Fit, identify
from ident.fit.calibration import Budget
from ident.fit.prediction import identifiable_multipliers
from ident.fit.shapes import working_point
from ident.fit.values import BaseValue, ParameterValues, Value, with_noise
from ident.information.blocks import Error, Information, Squares
from ident.information.chance import covariance, prior_covariance
from ident.information.estimate import Estimate, estimate
from ident.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.motion.spline import noise_level
from ident.streams.excerpt import NEW, SampleExcerpt, budget_of_samples
from ident.streams.samples import DataWatch, Sample, SampleParser, Since, log_of
from ident.streams.stream import (
    LATENCY,
    Accumulator,
    SampleWindow,
    Stream,
    check_causal,
    with_free_multipliers,
)  # fmt: skip

WARMUP = 5.0  # range: [s] from which a stream learns what it is like
MOVING_NOISE, FEWEST_TO_TELL = (
    3.0,
    10,
)  # level: times its noise that a position varies, in so many samples
LONGEST = 100_000  # work: samples that a warm-up keeps at most
CHECKED = 20.0, 5000  # work: s, samples from the beginning, in which errors are looked for


@dataclass(frozen=True, eq=False, repr=False)
class Forces(Displayed):
    """Multipliers λ of n samples."""

    names: tuple[str, ...]  # (m,)
    units: tuple[str, ...]  # (m,)
    t: np.ndarray  # (n,) [s]
    values: np.ndarray  # (n, m) [N | N m], NaN where a multiplier is not determined
    stderr: np.ndarray  # (n, m)

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, eq=False)
class Solved:
    """The unknowns of all rows by now.

    Attributes:
        values: with the covariance of noise and calibration, errors of which are fitted.
        by_noise: (n, n) what noise makes of that covariance.
        logged: values that predict the torques as they are logged, with errors by noise.
        budget: of the calibration; None where it is exact.
    """

    values: ParameterValues
    by_noise: np.ndarray
    logged: ParameterValues
    budget: Budget | None = None

    @property
    def base(self) -> tuple[BaseValue, ...]:
        """The base parameters."""
        noise = replace(self.values, cov=self.by_noise)
        return with_noise(self.values.base, noise.base, self.logged.base)

    def parameters(self, mechanism: Mechanism, point: Point) -> tuple[Value, ...]:
        """Return unknown dynamic parameters, then those of effects, linear about a point."""
        noise, every = replace(self.values, cov=self.by_noise), []
        for values in (self.values, noise, self.logged):
            at = point.at(mechanism, values.columns, values.estimate.x)
            of_effects = [v for effect in values.effects(at) for v in effect.parameters]
            unknown = [v for v in of_effects if v.name in values.columns.index]
            every.append((*values.rigid(mechanism), *unknown))
        return with_noise(*every)

    def shares(self, name: str, mechanism: Mechanism) -> dict[str, float]:
        """Return the share of each cause, and of `noise`, in the variance of a value; none of one
        that the rows do not determine.
        """
        gradient = self.values.gradient(name, mechanism)
        if gradient is None or not np.isfinite(self.values.cov).all():
            return {}
        if self.budget is None:
            return {"noise": 1.0}
        return self.budget.shares(gradient, self.by_noise, self.budget.parts)


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot(Displayed):
    """Parameters, reaction forces and errors after some samples. Made by `Online.snapshot`.

    Attributes:
        t: of the last sample whose equations are in it [s].
        samples: how many have come; rows: how many equations a coordinate count, old ones less.
        parameters: unknown dynamic parameters, then those of effects. One that is not identifiable
            stays at its prior or, where it was known and its information is forgotten, at its last
            value, with a standard error that grows. `stderr` is of noise and calibration,
            `stderr_noise` of noise alone.
        base_parameters: the combinations that the rows determine.
        held: names of the parameters that are held at their last value.
        multipliers: λ of the last sample; none for a tree.
        errors: by joint, of the rows that count, with these parameters.
        noise: by joint, the rms that noise of the sensors alone would leave [N m | N].
        rank: number of base parameters; condition_number: of their columns.
        lag: by how much `t` is behind the last sample at most [s].
        mechanism: whose parameters these are; solved: the estimate behind them, with its budget.
        notes: what a person should know.
    """

    t: float
    samples: int
    rows: float
    parameters: tuple[Value, ...]
    base_parameters: tuple[BaseValue, ...]
    held: tuple[str, ...]
    multipliers: Forces | None
    errors: Mapping[str, Error]
    noise: Mapping[str, float]
    rank: int
    condition_number: float
    lag: float
    mechanism: Mechanism
    solved: Solved
    notes: tuple[str, ...] = ()

    @property
    def budget(self) -> Budget | None:
        """The error budget; None where the calibration is exact."""
        return self.solved.budget

    def shares(self, name: str) -> dict[str, float]:
        """Return the share of each cause of calibration errors, and of `noise`, in the variance of
        a parameter or base parameter by its `name`; as `Fit.shares`.
        """
        if name not in {value.name for value in self.base_parameters}:
            self[name]
        return self.solved.shares(name, self.mechanism)

    def __getitem__(self, name: str) -> Value:
        """Return a parameter by its name."""
        by_name = {value.name: value for value in self.parameters}
        if name not in by_name:
            raise KeyError(f"no parameter '{name}'; {one_of(name, by_name)}")
        return by_name[name]

    @property
    def identified(self) -> tuple[Value, ...]:
        """The parameters that the data determine, or did."""
        return tuple(v for v in self.parameters if v.identifiable or v.name in self.held)

    @property
    def line(self) -> str:
        """Identified parameters, multipliers and errors in one line."""
        return str(render(self, "line"))


class Online:
    """Identifies a mechanism sample by sample, in constant memory.

    The equations are those of `identify` with the estimator least-squares. Where nothing is
    filtered and positions, velocities and accelerations are given, parameters are the same after
    every sample; else they are a fixed lag late. Errors of the data are looked for once in the
    first 20 s or 5000 samples, as `identify` does; standard errors hold what a named one does, and
    errors of the calibration.

    Args:
        mechanism: with what is unknown and which effects it has.
        like: a motion of the same machine, or a fit, from which is taken what a batch chooses from
            the whole log: the filter, smoothing, speeds of standstill; and values of shapes, which
            are held. Without it the first seconds are kept and looked at; they count like all
            others, and should show the machine moving as it will.
        forget: time constant [s] after which an equation counts e times less; None: all count
            alike.
        latency: how long samples may wait for others [s]: rows are made faster together. Those of
            a tree, whose results are seen in snapshots alone, wait 0.5 s or for the next snapshot.
        warmup: how many seconds are looked at where `like` is not given.
        cutoff, smoothing: as `complete` takes them, where `like` is not given.

    Raises:
        FitError: for an effect that cannot be evaluated sample by sample, or a time that is none.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        *,
        like: Motion | Fit | None = None,
        forget: float | None = None,
        latency: float = LATENCY,
        warmup: float = WARMUP,
        cutoff: float | str | None = "auto",
        smoothing: float | str | None = "auto",
    ) -> None:
        check_causal(mechanism)
        for name, value in {"latency": latency, "warmup": warmup, "forget": forget}.items():
            least, above = (0.0, "") if name == "latency" else (1e-9, ", above 0")
            if value is not None and not least <= value < np.inf:
                raise FitError(f"{name} {value:g}; valid: a time in seconds{above}")
        self.mechanism, notes = with_free_multipliers(mechanism)
        self.notes = tuple(notes)
        self._T, self._latency, self._warmup = forget, latency, warmup
        self._cutoff, self._smoothing = cutoff, smoothing
        reads = [name for effect in mechanism.effects for name in effect.reads()]
        self._parser = SampleParser(mechanism.name, mechanism.sources, None, reads)
        self._first: list[np.ndarray] = []  # samples of the warm-up
        self._resting = 0  # samples before the machine moved
        self._stream: Stream | None = None  # after the warm-up
        # values of unknowns, squares that they leave, parameters and those of effects, at the last
        self._solved: tuple[Solved, Squares, tuple[Value, ...]] | None = None
        # the last one, of which base parameters and when [s]; and why there is none
        self._budget: tuple[Budget | None, tuple[int, ...], float] | None = None
        self._no_budget = ""
        self.left_out: list[tuple[int, str]] = []  # (row, why) of samples of the last `update`
        self.findings: list[Since] = []  # new ones
        self._early: list[np.ndarray] | None = []  # samples not yet looked at for errors
        self._early_count = 0  # samples of these
        self._bias: np.ndarray | None = None  # of the unknowns, by errors that are named
        self._reference = like if isinstance(like, Fit) else None  # until errors were looked for
        if like is not None:
            self._begin(like)

    @property
    def samples(self) -> int:
        """How many have come."""
        since = self._stream.samples if self._stream else sum(map(len, self._first))
        return self._resting + since

    @property
    def warm(self) -> bool:
        """Whether the warm-up is over."""
        return self._stream is not None

    @property
    def t(self) -> float:
        """Time of the last sample [s]; NaN before the first."""
        last = self._stream.t if self._stream else self._parser.last
        return last if np.isfinite(last) else float("nan")

    @property
    def lag(self) -> float:
        """By how much equations are behind the last sample at most [s]; NaN in the warm-up."""
        return self._stream.lag if self._stream else float("nan")

    @property
    def multipliers(self) -> Forces | None:
        """λ of the samples that the last `update` or `snapshot` completed, by the parameters of the
        last snapshot; None before the first one, for a tree, and where none was completed.
        """
        return self._forces(self._stream, self._stream.windows) if self._stream else None

    def update(self, sample: Sample) -> None:
        """Take a sample or a block of them.

        Args:
            sample: numbers, or arrays (n,), by column, under this robot's own names or ident's:
                `t`, `q.<joint>`, `tau.<joint>`, …; or a `Log`.

        Samples of a block that are not whole, absurd or not later than those before are left out:
        `left_out` has their rows and why.

        Raises:
            LogError: for one sample that is left out; others may follow.
            MotionError: if the first seconds do not determine the motion.
        """
        if self._stream is not None:
            stream = self._stream
            self._absorb(stream, stream.push(sample))
            self.left_out = stream.left_out
            self._judge(stream, stream.last)
            return
        X = self._parser(sample)
        self.left_out = self._parser.left_out
        if not len(X):
            return
        self._first.append(X)
        full = sum(map(len, self._first)) >= LONGEST
        if (full or self.t - self._first[0][0, 0] >= self._warmup) and self._moving():
            self._start()

    def _moving(self) -> bool:
        """Leave out what comes before the machine moves; whether the rest makes a warm-up."""
        X, names = np.concatenate(self._first), self._parser.columns
        channels = [i for i, name in enumerate(names) if name.startswith(("q.", "v."))]
        while len(X) >= LONGEST or (len(X) and X[-1, 0] - X[0, 0] >= self._warmup):
            part = X[:, 0] <= X[0, 0] + self._warmup / 5
            channel_samples = X[part][:, channels].T
            if part.sum() < FEWEST_TO_TELL or any(
                np.std(x) > MOVING_NOISE * noise_level(x) for x in channel_samples
            ):
                return True
            X, self._resting = X[~part], self._resting + int(part.sum())
            self._first = [X] if len(X) else []
        return False

    def snapshot(self) -> Snapshot:
        """Return parameters, multipliers and errors by now; this ends a warm-up.

        Raises:
            FitError: if no equation is known yet.
            LogError, MotionError: if the samples so far do not determine the motion.
        """
        stream = self._stream or self._start()
        self._absorb(stream, stream.flush())
        return self._snapshot_of(stream)

    def finish(self) -> Snapshot:
        """Return the snapshot of all samples: what waits for later ones is not waited for.

        Samples that come after it begin a new run, as after a gap.

        Raises:
            FitError, LogError, MotionError: as `snapshot`.
        """
        stream = self._stream or self._start()
        self._absorb(stream, stream.flush(last=True))
        self._judge(stream, stream.last[:0], ended=True)
        self._budget = None
        return self._snapshot_of(stream)

    def _judge(self, stream: Stream, X: np.ndarray, ended: bool = False) -> None:
        """Look for errors of the data in further samples (n, columns); `ended`: no more come."""
        self.findings, mechanism = [], stream.mechanism
        self._kept.add(X)
        if self._early is not None:  # once, what `identify` says of the first samples
            self._early += [X] if len(X) else []
            self._early_count += len(X)
            long = len(X) and X[-1, 0] - self._early[0][0, 0] >= CHECKED[0]
            full = self._early_count >= CHECKED[1] or long
            if self._early_count and (ended or full):
                early, self._early = np.concatenate(self._early)[: CHECKED[1]], None
                with suppress(IdentError):  # too few: the stream says what it lacks
                    log = log_of(mechanism.name, stream.columns_of_samples, early)
                    motion = complete(mechanism, log)
                    fit = identify(mechanism, motion, estimator="least-squares")
                    self._bias = fit.checks.bias
                    findings = (*filter(self._is_new, fit.health.findings), *fit.checks.poor())
                    self.findings = self._watch.note(findings, float(early[0, 0]))
                self._reference = None
        states = [e.at_samples(inside) for e, inside in stream.windows]
        self.findings += self._watch.add(X, states, ended)

    def _is_new(self, finding: Finding) -> bool:
        """Whether a finding is none that a load may make of torques whose unit fits the reference:
        a machine that carries more needs other torques than the URDF's bodies.
        """
        if finding.code != "magnitude" or finding.number is None or self._reference is None:
            return True
        fitting = not any(
            finding_before.code == "magnitude" for finding_before in self._reference.health.findings
        )
        return not fitting or max(finding.number, 1 / finding.number) > TIMES

    def _snapshot_of(self, stream: Stream) -> Snapshot:
        solved, squares, parameters, outdated = self._solve(stream)
        joints, (lost, reason) = stream.recipe.independent, stream.lost
        left_out = [f"{lost} samples are left out, the last since {reason}"] if lost else []
        left_out += [self._no_budget] if self._no_budget else []
        if self._resting:
            left_out += [f"{self._resting} samples before the machine moved are left out"]
        units = [stream.mechanism.joint(name).force_unit for name in joints]
        return Snapshot(
            t=self._accumulator.now,
            samples=self.samples,
            rows=float(squares.all_rows[2].mean()),
            parameters=tuple(parameters),
            base_parameters=solved.base,
            held=tuple(outdated),
            multipliers=self._forces(stream, [self._last] if self._last else []),
            errors=squares.errors(joints, units),
            noise=dict(zip(joints, self._floor.tolist(), strict=True)),
            rank=solved.values.estimate.base.rank,
            condition_number=solved.values.estimate.base.condition_number,
            lag=stream.lag,
            mechanism=stream.mechanism,
            solved=solved,
            notes=(*self.notes, *map(str, self._watch.known.values()), *left_out),
        )

    def _start(self) -> Stream:
        """End the warm-up: look at its samples as at a whole log, and take them like all others."""
        if not self._first:
            what = f"nothing moved in {self._resting} samples" if self._resting else "no sample yet"
            raise LogError(f"{self.mechanism.name}: {what}; give `update` some in which it moves")
        X = np.concatenate(self._first)
        try:
            log = log_of(self.mechanism.name, self._parser.columns, X)
            like = complete(self.mechanism, log, cutoff=self._cutoff, smoothing=self._smoothing)
        except LogError as error:  # not of one sample
            raise MotionError(str(error)) from None
        self.notes = (*self.notes, *like.notes)
        stream = self._begin(like)
        self._absorb(stream, stream.push(log))
        self._judge(stream, stream.last)
        self._first = []
        return stream

    def _begin(self, like: Motion | Fit) -> Stream:
        """Make the stream of rows and the triangles that absorb it, as in a motion or a fit."""
        motion: object = like.motion if isinstance(like, Fit) else like
        if not isinstance(motion, Motion):
            raise FitError(
                f"like needs a motion or a fit, given: {type(like).__name__}; write "
                "like=ident.complete(mechanism, log)"
            )
        fit = like if isinstance(like, Fit) else None
        self._repeated = fit.repeated if fit else None
        point = working_point(self.mechanism, motion, fit.point if fit else None)
        mechanism = _with_known_shapes(self.mechanism, point)
        columns, first = Columns.of(mechanism), motion.experiments[0]
        tree = not mechanism.closures  # without forces to be seen after each call
        stream = Stream(mechanism, columns, motion, point, self._latency, on_demand=tree)
        supports = row_supports(mechanism, columns, first)
        self._accumulator = Accumulator(supports, self._T, stream.period)
        self._determined = identifiable_multipliers(mechanism, motion)
        self._noise = [first.noise.get(f"tau.{name}", 0.0) for name in mechanism.driven]
        self._floor = noise_floor(mechanism, motion.experiments, point, motion.band.cutoff)
        self._known: dict[str, tuple[Value, float]] = {}  # identified parameters, and when [s]
        self._most = 0  # base parameters that were known at once
        self._last: SampleWindow | None = None
        self._watch = DataWatch(mechanism, motion, stream.columns_of_samples)
        self._like, cutoff = replace(motion, experiments=(), logs=()), motion.band.cutoff
        self._kept = SampleExcerpt(first.rate, cutoff, self._T)
        self._stream = stream
        return stream

    def _absorb(self, stream: Stream, parts: Sequence[Rows]) -> None:
        if windows := stream.windows:
            e, inside = windows[-1]
            self._last = e, slice(inside.stop - 1, inside.stop)
        for rows in parts:
            self._accumulator.absorb(rows)

    def _solve(self, stream: Stream) -> tuple[Solved, Squares, list[Value], list[str]]:
        """Return the unknowns, squares that they leave, parameters, and the names of those that are
        held at their last value: all of them if no row informed lately.
        """
        old, now = self._solved, self._accumulator.now
        informed = not (old and self._T and now - self._accumulator.informed > self._T)
        if old is None or informed:
            mechanism, columns = stream.mechanism, stream.columns
            total = self._accumulator.information(len(columns))
            # what is forgotten stays where it was
            prior = old[0].logged.estimate.x if old and self._T else columns.prior
            sensible = plausible_of(mechanism, columns, total)
            fitted = estimate(total.totals, prior, total.rms_torque, sensible)
            solved = self._with_errors(stream, total, fitted, sensible)
            parameters = solved.parameters(mechanism, stream.point)
            old = self._solved = solved, total.squares(fitted.x), parameters
        solved, squares, current = old
        rank = solved.values.estimate.base.rank
        values, outdated = list[Value](), list[str]()
        if informed and rank >= self._most:  # as much is known as ever: none is lost
            self._most, self._known = rank, {}
        for value in current:
            if value.identifiable and informed:
                self._known[value.name] = value, now
            elif self._T and value.name in self._known:
                last, t = self._known[value.name]
                growth = float(np.exp((now - t) / (2 * self._T)))
                stderr, of_noise = (growth * (x or 0.0) for x in (last.stderr, last.stderr_noise))
                value = replace(last, stderr=stderr, stderr_noise=of_noise, identifiable=False)
                outdated.append(value.name)
            values.append(value)
        return solved, squares, values, outdated

    def _with_errors(
        self, stream: Stream, total: Information, fitted: Estimate, sensible: np.ndarray
    ) -> Solved:
        """Return an estimate by all rows with its errors, as `Fit` has them."""
        seconds, again = total.rows / total.d * stream.period, self._repeated
        by_priors, bias = prior_covariance(fitted, sensible), np.zeros(fitted.base.rank)
        if self._bias is not None:
            bias = fitted.base.combined(self._bias)
        scatter = covariance(total, fitted) + by_priors
        wider = 1.0 if again is None else again.variance(seconds)
        logged = ParameterValues(stream.columns, fitted, scatter * wider + np.outer(bias, bias))
        budget = self._budget_by_now(stream, total, fitted)
        if budget is None:
            return Solved(logged, logged.cov, logged)
        wider = 1.0 if again is None else again.with_less(budget.remaining).variance(seconds)
        by_noise = budget.noise * wider + by_priors + np.outer(bias, bias)
        x = fitted.x.copy()
        x[fitted.base.independent] += budget.shift
        cov = by_noise + budget.parts @ budget.parts.T
        values = ParameterValues(stream.columns, fitted.at(x), cov)
        return Solved(values, by_noise, logged, budget)

    def _budget_by_now(self, stream: Stream, total: Information, fitted: Estimate) -> Budget | None:
        """Return the budget of all rows by now, or the last one where few of them are new."""
        now, base = self._accumulator.now, tuple(fitted.base.independent.tolist())
        if self._budget is not None:
            last, of_base, t = self._budget
            if of_base == base and (now - t) * total.d < NEW * total.rows * stream.period:
                return last
        budget, self._no_budget = None, ""
        try:
            budget = budget_of_samples(stream, self._like, self._kept, total, fitted)
        except (IdentError, np.linalg.LinAlgError) as error:
            text = f"errors of the calibration are not in the standard errors: {error}"
            self._no_budget = text
        self._budget = budget, base, now
        return budget

    def _forces(self, stream: Stream, windows: Sequence[SampleWindow]) -> Forces | None:
        """λ of the samples of some windows by the last solution; None where there is none."""
        mechanism, cutoff = stream.mechanism, stream.recipe.band.cutoff
        if self._solved is None or not mechanism.closures or not windows:
            return None
        solved, kinematics = self._solved[0], mechanism.kinematics
        x, cov = solved.logged.estimate.x, solved.values.cov
        base, m, parts = solved.logged.estimate.base, len(kinematics.multipliers), []
        for around, part in windows:
            scene = Scene.of(mechanism, stream.columns, around, stream.point, cutoff)
            e, equations, s = scene.e, scene.terms(part, full=True), scene.samples.generalised(part)
            K_T = e.pinv[part, :, :m].transpose(0, 2, 1)
            b = equations.b - s.measured(e.independent)
            values = np.einsum("nmi,ni->nm", K_T, b - equations.A @ x)
            G = -K_T @ equations.A[:, :, base.independent]
            variance = np.einsum("nmi,ij,nmj->nm", G, cov, G)
            for name, sigma in zip(mechanism.driven, self._noise, strict=True):
                if name not in e.independent and sigma > 0:
                    W = np.zeros(s.shape)
                    s.add_torque(W, name, np.ones(len(s)))
                    variance += (np.einsum("nmi,ni->nm", K_T, W) * sigma) ** 2
            parts.append((e.t[part], values, np.sqrt(variance)))
        t, values, stderr = (np.concatenate(series) for series in zip(*parts, strict=True))
        open_ = np.where(self._determined, 0.0, np.nan)
        return Forces(kinematics.multipliers, kinematics.units, t, values + open_, stderr + open_)


def _with_known_shapes(mechanism: Mechanism, point: Point) -> Mechanism:
    """Hold all shape parameters at their values in `point`; FitError for one without a value."""
    effects = []
    for effect in mechanism.effects:
        _, shape = point.of(effect)
        names = [shape_parameter.name for shape_parameter in effect.searched]
        if lacking := [name for name in names if name not in shape]:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' has no value for {', '.join(lacking)}, "
                "which is not linear and is not searched online; give like= a fit, or its value"
            )
        known = {name: shape[name] for name in names}
        effects.append(replace(effect, values={**effect.values, **known}))
    return replace(mechanism, effects=tuple(effects))
