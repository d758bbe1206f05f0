"""What is exported: a mechanism with the value of every parameter, as simulators see machines.

    M(q) q̇' + h(q, q̇) + Σ E_k c_k + Jᵀλ = Wᵀτ      all at their values, corrections applied

Lengths, gravity and positions are corrected, so that a target writes what it is given: `geometry`
moves places, `gravity_tilt` turns gravity, `encoder_offset` is the coordinate at which a joint is
in the pose of the drawing. Of bodies that cannot exist the nearest possible ones are taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from ident.equations.unknowns import Point
from ident.errors import MechanismError, one_of
from ident.fit.files import Saved
from ident.fit.result import Fit
from ident.mechanism.description import joint_axis
from ident.mechanism.mechanism import Joint, Mechanism
from ident.mechanism.parameters import COUNT, about_origin, pseudo_inertia, split
from ident.simulate.inverse import point_of
from ident.simulate.plant import constant_correction

SMALL = 1e-12  # numerics: [kg, kg m²] of a body that is none


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in its joint's frame."""

    mass: float  # [kg]
    centre: np.ndarray  # (3,) [m]
    inertia: np.ndarray  # (3, 3) [kg m²] about the centre

    @classmethod
    def of(cls, pi: np.ndarray) -> Body:
        """Take ten dynamic parameters (10,) about the frame's origin."""
        m, moments, L = split(pi)
        centre = moments / m if m else np.zeros(3)
        return cls(m, centre, L - about_origin(m, moments))

    @property
    def six(self) -> np.ndarray:
        """(6,) xx, yy, zz, xy, xz, yz of its inertia."""
        return self.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]

    @property
    def none(self) -> bool:
        """Whether nothing is there."""
        return abs(self.mass) < SMALL and bool(np.abs(self.inertia).max() < SMALL)

    def at(self, placement: pin.SE3) -> Body:
        """Return the body in a frame in which its own is at `placement`."""
        R = placement.rotation
        return Body(self.mass, placement.act(self.centre), R @ self.inertia @ R.T)


@dataclass(frozen=True, eq=False)
class Link:
    """A moving link with the joint that moves it."""

    name: str
    joint: Joint
    parent: int  # index into `Machine.links`; −1: the ground
    placement: pin.SE3  # of the joint in its parent's frame, at q = 0
    axis: np.ndarray  # (3,) in the joint's frame
    pi: np.ndarray  # (10,) dynamic parameters, without payloads
    offset: float = 0.0  # true coordinate less the one that is logged [rad | m]

    @property
    def body(self) -> Body:
        """The rigid body."""
        return Body.of(self.pi)


@dataclass(frozen=True, eq=False)
class Machine:
    """A mechanism at its values.

    Attributes:
        mechanism: as it was given, with its effects.
        drawing: the same with lengths and gravity corrected by them.
        links: moving links in the order of q.
        point: values of all parameters.
        substituted: links whose identified bodies cannot exist, with the nearest in their place.
    """

    mechanism: Mechanism
    drawing: Mechanism
    links: tuple[Link, ...]
    point: Point
    substituted: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Of the mechanism."""
        return self.mechanism.name

    @property
    def gravity(self) -> np.ndarray:
        """(3,) [m/s²]."""
        return np.array(self.drawing.model.gravity.linear)

    @cached_property
    def by_joint(self) -> Mapping[str, Link]:
        """The links by their joints' names."""
        return {link.joint.name: link for link in self.links}

    @cached_property
    def values(self) -> Mapping[str, Mapping[tuple[str, ...], dict[str, float]]]:
        """Parameters of effects by short name: by kind, then joints; those of no size left out."""
        result: dict[str, dict[tuple[str, ...], dict[str, float]]] = {}
        for effect in self.mechanism.effects:
            c, shape = self.point.of(effect)
            values = dict(zip((u.name for u in effect.unknowns), map(float, c), strict=True))
            settings = {name: effect.setting(name) for name in effect.settings}
            if any(values.values()) or effect.corrects:
                result.setdefault(effect.kind, {})[effect.joints] = {**settings, **values, **shape}
        return result

    def value(self, kind: str, joint: str, name: str) -> float:
        """Return a parameter of an effect at one joint, 0 where there is none."""
        return self.values.get(kind, {}).get((joint,), {}).get(name, 0.0)

    def speaks_of(self, kind: str, joint: str) -> bool:
        """Return whether the model has such an effect at a joint, be its value zero: what it does
        not speak of stays as it is in a file of the user.
        """
        return f"{kind}:{joint}" in {effect.label for effect in self.mechanism.effects}

    def payloads(self, link: str) -> np.ndarray | None:
        """Return the ten parameters (10,) of the payload on a link, if there is one."""
        result = self.values.get("payload", {}).get((link,))
        return None if result is None else np.array([*result.values()])

    def total(self, link: Link) -> np.ndarray:
        """Return the ten parameters (10,) of a link with its payload."""
        payload = self.payloads(link.name)
        return link.pi if payload is None else link.pi + payload

    def model(self) -> pin.Model:
        """Return Pinocchio's model with the bodies and payloads of all links."""
        model = self.drawing.model.copy()
        for link in self.links:
            body = self.total(link)
            model.inertias[model.getJointId(link.joint.name)] = (
                pin.Inertia.FromDynamicParameters(body) if body[0] > 0 else pin.Inertia.Zero()
            )
        return model

    def separate_payload(self, link: Link) -> bool:
        """Whether both the link and its payload are possible bodies, so that each is one."""
        payload = self.payloads(link.name)
        return payload is not None and possible(payload) and possible(link.pi)

    @cached_property
    def start(self) -> np.ndarray:
        """The assembled configuration (nq,)."""
        return self.drawing.assembled


