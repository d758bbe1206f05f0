"""The right side of the equations of motion, as an integrator asks for it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ident.errors import MotionError
from ident.simulate.instant import Actuator, Balance, Instant, Surroundings
from ident.simulate.plant import Moment, Plant
from ident.simulate.presence import Presence

SETTLED = 1e-12  # relative change at which what effects ask for is found
TRIES = 60


class Dynamics:
    """The right side of the equations of motion of a plant.

    Args:
        plant: the mechanism.
        actuator: what drives it.
        around: what time brings.
        independent: joints in whose coordinates the model's own torques are predicted.
    """

    def __init__(
        self, plant: Plant, actuator: Actuator, around: Surroundings, independent: tuple[str, ...]
    ) -> None:
        self.plant, self.actuator, self.around = plant, actuator, around
        self.presence = Presence(plant, independent)
        self.near: np.ndarray | None = None  # whole turns are counted from here
        asked = len(self.presence.asking)
        self._x, self._slope = np.zeros(asked), np.zeros((asked, asked))

    def moment(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Moment:
        """The terms at one state."""
        return self.plant.moment(t, q, v, z, self.near)

    def balance(self, m: Moment, modes: np.ndarray, resting: np.ndarray | None = None) -> Balance:
        """Accelerations and forces in given modes.

        Args:
            modes: (dry,) −1, 0, +1.
            resting: (dry,) joints at rest whose modes are open: they stick or slide as the forces
                at this instant will have it.

        Raises:
            MechanismError: if the inertia of a possible motion is not positive.
            MotionError: if effects that depend on the load contradict each other.
        """
        solver = Instant(self.presence, self.actuator, self.around, m, modes, resting)
        x = self._found(solver) if len(self._x) else self._x
        return solver.balance(x)

    def _found(self, solver: Instant) -> np.ndarray:
        """x = g(x) of what effects ask for, by Newton's method with a slope that is kept."""
        x = self._x
        for k in range(TRIES):
            off = solver.asked(x) - x
            if np.abs(off).max() <= SETTLED * (1.0 + np.abs(x).max()):
                self._x = x
                return x
            if k % 8 == 2:
                self._slope = _slope(solver.asked, x)
            step = np.linalg.lstsq(np.eye(len(x)) - self._slope, off, rcond=1e-12)[0]
            x = x + (step if k < TRIES // 2 else 0.5 * step)
        raise MotionError(
            f"{self.plant.mechanism.name}: at t = {solver.m.t:.6g} s no torque satisfies the "
            "effects that depend on the load (load_friction, torque_gain, …): a coefficient is too "
            "large for this motion"
        )

    def zdot(self, m: Moment) -> np.ndarray:
        """ż = v − |v| z / z0 (presliding,)."""
        v = [m.yd[each.at] for each in self.plant.laws.presliding]
        z0 = [each.z0 for each in self.plant.laws.presliding]
        return np.array([u - abs(u) * z / r for u, z, r in zip(v, m.z, z0, strict=True)])


def _slope(g: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """∂g/∂x by forward differences; g is linear but for signs."""
    base = g(x)
    h = 1e-4 * (1.0 + np.abs(x))
    return np.stack([(g(x + e) - base) / e.sum() for e in np.diag(h)], axis=1)
