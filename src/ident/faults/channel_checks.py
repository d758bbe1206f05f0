"""Checks of logged channels by their samples, without a model: dead, clipped, held, copied, …

Each check is a function of one channel that returns a number, its threshold, the meaning and a
remedy, or None where nothing is wrong; its name is the finding's code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from ident.faults.channel_fits import SMALL
from ident.finding import Finding
from ident.information.evidence import BEYOND, MAIN_CAUSE
from ident.information.linear import Array
from ident.log import Log
from ident.mechanism.mechanism import Joint, Mechanism
from ident.motion import Motion, State
from ident.motion.recipe import ROWS_OVER_MOTION
from ident.motion.signals import CLIPPED, LARGEST, NIL, absurd_samples, at_limit, runs
from ident.motion.spline import grain, noise_level
from ident.motion.torque_class import (
    SHORTEST,
    STAIRCASE_SAMPLES,
    TorqueVerdict,
    held_samples,
    is_compared,
    torque_verdict,
)
from ident.text import shortlist, significant, stamp, two_digits

Judgement = tuple[float, float, str, str] | None  # number, threshold, meaning, remedy

NAMED = 4  # shown: channels that are named of those with one fault
FROZEN = 0.25  # tuned: s for which a channel stays at a value while its joint moves
# tuned: times the largest other step, by which a position that was frozen goes on; one that rested
# sets out by steps that grow
JUMP = 5.0
ROUGH = 0.1  # tuned: noise in the accelerations by the steps of an encoder, of their rms
SPIKE = 15.0  # level: standard deviations from its neighbours, from which a sample is no noise
RARE = 1e-3  # tuned: share of lone samples that no sensor is free of (TX40: 3 of 45,000)
ROUNDED = 0.3  # numerics: of a channel's noise, by which copies may differ; measurements do by √2
COMPARED_SAMPLES = 2000  # work: samples by which two logs are compared
SAME_POSITION = 1e-3  # numerics: of a position's range, within which it is that of the other log
STAMPS_IN_COMMON = 0.5  # range: share of stamps from which two logs may be one
MOST_THINNED = 10  # range: rows of which one may be kept
LEAST_LAG = 2e-3  # range: s, a lateness of a velocity that matters
LAG_STEPS = 3  # work: in which a lag settles
NO_LAG = 0.1  # numerics: of a lag that matters, below which the first step leads to none
LOCKED = 0.05  # range: [rad | m] by which a joint that is held may move: fingers give way a little
LATE_RATES = "late rates"  # code of a finding; its number is negative where velocities are early
A_COMMAND = "a command, not a measurement"
ALTERNATES = 0.9  # range: share of rows from which a channel jumps to and fro in each


@dataclass(frozen=True, eq=False)
class LoggedChannel:
    """One column of one log: samples t, x (n,) as logged, and the motion that was made of it."""

    name: str
    kind: str  # `q`, `v` or `tau`
    joint: Joint
    t: Array
    x: Array
    log: Log
    state: State
    mechanism: Mechanism
    motion: Motion
    other: LoggedChannel | None = None  # of the same joint

    @cached_property
    def moving(self) -> Array:
        """(n,) whether the joint moves, well above standstill; from one pose to another."""
        if self.other is not None and self.other.t is self.t:
            return self.other.moving
        if self.log.poses:
            return np.full(len(self.x), np.ptp(self.log.columns[f"q.{self.joint.name}"]) > NIL)
        at = self.mechanism.joint_index[self.joint.name]
        speed = np.abs(self.state.yd[:, at])
        if not np.array_equal(self.t, self.state.t):
            speed = np.abs(np.interp(self.t, self.state.t, self.state.yd[:, at]))
        least = 0.1 * float(np.sqrt(np.mean(speed**2)))
        return np.asarray(speed > max(float(self.state.still[at]), least))

    @cached_property
    def step(self) -> float:
        """The step of a quantised channel, 0 for others."""
        return grain(self.x)

    @cached_property
    def verdict(self) -> TorqueVerdict:
        """The class of a torque."""
        used = {source.column for source in self.mechanism.columns.values()}
        others = {x: self.log.series(x)[1] for x in self.log.columns if is_compared(x)}
        return torque_verdict(self.name, self.x, self.moving, others, used)

    @property
    def left_out(self) -> str:
        """What else helps in a tree, where a joint has no torque sensor."""
        if self.mechanism.closures:
            return ""
        return f", or leave out its equation if it has no sensor (--unmeasured {self.joint.name})"

    @property
    def entry(self) -> str:
        """The line of [log] that maps another column."""
        return f'map the measured one: [log] "{self.name}" = {{ column = …, scale = … }}'


# --- one channel --------------------------------------------------------------------------------


def torque_class(c: LoggedChannel) -> tuple[str, Judgement]:
    """The cause for which a torque is no measurement, "" for one that is, and what to do."""
    verdict = c.verdict
    number, threshold = verdict.number, verdict.threshold
    text, remedy = "", c.entry
    match verdict.cause:
        case "constant":
            # a drive that the others can do without may be off
            if not c.x.any() and len(c.mechanism.driven) > len(c.motion.independent):
                return "", None
            text = f"always {significant(c.x[0] + 0.0, 4)} while the joint moves: no measurement"
            passive = f"put '{c.joint.name}' among the passive joints"
            remedy = f"map the right column in [log]{c.left_out}, or {passive}"
        case "switched":
            values = ", ".join(significant(level) for level in verdict.levels)
            text = (
                f"has {len(verdict.levels)} values alone ({values} {c.joint.force_unit}): what the "
                "controller asks for, which the drive follows more or less, and no measurement; as "
                "an experiment it is as good as the drive"
            )
            remedy = (
                f"take it as it is if the drive is fast; its delay and gain are --with "
                f"delay:{c.joint.name} and --with torque_gain:{c.joint.name}"
            )
        case "shared":
            text = (
                f"{verdict.column}: one drive's torque in several columns, which counts it as often"
            )
            remedy = (
                "keep the column of the joint that the drive turns, and put the others among the "
                "passive joints ([joints] passive)"
            )
        case "copied":
            text = f"{verdict.column}: {A_COMMAND}"
        case "staircase":
            text = held_for(number)
        case "zero":
            text = (
                f"exactly zero in {100 * number:.0f} % of the samples at which the joint moves: "
                f"{A_COMMAND}"
            )
            remedy = c.entry + c.left_out
        case "noise_only":
            text = (
                f"{100 * number:.0f} % of its rms is noise of the sensor: its relative error says "
                "nothing"
            )
            remedy = f"put '{c.joint.name}' among the passive joints for this log"
        case "noiseless":
            text = f"not the least noise, while the other torques have it: {A_COMMAND}"
        case _:
            return "", None
    return verdict.cause, (number, threshold, text, remedy)


def held_for(samples: float) -> str:
    """Say for how many samples at a time a channel is held."""
    return (
        f"held for {samples:.0f} samples at a time: rows are repeated, or a slower controller "
        "commands it, and it is no measurement"
    )


def staircase(c: LoggedChannel) -> Judgement:
    """A position held for the same number of samples again and again."""
    usual = held_samples(c.x)
    return None if usual is None else (usual, STAIRCASE_SAMPLES, held_for(usual), c.entry)


def alternating(c: LoggedChannel) -> Judgement:
    """A channel that jumps between two series from row to row."""
    between = c.x[1:-1] - 0.5 * (c.x[:-2] + c.x[2:])
    turning = between[c.moving[1:-1]]
    if len(turning) <= SHORTEST:
        return None
    flips = float((turning[1:] * turning[:-1] < 0).mean())
    if flips <= ALTERNATES:  # no medians are needed
        return None
    jump = float(np.median(np.abs(turning)))
    step = float(np.median(np.abs(c.x[2:] - c.x[:-2])))
    wild = jump > BEYOND * step and jump > SMALL * float(np.ptp(c.x))
    text = (
        f"jumps by {significant(2 * jump)} and back from row to row: two publishers in one topic, "
        "or two logs in one"
    )
    remedy = "log one of them; ros2 topic info -v names both"
    return (flips, ALTERNATES, text, remedy) if wild else None


def frozen(c: LoggedChannel) -> Judgement:
    """A channel that stays at a value for a while as its joint moves, or jumps after it."""
    step = np.abs(np.diff(c.x))
    longest = max(runs(step == 0), key=lambda run: run.stop - run.start, default=slice(0, 0))
    first, last = longest.start, longest.stop
    seconds = float(c.t[last] - c.t[first])
    if seconds < FROZEN or not np.ptp(c.x):
        return None
    if c.kind == "tau":  # an extreme is a limit, and what is quantised may well stay
        inside = 0 < abs(c.x[first]) < np.abs(c.x).max()
        moving = seconds * float(c.moving[longest].mean())
        wrong = inside and not c.step and moving > max(FROZEN, 0.5 * seconds)
    else:
        wrong = last < len(step) and step[last] > JUMP * np.delete(step, last).max()
    text = (
        f"stays at {significant(c.x[first], 4)} for {seconds:.3g} s from t = {stamp(c.t[first])} s "
        "on, while the joint moves"
    )
    return (seconds, FROZEN, text, "leave these samples empty") if wrong else None


def clipped(c: LoggedChannel) -> Judgement:
    """A torque that stays at an extreme of its channel."""
    at_extreme = at_limit(c.x)
    share = float(at_extreme.mean())
    extremes = " and ".join(significant(x, 4) for x in np.unique(c.x[at_extreme]))
    text = (
        f"{100 * share:.2g} % of the samples stay at an extreme ({extremes}): the range of the "
        "drive or of its sensor ends there"
    )
    remedy = "leave these stretches empty, or move within that range"
    return (share, CLIPPED, text, remedy) if share else None


def steps(c: LoggedChannel) -> Judgement:
    """Steps of a quantised channel that matter."""
    if not c.step:
        return None
    # noise Δ/√12 is white; below f in a torque, or in the derivatives of q or v
    dt, band = float(np.median(np.diff(c.t))), c.motion.band
    f = min(band.cutoff or ROWS_OVER_MOTION * band.motion, 0.5 / dt)
    if c.kind == "tau":
        f = band.cutoff or 0.5 / dt
        share = c.step * np.sqrt(2 * f * dt / 12) / float(np.sqrt(np.mean(c.x**2)))
        text = (
            f"steps of {significant(c.step)} {c.joint.force_unit}: an error of {100 * share:.2g} % "
            f"of the rms torque up to {f:.3g} Hz, below which no model can come"
        )
        remedy = "log it with more digits or in a finer range"
        return (share, SMALL, text, remedy) if share > SMALL else None
    order, digits = (2, 5) if c.kind == "q" else (1, 3)
    noise = c.step / np.sqrt(12) * (2 * np.pi * f) ** order * np.sqrt(2 * f * dt / digits)
    a = c.state.ydd[c.state.usable, c.mechanism.joint_index[c.joint.name]]
    share = noise / max(float(np.sqrt(np.mean(a**2))), 1e-300)
    finer = ("a", "v") if c.kind == "q" else ("a",)
    if share < ROUGH or any(f"{other}.{c.joint.name}" in c.log for other in finer):
        return None
    unit = c.joint.unit + ("/s" if c.kind == "v" else "")
    text = (
        f"steps of {significant(c.step)} {unit}, which make {100 * share:.2g} % noise in the "
        f"accelerations below {f:.3g} Hz"
    )
    return share, ROUGH, text, "lower --cutoff, move faster, or log velocities too"


def spikes(c: LoggedChannel) -> Judgement:
    """Lone samples far from both neighbours, which are alike: cells without a value, glitches."""
    before, x, after = c.x[:-2], c.x[1:-1], c.x[2:]
    far = np.minimum(np.abs(x - before), np.abs(x - after))
    least = ROUGH * float(np.sqrt(np.mean(c.x**2)))
    at = np.flatnonzero(far > least)
    at = at[np.abs(after[at] - before[at]) < 0.25 * far[at]]
    if len(at) < 3:  # no medians are needed
        return None
    off, moving = np.abs(x - 0.5 * (before + after)), c.moving[1:-1]
    # noise may be larger in motion, of which a log may hold little
    usual = max(float(np.median(gaps)) for gaps in (off, off[moving]) if len(gaps)) / 0.6745
    at = at[far[at] > SPIKE * usual] + 1
    share = len(at) / len(c.x)
    if len(at) < 3 or share < RARE or not c.moving[at].any():
        return None
    text = (
        f"{len(at)} lone samples far from their neighbours, as {significant(c.x[at[0]], 4)} at "
        f"t = {c.t[at[0]]:.6g} s: cells without a value, or glitches"
    )
    return share, RARE, text, "leave these cells empty"


CHECKS = {
    "tau": (frozen, clipped, steps, spikes),
    "q": (frozen, steps, staircase),
    "v": (frozen, steps),
}  # fmt: skip

OF_POSES = ("constant", "zero")  # no check of what follows from the pose before

# --- all channels -------------------------------------------------------------------------------


def log_findings(mechanism: Mechanism, motion: Motion) -> Iterator[Finding]:
    """Report what is wrong with the channels of a motion's logs, where these are at hand."""
    for log in motion.logs:
        # the motion of a long log is that of stretches, and its samples are the first's
        stretches = (e for e in motion.experiments if f"{e.name}, ".startswith(f"{log.name}, "))
        state = next(stretches, None)
        same: dict[tuple[str, str], list[tuple[str, float, float, str]]] = {}  # by check and text
        of_joint = dict[str, LoggedChannel]()
        for name in log.columns:
            kind, _, joint = name.partition(".")
            if kind == "q" and (at := mechanism.locked.get(joint)) is not None:
                off = float(np.nanmax(np.abs(log.columns[name] - at), initial=0.0))
                text = f"{log.name}: {name} is up to {off:.3g} off {at:.4g}, at which it is locked"
                if off >= LOCKED:
                    remedy = "give its position, or do not lock it"
                    yield Finding("locked", text, remedy, (name,), off, LOCKED)
            if joint not in mechanism.joint_index or state is None:
                continue
            if kind == "tau" and joint not in mechanism.measured:
                continue
            t, x = log.series(name)
            measured = np.abs(x) < LARGEST
            measured[absurd_samples(x)] = False  # the motion names them and leaves them out
            t, x = (t, x) if measured.all() else (t[measured], x[measured])
            channel = LoggedChannel(
                name, kind, mechanism.joint(joint), t, x, log, state, mechanism, motion,
                of_joint.get(joint),
            )  # fmt: skip
            of_joint.setdefault(joint, channel)
            if len(x) <= SHORTEST:
                continue
            checks: Iterator[tuple[str, Judgement]]
            checks = ((check.__name__, check(channel)) for check in CHECKS.get(kind, ()))
            of_class = torque_class(channel) if kind == "tau" else ("", None)
            if log.poses:
                checks = iter((of_class,) if of_class[0] in OF_POSES else ())
            elif (of_two := alternating(channel)) is not None:  # which looks like noise, too
                checks = iter((("alternating", of_two),))
            elif of_class[0]:
                checks = iter((of_class,))  # what is no measurement has one remedy
            for code, judgement in checks:
                if judgement is not None:
                    number, threshold, meaning, remedy = judgement
                    judgements = same.setdefault((code, meaning), [])
                    judgements.append((name, number, threshold, remedy))
        if state is not None:
            yield from contradicted(log, state, mechanism)
            yield from late_rates(log, mechanism)
        for (code, meaning), judgements_of_check in same.items():
            names = tuple(name for name, *_ in judgements_of_check)
            _, number, threshold, remedy = judgements_of_check[0]
            text = f"{log.name}: {shortlist(names, NAMED)}: {meaning}"
            yield Finding(code, text, remedy, names, number, threshold)
    ends = [f(e.y, axis=0) for e in motion.experiments if len(e.y) for f in (np.min, np.max)]
    if ends and (travel := float(np.ptp(ends, axis=0).max())) < NIL:
        text = "no position ever changes: a logger that hangs, or columns that are no positions"
        names = tuple(f"q.{name}" for name in motion.experiments[0].logged)
        yield Finding("no motion", text, "log a motion; ident excite plans one", names, travel, NIL)
    texts = "standard errors are too small by √2", "leave it out"
    pairs = [*combinations(motion.logs, 2)][::-1]  # the first log counts
    again = {copy.where: copy for a, b in pairs for copy in copies(a, b, *texts)}
    yield from again.values()


