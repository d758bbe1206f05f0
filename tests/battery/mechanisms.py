"""The mechanisms: two arms, four planar loops and the paper's spatial slider-crank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from rigid import Body, Closure, Joint, Machine, Range, box

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
IN_PLANE = (0.0, -1.0, 0.0)  # x towards z is positive


def arm3() -> Machine:
    bodies = (
        Body("turret", "world", (Joint("yaw", Z),), (0, 0, 0.3),
             *box(4.0, (0.02, -0.03, 0.08), (0.15, 0.12, 0.22), (0.3, -0.2, 0.4))),
        Body("upper", "turret", (Joint("shoulder", Y),), (0.0, 0.05, 0.15),
             *box(3.0, (0.17, 0.03, 0.02), (0.38, 0.08, 0.10), (0.2, 0.1, -0.15))),
        Body("fore", "upper", (Joint("elbow", Y),), (0.35, -0.02, 0.0),
             *box(1.8, (0.14, -0.02, 0.03), (0.30, 0.06, 0.08), (-0.3, 0.15, 0.2))),
    )  # fmt: skip
    ranges = {
        "yaw": Range(0.0, 1.4, 3.0),
        "shoulder": Range(-0.5, 0.9, 2.2),
        "elbow": Range(0.8, 1.1, 3.0),
    }
    return Machine("arm3", bodies, ranges)


def arm6() -> Machine:
    names = ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6")
    axes = (Z, Y, Y, X, Y, X)
    places = ((0, 0, 0.3), (0.05, 0, 0.12), (0, 0.02, 0.32), (0.16, 0, 0.03), (0.16, 0, 0),
              (0.07, 0, 0))  # fmt: skip
    solids = (
        box(7.0, (0.02, -0.01, 0.05), (0.2, 0.18, 0.25), (0.2, 0.1, 0.3)),
        box(6.0, (0.01, 0.03, 0.15), (0.10, 0.12, 0.40), (0.1, -0.2, 0.2)),
        box(3.5, (0.06, -0.02, 0.03), (0.22, 0.10, 0.12), (-0.2, 0.2, 0.1)),
        box(1.8, (0.08, 0.01, 0.015), (0.22, 0.07, 0.06), (0.3, 0.1, -0.2)),
        box(1.0, (0.03, 0.008, 0.012), (0.12, 0.06, 0.08), (0.1, 0.3, 0.2)),
        box(0.8, (0.06, 0.025, -0.02), (0.12, 0.10, 0.05), (-0.2, 0.3, 0.4)),
    )
    bodies = tuple(
        Body(f"link_{k + 1}", f"link_{k}" if k else "world", (Joint(names[k], axes[k]),),
             places[k], *solids[k])
        for k in range(6)
    )  # fmt: skip
    reach, speed = (1.4, 0.8, 0.9, 1.6, 1.3, 1.8), (2.5, 2.0, 2.5, 3.5, 3.5, 4.0)
    centre = (0.0, 0.2, 0.6, 0.0, 0.4, 0.0)
    ranges = {n: Range(c, r, s) for n, c, r, s in zip(names, centre, reach, speed, strict=True)}
    pairs = (("joint_5", "joint_6"), ("joint_4", "joint_5"))
    return Machine("arm6", bodies, ranges, pairs=pairs)


def four_bar(name: str, ground: float, crank: float, coupler: float, rocker: float, drive: Range,
             start: tuple[float, float, float]) -> Machine:  # fmt: skip
    """Vertical plane; the coupler's far end is a full pin, so it has a joint of its own."""
    bodies = (
        Body("crank_link", "world", (Joint("crank", IN_PLANE),), (0, 0, 0),
             *box(1.2, (0.4 * crank, 0.01, 0.02), (0.22, 0.03, 0.05), (0.1, 0.2, 0.1))),
        Body("coupler_link", "crank_link", (Joint("coupler", IN_PLANE),), (crank, -0.012, 0),
             *box(1.5, (0.55 * coupler, -0.01, 0.03), (coupler, 0.03, 0.06), (0.0, 0.1, 0.1))),
        Body("rocker_link", "world", (Joint("rocker", IN_PLANE),), (ground, 0, 0),
             *box(1.0, (0.45 * rocker, 0.006, -0.02), (rocker, 0.03, 0.05), (0.2, 0.1, 0.0))),
    )  # fmt: skip
    turn = {"crank": 1.0, "coupler": 1.0, "rocker": -1.0}
    pin = Closure("pin", "revolute", ("coupler_link", (coupler, 0.006, 0.0)),
                  ("rocker_link", (rocker, -0.006, 0.0)), turn)  # fmt: skip
    at = dict(zip(("crank", "coupler", "rocker"), start, strict=True))
    return Machine(name, bodies, {"crank": drive}, at, (pin,), step=1e-4)


