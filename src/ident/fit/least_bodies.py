"""The least bodies with which a simulator takes a machine whose links move without mass.

    P(π) + P_s ≻ 0,   P_s = s M [r² 1/5  0; 0  1]

M and r are mass and reach of the whole machine, s a share of it that no torque sensor sees. A
simulator inverts the mass of every body that moves (MuJoCo refuses what has less than 1e-15), and a
URDF has frames that move and weigh nothing: those of a universal joint or of absolute coordinates,
point masses, flat plates. A body which is smaller than a ball with the share s of the machine gets
that ball added, at its link's origin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.equations.problem import body_scales
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, DYNAMIC, pseudo_inertia, rigid_forces
from ident.motion.state import State

SHARE = 1e-7  # range: of the machine's mass, and less than any torque sensor resolves of its weight
SIZE = 0.1  # range: of a mean link, a ball's radius
GYRATION = 0.2  # numerics: Σ of a ball with the radius 1: ∫ x² dm / m
SAMPLES = 1000  # work: of a log, at which the change of the torques is evaluated


@dataclass(frozen=True, eq=False)
class LeastBodies:
    """Balls that were added to bodies of too little mass or inertia."""

    links: tuple[str, ...]
    mass: float  #: of each ball [kg]
    radius: float  #: [m]
    pi: np.ndarray  #: (10 · bodies,) what they add to the dynamic parameters
    #: by independent joint, rms [N m | N] of what they add to the torques
    difference: Mapping[str, float]

    @classmethod
    def of(
        cls, mechanism: Mechanism, pi: np.ndarray, states: Sequence[State]
    ) -> LeastBodies | None:
        """Return the balls that bodies with parameters `pi` (10 · bodies,) need; None without any.

        Their torques are those on the motion of `states`.
        """
        masses, sizes = body_scales(mechanism)
        m, r = SHARE * float(masses.sum()), SIZE * float(sizes.mean())
        ball = ball_parameters(m, r)
        half = np.diag(1 / np.sqrt(np.diag(pseudo_inertia(ball))))
        added, links = np.zeros_like(pi), []
        for link in mechanism.bodies.links:
            body = mechanism.bodies.columns(link)
            least = np.linalg.eigvalsh(half @ pseudo_inertia(pi[body]) @ half)[0]
            if -1.0 < least < 1.0:  # a body that cannot exist is a finding, and stays
                added[body] = ball
                links.append(link)
        if not links:
            return None
        names = states[0].independent
        sums, count = np.zeros(len(names)), 0
        for state in states:
            e = state.thinned(max(len(state) // SAMPLES, 1))
            forces = rigid_forces(mechanism.model, e.q, e.v, e.a, added)
            Z = e.pinv[:, :, -len(names) :]
            torques = np.einsum("niu,ni->nu", Z, forces)[e.usable]
            sums += np.sum(torques**2, axis=0)
            count += len(torques)
        rms = np.sqrt(sums / max(count, 1))
        return cls(tuple(links), m, r, added, dict(zip(names, map(float, rms), strict=True)))

    @property
    def words(self) -> str:
        """What was added, and what that does to the torques, for the file itself."""
        most = max(self.difference, key=self.difference.__getitem__)
        return (
            f"{', '.join(self.links)}: a ball of {self.mass:.2g} kg with a radius of "
            f"{self.radius:.2g} m was added, as simulators refuse bodies without mass or inertia; "
            f"it changes torques by {self.difference[most]:.1g} at most ({most}, rms)"
        )

    def json(self) -> dict[str, Any]:
        """Return the entry of fit.json."""
        return {
            "links": list(self.links),
            "mass": self.mass,
            "radius": self.radius,
            "torque_change": dict(self.difference),
        }


def ball_parameters(m: float, r: float) -> np.ndarray:
    """Return the ten parameters (10,) of a ball of mass m [kg] and radius r [m] at the origin."""
    values = dict.fromkeys(("Lxx", "Lyy", "Lzz"), 2 * GYRATION * m * r**2) | {"m": m}
    ball = np.array([values.get(name, 0.0) for name in DYNAMIC])
    assert ball.shape == (COUNT,)
    return ball