def late_rates(log: Log, mechanism: Mechanism) -> Iterator[Finding]:
    """Report a velocity and a position of a joint of which one is late.

    v(t) ≈ q̇(t − l),  l = −Σ (v − q̇) q̈ / Σ q̈²     where l takes off half of v − q̇
    """
    late: dict[str, float] = {}
    rate_of = _rates(log.t)
    for joint in mechanism.joint_index:
        if not {f"q.{joint}", f"v.{joint}"} <= {*log.columns}:
            continue
        both = (log.columns[f"{c}.{joint}"] for c in "qv")
        good = np.logical_and(*(np.abs(x) < LARGEST for x in both))  # neither empty nor absurd
        t, q, v = (x[good] for x in (log.t, *(log.columns[f"{c}.{joint}"] for c in "qv")))
        if len(t) <= SHORTEST:
            continue
        rates = rate_of if good.all() else _rates(t)
        step, lag = float(np.median(np.diff(t))), 0.0
        rate = shifted = rates(q)
        before = float(np.linalg.norm(v - rate))
        for _ in range(LAG_STEPS):
            slope = rates(shifted)
            lag -= float((v - shifted) @ slope) / max(float(slope @ slope), 1e-300)
            if abs(lag) < NO_LAG * max(step, LEAST_LAG):
                break
            shifted = np.interp(t - lag, t, rate)
        after = float(np.linalg.norm(v - np.interp(t - lag, t, rate)))
        if after < MAIN_CAUSE * before and abs(lag) > max(step, LEAST_LAG):
            late[joint] = lag
    if late:
        lag = max(late.values(), key=abs)
        names = tuple(f"{c}.{joint}" for joint in late for c in "vq")
        words = "late" if lag > 0 else "early"
        text = (
            f"{log.name}: {shortlist([f'v.{joint}' for joint in late], NAMED)}: "
            f"{two_digits(1e3 * abs(lag))} ms {words} against the rate of the position: a filter "
            "or another clock in one of them"
        )
        remedy = "leave out the velocities where their filter makes it"
        yield Finding(LATE_RATES, text, remedy, names, 1e3 * lag, 1e3 * LEAST_LAG)


