"""How far a parameter can sensibly be from its prior.

Noise makes every column look a little excited. A combination of parameters that the data know no
better than this is left at the prior instead of being set to what the noise says.
"""

from __future__ import annotations

import numpy as np

from ident.equations.columns import Columns
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, split

BOUNDLESS = 1e30  # stands for infinity, with which 0 may be multiplied
TORQUE = 10.0  # times the largest torque, by which an effect's unknown is bounded


def plausible(
    mechanism: Mechanism, columns: Columns, torque: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """(k,) largest sensible deviation of every unknown from its prior, in its own unit.

    Of a body with mass m and size l (centre of mass, radius of gyration, or a mean link's length):
    m, m l, m l². Of an effect: ten times the largest torque per unit of its column.

    Args:
        mechanism: whose URDF gives masses and sizes.
        columns: the unknowns.
        torque: (d,) rms torque of the independent coordinates [N m | N].
        size: (k,) rms of every unknown's column.
    """
    m, length = body_scales(mechanism)
    found = np.stack([m, *[m * length] * 3, *[m * length**2] * 6], axis=1).ravel()
    largest = float(torque.max(initial=0.0)) or np.inf
    effects = np.minimum(TORQUE * largest, BOUNDLESS) / np.maximum(
        size[len(columns.rigid) :], 1 / BOUNDLESS
    )
    return np.concatenate([found[columns.rigid], effects])


def body_scales(mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Mass [kg] and size [m] of every body, (bodies,): what the URDF says, a mean link's at least.

    The size is the largest of the centre of mass' distance, the radius of gyration, and the mean
    length of a link.
    """
    model = mechanism.model
    count = len(mechanism.bodies.links)
    steps = [model.jointPlacements[i].translation for i in range(1, model.njoints)]
    for closure in mechanism.closures:  # in absolute coordinates these are all the steps there are
        if closure.frames:
            ends = (frame.placement.translation for frame in closure.frames)
            steps.append(max(ends, key=np.linalg.norm))
    reach = sum(float(np.linalg.norm(step)) for step in steps)
    bodies = mechanism.prior.reshape(count, COUNT)
    total = float(bodies[:, 0].sum())
    found = np.empty((2, count))
    for i, pi in enumerate(bodies):
        m, moments, L = split(pi)
        length = reach / count
        if m > 0:
            length = max(
                length, float(np.linalg.norm(moments)) / m, np.sqrt(max(np.trace(L), 0) / m)
            )
        found[:, i] = max(m, total / count) or 100.0, length or 1.0
    return found[0], found[1]
