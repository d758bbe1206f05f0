"""Checks of the logged data: units, signs, swapped channels, delays, clipping, clocks."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ident.diagnosis.channel_fits import (
    CLEAR,
    USUAL,
    Change,
    ChannelTrial,
    changes,
    least,
)
from ident.display import Displayed
from ident.fit import Fit
from ident.information.estimate import term_sizes
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.motion.recipe import ROWS_OVER_MOTION
from ident.motion.signals import measure, noise_level, noise_share, runs

# --- check ---------------------------------------------------------------------------------------
# One check of the logged data: a number, its threshold, what it means and what to do.


@dataclass(frozen=True)
class Check:
    """A judgement on one or more channels.

    Attributes:
        name: of the check: `sign`, `swapped`, `scale`, `command`, `delay`, …
        channels: columns it is about (`tau.elbow`, `q.elbow`); empty: the whole log.
        number: what was measured, in `unit`; NaN where the check has none.
        threshold: at which it is bad; NaN where nothing can be bad.
        bad: whether a person should act before naming any missing effect.
        meaning: what is so, and what a person sees in the plot.
        remedy: what to do, in the words of mechanism.toml; empty where nothing is to be done.
    """

    name: str
    channels: tuple[str, ...]
    number: float
    threshold: float
    bad: bool
    meaning: str
    remedy: str = ""
    unit: str = ""

    def __post_init__(self) -> None:  # NumPy's own numbers are no JSON
        object.__setattr__(self, "number", float(self.number))
        object.__setattr__(self, "threshold", float(self.threshold))
        object.__setattr__(self, "bad", bool(self.bad))

    @property
    def where(self) -> str:
        """The channels in one string."""
        return ", ".join(self.channels) or "log"

    def json(self) -> dict[str, Any]:
        """As JSON has it: a number that is not finite is None."""
        found = asdict(self)
        for key in ("number", "threshold"):
            found[key] = found[key] if math.isfinite(found[key]) else None
        return found | {"channels": list(self.channels)}

    def __str__(self) -> str:
        remedy = f"; {self.remedy}" if self.bad and self.remedy else ""
        return f"{self.where}: {self.meaning}{remedy}"


# --- health --------------------------------------------------------------------------------------
# The noun that all checks together are.


@dataclass(frozen=True, repr=False)
class Health(Displayed):
    """The health of the logged data. Made by `ident.health`.

    Attributes:
        checks: all of them, bad ones first.
    """

    checks: tuple[Check, ...]

    @property
    def findings(self) -> tuple[Check, ...]:
        """What is bad."""
        return tuple(check for check in self.checks if check.bad)

    @property
    def good(self) -> bool:
        """Whether nothing is bad."""
        return not self.findings

    def json(self) -> list[dict[str, Any]]:
        """One dictionary a check."""
        return [check.json() for check in self.checks]


# --- channels ------------------------------------------------------------------------------------
# The samples of a log's channels: as logged where logs are given, else as the motion has them.


ON_GRID = 0.95  # share of the gaps between neighbouring values that are whole steps
WHOLE = 0.05  # of a step, by which a gap may differ from a whole number of steps
ROUNDING = 1e-9  # of a channel's largest value: nearer values are one


@dataclass(frozen=True, eq=False)
class LoggedChannel:
    """One column of one log.

    Attributes:
        name: `tau.elbow`; log: the log's name.
        t: (n,) [s]; x: (n,) values.
        raw: whether x are the samples as logged, not on another clock or smoothed.
    """

    name: str
    log: str
    t: np.ndarray
    x: np.ndarray
    raw: bool

    @property
    def rms(self) -> float:
        """Root mean square of x."""
        return float(np.sqrt(np.mean(self.x**2)))

    @property
    def step(self) -> float:
        """The step of a quantised channel, 0 if its values lie on no grid."""
        values = np.unique(self.x)
        size = ROUNDING * np.abs(values).max(initial=0.0)
        gaps = np.diff(values)
        gaps = gaps[gaps > size]
        if len(gaps) < 3:
            return float(gaps.min(initial=np.inf)) if len(gaps) else 0.0
        step = float(np.quantile(gaps, 0.02))
        step = float(gaps[gaps < 1.5 * step].mean())
        whole = (
            np.abs(gaps / step - np.round(gaps / step)) < WHOLE * np.maximum(gaps / step, 1) ** 0.5
        )
        return step if whole.mean() > ON_GRID else 0.0


@dataclass(frozen=True, eq=False)
class Channels:
    """All channels of a fit's logs.

    Attributes:
        found: by (log, column); logs: those that were given, under ident's names of columns.
        others: (log, column) of columns that are no channel of this mechanism.
    """

    found: dict[tuple[str, str], LoggedChannel]
    others: dict[tuple[str, str], LoggedChannel]
    logs: tuple[Log, ...]

    def of(self, kind: str) -> list[LoggedChannel]:
        """The channels `q`, `v`, `a` or `tau`."""
        return [c for (_, name), c in self.found.items() if name.split(".", 1)[0] == kind]


def channels(fit: Fit, logs: Sequence[Log] = ()) -> Channels:
    """The channels of a fit, and of the logs it was made from where they are at hand."""
    mechanism = fit.mechanism
    mapped = tuple(measure(mechanism, log).log for log in logs)
    used = {source.column for source in mechanism.columns.values()}
    wanted = {f"{c}.{joint.name}" for joint in mechanism.joints for c in ("q", "v", "a", "tau")}
    found: dict[tuple[str, str], LoggedChannel] = {}
    others: dict[tuple[str, str], LoggedChannel] = {}
    for log in mapped:
        for name in log.columns:
            t, x = log.series(name)
            if len(x) > 2 and name not in used:
                into = found if name in wanted else others
                into[log.name, name] = LoggedChannel(name, log.name, t, x, True)
    if mapped:
        return Channels(found, others, mapped)
    for e in fit.motion.experiments:
        t = e.t[e.usable]
        for j, joint in enumerate(mechanism.driven):
            name = f"tau.{joint}"
            found[e.name, name] = LoggedChannel(name, e.name, t, e.tau[e.usable, j], False)
        for name, x in e.extra.items():
            if name not in wanted and name not in used:
                others[e.name, name] = LoggedChannel(name, e.name, t, x[e.usable], False)
    return Channels(found, others, ())


# --- clipped -------------------------------------------------------------------------------------
# Saturation: a torque that stays at its extreme while the model asks for more.


LONG = 3  # consecutive samples at the very extreme
TWICE = 2  # such runs: a single one may be a peak
SHARE = 0.005  # of all samples in such runs
BEYOND = 1.01  # times the extreme that the model asks for, in the middle of the runs


def clipped(fit: Fit, data: Channels) -> list[Check]:
    """Torque channels at their limit."""
    wanted: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]] = {}
    found = []
    for channel in data.of("tau"):
        found += [
            (channel, side, at)
            for side in (1.0, -1.0)
            if (at := _at_extreme(side * channel.x)).any()
        ]
    if not found:
        return []
    for p in fit.predict():
        for u, joint in enumerate(p.joints):
            wanted[p.name, f"tau.{joint}"] = p.t, p.predicted[:, u]
    shares: dict[tuple[str, str], float] = {}
    for channel, side, at in found:
        key = channel.log, channel.name
        if key in wanted:
            asked = side * np.interp(channel.t[at], *wanted[key])
            limit = float((side * channel.x).max())
            if limit > 0 and np.median(asked) < BEYOND * limit:
                continue
        elif side * float(channel.x[at][0]) <= 0:
            continue
        shares[key] = shares.get(key, 0.0) + float(at.mean())
    return [_said(channel, shares.pop((channel.log, channel.name)))
            for channel in data.of("tau") if (channel.log, channel.name) in shares]  # fmt: skip


def _at_extreme(x: np.ndarray) -> np.ndarray:
    """(n,) true in runs of LONG and more samples at the maximum of x, if there are enough."""
    top = x == x.max()
    at = np.zeros(len(x), dtype=bool)
    if top.all():
        return at
    long = [run for run in runs(top) if run.stop - run.start >= LONG]
    for run in long:
        at[run] = True
    enough = len(long) >= TWICE or at.mean() > SHARE
    return at if enough else np.zeros(len(x), dtype=bool)


def _said(channel: LoggedChannel, share: float) -> Check:
    limit = float(np.abs(channel.x).max())
    return Check(
        "saturation", (channel.name,), share, SHARE, share > SHARE,
        f"{channel.log}: {100 * share:.2g} % of the samples stay at the extreme ({limit:.4g}) "
        "while the model asks for more: flat tops in the plot",
        "leave these stretches out, or move within the drive's or the sensor's range",
        "of the samples",
    )  # fmt: skip


# --- closed --------------------------------------------------------------------------------------
# Joints that are logged beyond the degrees of freedom, against the closures.


NOISE = 5.0  # times the channel's own noise
TURN = 1.0  # rad; a joint that turns on and on has no larger motion than this
MATERIAL = 0.005  # of the joint's own motion: smaller misses change no torque that one could see


def disagreement(fit: Fit, data: Channels) -> list[Check]:
    """How far logged joints are from where closures and the other joints put them."""
    mechanism = fit.mechanism
    by_log = {e.name: e for e in fit.motion.experiments}
    found = []
    for log in data.logs if mechanism.closures else ():
        own = [c for c in data.of("q") if c.log == log.name]
        e = by_log.get(log.name)
        if e is None or len(own) <= mechanism.degrees_of_freedom:
            continue
        for channel in own:
            joint = mechanism.joint(channel.name.removeprefix("q."))
            at = mechanism.joint_index[joint.name]
            inside = (channel.t >= e.t[0]) & (channel.t <= e.t[-1])
            off = channel.x[inside] - np.interp(channel.t[inside], e.t, e.y[:, at])
            if joint.rotational:
                off = (off + np.pi) % (2 * np.pi) - np.pi
            rms, mean = float(np.sqrt(np.mean(off**2))), float(np.mean(off))
            spread = max(float(np.std(channel.x)), 1e-300)
            spread = min(spread, TURN) if joint.rotational else spread
            share, noise = rms / spread, noise_level(channel.x)
            bad = share > MATERIAL and rms > NOISE * noise
            like = (
                "a constant: an encoder's offset"
                if abs(mean) > 0.8 * rms
                else "changing with position: a length or a joint's placement"
            )
            text = (
                f"{log.name}: differs by {rms:.3g} {joint.unit} rms from where the closures and "
                f"the other joints put it" + (f", {like}" if bad else "")
            )
            remedy = (
                f"check the zero of {channel.name} ([log] offset) and the closures' lengths and "
                "frames"
            )
            found.append(
                Check(
                    "closure", (channel.name,), share, MATERIAL, bad, text, remedy, "of its motion"
                )
            )
    return found


# --- command -------------------------------------------------------------------------------------
# A torque channel that is a command and no measurement, by the signs that commands have.


HELD = 3.0  # samples that most values are held: a staircase of a slower controller
REGULAR = 0.8  # share of the steps of one and the same length
ZERO = 0.2  # share of the moving samples at which the torque is exactly zero
NOISELESS = 1e-3  # of the other channels' median share of noise: this one has none
NOISY = 1e-3  # share of noise from which the others count as measured
SAME = 1e-6  # of a channel's size, by which it may differ from a command and still be it
COMMAND = re.compile(
    r"(des|cmd|command|ref|set|target|goal|con)(ired|erence|point|trol)?[\W_\d]*", re.I
)


def commands(fit: Fit, data: Channels) -> list[Check]:
    """The signs of a command, for each torque channel and log; quiet ones are left out."""
    found = []
    by_log = {e.name: e for e in fit.motion.experiments}
    torques = data.of("tau")
    for channel in torques:
        e = by_log.get(channel.log)
        if e is None or float(np.ptp(channel.x)) == 0.0:
            continue
        peers = [c for c in torques if c.log == channel.log and c is not channel]
        others = [c for (log, _), c in data.others.items() if log == channel.log]
        for number, threshold, text, unit in (
            *_zero(fit, e, channel),
            *_staircase(channel),
            *_noiseless(channel, peers),
            *_copy(channel, others + peers),
        ):
            found.append(
                Check(
                    "command", (channel.name,), number, threshold, True,
                    f"{channel.log}: {text}: a command, not a measurement",
                    "give the measured torque or motor current instead: "
                    f'[log] "{channel.name}" = {{ column = …, scale = … }}',
                    unit,
                )
            )  # fmt: skip
    return found


Sign = tuple[float, float, str, str]


def _zero(fit: Fit, e: State, channel: LoggedChannel) -> list[Sign]:
    """Exactly zero while the joint moves."""
    at = fit.mechanism.joint_index[channel.name.removeprefix("tau.")]
    speed = np.abs(np.interp(channel.t, e.t, e.yd[:, at]))
    moving = speed > max(float(e.still[at]), 0.1 * float(np.sqrt(np.mean(speed**2))))
    if moving.sum() < 20:
        return []
    share = float((channel.x[moving] == 0.0).mean())
    text = f"exactly zero in {100 * share:.0f} % of the samples at which the joint moves"
    return [(share, ZERO, text, "of moving samples")] if share > ZERO else []


def _staircase(channel: LoggedChannel) -> list[Sign]:
    """Held for the same number of samples again and again."""
    edges = np.flatnonzero(np.diff(channel.x) != 0)
    lengths = np.diff(edges)
    if len(lengths) < 10 or np.median(lengths) < HELD:
        return []
    usual = int(np.median(lengths))
    regular = float((np.abs(lengths - usual) <= 1).mean())
    if regular < REGULAR:  # a coarse sensor's steps are as long as the torque is flat
        return []
    text = f"held for {usual} samples at a time, as a slower controller does"
    return [(float(usual), HELD, text, "samples")]


def _noiseless(channel: LoggedChannel, peers: list[LoggedChannel]) -> list[Sign]:
    """No noise, where the other torques have it; a quantised one has that of its steps."""
    if not peers or channel.step > 0:
        return []
    theirs = float(np.median([noise_share(c.x) for c in peers]))
    own = noise_level(channel.x) / float(np.std(channel.x))
    if theirs < NOISY or own > NOISELESS * theirs:
        return []
    text = "not the least noise, while the other torques have it"
    return [(own / theirs, NOISELESS, text, "of the others' noise")]


def _copy(channel: LoggedChannel, others: list[LoggedChannel]) -> list[Sign]:
    """A constant times another column that is called a command, or another joint's torque."""
    for other in others:
        peer = other.name.startswith("tau.")
        if not (peer or COMMAND.search(other.name.replace(".", "_"))):
            continue
        if len(other.x) != len(channel.x) or float(np.ptp(other.x)) == 0.0:
            continue
        gain = float(channel.x @ other.x) / float(other.x @ other.x)
        off = float(np.linalg.norm(channel.x - gain * other.x) / np.linalg.norm(channel.x))
        if gain and off < SAME:
            times = "" if abs(gain - 1) < SAME else f"{gain:.4g} times "
            return [(off, SAME, f"it is {times}the column '{other.name}'", "difference")]
    return []


