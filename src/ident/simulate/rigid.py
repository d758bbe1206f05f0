"""Rigid bodies at one instant, whatever their parameters are.

    M(q) v̇ + h(q, v) = τ            M and h are linear in the dynamic parameters π

Pinocchio stores a body by mass and centre of mass, and adds bodies only if their mass is positive.
Identified parameters need not be those of bodies that can exist, so π is written as the difference
π⁺ − π⁻ of two sets with positive masses where it must be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ident.mechanism.parameters import COUNT

FAR = 1e3  # [m] a centre of mass beyond is that of a mass that is as good as zero


@dataclass(frozen=True, eq=False)
class Rigid:
    """M, h and inverse dynamics of a tree with given dynamic parameters; made by `Rigid.of`.

    Attributes:
        terms: (sign, model, data) whose signed sum it is.
    """

    terms: tuple[tuple[float, pin.Model, pin.Data], ...]

    @classmethod
    def of(cls, model: pin.Model, pi: np.ndarray) -> Rigid:
        """Of dynamic parameters π (10 · bodies,) in Γ's order, physically possible or not."""
        bodies = pi.reshape(-1, COUNT)
        taken = np.zeros_like(bodies)
        for body, added in zip(bodies, taken, strict=True):
            if body.any() and not _storable(body):
                added[0] = 1.0 + 2.0 * abs(body[0])
        terms = [(1.0, _with(model, bodies + taken))]
        if taken.any():
            terms.append((-1.0, _with(model, taken)))
        return cls(tuple((sign, each, each.createData()) for sign, each in terms))

    def mass(self, q: np.ndarray) -> np.ndarray:
        """M (nv, nv) at q (nq,)."""
        return sum(sign * pin.crba(model, data, q) for sign, model, data in self.terms)

    def bias(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """h (nv,): gravity, Coriolis and centrifugal forces."""
        return sum(
            sign * pin.nonLinearEffects(model, data, q, v) for sign, model, data in self.terms
        )

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """M a + h (nv,), which is Γ(q, v, a) π."""
        return sum(sign * pin.rnea(model, data, q, v, a) for sign, model, data in self.terms)


def _storable(body: np.ndarray) -> bool:
    return bool(body[0] > 0 and np.abs(body[1:4]).max() < FAR * body[0])


def _with(model: pin.Model, bodies: np.ndarray) -> pin.Model:
    """The model with other inertias; a body of zeros has none."""
    other = model.copy()
    other.armature = np.zeros(model.nv)  # what turns with a motor is an effect here
    for index, body in enumerate(bodies, start=1):
        other.inertias[index] = (
            pin.Inertia.FromDynamicParameters(body) if body.any() else pin.Inertia.Zero()
        )
    return other
