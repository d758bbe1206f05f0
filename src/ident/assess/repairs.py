"""What is put right in a log or a mechanism's file, where an effect says that it is wrong there."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from ident.finding import Finding
from ident.fit import Fit
from ident.fit.values import EffectValues
from ident.information.evidence import CERTAIN
from ident.log import Column
from ident.request import Repair, Step

# effects of channels that are late, with the prefix of the channel
LATE = {"delay": "tau", "position_delay": "q"}
ROUNDING = 1e-9  # numerics: [m] of an origin, in the file and in the model


def repairs_of(fit: Fit, but: Collection[str] = ()) -> tuple[Repair, ...]:
    """Return what is put right in place of a fit's effects that correct data, gravity or lengths.

    Effects of which no value is beyond its error, those of known values and those whose labels are
    in `but`, as of effects with rivals, are none.
    """
    return tuple(
        repair
        for values in fit.effects
        if values.effect.label not in but and _certain(values)
        for repair in _repairs(fit, values)
    )


def repairing_step(fit: Fit, effects: Collection[str] = (), but: Collection[str] = ()) -> Step:
    """Return the step that puts things right and identifies again with those of the `effects` (by
    label) that stay; an empty one where nothing is to be put right.
    """
    repairs = repairs_of(fit, but)
    if not repairs:
        return Step()
    gone = {repair.effect for repair in repairs}
    rest = tuple(label for label in effects if label not in gone)
    return Step("identify", rest, repairs=repairs)


def correcting_step(verb: str, findings: Collection[Finding]) -> Step:
    """Return the step that takes into a model the faults of the data for which it has effects; an
    empty one where there are none, or something else is wrong that no model can have.
    """
    if not findings or not all(finding.effects for finding in findings):
        return Step()
    return Step(verb, tuple(dict.fromkeys(x for finding in findings for x in finding.effects)))


def _certain(values: EffectValues) -> bool:
    """Return whether a value of an effect is beyond its error; one that is known has none."""
    return any(
        x.stderr and np.isfinite(x.stderr) and abs(x.value) > CERTAIN * x.stderr
        for x in values.parameters
    )


def _repairs(fit: Fit, values: EffectValues) -> Iterator[Repair]:
    """Yield what is put right in place of an effect; nothing for one that is part of a machine."""
    effect, mechanism = values.effect, fit.mechanism
    number = [x.value for x in values.parameters]
    unit = values.parameters[0].unit
    file = "" if mechanism.toml is not None else mechanism.urdf.name
    if effect.kind == "encoder_offset":
        channel = f"q.{effect.joints[0]}"
        source = mechanism.columns.get(channel, Column(channel))
        now = (source.scale, source.offset + number[0])  # q = q_logged + delta
        yield Repair(effect.label, "offset", channel, number[0], unit, source.column, now, file)
    elif effect.kind == "torque_gain":
        channel, factor = f"tau.{effect.joints[0]}", 1 + number[0]  # τ_logged = (1 + g) τ
        source = mechanism.columns.get(channel, Column(channel))
        now = (source.scale / factor, source.offset / factor)
        yield Repair(effect.label, "scale", channel, factor, "1", source.column, now, file)
    elif effect.kind in LATE:
        for joint in effect.joints:
            channel = f"{LATE[effect.kind]}.{joint}"
            column = mechanism.columns.get(channel, Column(channel)).column
            yield Repair(effect.label, "delay", channel, number[0], unit, column)
    elif effect.kind == "geometry":
        place = effect.joints[0]
        lengths = _origin(fit, place, number[0])
        yield Repair(effect.label, "length", place, number[0], unit, "", lengths)
    elif effect.kind == "gravity_tilt":
        x, y = number
        cos, sin = np.cos, np.sin
        R = np.array([[1, 0, 0], [0, cos(x), -sin(x)], [0, sin(x), cos(x)]])
        R = R @ np.array([[cos(y), 0, sin(y)], [0, 1, 0], [-sin(y), 0, cos(y)]])
        gravity = R.T @ np.asarray(mechanism.model.gravity.linear)  # the base is turned by R
        angle = float(np.arccos(np.clip(cos(x) * cos(y), -1, 1)))
        yield Repair(
            effect.label, "gravity", "base", angle, unit, "", tuple(map(float, gravity)), file
        )


def _origin(fit: Fit, place: str, by: float) -> tuple[float, ...]:
    """Return a joint's coordinate in the URDF [m] as it is, and displaced; nothing where the file
    states another number than the model has, as where links are joined rigidly in between.
    """
    from lxml import etree  # takes time to import

    joint, _, axis = place.rpartition(".")
    model, urdf = fit.mechanism.model, fit.mechanism.urdf
    if not model.existJointName(joint) or urdf.suffix != ".urdf":
        return ()
    try:
        robot = etree.parse(urdf).getroot()
    except (OSError, etree.XMLSyntaxError):  # not there any more
        return ()
    for element in robot.iterfind("joint"):
        origin = element.find("origin")
        if element.get("name") == joint and origin is not None:
            xyz = np.array([float(word) for word in origin.get("xyz", "0 0 0").split()])
            given = model.jointPlacements[model.getJointId(joint)].translation
            if np.abs(given - xyz).max() < ROUNDING:
                before = float(xyz["xyz".index(axis)])
                return before, before + by
    return ()
