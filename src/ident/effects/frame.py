"""Forces at places: a wrench of a frame of a body, W(p, R, v, ω, t, logged) c, on all joints below.

    E c = −Jᵀ W c        J (6, joints): velocity of the frame's origin and body's rate, in its axes

The frame is a link of the URDF, a fixed one (a rotor's hub, a contact patch) as well. Its pose and
twist follow from the coordinates of the joints between it and the ground, so that such an effect is
a torque of these joints like any other, in a fit, a diagnosis and a simulation.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ident.effects.effect import NOWHERE, Bounds, Effect, Shape, Signals, Unknown
from ident.effects.user_function import Shapes, compiled_columns, members_of, split_unit
from ident.errors import MechanismError, line_of
from ident.lazy import lazy

if TYPE_CHECKING:
    import casadi as ca
else:
    ca = lazy("casadi")

SLOWEST = 0.3  # range: [m/s] of rolling below which slip is no angle
CURVED = 1.3  # level: C of Pacejka's sin(C atan(B α)) of a side force (Pacejka, ch. 4)


@dataclass(frozen=True, eq=False)
class FramePath:
    """The joints between the ground and a frame.

    Attributes:
        joints: names, from the ground on.
        rotations, offsets: (k, 3, 3), (k, 3) [m] of each joint's frame in that of the one before.
        axes: (k, 3) unit axes in the joints' frames; turning: (k,) whether each turns.
        tip: rotation (3, 3) and offset (3,) [m] of the frame in that of the last joint.
    """

    joints: tuple[str, ...]
    rotations: np.ndarray
    offsets: np.ndarray
    axes: np.ndarray
    turning: np.ndarray
    tip: tuple[np.ndarray, np.ndarray]

    def at(self, q: np.ndarray, v: np.ndarray) -> FrameMotion:
        """Return where the frame is and how it moves at coordinates and rates (n, k)."""
        n, k = q.shape
        R, p = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
        places, axes = np.empty((k, n, 3)), np.empty((k, n, 3))
        for i in range(k):
            p = p + R @ self.offsets[i]
            R = R @ self.rotations[i]
            places[i], axes[i] = p, R @ self.axes[i]
            if self.turning[i]:
                R = R @ _turn(self.axes[i], q[:, i])
            else:
                p = p + q[:, i, None] * axes[i]
        p, R = p + R @ self.tip[1], R @ self.tip[0]
        J = np.zeros((n, 6, k))
        for i in range(k):
            if self.turning[i]:
                J[:, :3, i] = np.cross(axes[i], p - places[i])
                J[:, 3:, i] = axes[i]
            else:
                J[:, :3, i] = axes[i]
        local = R.transpose(0, 2, 1)
        J = np.concatenate([local @ J[:, :3], local @ J[:, 3:]], axis=1)
        twist = np.einsum("nck,nk->nc", J, v)
        return FrameMotion(p, R, twist[:, :3], twist[:, 3:], J)


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """Pose and twist of a frame at n samples."""

    position: np.ndarray  # (n, 3) [m], in the world's axes
    rotation: np.ndarray  # (n, 3, 3), from the frame's axes to the world's
    velocity: np.ndarray  # (n, 3) [m/s] of its origin, in its own axes
    rate: np.ndarray  # (n, 3) [rad/s], in its own axes
    jacobian: np.ndarray  # (n, 6, k), of both


def _turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the rotations (n, 3, 3) by angles (n,) about an axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1 - c) * (K @ K))


@dataclass(frozen=True)
class FrameForce(Effect):
    """A force or moment at a frame of a body."""

    sits: ClassVar[str] = "frame"
    candidate_sites: ClassVar[str] = NOWHERE
    signature: ClassVar[str] = "the residuals of all joints below fit one force at one place"

    path: FramePath | None = field(default=None, compare=False, repr=False, kw_only=True)

    @classmethod
    def example(cls) -> Effect:
        return cls(("frame1",))

    @property
    def acting(self) -> tuple[str, ...]:
        return () if self.path is None else self.path.joints

    def along(self, path: FramePath) -> FrameForce:
        """Return the effect at a frame whose path is known."""
        return replace(self, path=path)

    def motion(self, s: Signals) -> FrameMotion:
        """Return where the frame is and how it moves."""
        if self.path is None:
            raise MechanismError(
                f"effect '{self.label}': is in no mechanism yet; write mechanism + effect"
            )
        return self.path.at(s.q, s.v)

    @abstractmethod
    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        """W (n, 6, unknowns): force [N] and moment [N m] on the body, in the frame's axes, of one
        of each unknown.
        """

    def columns(self, s: Signals) -> np.ndarray:
        m = self.motion(s)
        return np.asarray(-m.jacobian.transpose(0, 2, 1) @ self.wrench(m, s))

    def column_of(self, word: str) -> str:
        """The log's column of this frame's `word`."""
        return f"{word}.{self.joints[0]}"


class Thrust(FrameForce):
    """Thrust of a rotor or propeller along the frame's z, with the torque of its drag about z."""

    kind = "thrust"
    candidate_sites = "frame"  # wherever the log has a column input.<frame>
    unknowns = (
        Unknown("k", ("N/u²", "N/u²"), "thrust of the input squared"),
        Unknown("d", ("N m/u²", "N m/u²"), "moment about z; its sign is the rotor's direction"),
    )
    settings: ClassVar = {"power": 2.0}
    equation = "force k u², moment d u² along z; u: column input.<frame>; power = 1: k u"
    confused_with = ("the mass: only their ratio is determined where neither is known",)
    source = "Mahony, Kumar, Corke, IEEE Robotics & Automation Magazine 19(3), 2012"

    @property
    def units(self) -> tuple[str, ...]:
        return super().units if self.setting("power") == 2 else ("N/u", "N m/u")

    def reads(self) -> tuple[str, ...]:
        return (self.column_of("input"),)

    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        u = s.extra[self.reads()[0]]
        W = np.zeros((len(u), 6, 2))
        W[:, 2, 0] = W[:, 5, 1] = u * np.abs(u) if self.setting("power") == 2 else u
        return W