# --- delay ---------------------------------------------------------------------------------------
# Delay of torque channels against positions.
#
#     S(d) = min_x Σ_u ‖X_u x − known − τ_u(t + d)‖² / σ_u²,    d > 0: the torque is late
#
# Torques shifted by whole samples are right-hand sides too. S is looked at there alone, for a
# torque interpolated between two samples has less noise, and its minimum is that of a parabola.


SAMPLES = 2.0  # a shorter delay is the effect `delay`
CERTAIN = 3.0  # standard errors
FALL = 0.5  # of the joint's sum of squares: less is not material
EXPLAINED = 0.3  # relative error that may be left: a delay that leaves more explains nothing
LEAST = 0.02  # relative error below which nothing is to be gained
ALIKE = 1.5  # times the squares left by delays of their own, that one delay of all may leave


def delays(fit: Fit, trial: ChannelTrial, idle: frozenset[str] = frozenset()) -> list[Check]:
    """The delay of each torque channel but those of idle joints; those that matter are bad."""
    if not trial.square or not len(trial.lags):
        return []
    gram, J = _grams(trial), len(trial.driven)
    zero = np.full(J, int((trial.lags < 0).sum()))
    at, d, sharp = zero.copy(), np.zeros(J), np.zeros(J)
    for _ in range(2):  # a delay of one joint is in the others' parameters
        for j in range(J):
            at[j], d[j], sharp[j] = _best(trial, gram, at, j)
    place, common, bend = _best(trial, gram, zero, slice(None))
    alone, both = (_left(gram, _shifted(trial, x)) for x in (at, np.full(J, place)))
    together = J > 1 and bool((both <= ALIKE * alone).all())
    if together:
        at, d, sharp = np.full(J, place), np.full(J, common), np.full(J, bend)
    # standard error √(S / (n S″/2)), n the samples that are independent at the motion's bandwidth
    effective = 2.0 * max(fit.motion.band.motion, 0.1) * _duration(fit)
    stderr = 1 / np.sqrt(np.maximum(effective * sharp, 1e-300))
    before, after = (_left(gram, _shifted(trial, x)) for x in (zero, at))
    fell = {j: 1 - after[u] / max(before[u], 1e-300) for u, j in enumerate(trial.own)}
    size = {j: float(np.sqrt(before[u])) for u, j in enumerate(trial.own)}
    found = []
    for j, name in enumerate(trial.driven):
        certain = abs(d[j]) / stderr[j]
        bad = (
            abs(d[j]) >= SAMPLES * trial.dt
            and certain >= CERTAIN
            and fell[j] >= FALL
            and size[j] >= LEAST
            and size[j] * np.sqrt(1 - fell[j]) <= EXPLAINED
            and name not in idle
        )
        word = "late" if d[j] > 0 else "early"
        text = (
            f"{1e3 * abs(d[j]):.3g} ms {word} against the positions; without the delay its sum of "
            f"squared errors falls by {100 * fell[j]:.3g} %"
            if bad
            else "no delay that matters"
        )
        found.append(
            Check(
                "delay", (f"tau.{name}",), 1e3 * d[j] if bad else 0.0, 1e3 * SAMPLES * trial.dt,
                bad, text, f"shift the column, or add the effect delay:{name}", "ms",
            )
        )  # fmt: skip
    fall = 1 - float(after.sum() / max(before.sum(), 1e-300))
    if together and fall >= FALL and any(check.bad for check in found):
        return [_common(found, 1e3 * common)]
    return found


