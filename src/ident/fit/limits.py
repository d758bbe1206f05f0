"""Limits of a consistent fit on the unknowns x: G x + h ∈ K, scaled to 1.

Possible bodies: the pseudo-inertia, measured by a ball of the body's own mass and size.

    P(π) = [Σ  h; hᵀ  m],  Σ = tr(L)/2 · 1 − L,  h = m c          possible: P ⪰ 0
    B = F Fᵀ,  F = √m [r·1  c; 0  1]                              of a ball: m, c, r of the prior

P ⪰ 0 says that some distribution of positive mass has these ten parameters (P. Wensing, S. Kim,
J.-J. Slotine, IEEE Robot. Autom. Lett. 3(1), 2018). The eigenvalues of F⁻¹ P F⁻ᵀ are numbers around
1/3 and 1 whatever the units, the frame, and whether a body weighs grams or tons.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.equations.unknowns import Columns
from ident.errors import FitError, one_of
from ident.fit.problem import body_scales
from ident.information.cone import Limit, smat, svec
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import (
    CENTROIDAL,
    COUNT,
    DYNAMIC,
    Consistency,
    about_origin,
    pseudo_inertia,
    split,
)

MARGIN = 1e-6  # of the ball, what a body keeps at least: with 0 no simulator could invert its mass
SMALL = 1e-3  # of a mean link, the least size that is believed
CENTROID = {centroidal: about for about, centroidal in CENTROIDAL.items()}


def in_balls(mechanism: Mechanism) -> list[np.ndarray]:
    """Return (10, 10) of every body: `svec` of F⁻¹ P F⁻ᵀ of each dynamic parameter, a column each.

    Where the URDF gives no mass or no size, those of a mean link stand in.
    """
    found = []
    priors = mechanism.prior.reshape(-1, COUNT)
    for prior, mean_m, mean_l in zip(priors, *body_scales(mechanism), strict=True):
        m, moments, L = split(prior)
        c = moments / m if m > 0 else np.zeros(3)
        m = m if m > 0 else mean_m
        r = np.sqrt(max(np.trace(L) / (2 * m) - c @ c, 0.0))
        if r < SMALL * mean_l:
            r = 0.1 * mean_l
        F = np.eye(4)  # its inverse
        F[:3, :3] /= r
        F[:3, 3] = -c / r
        F /= np.sqrt(m)
        columns = [svec(F @ pseudo_inertia(one) @ F.T) for one in np.eye(COUNT)]
        found.append(np.stack(columns, axis=1))
    return found


def of_bodies(mechanism: Mechanism, columns: Columns) -> np.ndarray:
    """Return ∂π/∂x (10 · bodies, k) of all dynamic parameters."""
    D = np.zeros((len(mechanism.prior), len(columns)))
    D[columns.rigid, np.arange(len(columns.rigid))] = 1.0
    return D


def smallest_eigenvalues(mechanism: Mechanism, pi: np.ndarray) -> dict[str, float]:
    """Return that of F⁻¹ P F⁻ᵀ by link: below zero for an impossible body."""
    bodies = zip(mechanism.bodies.links, in_balls(mechanism), pi.reshape(-1, COUNT), strict=True)
    return {link: float(np.linalg.eigvalsh(smat(S @ body))[0]) for link, S, body in bodies}


def limits_of(
    mechanism: Mechanism,
    columns: Columns,
    asked: Consistency,
    scale: np.ndarray,
    shapes: Mapping[int, tuple[float, float]],
) -> list[Limit]:
    """Return limits: possible bodies, effects that cannot be negative, shapes, bounds, total mass.

    Args:
        mechanism, columns: whose unknowns.
        asked: bounds and total mass.
        scale: (k,) size of every unknown, that is plausible.
        shapes: by place in x, the range in which a shape's column means something.

    Raises:
        FitError: for a bound on what is no unknown, or is no linear function of the unknowns.
    """
    intervals = [  # low ≤ x_at + constant ≤ high
        (name, at, 0.0, (0.0, np.inf), "")
        for effect, places in columns.effects
        for name, unknown, at in zip(effect.names, effect.parameters, places, strict=True)
        if at >= 0 and unknown.nonnegative
    ]
    intervals += [(columns.names[at], at, 0.0, bounds, "") for at, bounds in shapes.items()]
    for name, bounds in asked.bounds.items():
        at, constant = _linear(mechanism, columns, name)
        intervals.append((name, at, constant, bounds, f" {columns.units[at]}"))
    limits = _bodies(mechanism, columns)
    for name, at, constant, bounds, unit in intervals:
        row = np.zeros((1, len(columns)))
        row[0, at] = 1.0 / scale[at]
        low, high = (np.array([(bound - constant) / scale[at]]) for bound in bounds)
        if bounds[0] == bounds[1]:
            limits.append(Limit(f"{name} = {bounds[0]:.6g}{unit}", "zero", row, -low, name))
            continue
        for sign, bound, G, h in (("≥", bounds[0], row, -low), ("≤", bounds[1], -row, high)):
            if np.isfinite(bound):
                limits.append(Limit(f"{name} {sign} {bound:.6g}{unit}", "nonnegative", G, h, name))
    if asked.total_mass is not None:
        limits.append(_total(mechanism, columns, asked.total_mass))
    return limits


def _bodies(mechanism: Mechanism, columns: Columns) -> list[Limit]:
    """Return P ⪰ MARGIN · B of every body with unknowns, and of every body with its payload."""
    D = of_bodies(mechanism, columns)
    known = columns.dynamic_parameters(mechanism, np.zeros(len(columns)))
    payloads = {
        effect.joints[0]: (effect, places)
        for effect, places in columns.effects
        if effect.loaded_link
    }
    found, edge = [], MARGIN * svec(np.eye(4))
    for link, S in zip(mechanism.bodies.links, in_balls(mechanism), strict=True):
        mine = mechanism.bodies.columns(link)
        G, pi = D[mine].copy(), known[mine].copy()
        if G.any():
            found.append(Limit(f"{link} is a possible body", "psd", S @ G, S @ pi - edge, link))
        if link in payloads:
            effect, places = payloads[link]
            for j, (at, parameter) in enumerate(zip(places, effect.parameters, strict=True)):
                if at >= 0:
                    G[j, at] += 1.0
                else:
                    pi[j] += effect.values[parameter.name]
            name = f"{link} with its payload is a possible body"
            found.append(Limit(name, "psd", S @ G, S @ pi - edge, link))
    return found


def _total(mechanism: Mechanism, columns: Columns, mass: float) -> Limit:
    masses = np.tile(np.eye(COUNT)[0], len(mechanism.bodies.links))
    row = masses @ of_bodies(mechanism, columns) / mass
    known = float(masses @ columns.dynamic_parameters(mechanism, np.zeros(len(columns))))
    if not row.any():
        raise FitError(
            f"total mass {mass:g} kg: no body's mass is unknown, they add up to {known:.6g} kg; "
            "leave it out, or make a link's m unknown"
        )
    return Limit(f"total mass = {mass:g} kg", "zero", row[None], np.array([known / mass - 1.0]))


def _linear(mechanism: Mechanism, columns: Columns, name: str) -> tuple[int, float]:
    """Return the unknown and the constant of which a named parameter is the sum."""
    link, _, word = name.rpartition(".")
    column, constant = name, 0.0
    if link in mechanism.bodies.links and word in CENTROID:
        moving = [f"{link}.{w}" for w in DYNAMIC[:4] if f"{link}.{w}" in columns.index]
        if moving:
            raise FitError(
                f"bounds of {name}: about the centre of mass, which is unknown ({moving[0]}), it "
                f"is no linear function of the unknowns; bound {link}.{CENTROID[word]}, about the "
                "joint frame's origin, or m and the first moments"
            )
        pi = mechanism.prior[mechanism.bodies.columns(link)]
        column = f"{link}.{CENTROID[word]}"
        i, j = ("xyz".index(axis) for axis in word[1:])
        constant = -float(about_origin(*split(pi)[:2])[i, j])
    if column in columns.index:
        return columns.index[column], constant
    known = [*mechanism.bodies.names, *(n for effect, _ in columns.effects for n in effect.names)]
    if name in known or word in CENTROID:
        raise FitError(
            f"bounds of {name}: it is known, so nothing can move it; add it to [parameters] "
            "unknown, or leave the bound out"
        )
    raise FitError(f"bounds of {name}: there is no such parameter; {one_of(name, known)}")