class BodyDrag(FrameForce):
    """Resistance of air or water to a body, along each of the frame's axes."""

    kind = "body_drag"
    candidate_sites = "flying"
    smooth = True
    unknowns = tuple(
        Unknown(f"D{axis}", ("N s/m", "N s/m"), f"drag along {axis}", True) for axis in "xyz"
    )
    settings: ClassVar = {"power": 1.0}
    equation = "force −D_i |v|^(power − 1) v_i, v of the frame's origin; power 1 or 2"
    confused_with = ("drag of a rotor, which has the same form with power = 1",)
    source = "Faessler, Franchi, Scaramuzza, IEEE Robotics and Automation Letters 3(2), 2018"

    @property
    def units(self) -> tuple[str, ...]:
        return ("N s²/m²",) * 3 if self.setting("power") == 2 else super().units

    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        W, v = np.zeros((len(s.t), 6, 3)), m.velocity
        size = np.linalg.norm(v, axis=1) if self.setting("power") == 2 else np.ones(len(v))
        for i in range(3):
            W[:, i, i] = -size * v[:, i]
        return W


def rolling_speed(vx: np.ndarray) -> np.ndarray:
    """Return |vx| [m/s], by which slip is divided, exact wherever a wheel rolls."""
    return np.maximum(np.abs(vx), SLOWEST)


class Side(FrameForce):
    """A side force of a tyre, of its slip angle."""

    settings: ClassVar = {"normal": 0.0}

    @property
    def units(self) -> tuple[str, ...]:
        units = super().units  # of a slope: with the load as a column it is a share of it
        return tuple(unit.replace("N/", "1/") for unit in units) if self.reads() else units

    def reads(self) -> tuple[str, ...]:
        return (self.column_of("normal"),) if self.setting("normal") else ()

    def slip(self, m: FrameMotion) -> np.ndarray:
        """Return the slip angle α (n,) [rad]: of the velocity of the contact against x."""
        vx, vy = m.velocity[:, 0], m.velocity[:, 1]
        return np.asarray(np.arctan(vy / rolling_speed(vx)))

    def across(self, s: Signals, shape: np.ndarray) -> np.ndarray:
        """Return W (n, 6, 1) of the side force of a function (n,) of slip."""
        W = np.zeros((len(shape), 6, 1))
        load = s.extra[self.reads()[0]] if self.reads() else 1.0
        W[:, 1, 0] = -shape * load
        return W