def _common(found: list[Check], ms: float) -> Check:
    text = (
        f"all torques are {abs(ms):.3g} ms {'late' if ms > 0 else 'early'} against the positions: "
        "two clocks, or a filter on one of them"
    )
    remedy = "shift the torque columns together, or filter positions and torques alike"
    channels = tuple(c.channels[0] for c in found)
    return Check("delay", channels, ms, found[0].threshold, True, text, remedy, "ms")


def _grams(trial: ChannelTrial) -> list[np.ndarray]:
    """EᵀE of each coordinate, E what a refit leaves of every right-hand side."""
    size = trial.torque(trial.as_logged)
    scale = np.where(size > 0, size, 1.0)
    stack = [T / s for T, s in zip(trial.triangles, scale, strict=True)]
    whole = np.concatenate(stack)
    x = least(whole[:, : trial.width], whole[:, trial.width :])
    left = [T[:, trial.width :] - T[:, : trial.width] @ x for T in stack]
    return [E.T @ E for E in left]


def _left(gram: list[np.ndarray], c: np.ndarray) -> np.ndarray:
    return np.array([max(float(c @ G @ c), 0.0) for G in gram])  # rounding apart


def _shifted(trial: ChannelTrial, at: np.ndarray) -> np.ndarray:
    """c with τ_j(t + d), d the at[j]-th of the shifts and 0 in order of size."""
    J, L = len(trial.driven), len(trial.lags)
    zero = int((trial.lags < 0).sum())
    c = trial.as_logged.copy()
    for j in range(J):
        if at[j] != zero:
            c[1 + J * j + j] = 0.0
            c[1 + J * J + L * j + at[j] - (at[j] > zero)] = 1.0
    return c


