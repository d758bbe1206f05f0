"""A motion of the drives as the equations see it: followed through the closures, with its rows.

τ̂ = A x₀ − b         rows of the thinned motion, x₀ the prior, b of a motion without torques
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Correcting
from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.rows import informing, reach
from ident.equations.scene import Scene
from ident.equations.terms import terms
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.independent import best_conditioned
from ident.motion.place import again, in_tree, reduced, through_closures
from ident.motion.rest import STILL

LEAP = 0.4  # [rad | m] by which a drive may move in one step along the branch
SLIP, GAIN = 0.05, 2.0  # [rad | m] and times ‖K⁺‖ of that step, by which the others may
EVERY = slice(None)


@dataclass(frozen=True, eq=False)
class Seen:
    """What n samples of a motion show.

    Attributes:
        e: the experiment, with the torques that the model predicts.
        A: (n, d, k) rows; informed: (n, d), false where dry friction leaves the torque open.
    """

    e: Experiment
    A: np.ndarray
    informed: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """A (n, d, k) with zeros where it does not inform."""
        return self.A * self.informed[:, :, None]


@dataclass(frozen=True, eq=False)
class Stage:
    """A mechanism with the unknowns and the working point of its equations."""

    mechanism: Mechanism
    columns: Columns
    point: Point

    def followed(self, near: Experiment, states: np.ndarray) -> Experiment | None:
        """The experiment at y, ẏ, ÿ (3, n, d) of its drives, on the branch of one that is near.

        None where the closures cannot follow, or would leap. Speeds of standstill stay as they are.
        """
        at = [self.mechanism.joint_index[name] for name in near.independent]
        step = states - np.stack([x[:, at] for x in (near.y, near.yd, near.ydd)])
        if self.mechanism.closures and np.abs(step[0]).max() > LEAP:
            return None
        try:
            with np.errstate(all="ignore"):
                moved = {name: tuple(step[:, :, i]) for i, name in enumerate(near.independent)}
                e = again(self.mechanism, near, moved)
        except (MotionError, np.linalg.LinAlgError):
            return None
        if not e.usable.all() or _leapt(near, e, step[0]):
            return None
        return e

    def seen(self, e: Experiment) -> Seen:
        """Rows and predicted torques of an experiment."""
        mechanism = self.mechanism
        e = replace(e, tau=np.zeros((len(e), len(mechanism.driven))))
        scene = Scene.of(mechanism, self.columns, e, self.point)
        found = terms(scene, EVERY)
        x = self.columns.prior_at(self.point.values)
        e = replace(e, tau=self._of_drives(e, found.A @ x - found.b))
        if any(isinstance(effect, Correcting) for effect in mechanism.effects):
            scene = Scene.of(mechanism, self.columns, e, self.point)  # these see torques
            found = terms(scene, EVERY)
        informed = informing(scene.samples(EVERY), found.told, reach(scene.e))
        return Seen(e, found.A, informed)

    def _of_drives(self, e: Experiment, torque: np.ndarray) -> np.ndarray:
        """(n, driven) from the torques in the independent coordinates; surplus drives share."""
        at = [self.mechanism.joint_index[name] for name in self.mechanism.driven]
        if e.leverage is None:
            order = [self.mechanism.joint(name).index for name in self.mechanism.driven]
            return torque[:, order]
        if tuple(self.mechanism.driven) == e.independent:
            return torque
        return np.einsum("ndj,nd->nj", np.linalg.pinv(e.leverage[:, at], rcond=1e-6), torque)


def _leapt(near: Experiment, e: Experiment, step: np.ndarray) -> bool:
    """Whether some sample is on another branch: it moved by more than K⁺ says."""
    if near.pinv is None:
        return False
    size = np.linalg.norm(near.pinv, axis=(1, 2)) * np.linalg.norm(step, axis=1)
    return bool((np.abs(e.q - near.q).max(axis=1) > SLIP + GAIN * size).any())


def moved_joints(mechanism: Mechanism) -> tuple[str, ...]:
    """The drives whose positions determine the motion.

    Raises:
        MotionError: if there are fewer drives than degrees of freedom.
    """
    if mechanism.closures:
        names = best_conditioned(mechanism, mechanism.assembled[None])
    else:
        names = tuple(joint.name for joint in mechanism.joints)
    free = [name for name in names if name not in mechanism.driven]
    if free:
        raise MotionError(
            f"{mechanism.name}: {', '.join(free)} moves freely, without a drive, so no motion can "
            "be asked of it; `excite` needs as many drives as degrees of freedom"
        )
    return names


def resting(
    mechanism: Mechanism, names: tuple[str, ...], home: np.ndarray, t: np.ndarray
) -> Experiment:
    """An experiment in which the drives `names` stay at home (d,), at the times t (n,) [s].

    Raises:
        MotionError: if the closures cannot be followed there from the start.
    """
    none = np.empty(0)
    base = Experiment(
        name=f"a motion of {mechanism.name}", t=t, q=none, v=none, a=none, y=none, yd=none,
        ydd=none, tau=np.zeros((len(t), len(mechanism.driven))), wrench=None, pinv=None,
        leverage=None, usable=np.ones(len(t), dtype=bool), still=none, logged=names,
        independent=names,
    )  # fmt: skip
    known = np.zeros((3, len(t), len(home)))
    known[0] = home
    if not mechanism.closures:
        return stilled(in_tree(mechanism, base, names, known))
    return stilled(reduced(mechanism, through_closures(mechanism, base, names, known), names)[0])


def stilled(e: Experiment) -> Experiment:
    """With the speeds below which joints stand still, as a log of this motion would have them."""
    return replace(e, still=np.maximum(STILL * np.abs(e.yd).max(axis=0), 1e-9))
