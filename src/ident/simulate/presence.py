"""What the model itself says of a joint's torque and load, for effects whose torque depends on it.

    load = (Γ π − f_e)_j     torque = load + Σ E c of effects that do not ask     in closures |λ|

As `ident.equations.predicted` has it for a whole log, here at one instant of an integration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.motion.close import pseudo_inverse
from ident.simulate.plant import Moment, Plant


@dataclass(frozen=True, eq=False)
class Presence:
    """Predicts torque, load and acceleration of the joints that some law asks for.

    Args:
        plant: the mechanism.
        independent: joints in whose coordinates driven joints' torques are predicted.
    """

    plant: Plant
    independent: tuple[str, ...]

    @cached_property
    def asking(self) -> tuple[tuple[str, int], ...]:
        """(what, joint)."""
        return self.plant.laws.asking

    def of(
        self, m: Moment, a: np.ndarray, rigid: np.ndarray, others: np.ndarray, tau: np.ndarray
    ) -> np.ndarray:
        """What is asked for (asking,), from generalised forces (nv,) and drives' τ (driven,)."""
        joints = sorted({i for word, i in self.asking if word != "ydd"})
        said = self._torques(m, joints, rigid, others, tau) if joints else {}
        said |= {("ydd", i): m.W[i] @ a + m.drift[i] for word, i in self.asking if word == "ydd"}
        return np.array([said[each] for each in self.asking])

    def _torques(
        self, m: Moment, joints: list[int], rigid: np.ndarray, others: np.ndarray, tau: np.ndarray
    ) -> dict[tuple[str, int], float]:
        mechanism = self.plant.mechanism
        found: dict[tuple[str, int], float] = {}
        if not mechanism.closures:
            for i in joints:
                at = mechanism.joints[i].index
                found["load", i], found["torque", i] = rigid[at], rigid[at] + others[at]
            return found
        u = [mechanism.joint_index[name] for name in self.independent]
        Kp = pseudo_inverse(np.concatenate([m.J, m.W[u]])[None])[0]
        surplus = [k for k, name in enumerate(mechanism.driven) if name not in self.independent]
        known = sum(
            (m.W[mechanism.joint_index[mechanism.driven[k]]] * tau[k] for k in surplus),
            np.zeros(len(rigid)),
        )
        for i in joints:
            joint = mechanism.joints[i]
            if joint.name in self.independent:
                extract = Kp[:, len(m.J) + self.independent.index(joint.name)]
                found["load", i] = extract @ (rigid - known)
                found["torque", i] = extract @ (rigid + others - known)
            elif joint.name in mechanism.driven:
                found["load", i] = found["torque", i] = tau[mechanism.driven.index(joint.name)]
            elif joint.in_tree:
                found["load", i] = found["torque", i] = 0.0
            else:
                force = Kp[:, self._forces_of(joint.name)].T @ (rigid + others - known)
                found["load", i] = found["torque", i] = float(np.linalg.norm(force))
        return found

    def _forces_of(self, joint: str) -> list[int]:
        """Multipliers that are forces of the closure whose own joint this is."""
        kinematics = self.plant.mechanism.kinematics
        bare = joint.removeprefix("closure.")
        owners = {bare, bare.removesuffix(".z").removesuffix(".rz"), f"joint.{joint}"}
        names = zip(kinematics.multipliers, kinematics.units, strict=True)
        return [
            k
            for k, (name, unit) in enumerate(names)
            if name.rpartition(".")[0] in owners and unit == "N"
        ]