Profile = tuple[int, float, float]  # the best shift's place, d [s], S″/2 over the joint's own S


def _best(trial: ChannelTrial, gram: list[np.ndarray], at: np.ndarray, j: int | slice) -> Profile:
    """The shift of one joint, or of all, that leaves least, the others as they are."""
    nodes = np.insert(trial.lags, int((trial.lags < 0).sum()), 0.0)
    left = np.empty(len(nodes))
    for i in range(len(nodes)):
        other = at.copy()
        other[j] = i
        left[i] = _left(gram, _shifted(trial, other)).sum()
    best = int(np.clip(left.argmin(), 1, len(nodes) - 2))
    x = nodes[best - 1 : best + 2] - nodes[best]
    bend, slope, _ = np.polyfit(x, left[best - 1 : best + 2], 2)
    if bend <= 0:
        return int(left.argmin()), float(nodes[left.argmin()]), 0.0
    d = float(np.clip(-slope / (2 * bend), x[0], x[2]))
    other = at.copy()
    other[j] = int(left.argmin())
    noise = _left(gram, _shifted(trial, other))  # of its own rows: others may have faults of theirs
    bottom = max(float(noise.sum() if isinstance(j, slice) else noise[trial.own.index(j)]), 1e-300)
    return int(left.argmin()), float(nodes[best] + d), float(bend / bottom)


