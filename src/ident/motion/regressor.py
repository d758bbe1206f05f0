"""Γ(q, v, a), the regressor of a tree of rigid bodies, and forces of given bodies, by Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ident.mechanism.parameters import COUNT

FAR = 1e3  # [m] a centre of mass beyond belongs to a mass of rounding error


def regressor(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Γ (n, nv, 10 · bodies) of q (n, nq), v (n, nv), a (n, nv).

    Γ π are the joint torques of rigid bodies with gravity. Samples are contiguous in memory, as the
    filter of the rows wants them: a column of one row is one stretch.
    """
    data, gamma = model.createData(), np.empty((model.nv, COUNT * (model.njoints - 1), len(q)))
    for i, state in enumerate(zip(q, v, a, strict=True)):
        gamma[:, :, i] = pin.computeJointTorqueRegressor(model, data, *state)
    return gamma.transpose(2, 0, 1)


def rigid_forces(
    model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, pi: np.ndarray
) -> np.ndarray:
    """Γ π (n, nv) of π (10 · bodies,), which needs no Γ."""
    forces = np.zeros((len(q), model.nv))
    for sign, part, data in Rigid.of(model, pi).terms:
        for force, *state in zip(forces, q, v, a, strict=True):
            force += sign * pin.rnea(part, data, *state)
    return forces


def supports(model: pin.Model) -> list[np.ndarray]:
    """For every row of Γ the columns that can differ from zero: the bodies the joint moves."""
    moved: list[list[int]] = [[] for _ in range(model.nv)]
    for body in range(1, model.njoints):
        joint = body
        while joint > 0:
            for row in range(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint]):
                moved[row].extend(range(COUNT * (body - 1), COUNT * body))
            joint = model.parents[joint]
    return [np.array(columns, dtype=int) for columns in moved]


@dataclass(frozen=True, eq=False)
class Rigid:
    """Dynamics of a tree, linear in its dynamic parameters π.

    Pinocchio stores a body by mass and centre of mass, and adds bodies only if their mass is
    positive. Identified parameters need not be those of bodies that can exist, so π is written as
    the difference π⁺ − π⁻ of two sets with positive masses where that is necessary.
    """

    # (sign, model, data) whose signed sum it is
    terms: tuple[tuple[float, pin.Model, pin.Data], ...]

    @classmethod
    def of(cls, model: pin.Model, pi: np.ndarray) -> Rigid:
        """Take π (10 · bodies,) in Γ's order, physically possible or not."""
        bodies = pi.reshape(-1, COUNT)
        added = np.zeros_like(bodies)
        for body, extra in zip(bodies, added, strict=True):
            storable = body[0] > 0 and np.abs(body[1:4]).max() < FAR * body[0]
            if body.any() and not storable:
                extra[0] = 1.0 + 2.0 * abs(body[0])
        signed = [(1.0, bodies + added), *([(-1.0, added)] if added.any() else [])]
        terms = []
        for sign, part in signed:
            other = model.copy()
            other.armature = np.zeros(model.nv)  # the inertia that turns with a motor is an effect
            for index, body in enumerate(part, start=1):
                inertia = pin.Inertia.FromDynamicParameters(body)
                other.inertias[index] = inertia if body.any() else pin.Inertia.Zero()
            terms.append((sign, other, other.createData()))
        return cls(tuple(terms))

    def __call__(self, algorithm: Callable[..., np.ndarray], *state: np.ndarray) -> np.ndarray:
        """Return what an algorithm of Pinocchio makes of a state: crba, nonLinearEffects, rnea."""
        parts = [sign * algorithm(model, data, *state) for sign, model, data in self.terms]
        return np.sum(parts, axis=0) if len(parts) > 1 else parts[0]
