"""What in a result cannot be right, or not of a real machine, and what to look at then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.fit.values import EffectValues
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import pseudo_inertia
from ident.residual.error import Error

CERTAIN = 3.0  # standard errors below zero at which a negative coefficient is no accident
LEAST = 1e-9  # kg below which a body with first moments cannot be written in a URDF
POSSIBLE = -1e-6  # of a body's largest eigenvalue: what rounding may leave below zero


def absurdities(
    mechanism: Mechanism,
    errors: Mapping[str, Error],
    effects: Sequence[EffectValues],
    pi: np.ndarray,
) -> list[str]:
    """Notes on useless predictions, negative friction and impossible bodies.

    Args:
        mechanism: the mechanism.
        errors: in the data that were fitted, by joint.
        effects: with their values.
        pi: dynamic parameters (10 · bodies,) of all bodies.
    """
    said = []
    useless = [joint for joint, e in errors.items() if e.relative is not None and e.relative >= 1]
    if useless:
        said.append(
            f"the prediction for {', '.join(useless)} is no better than zero torque: check sign, "
            "unit and column of its torque and position, and that the torque is a measurement"
        )
    negative = [
        value.name
        for each in effects
        for value, unknown in zip(each.parameters, each.effect.parameters, strict=True)
        if unknown.nonnegative and value.stderr and value.value < -CERTAIN * value.stderr
    ]
    if negative:
        said.append(
            f"{', '.join(negative)} came out negative, which no such effect can be: check the sign "
            "of the torque, or whether another effect is missing"
        )
    massless = [
        link
        for link in mechanism.bodies.links
        if abs(pi[mechanism.bodies.columns(link)][0]) <= LEAST
        and np.any(pi[mechanism.bodies.columns(link)][1:])
    ]
    if massless:
        said.append(
            f"{', '.join(massless)} has moments but a mass that no torque determines: "
            "identified.urdf gives it 1 kg, shifted along what no torque feels"
        )
    impossible = impossible_bodies(mechanism, pi)
    if impossible:
        said.append(
            f"the identified inertia of {', '.join(impossible)} is that of no possible body (its "
            "pseudo-inertia has a negative eigenvalue): the predicted torque does not suffer from "
            "that, but a simulator may refuse identified.urdf; --consistent finds the nearest "
            "bodies that are possible"
        )
    return said


def impossible_bodies(mechanism: Mechanism, pi: np.ndarray) -> list[str]:
    """Links with unknowns whose pseudo-inertia is not positive semidefinite.

    Source: Wensing, Kim, Slotine, IEEE Robot. Autom. Lett. 3(1), 2018.
    """
    asked = {name.rsplit(".", 1)[0] for name in mechanism.unknown}
    found = []
    for link in mechanism.bodies.links:
        eigenvalues = np.linalg.eigvalsh(pseudo_inertia(pi[mechanism.bodies.columns(link)]))
        if link in asked and eigenvalues[0] < POSSIBLE * max(eigenvalues[-1], 1e-300):
            found.append(link)
    return found
