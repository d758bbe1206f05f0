"""Closed loops that are not shipped: a parallelogram, a crank with a slider, a hexapod."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

Vector = tuple[float, float, float]
Axes = list[tuple[str, str, Vector]]  # name, type of a joint and its axis
IN_PLANE = (0.0, -1.0, 0.0)  # x towards z is positive
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def vector(x: Vector | np.ndarray) -> str:
    return " ".join(repr(float(each)) for each in x)


def body(name: str, parent: str, axes: Axes, at: Vector, mass: float, com: Vector) -> str:
    """A body of a tenth of a metre about its centre of mass, on one joint or several at a place."""
    text, place = "", vector(at)
    for joint, kind, axis in axes:
        child = name if joint == axes[-1][0] else f"{joint}_cross"
        text += (
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{place}" rpy="0 0 0"/><axis xyz="{vector(axis)}"/>'
            '<limit lower="-99" upper="99" velocity="99" effort="9999"/></joint>\n'
        )
        text += f'<link name="{child}"/>\n' if child != name else ""
        parent, place = child, "0 0 0"
    i = [mass * share for share in (0.010, 0.012, 0.008)]
    inertia = f'ixx="{i[0]!r}" ixy="0" ixz="0" iyy="{i[1]!r}" iyz="0" izz="{i[2]!r}"'
    return text + (
        f'<link name="{name}"><inertial><origin xyz="{vector(com)}" rpy="0 0 0"/>'
        f'<mass value="{mass!r}"/><inertia {inertia}/></inertial></link>\n'
    )


def pin(name: str, a: str, at: Vector, b: str, there: Vector) -> str:
    ends = f'a = {{ link = "{a}", xyz = {list(at)} }}\nb = {{ link = "{b}", xyz = {list(there)} }}'
    return f'[[closure]]\nname = "{name}"\nkind = "point"\n{ends}\n'


def files(name: str, bodies: list[str], passive: list[str], start: dict[str, float],
          closures: list[str]) -> tuple[str, str]:  # fmt: skip
    """URDF and mechanism.toml."""
    urdf = f'<robot name="{name}">\n<link name="world"/>\n{"".join(bodies)}</robot>\n'
    free = ", ".join(f'"{joint}"' for joint in passive)
    begin = ", ".join(f"{joint} = {float(x)!r}" for joint, x in start.items())
    toml = f'urdf = "robot.urdf"\ngravity = [0.0, 0.0, -9.81]\n\n[joints]\npassive = [{free}]\n'
    toml += f"start = {{ {begin} }}\n\n" + "\n".join(closures)
    unknown = re.findall(r'<link name="([^"]*)"><inertial>', urdf)
    toml += f"\n[parameters]\nunknown = {unknown!r}\n".replace("'", '"')
    return urdf, toml + '\n[multipliers]\nbasis = "free"\n'


def parallelogram() -> tuple[str, str]:
    """Links of 0.2 and 0.4 m in a vertical plane."""
    bodies = [
        body("crank_link", "world", [("crank", "revolute", IN_PLANE)], (0, 0, 0), 1.2,
             (0.08, 0.0, 0.02)),
        body("coupler_link", "crank_link", [("coupler", "revolute", IN_PLANE)], (0.2, 0, 0), 1.5,
             (0.22, 0.0, 0.03)),
        body("rocker_link", "world", [("rocker", "revolute", IN_PLANE)], (0.4, 0, 0), 1.0,
             (0.09, 0.0, -0.02)),
    ]  # fmt: skip
    closure = pin("pin", "coupler_link", (0.4, 0.0, 0.0), "rocker_link", (0.2, 0.0, 0.0))
    start = {"crank": 1.5, "coupler": -1.5, "rocker": 1.5}
    return files("parallelogram", bodies, ["coupler", "rocker"], start, [closure])


def crank_slider() -> tuple[str, str]:
    """A crank of 0.15 m and a rod of 0.4 m in a vertical plane; the slider moves along x."""
    bodies = [
        body("crank_link", "world", [("crank", "revolute", IN_PLANE)], (0, 0, 0), 1.2,
             (0.06, 0.0, 0.02)),
        body("rod", "crank_link", [("knee", "revolute", IN_PLANE)], (0.15, 0, 0), 0.9,
             (0.22, 0.0, 0.01)),
        body("piston", "world", [("slide", "prismatic", X)], (0, 0, 0), 2.0, (0.0, 0.0, 0.0)),
    ]  # fmt: skip
    closure = pin("wrist", "rod", (0.4, 0.0, 0.0), "piston", (0.0, 0.0, 0.0))
    height, reach = 0.15 * np.sin(0.4), 0.15 * np.cos(0.4)
    start = {"crank": 0.4, "knee": -np.arcsin(height / 0.4) - 0.4,
             "slide": reach + np.sqrt(0.16 - height**2)}  # fmt: skip
    return files("crank_slider", bodies, ["knee", "slide"], start, [closure])


def hexapod() -> tuple[str, str]:
    """A Gough-Stewart platform: six legs with universal joints below and ball joints above."""
    names = ("x", "y", "z", "roll", "pitch", "turn")
    kinds = ["prismatic"] * 3 + ["revolute"] * 3
    free: Axes = list(zip(names, kinds, (X, Y, Z) * 2, strict=True))
    bodies = [body("platform", "world", free, (0, 0, 0), 6.0, (0.03, -0.02, 0.04))]
    start, passive, closures = {"z": 0.6}, [name for name, *_ in free], []
    for number, (below, above) in enumerate(places()):
        d = above + np.array([0.0, 0.0, 0.6]) - below
        axes: Axes = [(f"a{number}", "revolute", X), (f"b{number}", "revolute", Y)]
        at = tuple(map(float, below))
        bodies.append(body(f"tube{number}", "world", axes, at, 1.5, (0.0, 0.01, 0.15)))
        leg: Axes = [(f"leg{number}", "prismatic", Z)]
        bodies.append(body(f"rod{number}", f"tube{number}", leg, (0, 0, 0), 0.8, (0.0, 0.0, -0.2)))
        length = float(np.linalg.norm(d))
        first = float(np.arctan2(-d[1], d[2]))
        start |= {f"a{number}": first, f"b{number}": float(np.arcsin(d[0] / length)),
                  f"leg{number}": length}  # fmt: skip
        passive += [f"a{number}", f"b{number}"]
        top = tuple(map(float, above))
        closures.append(pin(f"ball{number}", f"rod{number}", (0.0, 0.0, 0.0), "platform", top))
    return files("hexapod", bodies, passive, start, closures)


def places() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Where the legs are below, and above in the platform's frame."""
    for k in range(6):
        low = np.deg2rad(60 * (k // 2 * 2) + (15 if k % 2 else -15) + 30)
        high = np.deg2rad(60 * (k // 2 * 2) + (45 if k % 2 else -45) + 30)
        yield (
            0.5 * np.array([np.cos(low), np.sin(low), 0.0]),
            0.25 * np.array([np.cos(high), np.sin(high), 0.0]),
        )
