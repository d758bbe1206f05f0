"""Truth from elsewhere: random URDFs, finite differences, motions closed by Pinocchio alone.

Nothing here imports what it is meant to test.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

ROOT = Path(__file__).resolve().parents[1]
ROBOTS = ROOT / "robots"
Series = dict[str, np.ndarray]


# --- URDFs -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class J:
    """One joint of a URDF to be written; its child is the link `<name>_link`."""

    name: str
    kind: str = "revolute"
    axis: str | None = "0 0 1"
    parent: str = ""  # a joint; "" is the base
    inside: str = ""  # more elements


def body(rng: np.random.Generator, name: str) -> str:
    """A link with an inertia that a body can have."""
    A = rng.normal(size=(3, 3)) * 0.1
    points = A @ A.T
    inertia = np.trace(points) * np.eye(3) - points
    terms = {
        "ixx": (0, 0),
        "iyy": (1, 1),
        "izz": (2, 2),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyz": (1, 2),
    }
    tensor = " ".join(f'{key}="{inertia[at]:.6f}"' for key, at in terms.items())
    place = " ".join(f"{x:.4f}" for x in rng.normal(size=3) * 0.1)
    return (
        f'<link name="{name}"><inertial><origin xyz="{place}" rpy="0.3 -0.2 0.1"/>'
        f'<mass value="{rng.uniform(0.5, 2):.4f}"/><inertia {tensor}/></inertial></link>'
    )


def tree_urdf(joints: Sequence[J], seed: int = 0, base: str = "base") -> str:
    """A robot of these joints with random rotated origins and random bodies."""
    rng = np.random.default_rng(seed)
    parts = [f'<link name="{base}"/>']
    for j in joints:
        xyz, rpy = rng.normal(size=3) * 0.3, rng.uniform(-1.5, 1.5, 3)
        axis = f'<axis xyz="{j.axis}"/>' if j.axis else ""
        limit = '<limit effort="10" velocity="10" lower="-9" upper="9"/>'
        parts += [
            body(rng, f"{j.name}_link"),
            f'<joint name="{j.name}" type="{j.kind}">'
            f'<parent link="{j.parent + "_link" if j.parent else base}"/>'
            f'<child link="{j.name}_link"/>'
            f'<origin xyz="{xyz[0]:.4f} {xyz[1]:.4f} {xyz[2]:.4f}" '
            f'rpy="{rpy[0]:.4f} {rpy[1]:.4f} {rpy[2]:.4f}"/>{axis}'
            f"{'' if unlimited(j) else limit}{j.inside}</joint>",
        ]
    return '<robot name="random">' + "\n".join(parts) + "</robot>"


def unlimited(joint: J) -> bool:
    return joint.kind == "fixed" or "<limit" in joint.inside


def write_mechanism(folder: Path, urdf: str, toml: str = "") -> Path:
    """A mechanism folder of this URDF and these lines of mechanism.toml."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf)
    (folder / "mechanism.toml").write_text(f'urdf = "robot.urdf"\n{toml}')
    return folder


def raw_configuration(raw: pin.Model, coordinates: Mapping[str, float]) -> np.ndarray:
    """q of Pinocchio's own reading of a URDF, where continuous joints are (cos, sin)."""
    q = pin.neutral(raw)
    for index in range(1, raw.njoints):
        name, at, nq = raw.names[index], raw.idx_qs[index], raw.nqs[index]
        if nq == 1:
            q[at] = coordinates[name]
        elif nq == 2:
            q[at : at + 2] = np.cos(coordinates[name]), np.sin(coordinates[name])
    return q


# --- finite differences ------------------------------------------------------------------------


def along(
    model: pin.Model, q: np.ndarray, v: np.ndarray, f: Callable[[np.ndarray], np.ndarray], h: float
) -> np.ndarray:
    """d/dt f(q ⊕ t v) at t = 0, of fourth order."""
    at = {k: f(pin.integrate(model, q, k * h * v)) for k in (-2, -1, 1, 2)}
    return (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h)