def _rates(t: Array) -> Callable[[Array], Array]:
    """Return what differentiates series x (n,) by their stamps t (n,), as np.gradient does."""
    step = np.diff(t)
    before, after = step[:-1], step[1:]
    both = before + after
    a, b, c = -after / (before * both), (after - before) / (before * after), before / (after * both)

    def rates(x: Array) -> Array:
        ends = (x[1] - x[0]) / step[0], (x[-1] - x[-2]) / step[-1]
        return np.concatenate([ends[:1], a * x[:-2] + b * x[1:-1] + c * x[2:], ends[1:]])

    return rates


def contradicted(log: Log, state: State, mechanism: Mechanism) -> Iterator[Finding]:
    """Report positions of a loop that the closures and the other positions contradict."""
    contradictions: dict[str, str] = {}
    known = state.logged if len(state.logged) > mechanism.degrees_of_freedom else ()
    largest = 0.0
    for joint in map(mechanism.joint, known):
        column = f"q.{joint.name}"
        smoothed = next((x for x in state.channels if x.column == column and x.spacing), None)
        if smoothed is None or smoothed.residual < BEYOND * smoothed.noise:
            continue
        spread = float(np.nanstd(log.columns[column]))
        spread = min(spread, 1.0) if joint.rotational else spread  # of a radian, where it turns
        if (share := smoothed.residual / max(spread, 1e-300)) > SMALL:
            times, largest = two_digits(smoothed.residual / smoothed.noise), max(largest, share)
            size = f"{significant(smoothed.residual)} {joint.unit}"
            contradictions[column] = f"{column} by {size} rms, {times} times its noise"
    if contradictions:
        text = (
            f"{log.name}: these positions and the closures contradict each other: "
            f"{shortlist([*contradictions.values()], NAMED)}"
        )
        remedy = (
            "check their zeros, signs and units and the closures' frames; if a length is wrong, "
            "a diagnosis can find which from a log without the columns that the motion does not "
            "need"
        )
        yield Finding("contradicted", text, remedy, tuple(contradictions), largest, SMALL)


