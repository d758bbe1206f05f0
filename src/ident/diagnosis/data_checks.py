"""The verb `health`: what is wrong with the logged data, before any missing effect is named.

Channels are judged by their own samples when a fit is made (`fit.channel_checks`). Here wrong
signs, units, delays and exchanged columns are tried on the equations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ident.diagnosis.candidates import Contest
from ident.diagnosis.channel_fits import (
    POOR,
    UNITS,
    ChannelCause,
    ChannelEquations,
    CredibleCause,
    credible_t,
)
from ident.display import Displayed
from ident.effects import KINDS
from ident.fit import Fit
from ident.fit.channel_checks import CODES, TIMES
from ident.fit.findings import Finding
from ident.fit.table import Table
from ident.information.hypotheses import Array, zscore
from ident.mechanism.mechanism import Mechanism
from ident.motion import State

DEGREES = 10.0  # smallest range of a position that may be in degrees
FEW = 700  # samples that tell a right motion from a wrong one


@dataclass(frozen=True, repr=False)
class Health(Displayed):
    """Errors in the logged data: `findings`, each with a remedy. From `ident.health`."""

    findings: tuple[Finding, ...]

    @property
    def good(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def json(self) -> list[dict[str, Any]]:
        """One dictionary a finding."""
        return [asdict(finding) for finding in self.findings]


def health(fit: Fit) -> Health:
    """Judge the data behind a fit, from `identify`.

    Returns:
        Its findings, gravest first; `print` shows them in words.
    """
    table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    return _judged(fit, table, table.informed)


def health_beside(contest: Contest, explained: Array) -> Health:
    """The same beside a diagnosis, on its rows: a wrong channel must explain more than the effects
    that it found, which leave squares (blocks, d) of blocks that were left out.
    """
    return _judged(contest.fit, contest.table, contest.use, explained)


def _judged(fit: Fit, table: Table, use: Array, explained: Array | None = None) -> Health:
    equations = ChannelEquations.of(fit, table, use)
    causes = equations.credible(explained)
    found = [_torque_finding(fit.mechanism, equations, each) for each in causes]
    if not causes:
        found += _positions(fit, equations, explained)
        found += _magnitudes(fit, equations)
    # a joint swings freely by the fitted terms, which wrong channels spoil
    codes = CODES if found else CODES | {"swings freely"}
    return Health((*found, *(each for each in fit.findings if each.code in codes)))


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
        size = max(number, 1 / number)
        unit = UNITS[min(UNITS, key=lambda known: abs(size - known))]
        text = (
            f"reads {1 / number:.3g} times what the other joints' torques require ({unit}?): "
            f"scaled, {fall}"
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


def _magnitudes(fit: Fit, equations: ChannelEquations) -> Iterator[Finding]:
    """Torques of another size than the URDF's bodies need: a hint, for a URDF may be wrong."""
    rigid = np.arange(len(fit.columns)) < len(fit.columns.rigid)
    prior = np.where(rigid, fit.columns.prior, 0.0)[~fit.estimate.held]
    for name, gain in equations.magnitudes(prior).items():
        if max(gain, 1 / gain) > TIMES:
            text = (
                f"tau.{name}: {gain:.3g} times what the URDF's bodies need, and of the same shape: "
                "a unit, a gear ratio or a torque constant, unless its masses are no real ones"
            )
            remedy = _entry(fit.mechanism, f"tau.{name}", float(f"{1 / gain:.2g}"))
            yield Finding("magnitude", text, remedy, (f"tau.{name}",), gain, TIMES)


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


# --- positions ----------------------------------------------------------------------------------

Change = tuple[str, tuple[int, ...], list[int], np.ndarray]  # kind, joints, taken from, times


def _positions(fit: Fit, equations: ChannelEquations, explained: Array | None) -> list[Finding]:
    """The exchanged, turned or scaled position of a tree that explains the log best.

    Each costs all rows anew, so that they are tried on few samples and only where the effects that
    a diagnosis found, if any, leave more than POOR of some joint's torque.
    Through closures a wrong position does not close, and `complete` says so.
    """
    mechanism, motion = fit.mechanism, fit.motion
    logged = equations.as_logged
    if mechanism.closures or not equations.own:
        return []
    if explained is None:
        error = equations.noise(logged, np.ones(len(equations.total)))
    else:
        error = np.sqrt(explained.sum(axis=0) / equations.torque)
    if error.max() < POOR:
        return []
    names = tuple(joint.name for joint in mechanism.joints)
    every = max(1, sum(int(e.usable.sum()) for e in motion.experiments) // FEW)
    thin = [e.at_samples(np.flatnonzero(e.usable)[::every]) for e in motion.experiments]
    changes = list(_changes(names, thin))
    states = [thin] + [
        [e.at(mechanism, e.known(mechanism, names)[:, :, take] * times, names) for e in thin]
        for _, _, take, times in changes
    ]
    noises, density = [], []
    for each in states:
        moved = _equations(fit, each)
        noises.append(moved.noise(logged, np.ones(len(names))))
        density.append(moved.left_out(logged, noises[-1]).sum(axis=1))
    best = min(range(len(changes)), key=lambda i: float(np.log(noises[i + 1]).sum()))
    if zscore(density[best + 1] - density[0]) < credible_t(len(changes), len(density[0])):
        return []
    kind, joints, _, times = changes[best]
    channels = tuple(f"q.{names[j]}" for j in joints)
    was, now = (100 * float(np.sqrt(np.mean(x**2))) for x in (noises[0], noises[best + 1]))
    fall = f"the error of the predicted torques falls from {was:.3g} % to {now:.3g} %"
    if kind == "swapped":
        text = f"{' and '.join(channels)} look exchanged: with one in the other's place {fall}"
        remedy = f"write {_exchange(mechanism, channels)}, velocities alike"
    else:
        what = "the sign is wrong" if kind == "sign" else "in degrees, not in radians"
        text = f"{channels[0]}: {what}: corrected, {fall}"
        remedy = f"write {_entry(mechanism, channels[0], times[joints[0]])}, velocity alike"
    return [Finding(f"position {kind}", text, remedy, channels, now / was)]


def _equations(fit: Fit, states: list[State]) -> ChannelEquations:
    """The equations of other states, unfiltered."""
    band = replace(fit.motion.band, cutoff=None)
    motion = replace(fit.motion, experiments=tuple(states), band=band)
    table = Table.of(fit.mechanism, fit.columns, motion, fit.point)
    return ChannelEquations.of(fit, table, table.informed, shifts=False)


def _changes(names: tuple[str, ...], states: list[State]) -> Iterator[Change]:
    same, ones = list(range(len(names))), np.ones(len(names))
    for j in same:
        yield "sign", (j,), same, np.where(np.arange(len(names)) == j, -1.0, ones)
        if max(float(np.ptp(e.y[:, j])) for e in states) > DEGREES:
            yield "scale", (j,), same, np.where(np.arange(len(names)) == j, np.pi / 180, ones)
        for i in range(j):
            take = list(same)
            take[i], take[j] = j, i
            yield "swapped", (i, j), take, ones