def _duration(fit: Fit) -> float:
    return sum(float(e.usable.mean() * (e.t[-1] - e.t[0])) for e in fit.motion.experiments)


# --- grain ---------------------------------------------------------------------------------------
# Quantisation: the step of a channel against its size, and what it does to accelerations.
#
# step Δ of q:  σ_a = Δ/√12 · (2π f)² · √(2 f dt / 5)      white noise below the cut-off f
# step Δ of v:  σ_a = Δ/√12 · 2π f · √(2 f dt / 3)


TORQUE = 0.01  # of the rms torque: a coarser step is an error that no model can explain
ACCELERATION = 0.1  # of the rms acceleration
OWN = 0.5  # share of a channel's noise that its steps must make for them to matter


def grains(fit: Fit, data: Channels) -> list[Check]:
    """The steps of all quantised channels, the coarsest of the logs for each."""
    worst: dict[str, Check] = {}
    for channel in [*data.of("tau"), *data.of("q"), *data.of("v")]:
        step = channel.step
        if not step:
            continue
        if channel.name.startswith("tau."):
            check: Check | None = _torque(fit, channel, step)
        else:
            check = _position(fit, data, channel, step)
        if check and (channel.name not in worst or check.number > worst[channel.name].number):
            worst[channel.name] = check
    return list(worst.values())


def _torque(fit: Fit, channel: LoggedChannel, step: float) -> Check:
    share = step / np.sqrt(12) / channel.rms
    unit = fit.mechanism.joint(channel.name.removeprefix("tau.")).force_unit
    bad = share > TORQUE
    text = f"{channel.log}: steps of {step:.3g} {unit}, {100 * share:.2g} % of the rms torque"
    return Check(
        "quantisation", (channel.name,), float(share), TORQUE, bad,
        text + (": a staircase; the error cannot fall below it" if bad else ""),
        "log the torque with more digits or a finer range", "of rms torque",
    )  # fmt: skip


def _position(fit: Fit, data: Channels, channel: LoggedChannel, step: float) -> Check | None:
    kind, joint = channel.name.split(".", 1)
    e = next((e for e in fit.motion.experiments if e.name == channel.log), None)
    if e is None:
        return None
    dt = float(np.median(np.diff(channel.t)))
    motion = fit.motion.band
    f = min(motion.cutoff or ROWS_OVER_MOTION * motion.motion, 0.5 / dt)
    power, digits = (2, 5) if kind == "q" else (1, 3)
    noise = step / np.sqrt(12) * (2 * np.pi * f) ** power * np.sqrt(2 * f * dt / digits)
    a = e.ydd[e.usable, fit.mechanism.joint_index[joint]]
    size = float(np.sqrt(np.mean(a**2)))
    share = float(noise / size) if size > 0 else np.inf
    own = step / np.sqrt(12) / max(noise_level(channel.x), 1e-300)
    finer = ("a", "v") if kind == "q" else ("a",)  # from which accelerations are rather had
    logged = any((e.name, f"{other}.{joint}") in data.found for other in finer)
    bad = share > ACCELERATION and own > OWN and not logged
    unit = fit.mechanism.joint(joint).unit + ("/s" if kind == "v" else "")
    text = (
        f"{channel.log}: steps of {step:.3g} {unit}, which make {100 * share:.2g} % noise in the "
        f"accelerations below {f:.3g} Hz"
    )
    return Check(
        "quantisation", (channel.name,), share, ACCELERATION, bad, text,
        "lower --cutoff, move faster, or log velocities too", "of rms acceleration",
    )  # fmt: skip


# --- torques -------------------------------------------------------------------------------------
# Swapped, mis-signed and scaled torque channels, and friction that came out negative, in words.


TORQUES_CERTAIN = 3.0  # standard errors below zero at which a coefficient is negative
FAMILIAR = {
    1000.0: "mN m for N m",
    9.81: "kgf m for N m",
    100.0: "N cm for N m",
    10.0: "a factor of ten",
    180 / np.pi: "degrees for radians",
}
SIGNED = ("viscous", "coulomb", "rotor_inertia", "drag")


def exchanged(fit: Fit, trial: ChannelTrial) -> list[Check]:
    """Swapped, mis-signed and scaled channels; one quiet check if there are none."""
    found = [_said_torques(fit.mechanism, change) for change in changes(trial)]
    if found:
        return found
    text = "no exchange, sign or gain of a torque channel explains the log clearly better"
    return [Check("arrangement", (), 1.0, CLEAR, False, text, unit="of the error left")]


def column_of(mechanism: Mechanism, channel: str) -> tuple[str, float]:
    """The log's own column behind a channel, and its scale."""
    source = mechanism.columns.get(channel)
    return (channel, 1.0) if source is None else (source.column, source.scale)


def entry(mechanism: Mechanism, channel: str, factor: float) -> str:
    """The line of `[log]` that multiplies a channel by a factor."""
    column, scale = column_of(mechanism, channel)
    return f'[log] "{channel}" = {{ column = "{column}", scale = {factor * scale:.4g} }}'


