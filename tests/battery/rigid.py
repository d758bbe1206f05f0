"""A mechanism as plain data, written twice: as MJCF (the truth) and as a folder with a wrong prior.

Both texts come from one description, so the kinematics agree exactly and only inertias differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Vector = tuple[float, float, float]
TYPES = {"hinge": "revolute", "slide": "prismatic"}


@dataclass(frozen=True)
class Joint:
    name: str
    axis: Vector
    kind: str = "hinge"


@dataclass(frozen=True)
class Body:
    """A link and the joints that carry it, one after the other at the same place."""

    name: str
    parent: str  # "world" is the ground
    joints: tuple[Joint, ...]
    xyz: Vector  # [m] in the parent
    mass: float
    com: Vector
    inertia: np.ndarray  # (3, 3) centroidal, in the link's axes [kg m²]


@dataclass(frozen=True)
class Closure:
    """Two places that coincide: (link, place); `turn` sums joints to the cut pin's own angle."""

    name: str
    kind: str  # "revolute" | "point"
    a: tuple[str, Vector]
    b: tuple[str, Vector]
    turn: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Range:
    """How a driven joint moves: about `centre`, at most `reach` away, at most `speed`."""

    centre: float
    reach: float
    speed: float


@dataclass(frozen=True)
class Machine:
    name: str
    bodies: tuple[Body, ...]
    ranges: Mapping[str, Range]  # of the driven joints
    start: Mapping[str, float] = field(default_factory=dict)
    closures: tuple[Closure, ...] = ()
    pairs: tuple[tuple[str, str], ...] = ()  # joints that may share a motor
    step: float = 2e-4  # of the simulation [s]

    @property
    def joints(self) -> tuple[Joint, ...]:
        return tuple(joint for body in self.bodies for joint in body.joints)

    @property
    def driven(self) -> tuple[str, ...]:
        return tuple(self.ranges)

    @property
    def passive(self) -> tuple[str, ...]:
        return tuple(j.name for j in self.joints if j.name not in self.ranges)


def box(mass: float, com: Vector, size: Vector, rpy: Vector) -> tuple[float, Vector, np.ndarray]:
    """Mass, centre and full inertia tensor of a turned box."""
    x, y, z = size
    principal = mass / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    R = rotation(rpy)
    return mass, com, R @ principal @ R.T


def rotation(rpy: Vector) -> np.ndarray:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    X = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return Z @ Y @ X


def wrong(body: Body, rng: np.random.Generator, spread: float) -> Body:
    """The body off by up to `spread`; still one that can exist: its second moments stay ≥ 0."""

    def scale(n: int) -> np.ndarray:
        return 1 + spread * rng.uniform(-1, 1, n)

    second = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia
    values, axes = np.linalg.eigh(second)
    second = axes @ np.diag(np.maximum(values, 0.0) * scale(3)) @ axes.T
    inertia = np.trace(second) * np.eye(3) - second
    com = tuple(float(x) for x in np.array(body.com) * scale(3))
    mass = float(body.mass * scale(1)[0])
    return Body(body.name, body.parent, body.joints, body.xyz, mass, com, inertia)  # type: ignore[arg-type]


def numbers(values: object) -> str:
    return " ".join(f"{x:.17g}" for x in np.asarray(values, dtype=float).ravel())