def jacobian(
    model: pin.Model, q: np.ndarray, f: Callable[[np.ndarray], np.ndarray], h: float = 1e-3
) -> np.ndarray:
    """∂f/∂q (m, nv) by `along` each coordinate."""
    return np.stack([along(model, q, e, f, h) for e in np.eye(model.nv)], axis=-1)


def frame_jacobian(model: pin.Model, q: np.ndarray, joint: int, placement: pin.SE3) -> np.ndarray:
    """Pinocchio's Jacobian (6, nv) of a place on a body, world axes, linear rows first."""
    extended = model.copy()
    index = extended.addFrame(pin.Frame("place", joint, placement, pin.FrameType.OP_FRAME), False)
    data = extended.createData()
    return pin.computeFrameJacobian(extended, data, q, index, pin.LOCAL_WORLD_ALIGNED)


# --- motions -----------------------------------------------------------------------------------


MOTIONS: dict[str, dict[str, tuple[float, int, list[tuple[int, float, float]]]]] = {
    # joint: (offset, turns a period, [(harmonic, sin, cos), …])
    "four_bar": {"crank": (0.0, 3, [(1, 0.5, 0.2), (2, -0.3, 0.25), (3, 0.12, -0.15)])},
    "five_bar": {
        "left": (2.1, 0, [(1, 0.24, -0.09), (2, 0.14, 0.11), (3, -0.1, 0.08)]),
        "right": (1.04, 0, [(1, -0.11, 0.22), (2, 0.13, -0.12), (3, 0.09, 0.09)]),
    },
    "arm": {
        "yaw": (0.0, 0, [(1, 1.1, 0.3), (2, -0.45, 0.25)]),
        "shoulder": (-0.55, 0, [(1, -0.3, 0.45), (2, 0.3, 0.18)]),
        "elbow": (0.9, 0, [(1, 0.55, 0.35), (2, 0.25, -0.35)]),
        "wrist": (0.2, 0, [(1, -0.6, 0.8), (3, 0.3, 0.35)]),
    },
    "slider_crank": {"theta": (0.4, 0, [(1, 0.9, 0.3), (2, -0.3, 0.2)])},
    "pendulum": {"theta": (1.2, 0, [(1, 0.8, 0.3), (2, 0.2, 0.1)])},
}


def series(
    name: str, rate: float = 200.0, seconds: float = 4.0, period: float = 4.0
) -> tuple[np.ndarray, Series, Series, Series]:
    """t and analytic q, v, a of a robot's driven joints: a finite Fourier series."""
    t = np.arange(round(seconds * rate)) / rate
    q, v, a = {}, {}, {}
    w = 2 * np.pi / period
    for joint, (offset, turns, terms) in MOTIONS[name].items():
        q[joint] = offset + turns * w * t
        v[joint], a[joint] = np.full_like(t, turns * w), np.zeros_like(t)
        for k, s, c in terms:
            sin, cos = np.sin(k * w * t), np.cos(k * w * t)
            q[joint] = q[joint] + s * sin + c * cos
            v[joint] = v[joint] + k * w * (s * cos - c * sin)
            a[joint] = a[joint] - (k * w) ** 2 * (s * sin + c * cos)
    return t, q, v, a


