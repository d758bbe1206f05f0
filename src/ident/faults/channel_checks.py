"""Checks of logged channels by their samples, without a model: dead, clipped, held, copied, …

Each check is a function of one channel that returns a number, its threshold, the meaning and a
remedy, or None where nothing is wrong; its name is the finding's code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from ident.faults.channel_fits import SMALL
from ident.finding import Finding
from ident.information.chance import BEYOND
from ident.information.linear import Array
from ident.log import Log
from ident.mechanism.mechanism import Joint, Mechanism
from ident.motion import Motion, State
from ident.motion.recipe import CLEAN, ROWS_OVER_MOTION
from ident.motion.signals import CLIPPED, LARGEST, NIL, REGULAR, absurd_samples, at_limit, runs
from ident.motion.spline import grain, noise_level, noise_share
from ident.text import shortlist, significant, two_digits

Judgement = tuple[float, float, str, str] | None  # number, threshold, meaning, remedy

NOISE = 0.5**0.5  # level: noise over rms: from half of its squares on a torque is no torque
ZERO = 0.2  # tuned: share of the samples at which a joint moves, where its torque is exactly zero
STAIRCASE_SAMPLES = (
    2  # range: samples for which most values stay: a staircase of a slower controller
)
ALWAYS = 0.98  # tuned: share of pairs from which rows are repeated: a slow channel repeats some
NAMED = 4  # shown: channels that are named of those with one fault
SHORTEST = 20  # work: samples of a channel that can be judged
FROZEN = 0.25  # tuned: s for which a channel stays at a value while its joint moves
# tuned: times the largest other step, by which a position that was frozen goes on; one that rested
# sets out by steps that grow
JUMP = 5.0
ROUGH = 0.1  # tuned: noise in the accelerations by the steps of an encoder, of their rms
SPIKE = 15.0  # level: standard deviations from its neighbours, from which a sample is no noise
RARE = 1e-3  # tuned: share of lone samples that no sensor is free of (TX40: 3 of 45,000)
SAME = 1e-6  # numerics: of a channel's size, by which it may differ from a command and still be it
COMMAND = re.compile(
    r"(des|cmd|command|ref|set|target|goal|con)(ired|erence|point|trol)?[\W_\d]*", re.I
)
ROUNDED = 0.3  # numerics: of a channel's noise, by which copies may differ; measurements do by √2
COMPARED_SAMPLES = 2000  # work: samples by which two logs are compared
SAME_POSITION = 1e-3  # numerics: of a position's range, within which it is that of the other log
LOCKED = 0.05  # range: [rad | m] by which a joint that is held may move: fingers give way a little
MEASURED = "a command, not a measurement"


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

    @cached_property
    def moving(self) -> Array:
        """(n,) whether the joint moves, well above standstill; from one pose to another."""
        if self.log.poses:
            return np.full(len(self.x), np.ptp(self.log.columns[f"q.{self.joint.name}"]) > NIL)
        at = self.mechanism.joint_index[self.joint.name]
        speed = np.abs(np.interp(self.t, self.state.t, self.state.yd[:, at]))
        least = 0.1 * float(np.sqrt(np.mean(speed**2)))
        return np.asarray(speed > max(float(self.state.still[at]), least))

    @cached_property
    def step(self) -> float:
        """The step of a quantised channel, 0 for others."""
        return grain(self.x)

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


def constant(c: LoggedChannel) -> Judgement:
    """A torque that never changes while the joint moves."""
    # a drive that the others can do without may be off
    off = not c.x.any() and len(c.mechanism.driven) > len(c.motion.independent)
    text = f"always {significant(c.x[0] + 0.0, 4)} while the joint moves: no measurement"
    passive = f"put '{c.joint.name}' among the passive joints"
    remedy = f"map the right column in [log]{c.left_out}, or {passive}"
    return None if np.ptp(c.x) > 0 or not c.moving.any() or off else (0.0, 0.0, text, remedy)


def zero(c: LoggedChannel) -> Judgement:
    """A torque that is exactly zero again and again while the joint moves."""
    share = float((c.x[c.moving] == 0).mean()) if c.moving.any() else 0.0
    text = (
        f"exactly zero in {100 * share:.0f} % of the samples at which the joint moves: {MEASURED}"
    )
    return (share, ZERO, text, c.entry + c.left_out) if share > ZERO and c.x.any() else None


def noise_only(c: LoggedChannel) -> Judgement:
    """A torque that is noise of its sensor."""
    share = noise_level(c.x) / max(float(np.sqrt(np.mean(c.x**2))), 1e-300)
    text = f"{100 * share:.0f} % of its rms is noise of the sensor: its relative error says nothing"
    remedy = f"put '{c.joint.name}' among the passive joints for this log"
    return (share, NOISE, text, remedy) if share > NOISE else None


def staircase(c: LoggedChannel) -> Judgement:
    """A channel held for the same number of samples again and again."""
    lengths = np.diff(np.flatnonzero(np.diff(c.x)))
    usual = float(np.median(lengths)) if len(lengths) >= 10 else 0.0
    # steps of a coarse sensor are as long as the channel is flat, only two samples are never by it
    regular = np.abs(lengths - usual) <= (usual > STAIRCASE_SAMPLES)
    if usual < STAIRCASE_SAMPLES or regular.mean() < (
        REGULAR if usual > STAIRCASE_SAMPLES else ALWAYS
    ):
        return None
    text = (
        f"held for {usual:.0f} samples at a time: rows are repeated, or a slower controller "
        "commands it, and it is no measurement"
    )
    return usual, STAIRCASE_SAMPLES, text, c.entry


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
        f"stays at {significant(c.x[first], 4)} for {seconds:.3g} s from t = {c.t[first]:.4g} s "
        "on, while the joint moves"
    )
    return (seconds, FROZEN, text, "leave these samples empty") if wrong else None


def clipped(c: LoggedChannel) -> Judgement:
    """A torque that stays at an extreme of its channel."""
    share = float(at_limit(c.x).mean())
    text = (
        f"{100 * share:.2g} % of the samples stay at an extreme "
        f"({significant(np.abs(c.x).max(), 4)}): the range of the drive or of its sensor ends there"
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
    off, moving = np.abs(x - 0.5 * (before + after)), c.moving[1:-1]
    # noise may be larger in motion, of which a log may hold little
    usual = max(float(np.median(gaps)) for gaps in (off, off[moving]) if len(gaps)) / 0.6745
    far = np.minimum(np.abs(x - before), np.abs(x - after))
    least = max(SPIKE * usual, ROUGH * float(np.sqrt(np.mean(c.x**2))))
    lone = (far > least) & (np.abs(after - before) < 0.25 * far)
    at = np.flatnonzero(lone) + 1
    share = len(at) / len(c.x)
    if len(at) < 3 or share < RARE or not c.moving[at].any():
        return None
    text = (
        f"{len(at)} lone samples far from their neighbours, as {significant(c.x[at[0]], 4)} at "
        f"t = {c.t[at[0]]:.6g} s: cells without a value, or glitches"
    )
    return share, RARE, text, "leave these cells empty"


def noiseless(c: LoggedChannel) -> Judgement:
    """A torque without noise, where the others have it."""
    share = noise_share(c.x)
    if share > CLEAN or c.step or not np.ptp(c.x):
        return None
    names = [name for name in c.log.columns if name.startswith("tau.") and name != c.name]
    others = [noise_share(c.log.series(name)[1]) for name in names]
    usual_share = float(np.median(others)) if others else 0.0
    if usual_share < CLEAN or share > CLEAN * usual_share:
        return None
    text = f"not the least noise, while the other torques have it: {MEASURED}"
    return share / usual_share, CLEAN, text, c.entry


def copied(c: LoggedChannel) -> Judgement:
    """A torque that is a constant times a command, or another joint's torque."""
    used = {source.column for source in c.mechanism.columns.values()}
    for name in c.log.columns:
        if name == c.name or name in used:
            continue
        if not name.startswith("tau.") and not COMMAND.search(name.replace(".", "_")):
            continue
        x = c.log.series(name)[1]
        if len(x) != len(c.x) or not np.ptp(x):
            continue
        at = int(np.abs(x).argmax())
        gain = float(c.x[at] / x[at])
        if abs(c.x[at // 2] - gain * x[at // 2]) > SAME * np.abs(c.x[at]):  # most end here
            continue
        off = float(np.linalg.norm(c.x - gain * x)) / max(float(np.linalg.norm(c.x)), 1e-300)
        if gain and off < SAME:
            times = "" if abs(gain - 1) < SAME else f"{gain:.4g} times "
            return off, SAME, f"{times}the column '{name}': {MEASURED}", c.entry
    return None


CHECKS = {
    "tau": (constant, zero, noise_only, staircase, frozen, clipped, steps, spikes, noiseless,
            copied),
    "q": (frozen, steps, staircase),
    "v": (frozen, steps),
}  # fmt: skip

OF_POSES = {"tau": (constant, zero)}  # no check of what follows from the pose before

# --- all channels -------------------------------------------------------------------------------


def log_findings(mechanism: Mechanism, motion: Motion) -> Iterator[Finding]:
    """Report what is wrong with the channels of a motion's logs, where these are at hand."""
    for log in motion.logs:
        # the motion of a long log is that of stretches, and its samples are the first's
        stretches = (e for e in motion.experiments if f"{e.name}, ".startswith(f"{log.name}, "))
        state = next(stretches, None)
        same: dict[tuple[str, str], list[tuple[str, float, float, str]]] = {}  # by check and text
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
            t, x = t[measured], x[measured]
            channel = LoggedChannel(
                name, kind, mechanism.joint(joint), t, x, log, state, mechanism, motion
            )
            checks = OF_POSES if log.poses else CHECKS
            for check in checks.get(kind, ()) if len(x) > SHORTEST else ():
                if (judgement := check(channel)) is not None:
                    number, threshold, meaning, remedy = judgement
                    judgements = same.setdefault((check.__name__, meaning), [])
                    judgements.append((name, number, threshold, remedy))
        if state is not None:
            yield from contradicted(log, state, mechanism)
        for (code, meaning), judgements_of_check in same.items():
            names, (_, number, threshold, remedy) = (
                tuple(name for name, *_ in judgements_of_check),
                judgements_of_check[0],
            )
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
    i = j = 0
    if len(a.t) != len(b.t):
        i, j = int(np.searchsorted(a.t, b.t[0])), int(np.searchsorted(b.t, a.t[0]))
        i, j = min(i, len(a.t) - 1), min(j, len(b.t) - 1)
    count = min(len(a.t) - i, len(b.t) - j)
    n = min(count, COMPARED_SAMPLES)
    if not names or (len(a.t) != len(b.t) and a.t[i] != b.t[j]):
        return []
    for name in names:
        x, y = a.columns[name][i : i + n], b.columns[name][j : j + n]
        x, y = (series[np.isfinite(x) & np.isfinite(y)] for series in (x, y))
        if len(x) <= SHORTEST:
            return []
        far = ROUNDED * noise_level(x) if name[0] == "t" else SAME_POSITION * np.ptp(x)
        if np.linalg.norm(x - y) > far * np.sqrt(len(x)):
            return []
    text = f"{b.name} holds {count} samples of {a.name}: {harm}"
    return [Finding("copy", text, remedy, (b.name,))]