def possible(pi: np.ndarray) -> bool:
    """Return whether ten parameters (10,) are those of a body that can exist."""
    P = pseudo_inertia(pi)
    return bool(pi[0] > 0 and np.linalg.eigvalsh(P)[0] > -1e-9 * np.abs(P).max())


def machine_of(
    model: Fit | Saved | Mechanism,
    values: Mapping[str, float] | None = None,
    without: Sequence[str] = (),
    gravity: Sequence[float] | None = None,
) -> Machine:
    """Return a mechanism, or that of a fit, at the values of all its parameters.

    Args:
        model: a fit, one read back, or a mechanism whose effects have values.
        values: other values of parameters, by full name.
        without: effects that are left out, as `payload:tool`.
        gravity: another one (3,) [m/s²].

    Raises:
        MechanismError: for an effect without a value, or a name that is not there.
    """
    mechanism = model if isinstance(model, Mechanism) else model.mechanism
    substituted: tuple[str, ...] = ()
    if isinstance(model, Fit):
        nearest = model.possible
        point = model.point if nearest is None else model.problem.point_at(nearest.x)
        substituted = nearest.links if nearest else ()
    elif isinstance(model, Saved):
        point = model.possible or model.point
        substituted = _changed_links(model)
    else:
        point = replace(Point.prior(mechanism), pi=mechanism.prior)  # as it is written
    for label in without:
        mechanism = mechanism.without(label)
    if gravity is not None:
        mechanism = mechanism.with_gravity(gravity)
    given = {**(values or {})}
    pi = mechanism.bodies.with_values(point.pi, given)
    known = {full for effect in mechanism.effects for full in effect.names}
    for name in given:
        if name not in known:
            raise MechanismError(
                f"{mechanism.name}: no parameter '{name}'; "
                f"{one_of(name, [*known, *mechanism.bodies.names])}"
            )
    point = point_of(mechanism, {**_of(point, known), **given}, pi)
    corrected, offsets = mechanism, dict[str, float]()
    for effect in mechanism.effects:
        correction = constant_correction(effect, point)
        corrected = corrected.corrected(correction)
        offsets |= {name: float(np.ravel(dq)[0]) for name, dq in correction.dq.items()}
    return Machine(mechanism, corrected, _links(corrected, point, offsets), point, substituted)


def check_scale(model: Fit | Saved | Mechanism, machine: Machine) -> None:
    """Refuse a fit in ratios to a gain of 1 where gravity acts: masses would be no kilograms.

    Raises:
        MechanismError: with what gives the fit a scale.
    """
    if isinstance(model, Mechanism) or not np.any(machine.gravity):
        return
    mechanism = model.mechanism
    names = {word for base in model.base_parameters for word in base.name.split() if "." in word}
    scales = {
        joint: float(model.point.values[name])
        for joint, drive in mechanism.drives.items()
        if (name := f"{drive.kind}.{joint}.{drive.scale}") not in names  # else it was identified
    }
    if {*mechanism.driven} - {*mechanism.drives} or {*scales.values()} != {1.0}:
        return  # a sensor, or a gain, gives the torques a scale
    unknown = model.fitted if isinstance(model, Saved) else {*mechanism.unknown}
    both = zip(mechanism.bodies.names, mechanism.prior, strict=True)
    if any(x and name not in unknown for name, x in both):
        return  # a known body
    joint = next(iter(scales))
    scale = mechanism.drives[joint].scale
    raise MechanismError(
        f"{machine.name}: the fit is in ratios to {scale} = 1 of '{joint}', so its masses are no "
        f"kilograms, and gravity acts on them: identify with the gain itself (--drive {joint}:"
        f"{scale}=…) or a known body, or export without gravity: --gravity 0,0,0"
    )


def shares_of(
    model: Fit | Saved | Mechanism,
    shares: Mapping[str, float],
    values: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Return values that are shares of those of a model, by full name; `values`: of others.

    Raises:
        MechanismError: for a name that is not there.
    """
    if not shares:
        return {}
    machine = machine_of(model, values)
    bodies = machine.mechanism.bodies
    known = dict(zip(bodies.names, map(float, machine.point.pi), strict=True))
    for effect in machine.mechanism.effects:
        known |= {name: float(machine.point.values[name]) for name in effect.names}
    for name in shares:
        if name not in known:
            raise MechanismError(f"{machine.name}: no parameter '{name}'; {one_of(name, known)}")
    return {name: share * known[name] for name, share in shares.items()}


def _of(point: Point, names: set[str]) -> dict[str, float]:
    return {name: float(x) for name, x in point.values.items() if name in names}


def _changed_links(saved: Saved) -> tuple[str, ...]:
    if saved.possible is None:
        return ()
    both = zip(
        saved.mechanism.bodies.links, saved.point.pi.reshape(-1, COUNT),
        saved.possible.pi.reshape(-1, COUNT), strict=True,
    )  # fmt: skip
    return tuple(link for link, a, b in both if not np.allclose(a, b))


def _links(mechanism: Mechanism, point: Point, offsets: Mapping[str, float]) -> tuple[Link, ...]:
    model, links = mechanism.model, []
    joints = {joint.name: joint for joint in mechanism.joints}
    for index in range(1, model.njoints):
        if model.joints[index].nq != 1:
            raise MechanismError(
                f"{mechanism.name}: joint '{model.names[index]}' has several coordinates, which no "
                "target holds; lock it: --lock " + model.names[index]
            )
        name, link = model.names[index], mechanism.bodies.links[index - 1]
        pi = point.pi[mechanism.bodies.columns(link)]
        links.append(
            Link(
                link, joints[name], model.parents[index] - 1, model.jointPlacements[index].copy(),
                joint_axis(model, index), pi, offsets.get(name, 0.0),
            )
        )  # fmt: skip
    return tuple(links)
