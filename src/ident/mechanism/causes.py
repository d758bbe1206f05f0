"""The causes of a mechanism's calibration errors: what may be off, where, by how much; a column."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ident.effects import Effect
from ident.effects.calibration import ClockError, LateTorque
from ident.effects.drive import EncoderOffset, Geometry, PositionDelay, TorqueGain
from ident.information.cause import Cause
from ident.mechanism.calibration import KINDS
from ident.mechanism.mechanism import Mechanism


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibrationError(Cause):
    """An error of the calibration; `effect` has its column, at a value of 0."""

    effect: Effect


def causes_of(
    mechanism: Mechanism, logged: Sequence[str], rate: float
) -> Iterator[CalibrationError]:
    """Yield the causes of a mechanism, for logs of a rate [Hz], 0 of poses, with the positions
    `logged`; without those that an effect of the mechanism has already.
    """
    for kind, place, effect, size, unit in _every(mechanism, logged):
        keys = (place, place.rpartition(".")[0], place.partition(".")[2])
        amount, source = mechanism.calibration.amount(kind, *filter(None, keys), unit=unit)
        scale = amount.number
        if kind in ("lateness", "clock") and not rate:  # poses have no time
            continue
        if amount.unit == "sample":
            scale, source = scale / rate, f"{source}; samples of {1e3 / rate:.3g} ms"
        elif amount.unit == "1":
            scale *= size
        elif amount.unit != unit:  # degrees of a joint that slides
            defaults = (x.number for x in KINDS[kind].default if x.unit == unit)
            scale = next(defaults, scale)
        if scale > 0:
            name = f"{KINDS[kind].words} {place}".strip()
            places, of = (place,) if place else (), mechanism.placed(effect)
            yield CalibrationError(name, kind, places, scale, unit, source, effect=of)


def _every(
    mechanism: Mechanism, logged: Sequence[str]
) -> Iterator[tuple[str, str, Effect, float, str]]:
    """Yield kind, place, effect, size of what may be off, and the unit of the error."""
    present = {effect.common_label for effect in mechanism.effects}
    present |= {f"late_torque:{x.joints[0]}" for x in mechanism.effects if x.fault == "delay"}
    every: list[tuple[str, str, Effect, float, str]] = [("clock", "", ClockError(()), 1.0, "1")]
    for name in mechanism.measured:
        every.append(("tau", f"tau.{name}", TorqueGain((name,)), 1.0, "1"))
    for name in logged:
        unit = mechanism.joint(name).unit
        every.append(("q", f"q.{name}", EncoderOffset((name,)), 1.0, unit))
    for place in mechanism.sites.length:
        size = abs(mechanism.lengths[place])
        every.append(("length", place, Geometry((place,)), size, "m"))
    for name in mechanism.measured:
        every.append(("lateness", f"tau.{name}", LateTorque((name,)), 1.0, "s"))
    # what a drive supplies follows its position, and has a delay of its own
    for name in (name for name in logged if name not in mechanism.drives):
        every.append(("lateness", f"q.{name}", PositionDelay((name,)), 1.0, "s"))
    return (entry for entry in every if entry[2].label not in present)
