"""What λ does to bodies: forces and moments of closures, in world axes at their places.

    M a + … + Jᵀ λ = τ,  J = ∂Φ/∂q,  so a closure's reaction does the virtual work −λᵀ δΦ

With d = p_b − p_a and the relative turning rate ω = ω_b − ω_a, exactly, and so also where a closure
was assembled with its axes opposed:

    point, revolute, universal, fixed   δΦ = δd                     −λ on b at p_b, +λ on a at p_a
    prismatic, cylindrical, planar      δΦ = R_aᵀ (δp_b − v_a(p_b)) ∓R_a λ, both at p_b
    distance                            δΦ = u·δd, u = d/|d|        ∓u λ
    rx, ry, rz                          δΦ = (y_a × z_b)·ω, (z_b × x_a)·ω, (x_b × y_a)·ω
    rz of universal                     δΦ = (x_a × y_b)·ω          ∓ moments about these
"""

from __future__ import annotations

import numpy as np

from ident.mechanism.closures import KINDS, Closure
from ident.mechanism.mechanism import Mechanism
from ident.show.view3d import Loads

Frames = tuple[np.ndarray, np.ndarray]  # rotations (n, 3, 3), origins (n, 3)


def loads_of(mechanism: Mechanism, places: Frames, multipliers: np.ndarray) -> Loads:
    """The reactions of all closures that hold two frames together; NaN where λ is NaN.

    Args:
        mechanism: the mechanism.
        places: of its bodies in the world, (n, bodies, 3, 3) and (n, bodies, 3) [m], ground first.
        multipliers: (n, m) λ.
    """
    n = len(multipliers)
    names: list[str] = []
    at, force, moment = [], [], []
    for closure in mechanism.closures:
        if not isinstance(closure, Closure):
            continue
        a, b = (_frame(frame.placement, frame.joint, places) for frame in (closure.a, closure.b))
        F, M = _reaction(closure, a, b, _of(mechanism, closure, multipliers))
        sliding = closure.kind in KINDS and KINDS[closure.kind].sliding
        names += [f"{closure.name} on {frame.link}" for frame in (closure.a, closure.b)]
        at += [b[1] if sliding else a[1], b[1]]
        force += [F, -F]
        moment += [M, -M]
    stacked = (np.stack(x, axis=1) if x else np.zeros((n, 0, 3)) for x in (at, force, moment))
    return Loads(tuple(names), np.arange(len(names)) % 2 == 1, *stacked)


def _frame(placement: object, joint: int, places: Frames) -> Frames:
    R, p = places[0][:, joint], places[1][:, joint]
    local, origin = placement.rotation, placement.translation  # type: ignore[attr-defined]
    return R @ local, p + R @ origin


def _of(mechanism: Mechanism, closure: Closure, multipliers: np.ndarray) -> dict[str, np.ndarray]:
    """The closure's own multipliers (n,) by their last word."""
    return {
        name.rpartition(".")[2]: multipliers[:, i]
        for i, name in enumerate(mechanism.kinematics.multipliers)
        if name.rpartition(".")[0] == closure.name
    }


def _reaction(
    closure: Closure, a: Frames, b: Frames, own: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment (n, 3) on a; those on b are opposite."""
    (Ra, pa), (Rb, pb) = a, b
    force, moment = np.zeros_like(pa), np.zeros_like(pa)
    if closure.kind == "distance":
        d = pb - pa
        return own["1"][:, None] * d / np.linalg.norm(d, axis=1, keepdims=True), moment
    kind = KINDS[closure.kind]
    axes = Ra if kind.sliding else np.broadcast_to(np.eye(3), Ra.shape)
    for i, word in enumerate("xyz"):
        if word in own:
            force = force + own[word][:, None] * axes[:, :, i]
        if f"r{word}" in own:
            row = "cross" if kind.rotation == ("cross",) else f"r{word}"
            about = _axis(row, Ra, Rb)
            moment = moment + own[f"r{word}"][:, None] * about
    return force, moment


def _axis(row: str, Ra: np.ndarray, Rb: np.ndarray) -> np.ndarray:
    """(n, 3) about which the multiplier of a rotation's row turns."""
    (xa, ya, _), (xb, yb, zb) = (np.moveaxis(R, -1, 0) for R in (Ra, Rb))
    pair = {"rx": (ya, zb), "ry": (zb, xa), "rz": (xb, ya), "cross": (xa, yb)}[row]
    return np.cross(*pair)
