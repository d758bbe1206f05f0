"""What a log says of its drives before anything is fitted: scale, command, what it tells apart.

The scale of a drive (kp, kt, gain) is known where the rank of the equations supports it; what it
rests on is read off the tree: its own number, a body that it carries, another drive or a torque
sensor whose bodies it carries as well. If nothing gives it, everything is a ratio to one gain.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.effects import Effect
from ident.effects.command import held_samples, linear_samples
from ident.effects.servo import Drive
from ident.errors import FitError
from ident.fit import Fit
from ident.fit.drives import with_sensors_first
from ident.fit.identify import identify
from ident.fit.shapes import NoScale
from ident.fit.values import absorbed_by
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.commands import ON_ABOVE
from ident.text import listed, percent, shortlist, significant

INSEPARABLE = 0.98  # level: correlation of two estimates: each is five times as uncertain
UNKNOWN = "not known"
HELD_STILL = "none: it holds its joint still, whose equation is left out"


@dataclass(frozen=True)
class DriveCheck:
    """What a log says of the drive of one joint.

    Attributes:
        joint: its name; kind: of its drive.
        scale: what its scale rests on, in words; known: whether anything gives it one.
        error: of the scale, as a share of it, one standard deviation; None without one.
        command: how it changes between samples, and how often the drive is off.
        apart: what this log does not tell apart, and the cheapest change that would.
    """

    joint: str
    kind: str
    scale: str
    known: bool
    error: float | None = None
    command: str = ""
    apart: tuple[str, ...] = ()

    def json(self) -> dict[str, Any]:
        """Return it as a dictionary."""
        return {**vars(self), "apart": [*self.apart]}


def check_drives(mechanism: Mechanism, motion: Motion | None) -> tuple[DriveCheck, ...]:
    """Return a check of each drive of a mechanism whose commands a motion's logs have.

    Drives of joints whose torque is measured are none: a sensor goes first, as in `identify`.

    Raises:
        FitError: if some logs have the torque of a driven joint, and others its command alone.
    """
    if motion is None or not mechanism.drives or not motion.experiments:
        return ()
    mechanism, _ = with_sensors_first(mechanism, motion)
    drives = mechanism.drives
    if any(name not in e.extra for d in drives.values() for name in d.reads()
           for e in motion.experiments):  # fmt: skip
        return ()
    fit, unscaled = _tried(mechanism, motion)
    without = {name: UNKNOWN for name in unscaled}
    if fit is not None:
        without |= {name: HELD_STILL for name in drives if name not in fit.mechanism.drives}
    return tuple(
        DriveCheck(
            name,
            drive.kind,
            without.get(name) or _rests_on(mechanism, name, drive, motion),
            name not in without,
            _error(fit, drive),
            _command(drive, motion),
            tuple(_not_apart(fit, drive, motion)),
        )
        for name, drive in drives.items()
    )


def scale_problem(checks: tuple[DriveCheck, ...]) -> str:
    """Return the problem of drives without a scale with its remedies, or ""."""
    names = [check.joint for check in checks if check.scale == UNKNOWN]
    if not names:
        return ""
    first = names[0]
    return (
        f"nothing gives the torques of {listed(names)} a scale, so everything is a ratio to one "
        f"gain: give one (--drive {first}:kp=…), a known body that these drives carry, or a "
        f"second log with a known payload; --drive {first}:kp=1 gives the ratios"
    )


def drive_rows(checks: tuple[DriveCheck, ...]) -> list[list[str]]:
    """Return the checks as a table, the head first."""
    rows = [["drive", "", "scale", "command"]]
    for check in checks:
        error = "" if check.error is None else f", ± {percent(check.error)}"
        rows.append([check.joint, check.kind, check.scale + error, check.command])
    return rows


def _tried(mechanism: Mechanism, motion: Motion) -> tuple[Fit | None, set[str]]:
    """Return a fit with the friction that a drive's damping may be, and drives without a scale."""
    present = {effect.label for effect in mechanism.effects}
    model = mechanism
    for name in mechanism.drives:
        if f"viscous:{name}" not in present:
            model = model.with_effect(f"viscous:{name}")
    try:
        return identify(model, motion, estimator="least-squares"), set()
    except NoScale as error:
        return None, {*error.joints}
    except FitError:
        return None, set()


