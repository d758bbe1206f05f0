"""Closures: constraint functions Φ(q) = 0, as CasADi expressions, one class a kind.

A new kind is one class and one line in `KINDS`. It states its keys in mechanism.toml, how it is
read, Φ with the names and units of its multipliers, and its own joints: the coordinates that it
leaves free and on which effects may sit. A kind between two frames a and b only says which of the
relative position and orientation it keeps at zero:

    d = p_b − p_a                            in world axes, or in a's axes where the kind slides
    rx, ry: z_b = z_a, two equations         rz: x_b ⟂ y_a (together: the same orientation)

PyPI's `pin` has no CasADi binding, so placements are written here from the model's own data: a
joint's placement in its parent, then the joint's motion. Tested against Pinocchio.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pinocchio as pin

from ident.errors import MechanismError, line_of, one_of
from ident.files import TomlTable, function_of
from ident.lazy import lazy
from ident.mechanism.description import is_rotational, joint_axis, tidy

if TYPE_CHECKING:
    import casadi as ca
else:
    ca = lazy("casadi")

Coordinates = Mapping[str, "ca.SX"]


@dataclass(frozen=True)
class Placement:
    """A frame in the world: rotation R (3, 3) and origin p (3,) [m], CasADi or NumPy."""

    R: ca.SX
    p: ca.SX

    def __mul__(self, other: Placement) -> Placement:
        return Placement(self.R @ other.R, self.R @ other.p + self.p)

    @staticmethod
    def of(M: pin.SE3) -> Placement:
        """Return Pinocchio's constant placement, without rounding errors beside 0 and 1."""
        return Placement(ca.SX(tidy(M.rotation)), ca.SX(tidy(M.translation)))


def placements(model: pin.Model, q: ca.SX) -> list[Placement]:
    """Return world placements of all joints' frames, the world first, at q (nq,)."""
    placed = [Placement(ca.SX.eye(3), ca.SX.zeros(3))]
    for index in range(1, model.njoints):
        fixed = placed[model.parents[index]] * Placement.of(model.jointPlacements[index])
        at = model.idx_qs[index]
        if model.joints[index].nq == 7:
            motion = Placement(_rotation_of_quaternion(q[at + 3 : at + 7]), q[at : at + 3])
        elif is_rotational(model, index):
            cross = ca.skew(ca.SX(joint_axis(model, index)))  # Rodrigues
            turned = ca.sin(q[at]) * cross + (1 - ca.cos(q[at])) * (cross @ cross)
            motion = Placement(ca.SX.eye(3) + turned, ca.SX.zeros(3))
        else:
            motion = Placement(ca.SX.eye(3), ca.SX(joint_axis(model, index)) * q[at])
        placed.append(fixed * motion)
    return placed


def _rotation_of_quaternion(xyzw: ca.SX) -> ca.SX:
    cross = ca.skew(xyzw[:3])
    return ca.SX.eye(3) + 2 * xyzw[3] * cross + 2 * (cross @ cross)


def rates(model: pin.Model, q: ca.SX) -> ca.SX:
    """Return N(q) (nq, nv) of q̇ = N(q) v: 1 for scalar joints, a quaternion's for free bodies."""
    N = ca.SX(model.nq, model.nv)
    for index in range(1, model.njoints):
        joint, iq, iv = model.joints[index], model.idx_qs[index], model.idx_vs[index]
        if joint.nq == 1:
            N[iq, iv] = 1
            continue
        xyzw = q[iq + 3 : iq + 7]
        # ṗ = R v_lin ; quaternion rate = ½ quaternion ∘ (ω, 0), ω in the body's axes
        N[iq : iq + 3, iv : iv + 3] = _rotation_of_quaternion(xyzw)
        N[iq + 3 : iq + 6, iv + 3 : iv + 6] = 0.5 * (xyzw[3] * ca.SX.eye(3) + ca.skew(xyzw[:3]))
        N[iq + 6, iv + 3 : iv + 6] = -0.5 * xyzw[:3].T
    return N


