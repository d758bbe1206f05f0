"""A mechanism whose links have coordinates of their own beside their motors', for integration.

A joint that is not rigid becomes two: the motor, under the joint's name, with friction, rotor and
drive, and behind it a passive joint about the same axis, the link less the motor, with a spring or
two stops. What is simulated is then an ordinary mechanism.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pinocchio as pin

from ident.effects import Effect, Signals, Unknown
from ident.effects.drive import RotorInertia
from ident.effects.frame import FrameForce
from ident.effects.joint import Spring, Viscous
from ident.effects.transmission import Backlash, Elasticity
from ident.equations.unknowns import Point
from ident.errors import MechanismError
from ident.mechanism.mechanism import Joint, Mechanism
from ident.mechanism.parameters import COUNT, Bodies
from ident.motion import State

TWIST = ".twist"  # ends the name of a link's own coordinate
MOTOR = ".motor"  # and that of the motor's body, which has no mass
STOP_FREQUENCY = 150.0  # range: [Hz] at which a motor swings against a stop: a hard one


@dataclass(frozen=True)
class Stops(Effect):
    """Two hard ends of a play, in which what flies against them stays."""

    kind = "stops"
    settings: ClassVar = {"width": 0.0, "damping": 0.0}
    unknowns = (Unknown("k", ("N m/rad", "N/m"), "stiffness", True),)
    equation = "k (q ∓ width/2) + damping q̇ beyond ±width/2, never pulling"
    signature = "of a simulation"
    source = "Flores, Lankarani, Contact Force Models for Multibody Dynamics, ch. 2"

    def columns(self, s: Signals) -> np.ndarray:  # noqa: D102
        depth = s.q - np.clip(s.q, -0.5 * self.setting("width"), 0.5 * self.setting("width"))
        push = depth + self.setting("damping") * s.v
        pushing = np.where(depth > 0, np.maximum(push, 0.0), np.minimum(push, 0.0))
        return np.where(depth == 0, 0.0, pushing)[:, :, None]


def twisting(
    mechanism: Mechanism, point: Point, e: State | None
) -> tuple[Mechanism, Point, State | None]:
    """Return a mechanism in which links twist on their own, its point, and a state's like.

    Args:
        mechanism: with its effects; point: the values of all their parameters.
        e: a state in which the motors are at y and the links at q; or None.

    Raises:
        MechanismError: for a twist in a loop, or of a joint whose motor has no inertia.
    """
    soft = {
        effect.joints[0]: effect
        for effect in mechanism.effects
        if isinstance(effect, Elasticity | Backlash) and point.of(effect)[1].get(effect.extent)
    }
    if not soft:
        return mechanism, point, e
    for effect in soft.values():
        _check(mechanism, point, effect)
    model, order = _divided(mechanism, [*soft])
    names = [f"{name}{TWIST}" for name in soft]
    links = [f"{model.names[i]}{MOTOR}" if old < 0 else mechanism.bodies.links[old]
             for i, old in enumerate(order, 1)]  # fmt: skip
    bodies = [*point.pi.reshape(-1, COUNT), np.zeros(COUNT)]  # −1: of a motor
    pi = np.concatenate([bodies[old] for old in order])
    joints = [replace(j, index=model.joints[model.getJointId(j.name)].idx_v)
              for j in mechanism.joints]  # fmt: skip
    joints += [
        Joint(name, mechanism.joint(of).rotational, model.joints[model.getJointId(name)].idx_v)
        for name, of in zip(names, soft, strict=True)
    ]
    start = np.zeros(model.nq)
    for joint in mechanism.joints:
        start[model.joints[model.getJointId(joint.name)].idx_q] = mechanism.start[joint.index]
    others = [effect for effect in mechanism.effects if effect not in soft.values()]
    links_of = dict(zip(soft, names, strict=True))
    springs, values = [], dict(point.values)
    for name, effect in soft.items():
        for new, given in _forces(mechanism, point, effect, links_of[name]):
            springs.append(new)
            values |= {new.full[key]: x for key, x in given.items()}
    divided = replace(
        mechanism, model=model, bodies=Bodies(tuple(links)), joints=tuple(joints), start=start,
        passive=(*mechanism.passive, *names), unknown=(), plausible=None, covariance=None,
        effects=(*others, *springs),
    )  # fmt: skip
    # forces at places act on the links' own coordinates too
    placed = [divided.placed(x) if isinstance(x, FrameForce) else x for x in divided.effects]
    divided = replace(divided, effects=tuple(placed))
    return divided, Point(pi, values), None if e is None else _extended(divided, mechanism, e, soft)


def _check(mechanism: Mechanism, point: Point, effect: Effect) -> None:
    (joint,) = effect.joints
    if mechanism.closures:
        raise MechanismError(
            f"effect '{effect.label}': cannot be integrated in a mechanism with closures; leave it "
            "out, or simulate a given motion (without --forward)"
        )
    rotor = f"{RotorInertia.kind}.{joint}.Ia"
    if not point.values.get(rotor, 0.0) > 0:
        raise MechanismError(
            f"effect '{effect.label}': cannot be integrated: the motor of {joint} has no inertia; "
            f"add rotor_inertia:{joint} with a value above 0"
        )


def _divided(mechanism: Mechanism, soft: list[str]) -> tuple[pin.Model, list[int]]:
    """Return the model with two joints for each that is soft, and by body where it was, −1 of a
    motor's.
    """
    old, new = mechanism.model, pin.Model()
    new.gravity, new.name = old.gravity, old.name
    place, order = {0: 0}, []
    for i in range(1, old.njoints):
        name, joint, placement = old.names[i], old.joints[i], old.jointPlacements[i]
        at = new.addJoint(place[old.parents[i]], joint, placement, name)
        if name in soft:
            order.append(-1)
            at = new.addJoint(at, joint, pin.SE3.Identity(), f"{name}{TWIST}")
        order.append(i - 1)
        new.appendBodyToJoint(at, old.inertias[i], pin.SE3.Identity())
        place[i] = at
    for frame in old.frames:
        if frame.type == pin.FrameType.BODY:
            new.addBodyFrame(frame.name, place[frame.parentJoint], frame.placement, 0)
    return new, order


def _forces(
    mechanism: Mechanism, point: Point, effect: Effect, name: str
) -> list[tuple[Effect, dict[str, float]]]:
    """Return the effects of a link's own coordinate with their values."""
    shape, turns = point.of(effect)[1], effect.rotational
    if isinstance(effect, Elasticity):
        spring = Spring((name,), rotational=turns), {"k": 1 / shape["compliance"], "b": 0.0}
        return [spring, (Viscous((name,), rotational=turns), {"Fv": shape["damping"]})]
    (joint,) = effect.joints
    reduced = point.values[f"{RotorInertia.kind}.{joint}.Ia"]
    rate = 2 * np.pi * STOP_FREQUENCY
    given = {"width": shape["width"], "damping": 2 / rate}
    return [(Stops((name,), given, turns), {"k": reduced * rate**2})]


def _extended(
    divided: Mechanism, mechanism: Mechanism, e: State, soft: Mapping[str, Effect]
) -> State:
    """Return a state with the twists behind the other coordinates."""
    at = [mechanism.joint_index[name] for name in soft]
    link = [mechanism.joint(name).index for name in soft]
    series = []
    for q, y in ((e.q, e.y), (e.v, e.yd), (e.a, e.ydd)):
        joints = np.hstack([y, q[:, link] - y[:, at]])
        generalised = np.zeros((len(e), divided.model.nv))
        generalised[:, [joint.index for joint in divided.joints]] = joints
        series.append((generalised, joints))
    (q, y), (v, yd), (a, ydd) = series
    still = np.concatenate([e.still, e.still[at]])
    return replace(e, q=q, v=v, a=a, y=y, yd=yd, ydd=ydd, still=still)