class Tyre(Side):
    """Side force of a tyre in proportion to its slip angle."""

    kind = "tyre"
    noun = "side force of a tyre"
    smooth = True
    unknowns = (Unknown("C", ("N/rad", "N/rad"), "cornering stiffness", True),)
    equation = (
        "force −C α along y, α = atan(vy/|vx|) of the frame, x where it rolls; normal = 1: times "
        "the column normal.<frame>"
    )
    confused_with = ("the mass, where no force is known: only their ratio is determined",)
    source = "Rajamani, Vehicle Dynamics and Control, ch. 2"

    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        return self.across(s, self.slip(m))


class TyreSaturation(Side):
    """Side force of a tyre that bends away from its slope, after Pacejka."""

    kind = "tyre_saturation"
    noun = "side force of a tyre that is no longer in proportion to its slip"
    candidate_sites = "frame"
    needs = ("tyre",)
    smooth = True
    unknowns = (Unknown("S", ("N/rad", "N/rad"), "slope that bends, C of `tyre` if all of it"),)
    shapes = (Unknown("B", ("1/rad", "1/rad"), "stiffness factor", nonnegative=True),)
    equation = "force S (α − sin(1.3 atan(B α))/(1.3 B)) along y, beside `tyre`"
    signature = "the side force against slip bends away from a line on either side"
    confused_with = ("tyre, at small slip",)
    source = "Pacejka, Tire and Vehicle Dynamics, ch. 4"

    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        alpha, B = self.slip(m), s.shape["B"]
        return self.across(s, np.sin(CURVED * np.arctan(B * alpha)) / (CURVED * B) - alpha)

    def bounds(self, s: Signals) -> Bounds:
        # between a peak far beyond the largest slip and one in the middle of it
        largest = max(float(np.abs(self.slip(self.motion(s))).max(initial=0.0)), 1e-3)
        return {"B": (0.2 / largest, 20.0 / largest)}

    def starts(self, s: Signals) -> list[Shape]:
        low, high = self.bounds(s)["B"]
        return [{"B": float(B)} for B in np.geomspace(2 * low, high / 2, 4)]


class TyreSlip(FrameForce):
    """Force of a tyre along its rolling direction in proportion to its longitudinal slip."""

    kind = "tyre_slip"
    noun = "driving force of a tyre"
    candidate_sites = "frame"  # wherever the log has a column wheel.<frame>
    unknowns = (Unknown("Cx", ("N", "N"), "longitudinal stiffness", True),)
    settings: ClassVar = {"radius": 0.3}
    equation = "force Cx (r ω − vx)/|vx| along x, ω: column wheel.<frame> [rad/s], r: radius [m]"
    confused_with = ("the mass, where no force is known: only their ratio is determined",)
    source = "Rajamani, Vehicle Dynamics and Control, ch. 13"

    def reads(self) -> tuple[str, ...]:
        return (self.column_of("wheel"),)

    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        vx, W = m.velocity[:, 0], np.zeros((len(s.t), 6, 1))
        rolling = self.setting("radius") * s.extra[self.reads()[0]]
        W[:, 0, 0] = (rolling - vx) / rolling_speed(vx)
        return W


class GroundSpring(FrameForce):
    """Spring and damper between a place and the ground, while the place is below a height."""

    kind = "ground_spring"
    unknowns = (
        Unknown("K", ("N/m", "N/m"), "stiffness", True),
        Unknown("D", ("N s/m", "N s/m"), "damping", True),
    )
    settings: ClassVar = {"height": 0.0}
    equation = "force K (height − z) − D ż along the world's z, where z < height [m]"
    confused_with = ("gravity, over a small range",)
    source = "Gilardi, Sharf, Mechanism and Machine Theory 37(10), 2002"

    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        up = m.rotation[:, 2, :]  # the world's z, in the frame's axes
        deep = np.maximum(self.setting("height") - m.position[:, 2], 0.0)
        W = np.zeros((len(deep), 6, 2))
        W[:, :3, 0] = deep[:, None] * up
        W[:, :3, 1] = -((deep > 0) * np.einsum("ni,ni->n", up, m.velocity))[:, None] * up
        return W


# --- of a user ------------------------------------------------------------------------------------

SIZES = {"position": 3, "rotation": 9, "velocity": 3, "rate": 3, "t": 1}
FrameFunction = Callable[..., Mapping[str, Any]]