@dataclass(frozen=True)
class Frame:
    """A frame on a link: Pinocchio's joint index (0: the ground) and constant placement."""

    link: str
    joint: int
    placement: pin.SE3

    def at(self, joints: Sequence[Placement]) -> Placement:
        """Return the frame's world placement, given those of the joints."""
        return joints[self.joint] * Placement.of(self.placement)


def shifted(placement: pin.SE3, axis: str, by: float) -> pin.SE3:
    """Return a placement moved along x, y or z [m] of the frame that it is stated in."""
    step = by * np.eye(3)["xyz".index(axis)]
    return pin.SE3(placement.rotation, placement.translation + step)


@dataclass(frozen=True)
class OwnJoint:
    """A free coordinate of a closure: angle or length y(q)."""

    name: str
    rotational: bool
    expression: ca.SX


@dataclass(frozen=True)
class Constraint:
    """Φ (m,) with the names of its multipliers, their units, and the closure's own joints."""

    phi: ca.SX
    names: tuple[str, ...]
    units: tuple[str, ...]
    joints: tuple[OwnJoint, ...] = ()


@dataclass(frozen=True)
class Context:
    """The tree that a closure closes, and the rules for reading it from mechanism.toml."""

    model: pin.Model  # Pinocchio's
    folder: Path  # of mechanism.toml
    allow_code: bool  # whether Python files may be run
    locked: bool = False  # whether joints are held, so that several links may be one body

    def frame(self, table: TomlTable, key: str) -> Frame:
        """Return the frame `key = { link = "…", xyz = […], rpy = […] }`; "world" is the ground."""
        if not isinstance(table.data.get(key), dict):
            raise table.error(
                f'{key} = {table.data.get(key)!r}; write {key} = {{ link = "…", xyz = [0, 0, 0] }}'
            )
        inner = TomlTable(f"{table.where}: {key}", table.data[key])
        inner.check("link", "xyz", "rpy")
        xyz, rpy = (inner.vector(key, 3, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
        placement = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))
        link, model = inner.text("link"), self.model
        links = [f.name for f in model.frames if f.type == pin.FrameType.BODY]
        if link in links:
            frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
            return Frame(link, frame.parentJoint, frame.placement * placement)
        if link == "world":
            return Frame(link, 0, placement)
        raise inner.error(f"no link '{link}'; {one_of(link, [*links, 'world'])}")


@dataclass(frozen=True)
class Closure(ABC):
    """Scalar equations between coordinates, which their multipliers enforce."""

    kind: ClassVar[str]
    keys: ClassVar[tuple[str, ...]]  # of its table beside `name` and `kind`
    frames: ClassVar[tuple[Frame, ...]] = ()  # a and b, where it holds two frames together
    tied: ClassVar[tuple[str, ...]] = ()  # joints whose coordinates it counts, where it knows them

    name: str  # first part of its multipliers' names

    @classmethod
    @abstractmethod
    def read(cls, name: str, table: TomlTable, context: Context) -> Closure:
        """Return the closure of a checked [[closure]] table."""

    @abstractmethod
    def constraint(self, placements: Sequence[Placement], joints: Coordinates) -> Constraint:
        """Return Φ(q) of world placements, the ground's first, and coordinates, own joints' too."""

    @property
    def places(self) -> Mapping[str, float]:
        """Lengths [m] on which it depends: `<name>.<a|b>.<x|y|z>`, `<name>.length`."""
        return {}

    def displaced(self, place: str, by: float) -> Closure:
        """Return the closure with one of its `places` changed by a length [m]."""
        raise ValueError(place)