class Truth:
    """A robot of robots/ closed by Pinocchio alone: `point` rows, and the tilt of `revolute`."""

    def __init__(self, name: str, robots: Path = ROBOTS) -> None:
        self.toml = tomllib.loads((robots / name / "mechanism.toml").read_text())
        self.model = model = pin.buildModelFromUrdf(str(robots / name / self.toml["urdf"]))
        model.gravity.linear = np.array(self.toml["gravity"])
        self.index = {joint: i for i, joint in enumerate(list(model.names)[1:])}
        self.ends = []
        for table in self.toml.get("closure", []):
            ends = []
            for key in "ab":
                frame = model.frames[model.getFrameId(table[key]["link"], pin.FrameType.BODY)]
                rpy = pin.rpy.rpyToMatrix(*table[key].get("rpy", [0.0, 0.0, 0.0]))
                at = frame.placement * pin.SE3(rpy, np.array(table[key]["xyz"]))
                ends.append(
                    model.addFrame(
                        pin.Frame(
                            f"{key}_{len(self.ends)}", frame.parentJoint, at, pin.FrameType.OP_FRAME
                        ),
                        False,
                    )
                )
            axes = ["xyz".index(axis) for axis in table.get("axes", "xyz")]
            self.ends.append((table["kind"], ends, axes))
        self.data = model.createData()
        self.start = pin.neutral(model)
        for joint, value in self.toml["joints"].get("start", {}).items():
            self.start[self.index[joint]] = value

    def rows(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Φ, J, J̇v; the drift of tilt rows vanishes in planar loops, all that close so here."""
        model, data, world = self.model, self.data, pin.LOCAL_WORLD_ALIGNED
        pin.forwardKinematics(model, data, q, v, 0 * v)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        phi, J, drift = [np.zeros(0)], [np.zeros((0, model.nv))], [np.zeros(0)]
        for kind, (a, b), axes in self.ends:
            Ja, Jb = (pin.getFrameJacobian(model, data, f, world) for f in (a, b))
            aa, ab = (
                pin.getFrameClassicalAcceleration(model, data, f, world).linear for f in (a, b)
            )
            phi.append((data.oMf[b].translation - data.oMf[a].translation)[axes])
            J.append((Jb - Ja)[axes])
            drift.append((ab - aa)[axes])
            if kind == "revolute":
                R = data.oMf[a].rotation[:, :2].T
                phi.append(R @ data.oMf[b].rotation[:, 2])
                J.append(R @ (Jb - Ja)[3:])
                drift.append(np.zeros(2))
        return np.concatenate(phi), np.vstack(J), np.concatenate(drift)

    def assemble(self, driven: Sequence[int], y: np.ndarray, q: np.ndarray) -> np.ndarray:
        """q on the closures with the driven coordinates at y, by Newton from q."""
        q = q.copy()
        q[list(driven)] = y
        rest = [k for k in range(self.model.nv) if k not in driven]
        for _ in range(50):
            phi, J, _ = self.rows(q, np.zeros(self.model.nv))
            step = np.linalg.lstsq(J[:, rest], -phi, rcond=1e-10)[0]
            q[rest] += step
            if np.abs(step).max(initial=0.0) < 1e-14:
                break
        return q

    def complete(
        self, t: np.ndarray, q: Series, v: Series, a: Series
    ) -> tuple[Series, Series, Series]:
        """All joints' motion from that of the driven ones."""
        driven = [self.index[joint] for joint in q]
        rest = [k for k in range(self.model.nv) if k not in driven]
        y, yd, ydd = (np.stack([x[joint] for joint in q], axis=1) for x in (q, v, a))
        Q, V, A = (np.zeros((len(t), self.model.nv)) for _ in range(3))
        here = self.start
        for share in np.linspace(0, 1, 60):
            goal = self.start[driven] + share * (y[0] - self.start[driven])
            here = self.assemble(driven, goal, here)
        for i in range(len(t)):
            steps = max(1, int(np.ceil(np.abs(y[i] - here[driven]).max() / 0.05)))
            start = here[driven]
            for k in range(steps):
                here = self.assemble(driven, start + (k + 1) / steps * (y[i] - start), here)
            V[i, driven], A[i, driven] = yd[i], ydd[i]
            _, J, _ = self.rows(here, V[i])
            V[i, rest] = np.linalg.lstsq(J[:, rest], -J[:, driven] @ yd[i], rcond=1e-10)[0]
            _, _, drift = self.rows(here, V[i])
            A[i, rest] = np.linalg.lstsq(J[:, rest], -drift - J[:, driven] @ ydd[i], rcond=1e-10)[0]
            Q[i] = here
        return tuple({j: X[:, k] for j, k in self.index.items()} for X in (Q, V, A))  # type: ignore[return-value]