def _said_torques(mechanism: Mechanism, change: Change) -> Check:
    channels = tuple(f"tau.{mechanism.driven[j]}" for j in change.joints)
    fall = (
        f"the error of the predicted torque falls from {100 * change.before:.3g} % to "
        f"{100 * change.after:.3g} %"
    )
    also = "".join(
        f"; {_short(mechanism, rival)} would do nearly as well" for rival in change.rivals
    )
    if change.kind == "swapped":
        (a, b), (of_a, of_b) = channels, (column_of(mechanism, c) for c in channels)
        what = f"{a} and {b} look exchanged: with one in the other's place {fall}"
        remedy = (
            f'write [log] "{a}" = {{ column = "{of_b[0]}", scale = {of_b[1]:g} }} and '
            f'"{b}" = {{ column = "{of_a[0]}", scale = {of_a[1]:g} }}'
        )
    elif change.kind == "sign":
        joints = " and ".join(f"q.{mechanism.driven[j]}" for j in change.joints)
        what = (
            f"the sign is against that of {joints}: as logged, inertia or friction would be "
            f"negative; turned, {fall}"
        )
        remedy = f"write {', '.join(entry(mechanism, c, -1.0) for c in channels)}, or turn {joints}"
    else:
        size = max(change.factor, 1 / change.factor)
        near = min(FAMILIAR, key=lambda known: abs(np.log(size / known)))
        guess = f" ({FAMILIAR[near]}?)" if abs(np.log(size / near)) < 0.05 else ""
        what = (
            f"the channel reads {1 / change.factor:.3g} times what the other joints' torques ask "
            f"for{guess}: scaled, {fall}"
        )
        line = entry(mechanism, channels[0], change.factor)
        remedy = f"check unit, gear ratio and torque constant; {line}"
    share = change.after / change.before
    return Check(
        change.kind, channels, share, CLEAR, True, what + also, remedy, "of the error left"
    )


def _short(mechanism: Mechanism, change: Change) -> str:
    names = " and ".join(f"tau.{mechanism.driven[j]}" for j in change.joints)
    how = {"swapped": "exchanging", "sign": "turning", "scale": f"scaling by {change.factor:.3g}"}
    return f"{how[change.kind]} {names}"


def negative(fit: Fit) -> list[Check]:
    """Friction and rotor inertia below zero: a sign, or another effect that is missing."""
    found = []
    for each in fit.effects:
        for value, unknown in zip(each.parameters, each.effect.unknowns, strict=False):
            if not (each.effect.kind in SIGNED and unknown.nonnegative and value.stderr):
                continue
            ratio = value.value / value.stderr
            if ratio >= -TORQUES_CERTAIN:
                continue
            channels = tuple(f"tau.{joint}" for joint in each.effect.joints)
            said = f"{value.name} = {value.value:.3g} ± {value.stderr:.2g} {value.unit} is negative"
            found.append(
                Check(
                    "negative", channels, ratio, -TORQUES_CERTAIN, False,
                    f"{said}, which no such effect can be: a sign, or what it stands in for",
                    "check the sign of torque and position; else see which effect is missing",
                    "standard errors",
                )
            )  # fmt: skip
    return found


# --- positions -----------------------------------------------------------------------------------
# Swapped, mis-signed and scaled position channels, tried only where the fit is poor.
#
# Each trial completes the motion anew, which is cheap in a tree alone; through closures a wrong
# position channel does not close, and `complete` says so.


DOUBTFUL = 0.08  # error of the worst joint, above which positions are doubted
POSITIONS_CLEAR = 0.3  # of the error may be left; stricter than for torques, for more is tried
DEGREES = 10.0  # smallest range of a channel that may be in degrees
FEW = 700  # samples that tell a right motion from a wrong one
Map = tuple[str, tuple[int, ...], np.ndarray, np.ndarray]  # kind, joints, taken from, times