@dataclass(frozen=True)
class FrameClosure(Closure):
    """Two frames a and b held together; a subclass says what is kept at zero, and what is free."""

    keys: ClassVar[tuple[str, ...]] = ("a", "b")
    position: ClassVar[str] = "xyz"  # components of d that are zero
    rotation: ClassVar[tuple[str, ...]] = ()  # of rx ry rz; "cross": x_a ⟂ y_b
    sliding: ClassVar[bool] = False  # d in a's axes, and forces act at b
    free: ClassVar[tuple[str, ...]] = ()  # coordinates of its own joints: z [m], rz [rad]

    a: Frame
    b: Frame
    own_name: str = ""  # of its own joint, where that is not `closure.<name>`

    @classmethod
    def read(cls, name: str, table: TomlTable, context: Context) -> FrameClosure:
        a, b = (context.frame(table, end) for end in "ab")
        return cls(name, a, b)

    @property
    def frames(self) -> tuple[Frame, ...]:  # type: ignore[override]
        return (self.a, self.b)

    def constraint(self, placements: Sequence[Placement], joints: Coordinates) -> Constraint:
        return self.between(self.a.at(placements), self.b.at(placements))

    def between(self, a: Placement, b: Placement) -> Constraint:
        """Return Φ for two world placements."""
        d = a.R.T @ (b.p - a.p) if self.sliding else b.p - a.p
        rows = [d["xyz".index(axis)] for axis in self.position]
        (x_a, y_a), (x_b, y_b, z_b) = (a.R[:, 0], a.R[:, 1]), (b.R[:, i] for i in range(3))
        zero = {  # where the frames agree, with unit slope for a small turn of b about a's axis
            "rx": -(y_a.T @ z_b), "ry": x_a.T @ z_b, "rz": y_a.T @ x_b, "cross": -(x_a.T @ y_b),
        }  # fmt: skip
        rows += [zero[row] for row in self.rotation]
        free_coordinates = {
            "z": a.R[:, 2].T @ (b.p - a.p),
            "rz": ca.atan2(y_a.T @ x_b, x_a.T @ x_b),
        }
        words = [*self.position, *("rz" if row == "cross" else row for row in self.rotation)]
        return Constraint(
            ca.vertcat(*rows),
            tuple(f"{self.name}.{word}" for word in words),
            tuple("N" if word in "xyz" else "N m" for word in words),
            tuple(
                OwnJoint(self.own_joint(word), word == "rz", free_coordinates[word])
                for word in self.free
            ),
        )

    def own_joint(self, free: str) -> str:
        """Return the name of the own joint of a free coordinate."""
        several = f".{free}" if len(self.free) > 1 else ""
        return self.own_name or f"closure.{self.name}{several}"

    @property
    def places(self) -> Mapping[str, float]:
        return {
            f"{self.name}.{end}.{axis}": float(frame.placement.translation[i])
            for end, frame in zip("ab", self.frames, strict=True)
            for i, axis in enumerate("xyz")
        }

    def displaced(self, place: str, by: float) -> Closure:
        _, end, axis = place.rsplit(".", 2)
        frame: Any = getattr(self, end)
        frame = replace(frame, placement=shifted(frame.placement, axis, by))
        return replace(self, **{end: frame})


@dataclass(frozen=True)
class PointClosure(FrameClosure):
    """The origins of both frames coincide, along some of the world's axes."""

    kind: ClassVar[str] = "point"
    keys: ClassVar[tuple[str, ...]] = ("a", "b", "axes")

    position: str = field(default="xyz", kw_only=True)  # type: ignore[misc]

    @classmethod
    def read(cls, name: str, table: TomlTable, context: Context) -> FrameClosure:
        axes = table.text("axes", "xyz")
        if set(axes) - set("xyz") or len(set(axes)) != len(axes):
            raise table.error(f"axes = '{axes}'; some of the letters xyz, each once")
        a, b = super().read(name, table, context).frames
        return cls(name, a, b, position="".join(sorted(axes)))


class RevoluteClosure(FrameClosure):
    """A hinge about the common z axis."""

    kind, rotation, free = "revolute", ("rx", "ry"), ("rz",)


class PrismaticClosure(FrameClosure):
    """A slide along a's z axis."""

    kind, position, rotation, sliding = "prismatic", "xy", ("rx", "ry", "rz"), True
    free = ("z",)


class CylindricalClosure(FrameClosure):
    """A slide along a's z axis that also turns about it."""

    kind, position, rotation, sliding = "cylindrical", "xy", ("rx", "ry"), True
    free = ("z", "rz")


class UniversalClosure(FrameClosure):
    """A cross joint, x of a perpendicular to y of b."""

    kind, rotation = "universal", ("cross",)