def _rests_on(mechanism: Mechanism, name: str, drive: Effect, motion: Motion) -> str:
    """Return what a drive's scale rests on, in words."""
    unit = dict(zip((p.name for p in drive.parameters), drive.units, strict=True))[drive.scale]
    if drive.scale in drive.values:
        return f"{drive.scale} = {significant(drive.values[drive.scale])} {unit}, given"
    bodies = mechanism.bodies
    unknown = {link.rsplit(".", 1)[0] for link in mechanism.unknown}
    carried = _carried(mechanism, name)
    known = [
        link
        for link in carried
        if link not in unknown and mechanism.prior[bodies.columns(link)].any()
    ]
    if known:
        return f"by known bodies: {shortlist(known[::-1], 3)}"
    loads = [e.loaded_link for e in mechanism.effects if e.loaded_link in carried and e.known]
    if loads:
        return f"by a known payload on {loads[0]}"
    others = [
        other
        for other in mechanism.driven
        if other != name and {*_carried(mechanism, other)} & {*carried}
    ]
    for other in others:
        if other in mechanism.measured:
            return f"by the torque sensor of {other}"
        given = mechanism.drives.get(other)
        if given is not None and given.scale in given.values:
            return f"by the given {given.scale} of {other}, which carries the same bodies"
    if any((e.extra.get(f"on.{name}", np.ones(1)) < ON_ABOVE).any() for e in motion.experiments):
        return "by the drive off"
    return "by other joints"


def _carried(mechanism: Mechanism, name: str) -> list[str]:
    """Return the links that a joint of the tree carries."""
    model = mechanism.model
    if not model.existJointName(name):
        return []
    return [mechanism.bodies.links[i - 1] for i in model.subtrees[model.getJointId(name)]]


def _error(fit: Fit | None, drive: Effect) -> float | None:
    """Return the standard error of a drive's scale as a share of it."""
    for effect in fit.effects if fit is not None else ():
        for p in effect.parameters:
            if p.name == drive.full[drive.scale] and p.stderr and p.value:
                return abs(p.stderr / p.value)
    return None


def _command(drive: Effect, motion: Motion) -> str:
    """Return how a command is held, and how often the drive is off."""
    words = []
    name, column = drive.joints[0], drive.reads()[0]
    for e in motion.experiments[:1]:
        x, ms = e.extra[column], 1e3 / e.rate if e.rate else 0.0
        straight = isinstance(drive, Drive) and drive.goes_straight(e.extra)
        between = "straight on between them" if straight else "held between them"
        if (n := held_samples(x)) > 1:
            words.append(f"{column} constant for {n} samples ({n * ms:.3g} ms)")
        elif (n := linear_samples(x)) > 1:
            words.append(f"{column} straight for {n} samples ({n * ms:.3g} ms), {between}")
        else:
            words.append(f"{column} new in each sample, {between}")
    off = [float((e.extra[f"on.{name}"] < ON_ABOVE).mean())
           for e in motion.experiments if f"on.{name}" in e.extra]  # fmt: skip
    if off and max(off) > 0:
        words.append(f"off for {percent(float(np.mean(off)))} of the time")
    return ", ".join(words)


def _not_apart(fit: Fit | None, drive: Effect, motion: Motion) -> Iterator[str]:
    """Yield what of a drive's damping, viscous friction and delay a log does not tell apart."""
    if fit is None:
        return
    name = drive.joints[0]
    damping = next((drive.full[s.name] for s in drive.shapes if s.name != drive.scale), "")
    friction = f"viscous.{name}.Fv"
    carriers = absorbed_by(fit.columns, fit.estimate.base)
    pair = {damping, friction}
    one = [x for x in pair if x in carriers and pair - {x} & {*carriers[x].split(", ")}]
    if damping and one:
        short = damping.rpartition(".")[2]
        yield (
            f"{name}: {short} and viscous friction are one number, their sum; the cheapest change: "
            f"switch the drive off for a second (on.{name}), or give {short} from the controller"
        )
    with suppress(FitError):
        for a, b, r in fit.correlation.pairs(INSEPARABLE):
            if damping in (a, b) and any(x.startswith("command_delay") for x in (a, b)):
                wider = significant(1 / np.sqrt(max(1 - r**2, 1e-12)), 2)
                short, band = damping.rpartition(".")[2], significant(2 * motion.band.motion, 2)
                yield (
                    f"{name}: {short} and the delay are hardly told apart (correlation {r:.3f}, "
                    f"each {wider} times as uncertain as alone); give one of them, or command up "
                    f"to {band} Hz"
                )
