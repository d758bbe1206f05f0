"""Closures: constraint functions Φ(q) = 0 between two frames a and b, as CasADi expressions.

One line a kind: which of the relative position and the relative orientation is kept at zero. What
is kept names the multipliers; what is left free is the closure's own joint, where effects may sit.

    d = p_b − p_a                            in world axes, or in a's axes where the kind slides
    rx, ry: z_b = z_a, two equations         rz: x_b ⟂ y_a (together: the same orientation)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import pinocchio as pin

from ident.errors import MechanismError
from ident.mechanism.forward import Placement


@dataclass(frozen=True)
class Frame:
    """A place on a link: Pinocchio's joint index (0: the ground) and constant placement."""

    link: str
    joint: int
    placement: pin.SE3

    def at(self, found: Sequence[Placement]) -> Placement:
        """The frame's world placement."""
        return found[self.joint] * Placement.of(self.placement)


@dataclass(frozen=True)
class Kind:
    """What a closure of two frames keeps at zero, and what its own joint is free to do."""

    position: str  # of "xyz"
    rotation: tuple[str, ...]  # of rx ry rz; "cross": x_a ⟂ y_b
    sliding: bool = False  # position in a's axes, not in the world's
    own: tuple[str, ...] = ()  # free coordinates that have a name: z [m], rz [rad]


KINDS = {
    "point": Kind("xyz", ()),
    "revolute": Kind("xyz", ("rx", "ry"), own=("rz",)),
    "prismatic": Kind("xy", ("rx", "ry", "rz"), sliding=True, own=("z",)),
    "cylindrical": Kind("xy", ("rx", "ry"), sliding=True, own=("z", "rz")),
    "universal": Kind("xyz", ("cross",)),
    "planar": Kind("z", ("rx", "ry"), sliding=True),
    "fixed": Kind("xyz", ("rx", "ry", "rz")),
}
OTHER_KINDS = ("distance", "linear", "function")


@dataclass(frozen=True)
class OwnJoint:
    """A free coordinate of a closure: angle or length y(q), named `closure.<name>` or alike."""

    name: str
    rotational: bool
    expression: ca.SX


@dataclass(frozen=True)
class Terms:
    """Φ (m,) with the names of its multipliers, their units, and the closure's own joints."""

    phi: ca.SX
    names: tuple[str, ...]
    units: tuple[str, ...]
    own: tuple[OwnJoint, ...] = ()


Coordinates = Mapping[str, ca.SX]


@dataclass(frozen=True)
class Closure:
    """Two frames held together as `kind` says; see the table in the mechanism.toml reference."""

    name: str
    kind: str
    a: Frame
    b: Frame
    axes: str = "xyz"
    length: float = 0.0
    own_name: str = ""  # of its own joint, where that is not `closure.<name>`

    def terms(self, found: Sequence[Placement], joints: Coordinates) -> Terms:
        """Φ(q) as an expression of the joints' placements `found`."""
        a, b = self.a.at(found), self.b.at(found)
        d = b.p - a.p
        if self.kind == "distance":
            return Terms(ca.norm_2(d) - self.length, (f"{self.name}.1",), ("N",))
        kind = KINDS[self.kind]
        if kind.sliding:
            d = a.R.T @ d
        kept = [axis for axis in kind.position if self.kind != "point" or axis in self.axes]
        rows = [d["xyz".index(axis)] for axis in kept]
        rows += [_rotation_row(row, a.R, b.R) for row in kind.rotation]
        turns = ["rz" if row == "cross" else row for row in kind.rotation]
        return Terms(
            ca.vertcat(*rows),
            tuple(f"{self.name}.{row}" for row in [*kept, *turns]),
            tuple(["N"] * len(kept) + ["N m"] * len(turns)),
            tuple(self._own(free, a, b, len(kind.own) > 1) for free in kind.own),
        )

    def _own(self, free: str, a: Placement, b: Placement, several: bool) -> OwnJoint:
        name = self.own_name or f"closure.{self.name}" + (f".{free}" if several else "")
        if free == "z":
            return OwnJoint(name, False, a.R[:, 2].T @ (b.p - a.p))
        angle = ca.atan2(a.R[:, 1].T @ b.R[:, 0], a.R[:, 0].T @ b.R[:, 0])
        return OwnJoint(name, True, angle)


def _rotation_row(row: str, Ra: ca.SX, Rb: ca.SX) -> ca.SX:
    """Zero where the frames agree, with unit slope for a small turn of b about a's axis."""
    x_a, y_a = Ra[:, 0], Ra[:, 1]
    x_b, y_b, z_b = Rb[:, 0], Rb[:, 1], Rb[:, 2]
    return {
        "rx": -(y_a.T @ z_b),
        "ry": x_a.T @ z_b,
        "rz": y_a.T @ x_b,
        "cross": -(x_a.T @ y_b),
    }[row]


@dataclass(frozen=True)
class Linear:
    """Σ ratio · q = offset: gears, belts, tendons, parallelograms, mimicking joints."""

    name: str
    joints: tuple[str, ...]
    ratios: tuple[float, ...]
    offset: float = 0.0
    rotational: bool = True  # of the first joint, for the multiplier's unit
    kind: str = field(default="linear", init=False)

    def terms(self, found: Sequence[Placement], joints: Coordinates) -> Terms:
        """Φ(q) = Σ ratio · q − offset."""
        q = ca.vertcat(*(joints[name] for name in self.joints))
        phi = ca.dot(ca.SX(self.ratios), q)
        return Terms(phi - self.offset, (f"{self.name}.1",), ("N m" if self.rotational else "N",))


class JointSymbols(Mapping[str, ca.SX]):
    """What a user's closure function is given: `q["elbow"]`, or `q[0]`, the mechanism's first."""

    def __init__(self, symbols: Mapping[str, ca.SX]) -> None:
        self._symbols = dict(symbols)

    def __getitem__(self, key: str | int) -> ca.SX:
        return list(self._symbols.values())[key] if isinstance(key, int) else self._symbols[key]

    def __iter__(self):  # type: ignore[no-untyped-def]
        return iter(self._symbols)

    def __len__(self) -> int:
        return len(self._symbols)


@dataclass(frozen=True)
class Function:
    """A user's own Φ(q), written with CasADi."""

    name: str
    function: Callable[[JointSymbols], Any]
    kind: str = field(default="function", init=False)

    def terms(self, found: Sequence[Placement], joints: Coordinates) -> Terms:
        """Φ(q) as the user's function returns it: a scalar, a column or a list.

        Raises:
            MechanismError: if it fails, or returns anything but an expression of these joints.
        """
        try:
            value = self.function(JointSymbols(joints))
            if value is None or isinstance(value, str):  # CasADi's own words are no help here
                raise TypeError(f"it returned {value!r}")
            phi = ca.SX(ca.vertcat(*value) if isinstance(value, (list, tuple)) else value)
        except Exception as error:  # it is the user's code
            what = " ".join(str(error).split())[:200]
            raise MechanismError(
                f"closure '{self.name}': its function fails: {type(error).__name__}: {what}; it is "
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
        return Terms(
            ca.reshape(phi, count, 1),
            tuple(f"{self.name}.{i + 1}" for i in range(count)),
            ("1",) * count,
        )


AnyClosure = Closure | Linear | Function