def copies(a: Log, b: Log, harm: str, remedy: str) -> list[Finding]:
    """Return a finding if a log holds samples of another one, from its beginning on or from the
    first stamp that both have; rounded to fewer digits they differ by less than their noise.
    """
    names = [name for name in a.columns if name in b.columns and name.startswith(("q.", "tau."))]
    if not names:
        return []
    for rows_a, rows_b in _alike_rows(a, b):
        if all(_same_samples(a.columns[n][rows_a], b.columns[n][rows_b], n) for n in names):
            break
    else:
        return []
    count = len(a.t[rows_a])
    text = f"{b.name} holds {count} samples of {a.name}: {harm}"
    return [Finding("copy", text, remedy, (b.name,))]


def _alike_rows(a: Log, b: Log) -> Iterator[tuple[slice | np.ndarray, slice | np.ndarray]]:
    """Yield rows of two logs that may be the same samples: from the beginning or the first stamp
    that both have, of the same stamps, and every second, third, … row of one.
    """
    i = j = 0
    if len(a.t) != len(b.t):
        i, j = int(np.searchsorted(a.t, b.t[0])), int(np.searchsorted(b.t, a.t[0]))
        i, j = min(i, len(a.t) - 1), min(j, len(b.t) - 1)
    count = min(len(a.t) - i, len(b.t) - j)
    if len(a.t) == len(b.t) or a.t[i] == b.t[j]:
        yield slice(i, i + count), slice(j, j + count)
    at = np.clip(np.searchsorted(a.t, b.t), 0, len(a.t) - 1)
    same = a.t[at] == b.t
    if same.mean() > STAMPS_IN_COMMON:
        yield at[same], np.flatnonzero(same)
    for long, short, turned in ((a, b, False), (b, a, True)):
        step = round(len(long.t) / max(len(short.t), 1))
        for first in range(step if 2 <= step <= MOST_THINNED else 0):
            rows = np.arange(first, len(long.t), step)[: len(short.t)]
            both = rows, np.arange(len(rows))
            yield both[::-1] if turned else both


def _same_samples(x: np.ndarray, y: np.ndarray, name: str) -> bool:
    """Whether series of a column are the same but for rounding."""
    x, y = x[:COMPARED_SAMPLES], y[:COMPARED_SAMPLES]
    x, y = (series[np.isfinite(x) & np.isfinite(y)] for series in (x, y))
    if len(x) <= SHORTEST:
        return False
    far = ROUNDED * noise_level(x) if name[0] == "t" else SAME_POSITION * np.ptp(x)
    return bool(np.linalg.norm(x - y) <= far * np.sqrt(len(x)))
