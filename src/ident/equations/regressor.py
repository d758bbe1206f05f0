"""Γ(q, v, a), the joint torque regressor of Pinocchio, over samples."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ident.mechanism.parameters import COUNT


def regressor(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Γ (n, nv, 10 · bodies) of q (n, nq), v (n, nv), a (n, nv).

    Γ p are the joint torques of rigid bodies with gravity; source: Pinocchio's
    `computeJointTorqueRegressor`.
    """
    data = model.createData()
    evaluate = pin.computeJointTorqueRegressor
    gamma = np.empty((len(q), model.nv, COUNT * (model.njoints - 1)))
    for q_i, v_i, a_i, out in zip(q, v, a, gamma, strict=True):
        out[...] = evaluate(model, data, q_i, v_i, a_i)
    return gamma


def supports(model: pin.Model) -> list[np.ndarray]:
    """For every row of Γ the columns that can differ from zero: the bodies the joint moves."""
    moved: list[list[int]] = [[] for _ in range(model.nv)]
    for body in range(1, model.njoints):
        joint = body
        while joint > 0:
            for row in range(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint]):
                moved[row].extend(range(COUNT * (body - 1), COUNT * body))
            joint = model.parents[joint]
    return [np.array(sorted(columns), dtype=int) for columns in moved]