class UserFrameForce(FrameForce):
    """Base of the classes that `user_frame_force` makes."""

    function: ClassVar[FrameFunction]
    compiled: ClassVar[ca.Function]
    logged: ClassVar[tuple[str, ...]] = ()  # columns, {frame} standing for the frame
    starting: ClassVar[Mapping[str, float]] = {}

    def reads(self) -> tuple[str, ...]:
        return tuple(name.replace("{frame}", self.joints[0]) for name in self.logged)

    def wrench(self, m: FrameMotion, s: Signals) -> np.ndarray:
        n = len(s.t)
        shape = np.array([s.shape[entry.name] for entry in self.shapes]).reshape(-1, 1)
        columns = np.stack([s.extra[name] for name in self.reads()] or [np.zeros(n)])
        values = self.compiled(
            m.position.T, m.rotation.transpose(0, 2, 1).reshape(n, 9).T, m.velocity.T, m.rate.T,
            (s.t - s.t[0])[None], columns, np.tile(shape, n),
        )  # fmt: skip
        W: np.ndarray = values.full().T.reshape(n, len(self.unknowns), 6).transpose(0, 2, 1)
        if not np.isfinite(W).all():
            at = int(np.argmin(np.isfinite(W).all(axis=(1, 2))))
            raise MechanismError(
                f"effect '{self.label}': its function is not finite at t = {s.t[at]:.4g} s, where "
                f"v = {m.velocity[at]}; make it finite for every motion"
            )
        return W

    def starts(self, s: Signals) -> list[Shape]:
        return [dict(self.starting)]


def user_frame_force(
    name: str, function: FrameFunction, shapes: Shapes, file: Path | None = None
) -> type[UserFrameForce]:
    """A kind of force at a frame from a function of its motion.

    Args:
        name: of the kind.
        function: `s -> {"k [N/u²]": [fx, fy, fz]}`, or six numbers with moments: CasADi expressions
            of s.position, s.rotation (3, 3), s.velocity, s.rate (in the frame's axes), s.t and
            s.logged("input.{frame}"), a column of the log.
        shapes: starts and entries of its keyword arguments, as `library` reads them.
        file: where it was read from, if it was.

    Raises:
        MechanismError: if the function cannot be used.
    """
    symbols = {key: ca.SX.sym(key, size) for key, size in SIZES.items()}
    columns: dict[str, ca.SX] = {}
    values = {key: ca.SX.sym(key) for key in shapes[0]}

    def logged(column: str) -> ca.SX:
        return columns.setdefault(str(column), ca.SX.sym(f"column{len(columns)}"))

    given = {**symbols, "rotation": ca.reshape(symbols["rotation"], 3, 3)}
    try:
        returned = function(SimpleNamespace(**given, logged=logged), **values)
        wrenches = {str(key): ca.SX(ca.vertcat(*_parts(x))) for key, x in returned.items()}
    except (Exception, SystemExit) as error:  # it is the user's code
        raise MechanismError(
            f"effect '{name}': its function fails: {line_of(error)}; it is given s with "
            f"{', '.join(SIZES)}, logged(column) and returns {{'unknown': [fx, fy, fz]}}"
        ) from None
    unknowns, parts = [], []
    for key, wrench in wrenches.items():
        word, unit = split_unit(key)
        if not word.isidentifier() or wrench.shape not in ((3, 1), (6, 1)):
            raise MechanismError(
                f"effect '{name}': its function returns {wrench.shape[0]} × {wrench.shape[1]} "
                f"numbers for the unknown '{word}'; valid: three of a force, or six with a moment"
            )
        unknowns.append(Unknown(word, (unit, unit), "of the function"))
        parts.append(ca.vertcat(wrench, ca.SX.zeros(6 - wrench.shape[0])))
    if not parts:
        raise MechanismError(f"effect '{name}': its function returns no unknown")
    inputs = [
        *symbols.values(), ca.vertcat(*columns.values()) if columns else ca.SX.sym("none"),
        ca.vertcat(*values.values()),
    ]  # fmt: skip
    members = members_of(name, function, shapes, file, __name__) | {
        "compiled": compiled_columns(name, inputs, ca.vertcat(*parts)),
        "logged": tuple(columns),
        "unknowns": tuple(unknowns),
        "memory": bool(ca.depends_on(ca.vertcat(*parts), symbols["t"])),
        "equation": " + ".join(f"{x.name} · wrench" for x in unknowns),
    }
    return type(name, (UserFrameForce,), members)


def _parts(x: Any) -> list[ca.SX]:
    """Return a force or wrench as a list of expressions."""
    return [ca.SX(part) for part in x] if isinstance(x, list | tuple) else [ca.SX(x)]