class PlanarClosure(FrameClosure):
    """The plane of b's x and y axes lies in that of a."""

    kind, position, rotation, sliding = "planar", "z", ("rx", "ry"), True


class FixedClosure(FrameClosure):
    """Both frames are one."""

    kind, rotation = "fixed", ("rx", "ry", "rz")


@dataclass(frozen=True)
class DistanceClosure(FrameClosure):
    """A massless rod between the origins of both frames."""

    kind: ClassVar[str] = "distance"
    keys: ClassVar[tuple[str, ...]] = ("a", "b", "length")

    length: float = 0.0  # of the rod [m]

    @classmethod
    def read(cls, name: str, table: TomlTable, context: Context) -> FrameClosure:
        length = table.number("length", 0.0)
        if not length > 0:
            raise table.error(f"length = {length:g} m; a distance needs one above 0")
        a, b = super().read(name, table, context).frames
        return cls(name, a, b, length=length)

    def between(self, a: Placement, b: Placement) -> Constraint:
        """Return Φ = |p_b − p_a| − length."""
        return Constraint(ca.norm_2(b.p - a.p) - self.length, (f"{self.name}.1",), ("N",))

    @property
    def places(self) -> Mapping[str, float]:
        return {**super().places, f"{self.name}.length": self.length}

    def displaced(self, place: str, by: float) -> Closure:
        if place == f"{self.name}.length":
            return replace(self, length=self.length + by)
        return super().displaced(place, by)


