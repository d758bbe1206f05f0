"""Swapped, mis-signed and scaled torque channels, and friction that came out negative, in words."""

from __future__ import annotations

import numpy as np

from ident.fit import Fit
from ident.health.arrange import CLEAR, Change, changes
from ident.health.check import Check
from ident.health.trial import Trial
from ident.mechanism.mechanism import Mechanism

CERTAIN = 3.0  # standard errors below zero at which a coefficient is negative
FAMILIAR = {
    1000.0: "mN m for N m",
    9.81: "kgf m for N m",
    100.0: "N cm for N m",
    10.0: "a factor of ten",
    180 / np.pi: "degrees for radians",
}
SIGNED = ("viscous", "coulomb", "rotor_inertia", "drag")


def exchanged(fit: Fit, trial: Trial) -> list[Check]:
    """Swapped, mis-signed and scaled channels; one quiet check if there are none."""
    found = [_said(fit.mechanism, change) for change in changes(trial)]
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


def _said(mechanism: Mechanism, change: Change) -> Check:
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
            if ratio >= -CERTAIN:
                continue
            channels = tuple(f"tau.{joint}" for joint in each.effect.joints)
            said = f"{value.name} = {value.value:.3g} ± {value.stderr:.2g} {value.unit} is negative"
            found.append(
                Check(
                    "negative", channels, ratio, -CERTAIN, False,
                    f"{said}, which no such effect can be: a sign, or what it stands in for",
                    "check the sign of torque and position; else see which effect is missing",
                    "standard errors",
                )
            )  # fmt: skip
    return found
