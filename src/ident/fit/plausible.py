"""How far a parameter can sensibly be from its prior.

Noise makes every column look a little excited. A combination of parameters that the data know no
better than this is left at the prior instead of being set to what the noise says.
"""

from __future__ import annotations

import numpy as np

from ident.equations.columns import Columns
from ident.mechanism.closures import Closure
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, split

TORQUE = 10.0  # times the largest torque, by which an effect's unknown is bounded


def plausible(mechanism: Mechanism, columns: Columns, torque: np.ndarray) -> np.ndarray:
    """(k,) largest sensible deviation of every unknown from its prior, in its own unit.

    Of a body with mass m and size l (centre of mass, radius of gyration, or a mean link's length):
    m, m l, m l². Of an effect: ten times the largest torque per unit of its column.

    Args:
        mechanism: whose URDF gives masses and sizes.
        columns: the unknowns.
        torque: (d,) rms torque of the independent coordinates [N m | N].
    """
    model = mechanism.model
    count = len(mechanism.bodies.links)
    frames = [
        frame.placement.translation
        for closure in mechanism.closures
        if isinstance(closure, Closure)
        for frame in (closure.a, closure.b)
    ]
    steps = [model.jointPlacements[i].translation for i in range(1, model.njoints)]
    reach = sum(float(np.linalg.norm(step)) for step in steps)
    reach += max((float(np.linalg.norm(place)) for place in frames), default=0.0)
    bodies = mechanism.prior.reshape(count, COUNT)
    total = float(bodies[:, 0].sum())
    found = np.empty(len(mechanism.prior))
    for i, pi in enumerate(bodies):
        m, moments, L = split(pi)
        size = reach / count
        if m > 0:
            size = max(size, float(np.linalg.norm(moments)) / m, np.sqrt(max(np.trace(L), 0) / m))
        m, size = max(m, total / count) or 100.0, size or 1.0
        scale = np.array([m] + [m * size] * 3 + [m * size**2] * 6)
        found[COUNT * i : COUNT * (i + 1)] = scale
    largest = float(torque.max(initial=0.0)) or np.inf
    effects = np.full(len(columns) - len(columns.rigid), TORQUE * largest)
    return np.concatenate([found[columns.rigid], effects])
