"""What a consistent fit must keep to, as limits on the unknowns x: G x + h ∈ K, scaled to 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.effects.payload import Payload
from ident.equations.columns import Columns
from ident.errors import FitError, one_of
from ident.fit.bodies import MARGIN, basis, unit_ball
from ident.information.cone import Limit, svec
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import CENTROIDAL, COUNT, DYNAMIC, Consistency, about_origin, split

CENTROID = {centroidal: about for about, centroidal in CENTROIDAL.items()}


def limits_of(
    mechanism: Mechanism,
    columns: Columns,
    asked: Consistency,
    scale: np.ndarray,
    shapes: Mapping[int, tuple[float, float]],
) -> list[Limit]:
    """Possible bodies, effects that cannot be negative, shapes within reach, bounds, total mass.

    Args:
        mechanism, columns: whose unknowns.
        asked: bounds and total mass.
        scale: (k,) size of every unknown, from `plausible`.
        shapes: by place in x, the range in which a shape's column means something.

    Raises:
        FitError: for a bound on what is no unknown, or is no linear function of the unknowns.
    """
    found = _bodies(mechanism, columns)
    for effect, places in columns.effects:
        for name, unknown, at in zip(effect.names, effect.parameters, places, strict=True):
            if at >= 0 and unknown.nonnegative:
                found.append(_least(f"{name} ≥ 0", _row(len(columns), at), 0.0, scale[at], name))
    for at, (low, high) in shapes.items():
        found += _between(columns.names[at], _row(len(columns), at), low, high, scale[at], "")
    for name, (low, high) in asked.bounds.items():
        row, constant, size, unit = _linear(mechanism, columns, name, scale)
        found += _between(name, row, low - constant, high - constant, size, f" {unit}", constant)
    if asked.total_mass is not None:
        found.append(_total(mechanism, columns, asked.total_mass))
    return found


def _row(k: int, at: int) -> np.ndarray:
    row = np.zeros(k)
    row[at] = 1.0
    return row


def _least(said: str, row: np.ndarray, low: float, scale: float, name: str) -> Limit:
    return Limit(said, "nonnegative", row[None] / scale, np.array([-low / scale]), name)


def _between(
    name: str,
    row: np.ndarray,
    low: float,
    high: float,
    scale: float,
    unit: str,
    constant: float = 0.0,
) -> list[Limit]:
    """low ≤ row·x ≤ high, a limit a side; `constant`: what the name's value has beyond row·x."""
    said = f"{name} {{}} {{:.6g}}{unit}"
    if low == high:
        h = np.array([-low / scale])
        return [Limit(said.format("=", low + constant), "zero", row[None] / scale, h, name)]
    found = []
    if np.isfinite(low):
        found.append(_least(said.format("≥", low + constant), row, low, scale, name))
    if np.isfinite(high):
        found.append(_least(said.format("≤", high + constant), -row, -high, scale, name))
    return found


def _bodies(mechanism: Mechanism, columns: Columns) -> list[Limit]:
    """P ⪰ MARGIN · B of every body with unknowns, and of every body with its payload."""
    own = {int(column): i for i, column in enumerate(columns.rigid)}
    payloads = {
        effect.joints[0]: (effect, places)
        for effect, places in columns.effects
        if isinstance(effect, Payload)
    }
    found = []
    for number, link in enumerate(mechanism.bodies.links):
        S = basis(unit_ball(mechanism, number))
        G, h = np.zeros((COUNT, len(columns))), -MARGIN * svec(np.eye(4))
        for j in range(COUNT):
            column = COUNT * number + j
            if column in own:
                G[:, own[column]] += S[:, j]
            else:
                h += S[:, j] * mechanism.prior[column]
        if G.any():
            found.append(Limit(f"{link} is a possible body", "psd", G, h, link))
        if link in payloads:
            effect, places = payloads[link]
            G, h = G.copy(), h.copy()
            for j, (at, parameter) in enumerate(zip(places, effect.parameters, strict=True)):
                if at >= 0:
                    G[:, at] += S[:, j]
                else:
                    h += S[:, j] * effect.values[parameter.name]
            found.append(Limit(f"{link} with its payload is a possible body", "psd", G, h, link))
    return found


def _total(mechanism: Mechanism, columns: Columns, mass: float) -> Limit:
    masses = [f"{link}.m" for link in mechanism.bodies.links]
    unknown = [columns.index[name] for name in masses if name in columns.index]
    names = mechanism.bodies.names
    known = sum(
        float(mechanism.prior[names.index(name)]) for name in masses if name not in columns.index
    )
    if not unknown:
        raise FitError(
            f"total mass {mass:g} kg: no body's mass is unknown, they add up to {known:.6g} kg; "
            "leave it out, or make a link's m unknown"
        )
    row = np.zeros(len(columns))
    row[unknown] = 1.0 / mass
    return Limit(f"total mass = {mass:g} kg", "zero", row[None], np.array([known / mass - 1.0]))


def _linear(
    mechanism: Mechanism, columns: Columns, name: str, scale: np.ndarray
) -> tuple[np.ndarray, float, float, str]:
    """A named parameter as row·x + constant, its size, and its unit."""
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
    if column not in columns.index:
        _refuse(mechanism, columns, name)
    at = columns.index[column]
    return _row(len(columns), at), constant, float(scale[at]), columns.units[at]


def _refuse(mechanism: Mechanism, columns: Columns, name: str) -> None:
    known: Sequence[str] = [
        *mechanism.bodies.names, *(n for effect, _ in columns.effects for n in effect.names)
    ]  # fmt: skip
    if name in known or name.rpartition(".")[2] in CENTROID:
        raise FitError(
            f"bounds of {name}: it is known, so nothing can move it; add it to [parameters] "
            "unknown, or leave the bound out"
        )
    raise FitError(f"bounds of {name}: there is no such parameter; {one_of(name, known)}")
