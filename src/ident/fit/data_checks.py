"""What may be wrong with the data behind a fit, before any missing effect is named.

Channels are judged by their own samples (`channel_checks`), torques as right-hand sides of the
rows of the fit (`channel_fits`). What may be wrong with positions, time and gravity is a list of
suspects, each a state of the mechanism as it would be, tried on few samples:

    sign, axis, scale, exchange of positions      q_j → −q_j, …       `_positions`
    scale of time                                 v, a → v/s, a/s²    `_times`
    direction of gravity                          g → g'              `_gravities`
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ident.display import Displayed
from ident.effects import KINDS
from ident.errors import IdentError
from ident.fit.channel_checks import channel_findings
from ident.fit.channel_fits import (
    AS_WELL,
    CLOSEST,
    LEAVES,
    RIVAL,
    SMALL,
    ChannelCause,
    ChannelEquations,
    CredibleCause,
    credible_t,
    linear_effects,
    unit_of_factor,
)
from ident.fit.findings import Finding
from ident.fit.problem import Problem
from ident.fit.table import Table
from ident.information.blocks import Error
from ident.information.estimate import Estimate
from ident.information.hypotheses import Array, zscore
from ident.mechanism.mechanism import Mechanism
from ident.motion import State

FAULTS = {  # codes of findings that explain a log better than any effects that were found
    "sign", "swapped", "axis", "position sign", "position scale", "position swapped",
    "joints swapped", "time", "gravity", "another run",
}  # fmt: skip
DEGREES = 10.0  # smallest range of a position that may be in degrees
FEW = 300  # samples that tell a right motion from a wrong one
DOUBT = 2.5 * SMALL  # relative error of some torque from which time and gravity are doubted
BAD = 0.05  # the same for positions, of which there are many wrong ones
HALF = 0.5  # of the rms relative error: what explains less of it is an effect, no fault
EARTH = 9.81  # m/s²
CLOCKS = (1 / 60, 0.1, 0.3, 0.7, 0.9, 1.1, 1.5, 3.0, 10.0, 60.0)  # true over logged time
NEARLY = 1.2  # times the error of a fault that one missing effect may leave to be its rival
LIKE = 0.9  # correlation from which the URDF's torque is like the identified one
TIMES = 30.0  # of the URDF's torque at one joint, where a rotor behind its gears may be missing
TOGETHER = 3.0  # the same at all joints alike: masses in a URDF are rarely so wrong, units are
ALIKE = 0.7  # difference of logarithms of factors that are one, bodies being off by some 30 %


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
        """The findings that explain the log, so that no effect need be missing."""
        return tuple(each for each in self.findings if each.code in FAULTS)

    def json(self) -> list[dict[str, Any]]:
        """One dictionary a finding."""
        return [asdict(finding) for finding in self.findings]


@dataclass(frozen=True, eq=False)
class Suspect:
    """Something that may be wrong with positions, time or gravity.

    Attributes:
        kind: the code of its finding; joints: names; number: of it, or three of them.
        state: the mechanism and the state as they would be, from those as they are.
        gain, take: by driven joint, the factor and the channel of the torques that go with it.
    """

    kind: str
    joints: tuple[str, ...]
    number: tuple[float, ...]
    state: Callable[[Mechanism, State], tuple[Mechanism, State]]
    gain: Mapping[int, float]
    take: Mapping[int, int]


@dataclass(frozen=True, eq=False)
class DataChecks:
    """The questions to one fit's data.

    Attributes:
        problem, estimate, train: of the fit.
        table, use: its rows, and which of them count (N, d).
        explained: left-out squares (blocks, d) with the effects that a diagnosis found: a fault of
            the data must explain more.
    """

    problem: Problem
    estimate: Estimate
    train: Mapping[str, Error]
    table: Table
    use: np.ndarray
    explained: Array | None = None

    @classmethod
    def of(cls, problem: Problem, estimate: Estimate, train: Mapping[str, Error]) -> DataChecks:
        """Make the checks of a fit."""
        point = problem.point_at(estimate.x)
        table = Table.of(problem.mechanism, problem.columns, problem.motion, point)
        return cls(problem, estimate, train, table, table.informed)

    @cached_property
    def equations(self) -> ChannelEquations:
        """The fit's rows, with what every machine has."""
        return ChannelEquations.of(self.estimate, self.table, self.use, shifts=True)

    @cached_property
    def reference(self) -> Array:
        """Relative errors (d,) of the log as it is with all linear effects of the library."""
        kinds = {each.kind for each in linear_effects(self.mechanism)}
        reference = self._errors(self.table, self.use, kinds)
        if self.explained is None:
            return reference
        found = np.sqrt(self.explained.sum(axis=0) / self.equations.torque + SMALL**2)
        return found if np.log(found).sum() < np.log(reference).sum() else reference

    def _errors(self, table: Table, use: np.ndarray, kinds: Collection[str]) -> Array:
        """Relative errors (d,) of the log as it is with some kinds of effects at all its drives."""
        equations = ChannelEquations.of(self.estimate, table, use, kinds=kinds)
        return equations.noise(equations.as_logged, np.ones(len(equations.total)))

    def _rivalled(self, after: Array, table: Table, use: np.ndarray) -> bool:
        """Whether one kind of effect, missing at the drives, explains as much as a fault that
        leaves relative errors `after` (d,): then nobody can tell which it is.
        """
        kinds = {each.kind for each in linear_effects(self.mechanism) if not each.common}
        return any(
            _rms(self._errors(table, use, [kind])) < NEARLY * _rms(after) for kind in sorted(kinds)
        )

    @property
    def mechanism(self) -> Mechanism:
        """The fitted mechanism."""
        return self.problem.mechanism

    def health(self) -> Health:
        """Judge the data, gravest first."""
        channels = channel_findings(self.problem)
        if not self.mechanism.driven or not len(self.equations.total):
            return Health(tuple(channels))
        causes, noise = self.equations.credible(self.reference, self.explained)
        if causes and self._rivalled(noise, self.table, self.use):
            causes, noise = [], self.equations.noise(self.equations.as_logged, np.ones(len(noise)))
        found = [_torque_finding(self.mechanism, self.equations, each) for each in causes]
        if suspect := self._suspect(noise):
            found = [suspect]
        found = found or [*self._strangers(noise)] or [*self._magnitudes()]
        return Health((*found, *channels))

    def _strangers(self, noise: Array) -> Iterator[Finding]:
        """Report torques that do not belong to this motion: most of several, for one or two may be
        made by effects that the library does not have, or by a motor that is off.
        """
        names = [f"tau.{self.equations.driven[j]}" for j in self.equations.strangers(noise)]
        if 2 * len(names) >= max(6, len(self.equations.own)) and self.reference.max() > LEAVES:
            text = (
                f"{', '.join(names)}: explained no better by this motion than at another time of "
                "the log: they are of another run, of another joint, or no measurement"
            )
            yield Finding("another run", text, "check columns and files", tuple(names))

    # --- nothing that is known explains the log ---------------------------------------------------

    def poor(self) -> Iterator[Finding]:
        """Report torques of which the model leaves so much that its numbers mean nothing."""
        names = self.problem.motion.independent
        poor = {n: e.relative for n, e in self.train.items() if (e.relative or 0.0) > LEAVES}
        left = [f"{100 * float(self.reference[names.index(n)]):.0f} %" for n in poor]
        if not poor:
            return
        text = "the model leaves " + ", ".join(
            f"{100 * (x or 0.0):.0f} % of tau.{name}" for name, x in poor.items()
        )
        where = tuple(f"tau.{name}" for name in poor)
        if self.reference[[names.index(n) for n in poor]].max() < LEAVES / 2:
            text += ": friction or another effect is missing, and parameters make up for it"
            yield Finding("poor fit", text, "see ident diagnose", where, None, LEAVES)
            return
        strange = [
            f"tau.{self.equations.driven[j]}" for j in self.equations.strangers(self.reference)
        ]
        text += (
            f", and {', '.join(left)} with friction and springs: parameters are not to be trusted. "
            + (f"{', '.join(strange)} may be of another run or no measurement. " if strange else "")
            + "If no fault of the data is named above, none that was tried explains it"
        )
        remedy = "check units, signs, columns and lengths; ident diagnose shows where it fails"
        yield Finding("poor fit", text, remedy, where, None, LEAVES)

    def _magnitudes(self) -> Iterator[Finding]:
        """Torques of another size than the URDF's bodies need: a hint, for a URDF may be wrong."""
        rigid = np.arange(len(self.problem.columns)) < len(self.problem.columns.rigid)
        gains, motion = {}, self.problem.motion
        for name, triangle in zip(motion.independent, self.problem.information.totals, strict=True):
            sizes = [
                triangle.R @ np.where(rigid, x, 0.0)
                for x in (self.estimate.x, self.problem.columns.prior)
            ]
            now, then = map(float, map(np.linalg.norm, sizes))
            fits = (self.train[name].relative or 1.0) < LEAVES
            if (
                fits
                and name in self.mechanism.driven
                and sizes[0] @ sizes[1] > LIKE * now * then > 0
            ):
                gains[name] = now / then
        logs = np.log(list(gains.values()))
        alike = len(gains) > 1 and np.ptp(logs) < ALIKE and np.abs(logs).min() > np.log(TOGETHER)
        found = gains if alike else {n: x for n, x in gains.items() if max(x, 1 / x) > TIMES}
        for names in [list(found)] if alike else [[name] for name in found]:
            gain = float(np.exp(np.mean([np.log(found[name]) for name in names])))
            where = tuple(f"tau.{name}" for name in names)
            text = (
                f"{', '.join(where)}: {gain:.3g} times what the URDF's bodies need, and of the "
                "same shape: a unit, a gear ratio or a torque constant, a wrong unit of time or "
                "length, unless its masses are no real ones"
            )
            remedy = _entry(self.mechanism, where[0], float(f"{1 / gain:.2g}"))
            remedy += ", all alike" if len(names) > 1 else ""
            yield Finding("magnitude", text, remedy, where, gain, TOGETHER if alike else TIMES)

    # --- positions, time and gravity --------------------------------------------------------------

    def _suspect(self, noise: Array) -> Finding | None:
        """Return the suspect that explains the log by far best, if any does better than what wrong
        torques leave, the relative errors `noise` (d,).
        """
        if noise.max() < DOUBT:
            return None
        motion, mechanism = self.problem.motion, self.mechanism
        every = max(1, sum(int(e.usable.sum()) for e in motion.experiments) // FEW)
        thin = [e.at_samples(np.flatnonzero(e.usable)[::every]) for e in motion.experiments]
        as_logged_table = self._table(mechanism, thin)
        as_logged = ChannelEquations.of(self.estimate, as_logged_table, as_logged_table.informed)
        now = as_logged.as_logged
        before = as_logged.noise(now, np.ones(len(noise)))
        base = as_logged.left_out(now, before).sum(axis=1)
        tried: list[tuple[float, Suspect, Array, ChannelEquations]] = []
        several = [*_gravities(mechanism), *_times(CLOCKS)]
        if noise.max() > BAD:
            poor = {name for name, x in zip(motion.independent, noise, strict=True) if x > BAD}
            several += _positions(mechanism, thin, poor)
        equations: ChannelEquations | None = None
        last: object = None
        for each in several:
            if each.state is not last:
                last, equations = each.state, None
                with suppress(IdentError, np.linalg.LinAlgError):  # a motion that does not close
                    equations = self._moved(each, thin)
            # of an absurd motion, as of a clock far off, no rows may be left
            if equations is not None and len(equations.rows) == len(base):
                after = equations.noise(_with(equations, each), np.ones(len(noise)))
                tried.append((float(np.log(after).mean()), each, after, equations))
        if not tried:
            return None
        tried = sorted(tried, key=lambda each: each[0])[:CLOSEST]
        best, suspect, after, equations = tried[0]
        left = equations.left_out(_with(equations, suspect), after).sum(axis=1)
        limit = credible_t(len(several), len(base))
        enough = float(np.log(AS_WELL * self.reference).mean())
        clear = _rms(after) < HALF * min(_rms(before), _rms(noise)) and after.max() < LEAVES
        if not (clear and best < enough and zscore(left - base) > limit):
            return None
        if self._rivalled(after, as_logged_table, as_logged_table.informed):
            return None
        near = [
            each
            for score, each, other, own in tried[1:]
            if score < enough
            and zscore(left - own.left_out(_with(own, each), other).sum(axis=1)) < RIVAL
        ]
        if suspect.kind == "time":
            suspect = self._refined(suspect, thin)
            near = [each for each in near if each.kind != "time"]
        fall = "the error of the predicted torques falls from "
        fall += f"{100 * _rms(before):.3g} % to {100 * _rms(after):.3g} %"
        text, remedy = _said(mechanism, suspect, fall)
        also = "".join(f"; {_said(mechanism, each, 'it falls as far')[0]}" for each in near[:3])
        where = tuple(f"q.{name}" for name in suspect.joints)
        return Finding(suspect.kind, text + also, remedy, where, _rms(after) / _rms(before))

    def _refined(self, suspect: Suspect, thin: list[State]) -> Suspect:
        """The scale of time between those that were tried."""
        from scipy.optimize import minimize_scalar  # takes 0.2 s to import

        def error(x: float) -> float:
            (each,) = _times([float(np.exp(x))])
            moved = self._moved(each, thin)
            return float(np.log(moved.noise(moved.as_logged, np.ones(len(moved.total)))).mean())

        at = CLOCKS.index(suspect.number[0])
        ends = CLOCKS[max(at - 1, 0)], CLOCKS[min(at + 1, len(CLOCKS) - 1)]
        found = minimize_scalar(
            error, bounds=np.log(ends), method="bounded", options={"xatol": 0.003, "maxiter": 12}
        )
        (refined,) = _times([float(np.exp(found.x))])
        return refined

    def _moved(self, suspect: Suspect, thin: Sequence[State]) -> ChannelEquations:
        moved = [suspect.state(self.mechanism, e) for e in thin]
        table = self._table(moved[0][0], [e for _, e in moved])
        return ChannelEquations.of(self.estimate, table, table.informed)

    def _table(self, mechanism: Mechanism, states: Sequence[State]) -> Table:
        """The rows of other states, unfiltered."""
        band = replace(self.problem.motion.band, cutoff=None)
        motion = replace(self.problem.motion, experiments=tuple(states), band=band)
        return Table.of(mechanism, self.problem.columns, motion, self.table.point)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _with(equations: ChannelEquations, suspect: Suspect) -> ChannelCause:
    """The torques that go with a suspect."""
    cause = equations.as_logged
    gain = tuple(suspect.gain.get(j, x) for j, x in enumerate(cause.gain))
    take = tuple(suspect.take.get(j, x) for j, x in enumerate(cause.take))
    return replace(cause, gain=gain, take=take)


def _gravities(mechanism: Mechanism) -> Iterator[Suspect]:
    """Yield gravity along the other axes and none."""
    given = np.asarray(mechanism.model.gravity.linear)
    axes = [sign * EARTH * axis for axis in np.eye(3) for sign in (-1.0, 1.0)]
    for g in (*axes, np.zeros(3)):
        if np.linalg.norm(g - given) < 0.05 * EARTH:
            continue

        def state(mechanism: Mechanism, e: State, g: np.ndarray = g) -> tuple[Mechanism, State]:
            model = mechanism.model.copy()
            model.gravity.linear = g
            return mechanism.with_model(model), e

        yield Suspect("gravity", (), tuple(map(float, g)), state, {}, {})


def _times(factors: Sequence[float]) -> Iterator[Suspect]:
    """Yield other scales of time: true over logged."""
    for s in factors:

        def state(mechanism: Mechanism, e: State, s: float = s) -> tuple[Mechanism, State]:
            slower = replace(
                e, t=s * e.t, v=e.v / s, a=e.a / s**2, yd=e.yd / s, ydd=e.ydd / s**2,
                still=e.still / s,
            )  # fmt: skip
            return mechanism, slower

        yield Suspect("time", (), (s,), state, {}, {})


def _positions(
    mechanism: Mechanism, states: Sequence[State], poor: Collection[str]
) -> Iterator[Suspect]:
    """Yield positions turned (alone, and with their torque: an axis), in degrees, and exchanged
    (alone, and with their torques) where the torque of one is poor.
    """
    names = states[0].logged
    driven = {name: j for j, name in enumerate(mechanism.driven)}
    rows = list(range(len(names)))

    def moved(take: list[int], times: np.ndarray) -> Callable[..., tuple[Mechanism, State]]:
        def state(mechanism: Mechanism, e: State) -> tuple[Mechanism, State]:
            known = e.known(mechanism, names)[:, :, take] * times
            start = "follow" if mechanism.closures else "near"
            return mechanism, e.at(mechanism, known, names, start=start)

        return state

    ones = np.ones(len(names))
    for j, name in enumerate(names):
        at = mechanism.joint_index[name]
        turned = moved(rows, np.where(np.arange(len(names)) == j, -1.0, ones))
        yield Suspect("position sign", (name,), (-1.0,), turned, {}, {})
        if name in driven:
            yield Suspect("axis", (name,), (-1.0,), turned, {driven[name]: -1.0}, {})
        if max(float(np.ptp(e.y[:, at])) for e in states) > DEGREES:
            factor = np.where(np.arange(len(names)) == j, np.pi / 180, ones)
            state = moved(rows, factor)
            yield Suspect("position scale", (name,), (np.pi / 180,), state, {}, {})
        for i in range(j):
            if not {name, names[i]} & set(poor):
                continue
            take = list(rows)
            take[i], take[j] = j, i
            both, state = (names[i], name), moved(take, ones)
            yield Suspect("position swapped", both, (1.0,), state, {}, {})
            if set(both) <= set(driven):
                a, b = driven[names[i]], driven[name]
                yield Suspect("joints swapped", both, (1.0,), state, {}, {a: b, b: a})


def _said(mechanism: Mechanism, suspect: Suspect, fall: str) -> tuple[str, str]:
    """A suspect in words, and the remedy."""
    channels = tuple(f"q.{name}" for name in suspect.joints)
    joints = " and ".join(suspect.joints)
    number = suspect.number[0]
    if suspect.kind == "gravity":
        g = "[" + ", ".join(f"{x:.4g}" for x in suspect.number) + "] m/s²"
        given = ", ".join(f"{x:.4g}" for x in mechanism.model.gravity.linear)
        text = f"gravity: with {g} instead of [{given}] {fall}"
        return text, f"write gravity = {g.removesuffix(' m/s²')}, or turn the base of the URDF"
    if suspect.kind == "time":
        text = f"time: with a clock {number:.4g} times as long {fall}"
        source = mechanism.columns.get("t")
        column, scale = (source.column, source.scale) if source else ("t", 1.0)
        return (
            text,
            f'check the unit of t and the rate of the log; [log] "t" = {{ column = '
            f'"{column}", scale = {number * scale:.4g} }}',
        )
    if suspect.kind == "axis":
        text = f"{joints}: the axis points the other way: with position and torque turned {fall}"
        entries = ", ".join(_entry(mechanism, f"{k}.{joints}", -1.0) for k in ("q", "tau"))
        return text, f"turn the axis of {joints} in the URDF, or write {entries}"
    if suspect.kind == "position sign":
        text = f"{channels[0]}: the sign is wrong: corrected, {fall}"
        return text, f"write {_entry(mechanism, channels[0], -1.0)}, velocity alike"
    if suspect.kind == "position scale":
        text = f"{channels[0]}: in degrees, not in radians: corrected, {fall}"
        return text, f"write {_entry(mechanism, channels[0], number)}, velocity alike"
    torques = ", torques alike" if suspect.kind == "joints swapped" else ""
    text = f"{' and '.join(channels)} look exchanged{torques}: with one in the other's place {fall}"
    return (
        text,
        f"write {_exchange(mechanism, channels)}, velocities{torques.removesuffix(' alike')} alike",
    )


# --- torques ------------------------------------------------------------------------------------


def _torque_finding(
    mechanism: Mechanism, equations: ChannelEquations, found: CredibleCause
) -> Finding:
    """A credible cause in words."""
    cause = found.cause
    names = [mechanism.driven[j] for j in cause.joints]
    channels = tuple(f"tau.{name}" for name in names)
    fall = (
        f"the error of the predicted torque falls from {100 * found.before:.3g} % to "
        f"{100 * found.after:.3g} %"
    )
    number = cause.number
    if cause.kind == "swapped":
        text = f"exchanged: with one in the other's place {fall}"
        remedy = _exchange(mechanism, channels)
    elif cause.kind == "sign":
        joints = " and ".join(f"q.{name}" for name in names)
        text = (
            f"the sign is against that of {joints}: as logged, inertia or friction would be "
            f"negative; turned, {fall}"
        )
        remedy = (
            f"write {', '.join(_entry(mechanism, c, -1.0) for c in channels)}, or turn {joints}"
        )
    elif cause.kind == "scale":
        text = (
            f"reads {1 / number:.3g} times what the other joints' torques require "
            f"({unit_of_factor(number)}): scaled, {fall}"
        )
        remedy = f"check its unit; {_entry(mechanism, channels[0], number)}"
    else:
        number = 1e3 * equations.refined_delay(cause)
        late = f"{abs(number):.3g} ms {'late' if number > 0 else 'early'} against the positions"
        if len(names) > 1 and len(names) == len(mechanism.driven):
            text = (
                f"all torques are {late}: two clocks, or a filter on one of them; without it {fall}"
            )
            remedy = "shift the torque columns together, or filter positions and torques alike"
        else:
            text = f"{late}; without the delay {fall}"
            kinds = [kind for kind, each in KINDS.items() if each.fault == cause.kind]
            effect = "".join(f", or add the effect {kind}:{names[0]}" for kind in kinds)
            remedy = f"shift the column{effect}"
    also = "".join(f"; {_short(mechanism, each)} would do nearly as well" for each in found.rivals)
    return Finding(cause.kind, f"{', '.join(channels)}: {text}{also}", remedy, channels, number)


def _short(mechanism: Mechanism, cause: ChannelCause) -> str:
    names = " and ".join(f"tau.{mechanism.driven[j]}" for j in cause.joints)
    how = {
        "swapped": "exchanging",
        "sign": "turning",
        "scale": f"scaling by {cause.number:.3g}",
        "delay": f"shifting by {1e3 * cause.number:.3g} ms",
    }[cause.kind]
    return f"{how} {names}"


def _entry(mechanism: Mechanism, channel: str, factor: float) -> str:
    """The line of `[log]` that multiplies a channel by a factor."""
    source = mechanism.columns.get(channel)
    column, scale = (source.column, source.scale) if source else (channel, 1.0)
    return f'[log] "{channel}" = {{ column = "{column}", scale = {factor * scale:.4g} }}'


def _exchange(mechanism: Mechanism, channels: tuple[str, ...]) -> str:
    """The lines of `[log]` that exchange two channels."""
    columns = [
        source.column if (source := mechanism.columns.get(c)) else c for c in reversed(channels)
    ]
    return " and ".join(
        f'[log] "{c}" = {{ column = "{column}" }}'
        for c, column in zip(channels, columns, strict=True)
    )