@dataclass(frozen=True)
class LinearClosure(Closure):
    """Σ ratio · q = offset: gears, belts, tendons, parallelograms, mimicking joints."""

    kind: ClassVar[str] = "linear"
    keys: ClassVar[tuple[str, ...]] = ("joints", "ratios", "offset")

    joints: tuple[str, ...]
    ratios: tuple[float, ...]
    offset: float = 0.0
    rotational: bool = True  # of the first joint, for the multiplier's unit

    @property
    def tied(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.joints

    @classmethod
    def read(cls, name: str, table: TomlTable, context: Context) -> LinearClosure:
        joints, ratios = table.words("joints"), table.vector("ratios")
        if len(joints) < 2 or len(ratios) != len(joints) or len(set(joints)) != len(joints):
            raise table.error(
                f"{len(joints)} joints and {len(ratios)} ratios; two or more different joints "
                "with one ratio each are expected"
            )
        model, known = context.model, [*context.model.names][1:]
        for joint in joints:
            if joint not in known:
                raise table.error(f"no joint '{joint}'; {one_of(joint, known)}")
        if 0.0 in ratios:
            raise table.error(f"ratios = {list(ratios)}; a ratio of 0 ties nothing")
        offset = table.number("offset", 0.0)
        turns = is_rotational(model, model.getJointId(joints[0]))
        return cls(name, joints, ratios, offset, turns)

    def constraint(self, placements: Sequence[Placement], joints: Coordinates) -> Constraint:
        q = ca.vertcat(*(joints[name] for name in self.joints))
        unit = "N m" if self.rotational else "N"
        return Constraint(ca.dot(ca.SX(self.ratios), q) - self.offset, (f"{self.name}.1",), (unit,))


@dataclass(frozen=True)
class PolynomialClosure(Closure):
    """q_a = Σ c_k q_bᵏ: cams and tendons of changing leverage."""

    kind: ClassVar[str] = "polynomial"
    keys: ClassVar[tuple[str, ...]] = ("joints", "coefficients")

    joints: tuple[str, ...]  # a and b
    coefficients: tuple[float, ...]  # from the constant on
    rotational: bool = True  # of joint a, for the multiplier's unit

    @property
    def tied(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.joints

    @classmethod
    def read(cls, name: str, table: TomlTable, context: Context) -> PolynomialClosure:
        joints, coefficients = table.words("joints"), table.vector("coefficients")
        if len(joints) != 2 or len(set(joints)) != 2 or len(coefficients) < 2:
            raise table.error(
                f"{len(joints)} joints and {len(coefficients)} coefficients; two different joints "
                "and at least two coefficients are expected, the constant first"
            )
        model, known = context.model, [*context.model.names][1:]
        for joint in joints:
            if joint not in known:
                raise table.error(f"no joint '{joint}'; {one_of(joint, known)}")
        turns = is_rotational(model, model.getJointId(joints[0]))
        return cls(name, joints, coefficients, turns)

    def constraint(self, placements: Sequence[Placement], joints: Coordinates) -> Constraint:
        q_a, q_b = (joints[name] for name in self.joints)
        value = ca.SX(0.0)
        for c in reversed(self.coefficients):  # Horner
            value = value * q_b + c
        unit = "N m" if self.rotational else "N"
        return Constraint(ca.vertcat(q_a - value), (f"{self.name}.1",), (unit,))


class JointSymbols(dict[str | int, "ca.SX"]):
    """The argument of a user's closure function: `q["elbow"]`, or `q[0]`, the first joint."""

    def __missing__(self, key: str | int) -> ca.SX:
        if isinstance(key, int):
            return list(self.values())[key]
        raise KeyError(key)


@dataclass(frozen=True)
class FunctionClosure(Closure):
    """A user's own Φ(q), written with CasADi."""

    kind: ClassVar[str] = "function"
    keys: ClassVar[tuple[str, ...]] = ("file", "function")

    function: Callable[[JointSymbols], Any]

    @classmethod
    def read(cls, name: str, table: TomlTable, context: Context) -> FunctionClosure:
        file, function = context.folder / table.text("file"), table.text("function")
        try:
            return cls(name, function_of(file, function, allow_code=context.allow_code))
        except MechanismError as error:
            raise table.error(str(error)) from None

    def constraint(self, placements: Sequence[Placement], joints: Coordinates) -> Constraint:
        try:
            value = self.function(JointSymbols(joints))
            if value is None or isinstance(value, str):  # CasADi's message does not help here
                raise TypeError(f"it returned {value!r}")
            phi = ca.SX(ca.vertcat(*value) if isinstance(value, (list, tuple)) else value)
        except (Exception, SystemExit) as error:  # it is the user's code
            raise MechanismError(
                f"closure '{self.name}': its function fails: {line_of(error)}; it is "
                f'given q["<joint>"] of {", ".join(joints)} and returns Φ written with CasADi'
            ) from None
        known = {s.element_hash() for s in ca.symvar(ca.vertcat(*joints.values()))}
        foreign = [s.name() for s in ca.symvar(phi) if s.element_hash() not in known]
        if foreign:
            raise MechanismError(
                f"closure '{self.name}': its function returns symbols of its own "
                f"({', '.join(foreign)}); Φ may depend on the joints alone"
            )
        count = phi.numel()
        names = tuple(f"{self.name}.{i}" for i in range(1, count + 1))
        return Constraint(ca.reshape(phi, count, 1), names, ("1",) * count)


KINDS: dict[str, type[Closure]] = {
    closure.kind: closure
    for closure in (
        PointClosure, RevoluteClosure, PrismaticClosure, CylindricalClosure, UniversalClosure,
        PlanarClosure, FixedClosure, DistanceClosure, LinearClosure, PolynomialClosure,
        FunctionClosure,
    )
}  # fmt: skip


def read_closure(table: TomlTable, context: Context) -> Closure:
    """Return the closure of one [[closure]] table."""
    name, kind = table.text("name"), table.text("kind")
    table = TomlTable(f"{table.where} ('{name}')", table.data)
    if kind not in KINDS:
        raise table.error(f"kind = '{kind}'; {one_of(kind, KINDS)}")
    table.check("name", "kind", *KINDS[kind].keys)
    closure = KINDS[kind].read(name, table, context)
    if len({frame.joint for frame in closure.frames}) == 1:
        a, b = (frame.link for frame in closure.frames)
        if a == b or not context.locked:
            both = f"both frames are of link '{a}'" if a == b else f"'{a}' and '{b}' are one body"
            raise table.error(f"{both}; a loop is closed between two that move against each other")
    return closure