def mjcf(machine: Machine) -> str:
    """The truth. Soft constraints as stiff as the step allows, else friction reverses early."""
    soft = f"{2 * machine.step:g} 1"
    inside: dict[str, list[str]] = {"world": []}
    for body in machine.bodies:
        i = body.inertia
        tensor = numbers([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
        inside[body.name] = [
            f'<inertial pos="{numbers(body.com)}" mass="{body.mass:.17g}" fullinertia="{tensor}"/>'
        ] + [
            f'<joint name="{j.name}" type="{j.kind}" axis="{numbers(j.axis)}" '
            f'solreffriction="{soft}"/>'
            for j in body.joints
        ]
    for c in machine.closures:
        for end, (link, place) in (("a", c.a), ("b", c.b)):
            inside[link].append(f'<site name="{c.name}.{end}" pos="{numbers(place)}"/>')

    def tree(link: str) -> str:
        """The link's own elements, then its children in the order of joints."""
        return "".join(inside[link]) + "".join(
            f'<body name="{b.name}" pos="{numbers(b.xyz)}">{tree(b.name)}</body>'
            for b in machine.bodies
            if b.parent == link
        )

    connects = "".join(
        f'<connect site1="{c.name}.a" site2="{c.name}.b" solref="{soft}"/>'
        for c in machine.closures
    )
    sums = {f"closure.{c.name}": c.turn for c in machine.closures if c.turn}
    sums |= {",".join(pair): dict.fromkeys(pair, 1.0) for pair in machine.pairs}
    tendons = "".join(
        f'<fixed name="{name}" solreffriction="{soft}">'
        + "".join(f'<joint joint="{j}" coef="{c:g}"/>' for j, c in turn.items())
        + "</fixed>"
        for name, turn in sums.items()
    )
    return (
        f'<mujoco><compiler angle="radian" balanceinertia="false"/>'
        f'<option timestep="{machine.step:g}" gravity="0 0 -9.81" tolerance="1e-12">'
        '<flag contact="disable" eulerdamp="disable"/></option>'
        f"<worldbody>{tree('world')}</worldbody>"
        f"<equality>{connects}</equality><tendon>{tendons}</tendon></mujoco>"
    )


def urdf(machine: Machine, seed: int | None, spread: float = 0.3) -> str:
    """With true inertias for seed None, else with wrong ones."""
    rng = np.random.default_rng([7, seed]) if seed is not None else None
    parts = ['<link name="world"/>']
    for body in machine.bodies:
        known = wrong(body, rng, spread) if rng else body
        i = known.inertia
        parent, place = body.parent, numbers(body.xyz)
        for joint in body.joints[:-1]:  # several joints at one place: massless links between
            parts.append(f'<link name="{joint.name}_cross"/>')
        for joint in body.joints:
            child = body.name if joint is body.joints[-1] else f"{joint.name}_cross"
            parts.append(
                f'<joint name="{joint.name}" type="{TYPES[joint.kind]}"><parent link="{parent}"/>'
                f'<child link="{child}"/><origin xyz="{place}" rpy="0 0 0"/>'
                f'<axis xyz="{numbers(joint.axis)}"/>'
                '<limit lower="-99" upper="99" velocity="99" effort="999"/></joint>'
            )
            parent, place = child, "0 0 0"
        parts.append(
            f'<link name="{body.name}"><inertial><origin xyz="{numbers(known.com)}" rpy="0 0 0"/>'
            f'<mass value="{known.mass:.17g}"/><inertia ixx="{i[0, 0]:.17g}" ixy="{i[0, 1]:.17g}" '
            f'ixz="{i[0, 2]:.17g}" iyy="{i[1, 1]:.17g}" iyz="{i[1, 2]:.17g}" '
            f'izz="{i[2, 2]:.17g}"/></inertial></link>'
        )
    return f'<robot name="{machine.name}">\n' + "\n".join(parts) + "\n</robot>\n"


def toml(machine: Machine, effects: Mapping[tuple[str, str], Mapping[str, float]]) -> str:
    """mechanism.toml with these effects by (kind, joint); their values are known where given."""
    lines = [f'urdf = "{machine.name}.urdf"', "gravity = [0.0, 0.0, -9.81]", "", "[joints]"]
    if machine.passive:
        lines.append(f"passive = [{', '.join(map(quoted, machine.passive))}]")
    start = ", ".join(
        f"{j} = {machine.start.get(j, 0.0)!r}" for j in (x.name for x in machine.joints)
    )
    lines.append(f"start = {{ {start} }}")
    for c in machine.closures:
        rpy = ", rpy = [1.5707963267948966, 0.0, 0.0]" if c.kind == "revolute" else ""
        ends = [
            f"{key} = {{ link = {quoted(link)}, xyz = {list(place)}{rpy} }}"
            for key, (link, place) in (("a", c.a), ("b", c.b))
        ]
        lines += ["", "[[closure]]", f'name = "{c.name}"', f'kind = "{c.kind}"', *ends]
    if machine.closures:
        lines += ["", "[multipliers]", 'basis = "free"']
    for (kind, joint), values in effects.items():
        lines += ["", "[[effect]]", f'kind = "{kind}"']
        lines += [f"joint = {quoted(joint)}", *(f"{name} = {x!r}" for name, x in values.items())]
    return "\n".join(lines) + "\n"


def quoted(name: str) -> str:
    return f'"{name}"'


def write_folder(
    machine: Machine,
    folder: Path,
    effects: Mapping[tuple[str, str], Mapping[str, float]],
    seed: int | None,
) -> Path:
    """The mechanism folder; seed of the wrong prior, None for the true inertias."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{machine.name}.urdf").write_text(urdf(machine, seed))
    (folder / "mechanism.toml").write_text(toml(machine, effects))
    return folder