def five_bar() -> Machine:
    upper, lower = 0.22, 0.36
    bodies = []
    for side, at in (("left", -0.10), ("right", 0.10)):
        lean = 1.0 if side == "left" else -1.0
        bodies += [
            Body(f"{side}_upper", "world", (Joint(side, IN_PLANE),), (at, 0, 0),
                 *box(1.1, (0.09, 0.01, 0.015 * lean), (upper, 0.04, 0.05), (0.1, 0.2, 0.1))),
            Body(f"{side}_lower", f"{side}_upper", (Joint(f"{side}_elbow", IN_PLANE),),
                 (upper, 0, 0),
                 *box(0.8, (0.14, -0.01, 0.02 * lean), (lower, 0.03, 0.04), (0.0, 0.1, 0.2))),
        ]  # fmt: skip
    turn = {"left": 1.0, "left_elbow": 1.0, "right": -1.0, "right_elbow": -1.0}
    tip = Closure("tip", "revolute", ("left_lower", (lower, 0.006, 0.0)),
                  ("right_lower", (lower, 0.006, 0.0)), turn)  # fmt: skip
    ranges = {"left": Range(2.2, 0.55, 2.5), "right": Range(np.pi - 2.2, 0.55, 2.5)}
    # both elbows outwards; the tip on the axis of symmetry
    x, z = -0.10 + upper * np.cos(2.2), upper * np.sin(2.2)
    low = np.arctan2(np.sqrt(lower**2 - x**2), -x)
    start = {"left": 2.2, "left_elbow": low - 2.2, "right": np.pi - 2.2, "right_elbow": 2.2 - low}
    assert z > 0
    start = {name: float(q) for name, q in start.items()}
    return Machine("five_bar", tuple(bodies), ranges, start, (tip,), step=1e-4)


def slider_crank() -> Machine:
    """Geometry and masses of the paper's table 1; only the crank is driven."""
    rod = (Joint("alpha", Z), Joint("beta", X))
    bodies = (
        Body("crank", "world", (Joint("theta", X),), (0.0, 0.1, 0.12),
             0.12, (0.0, 0.0, 0.04), 1e-4 * np.eye(3)),
        Body("piston", "world", (Joint("s", X, "slide"),), (0, 0, 0),
             2.0, (0.0, 0.0, 0.0), 1e-4 * np.eye(3)),
        Body("rod", "piston", rod, (0, 0, 0), 0.5, (0.0, 0.15, 0.0), np.diag([4e-3, 4e-4, 4e-3])),
    )  # fmt: skip
    ball = Closure("ball", "point", ("crank", (0.0, 0.0, 0.08)), ("rod", (0.0, 0.3, 0.0)))
    start = {"theta": 0.0, "s": 0.2, "alpha": 1.1071487177940904, "beta": 0.7297276562269663}
    drive = {"theta": Range(0.4, 4.5, 5.0)}
    return Machine("slider_crank", bodies, drive, start, (ball,), step=1e-4)


FULL = Range(0.5, 4.5, 5.0)  # more than a turn each way
AT_REST = (0.0, 0.609385308031, 1.218770616062)
crank_rocker = four_bar("crank_rocker", 0.40, 0.15, 0.41, 0.25, FULL, AT_REST)
MACHINES: Mapping[str, Machine] = {
    machine.name: machine
    for machine in (
        arm3(),
        arm6(),
        crank_rocker,
        replace(crank_rocker, name="crank_rocker_15", ranges={"crank": Range(1.2, 0.26, 1.2)}),
        five_bar(),
        slider_crank(),
        four_bar("parallelogram", 0.40, 0.20, 0.40, 0.20, Range(1.5, 0.85, 2.5),
                 (1.5, -1.5, 1.5)),
    )
}  # fmt: skip