def moved(fit: Fit, trial: ChannelTrial) -> list[Check]:
    """The one change of position channels that explains the log clearly better, if there is one."""
    mechanism, motion = fit.mechanism, fit.motion
    if mechanism.closures or max(trial.now.relative) < DOUBTFUL or not trial.square:
        return []
    thin = [_thinned(e, FEW // len(motion.experiments)) for e in motion.experiments]
    unfiltered = replace(motion, band=replace(motion.band, cutoff=None))
    plain = replace(fit, problem=replace(fit.problem, motion=unfiltered))
    before = ChannelTrial.of(plain, thin).now
    names = [joint.name for joint in mechanism.joints]
    tried = []
    span = [max(float(np.ptp(e.y[:, j])) for e in thin) for j in range(len(names))]
    for kind, joints, take, times in _maps(len(names)):
        if kind == "scale" and span[joints[0]] < DEGREES:
            continue
        known = [[x[:, take] * times for x in (e.y, e.yd, e.ydd)] for e in thin]
        other = [
            e.at(mechanism, np.array(x), tuple(names)) for e, x in zip(thin, known, strict=True)
        ]
        tried.append(
            (ChannelTrial.of(plain, other).now.score, kind, joints, float(times[joints[0]]))
        )
    score, kind, joints, factor = min(tried)
    if score > POSITIONS_CLEAR * before.score:
        return []
    channels = tuple(f"q.{names[j]}" for j in joints)
    fall = (
        f"the error of the predicted torques falls from {100 * before.score:.3g} % to "
        f"{100 * score:.3g} %"
    )
    if kind == "swapped":
        a, b = (column_of(mechanism, c)[0] for c in channels)
        remedy = (
            f'write [log] "{channels[0]}" = {{ column = "{b}" }} and '
            f'"{channels[1]}" = {{ column = "{a}" }}, velocities alike'
        )
        text = (
            f"{channels[0]} and {channels[1]} look exchanged: with one in the other's place {fall}"
        )
    else:
        remedy = f"write {entry(mechanism, channels[0], factor)}, velocity alike"
        what = "the sign is wrong" if factor == -1.0 else "in degrees, not in radians"
        text = f"{what}: corrected, {fall}"
    return [
        Check(f"position {kind}", channels, score / before.score, POSITIONS_CLEAR, True, text,
              remedy, "of the error left")
    ]  # fmt: skip


def _maps(count: int) -> Iterator[Map]:
    every, ones = np.arange(count), np.ones(count)
    for j in range(count):
        for kind, factor in (("sign", -1.0), ("scale", np.pi / 180)):
            times = ones.copy()
            times[j] = factor
            yield kind, (j,), every, times
        for i in range(j):
            take = every.copy()
            take[i], take[j] = j, i
            yield "swapped", (i, j), take, ones


def _thinned(e: State, most: int) -> State:
    index = np.flatnonzero(e.usable)
    return e.at_samples(index[:: max(1, len(index) // most)])


# --- prior ---------------------------------------------------------------------------------------
# Torques of another magnitude than the URDF's bodies need: a hint, for a URDF may be wrong.


TIMES = 8.0  # masses in a URDF are rarely five times off, units and gear ratios are
CANCEL = 0.2  # of the URDF's terms: a smaller torque is a remainder, and tells no factor
LEFT = 0.2  # of the torque, that is neither friction, spring nor rotor inertia
LIKE = 0.9  # correlation from which the URDF's prediction is like the torque at all


def magnitudes(fit: Fit, trial: ChannelTrial) -> list[Check]:
    """The gain of each torque against the URDF's prediction, with the usual effects left free."""
    found = []
    remainder = shares(fit, fit.columns.prior)
    k, J = len(fit.columns), len(trial.driven)
    for T, own in zip(trial.triangles, trial.own, strict=True):
        if own < 0:
            continue
        predicted = T[:, :k] @ fit.columns.prior - T[:, trial.width]
        torque = T[:, trial.width :] @ trial.as_logged - T[:, trial.width]
        usual = T[:, k : k + USUAL * J]  # friction, offset, spring, rotor inertia
        y, p = (x - usual @ least(usual, x) for x in (torque, predicted))
        sizes = float(np.linalg.norm(y)), float(np.linalg.norm(p))
        if not all(sizes) or sizes[0] < LEFT * np.linalg.norm(torque):
            continue
        like, gain = float(y @ p) / sizes[0] / sizes[1], sizes[0] / sizes[1]
        part = remainder.get(trial.driven[own], 0.0)
        told = part / gain > CANCEL  # the URDF's own torque among its terms
        bad = like > LIKE and told and max(gain, 1 / gain) > TIMES
        if bad:
            name = trial.driven[own]
            text = (
                f"{gain:.3g} times what the URDF's bodies need, and of the same shape: a unit, a "
                "gear ratio or a torque constant, unless the URDF's masses are no real ones"
            )
            found.append(
                Check("magnitude", (f"tau.{name}",), gain, TIMES, True, text,
                      f'[log] "tau.{name}" = {{ column = …, scale = {1 / gain:.2g} }}',
                      "times the URDF's")
            )  # fmt: skip
    return found


# --- record --------------------------------------------------------------------------------------
# What the record itself says: dead channels, noise instead of torque, jitter, gaps, repairs.


RECORD_NOISE = 0.7  # noise over rms from which a torque channel is noise and no torque
JITTER = 0.1  # of a step, rms: information below and above, since stamps are taken as they are
REPAIRS = re.compile(r"jitter|uneven|no sample|empty|repeated|left out|interpolat|gap|repair|back")


def dead(fit: Fit, data: Channels) -> list[Check]:
    """Channels that never change, and torques that are noise alone."""
    by_log = {e.name: e for e in fit.motion.experiments}
    surplus = len(fit.mechanism.driven) > len(fit.motion.independent)
    found = []
    for channel in [*data.of("tau"), *data.of("q")]:
        e = by_log.get(channel.log)
        kind, joint = channel.name.split(".", 1)
        if e is None:
            continue
        moves = float(np.ptp(e.y[e.usable, fit.mechanism.joint_index[joint]])) > 0
        spread = float(np.ptp(channel.x))
        if spread == 0.0 and kind == "tau" and moves and joint in fit.mechanism.driven:
            found.append(_constant(channel, surplus and not channel.x.any()))
        elif spread == 0.0 and kind == "q":
            text = f"{channel.log}: never changes: the joint is locked, or its encoder is"
            found.append(Check("dead", (channel.name,), 0.0, 0.0, False, text))
        elif kind == "tau" and channel.rms > 0:
            share = noise_level(channel.x) / channel.rms
            if share > RECORD_NOISE:
                found.append(_noise(channel, joint, share))
    return found


def _constant(channel: LoggedChannel, idle: bool) -> Check:
    """`idle`: a drive that others could do without may be off, and its torque zero."""
    text = f"{channel.log}: always {channel.x[0]:.4g} while the joint moves: " + (
        "a motor that is off, or no measurement" if idle else "no measurement"
    )
    joint = channel.name.removeprefix("tau.")
    return Check(
        "dead", (channel.name,), 0.0, 0.0, not idle, text,
        f"map the right column in [log], or put '{joint}' among the passive joints",
    )  # fmt: skip


def _noise(channel: LoggedChannel, joint: str, share: float) -> Check:
    text = (
        f"{channel.log}: {100 * share:.0f} % of its rms is noise of the sensor: the motor does "
        "nothing there, and its relative error says nothing"
    )
    return Check(
        "noise only", (channel.name,), share, RECORD_NOISE, True, text,
        f"put '{joint}' among the passive joints for this log, friction kept as an effect",
        "of rms torque",
    )  # fmt: skip


def clock(data: Channels) -> list[Check]:
    """Jitter and gaps of the logs' time stamps, as information."""
    found = []
    for log in data.logs:
        step = 1 / log.rate
        share = log.jitter[1] / step
        if share > 1e-6:
            text = f"{log.name}: steps of {1e3 * step:.3g} ms ± {100 * share:.2g} % rms"
            found.append(Check("jitter", ("t",), share, JITTER, False, text, unit="of a step"))
        if log.gaps():
            longest = max(b - a for a, b in log.gaps())
            text = f"{log.name}: {len(log.gaps())} gap(s), the longest {longest:.3g} s"
            found.append(Check("gaps", ("t",), float(len(log.gaps())), np.nan, False, text))
    return found


def repairs(fit: Fit) -> list[Check]:
    """What was repaired or left out on the way, as information."""
    return [
        Check("repair", (), np.nan, np.nan, False, note)
        for note in fit.motion.notes
        if REPAIRS.search(note) and "spline" not in note
    ]


# --- remainder -----------------------------------------------------------------------------------
# Torques that are the small remainder of large terms that cancel: a joint that swings freely.


FREE = 0.1  # of the terms: 5 % of error in one of them is then half the torque or more


def shares(fit: Fit, x: np.ndarray) -> dict[str, float]:
    """By independent joint: rms torque over the root sum of squares of all terms at x (k,)."""
    terms = term_sizes(fit.information.totals, x)
    found = {}
    for (joint, error), size in zip(fit.train.items(), terms, strict=True):
        if error.relative and size > 0:
            found[joint] = error.rms / error.relative / float(size)
    return found


def free(fit: Fit) -> list[Check]:
    """Driven joints that swing freely, so that their relative error says little."""
    found = []
    for joint, share in shares(fit, fit.estimate.solution.x).items():
        if share >= FREE or joint not in fit.mechanism.driven:
            continue
        text = (
            f"{100 * share:.2g} % of the inertia, gravity and coupling terms that cancel in it: "
            "the motor does next to nothing, and a relative error of this joint says little"
        )
        remedy = (
            f"put '{joint}' among the passive joints for this log, its friction kept as an effect, "
            "or judge it by its rms error"
        )
        found.append(
            Check(
                "swings freely", (f"tau.{joint}",), share, FREE, True, text, remedy, "of its terms"
            )
        )
    return found


# --- useless -------------------------------------------------------------------------------------
# Predictions that are no better than zero torque.


USELESS = 1.0  # relative error of zero torque itself
USELESS_EXPLAINED = (
    0.7  # error with plain friction, offset, spring and rotor, below which data are not at fault
)


def useless(fit: Fit, trial: ChannelTrial) -> list[Check]:
    """Joints whose torque neither the model nor plain effects at each joint explain."""
    found = []
    for u, (joint, error) in enumerate(fit.train.items()):
        if error.relative is None:
            continue
        plain = float(trial.now.relative[u])
        bad = error.relative >= USELESS and plain >= USELESS_EXPLAINED
        text = f"relative error {100 * error.relative:.3g} %" + (
            f", and {100 * plain:.3g} % with friction, offset, spring and rotor inertia at every "
            "joint: the prediction is no better than zero torque"
            if bad
            else ""
        )
        remedy = (
            "check sign, unit and column of its torque and position, and that the torque is a "
            "measurement"
        )
        channels = (f"tau.{joint}", f"q.{joint}")
        found.append(Check("error", channels, error.relative, USELESS, bad, text, remedy, "of rms"))
    return found


# --- judge ---------------------------------------------------------------------------------------
# The verb `health`: what is wrong with the logged data, before any missing effect is named.


def health(fit: Fit, logs: Sequence[Log] = ()) -> Health:
    """The health of the data behind a fit.

    Args:
        fit: from `identify`.
        logs: those the fit was made from, as read. With them quantisation, staircases, jitter and
            the closure residual are judged on the samples as logged; without, on the motion's
            uniform clock, where positions are smoothed already and are not judged.

    Returns:
        All checks, bad ones first; `print` shows a table and the findings in words.
    """
    data, trial = channels(fit, logs), ChannelTrial.of(fit)
    arranged = exchanged(fit, trial)
    wrong = any(check.bad for check in arranged)
    if not wrong:
        arranged += moved(fit, trial)
        wrong = any(check.bad for check in arranged)
    swinging = free(fit)
    idle = frozenset(check.channels[0].removeprefix("tau.") for check in swinging)
    checks = [
        *arranged,  # what follows is judged by the model, which wrong channels spoil
        *([] if wrong else [*swinging, *magnitudes(fit, trial), *delays(fit, trial, idle)]),
        *negative(fit),
        *commands(fit, data),
        *clipped(fit, data),
        *grains(fit, data),
        *disagreement(fit, data),
        *dead(fit, data),
        *clock(data),
        *repairs(fit),
        *useless(fit, trial),
    ]
    return Health(tuple(sorted(checks, key=lambda check: not check.bad)))
