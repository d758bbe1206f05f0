"""Some samples of an experiment: Γ, what effects see, and where joints' torques work.

    generalised coordinates v        f        a joint's torque τ, ẏ = W v, is the force Wᵀτ
    independent coordinates u      Zᵀ f       and there (W Z)ᵀτ, its leverage      J Z = 0, W_uZ = 1

A joint of the tree has a unit row W: its torque stands in one row of all generalised forces, and no
W is written out for it. The leverage of every joint is in the experiment already, so that reduced
equations never evaluate the slow W of closures' own joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.effects import Signals
from ident.equations.regressor import regressor
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment

UNIT = np.ones((1, 1))  # W of a joint of the tree, in its own row


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples `part` of an experiment in generalised coordinates, r = nv rows a sample.

    Args:
        mechanism: the mechanism.
        e: the experiment, with q (n, nq), v, a (n, nv) and y, ẏ, ÿ of the named joints.
        part: a slice, or an index of samples.
    """

    mechanism: Mechanism
    e: Experiment
    part: slice | np.ndarray

    def __len__(self) -> int:
        return len(self.e.t[self.part])

    @property
    def shape(self) -> tuple[int, int]:
        """(n, r) of forces in these coordinates."""
        return len(self), self.mechanism.model.nv

    def reduce(self, f: np.ndarray) -> np.ndarray:
        """Generalised forces f (n, nv, …) in these coordinates (n, r, …); f itself where it can."""
        return f

    @cached_property
    def gamma(self) -> np.ndarray:
        """Γ (n, r, 10 · bodies)."""
        e, part = self.e, self.part
        return self.reduce(regressor(self.mechanism.model, e.q[part], e.v[part], e.a[part]))

    @cached_property
    def wrench(self) -> np.ndarray | None:
        """f_e (n, r) [N m | N] of measured external wrenches, if there are any."""
        return None if self.e.wrench is None else self.reduce(self.e.wrench[self.part])

    @cached_property
    def _own(self) -> np.ndarray:  # slow, so it is not asked for unless such a joint has a torque
        return self.mechanism.kinematics.own_rows(self.e.q[self.part]).rate

    @cached_property
    def _seen(self) -> dict[tuple[str, ...], Signals]:
        return {}

    def signals(self, joints: tuple[str, ...]) -> Signals:
        """What an effect on these joints sees."""
        if joints not in self._seen:
            e, part = self.e, self.part
            at = [self.mechanism.joint_index[name] for name in joints]
            self._seen[joints] = Signals(
                t=e.t[part],
                q=e.y[part][:, at],
                v=e.yd[part][:, at],
                a=e.ydd[part][:, at],
                still=e.still[at],
                extra={name: x[part] for name, x in e.extra.items()},
            )
        return self._seen[joints]

    def lever(self, name: str) -> tuple[slice, np.ndarray]:
        """The rows in which a joint's torque works, and W (n | 1, rows) there."""
        joint = self.mechanism.joint(name)
        if joint.in_tree:
            return slice(joint.index, joint.index + 1), UNIT
        return slice(None), self._own[:, joint.index]

    def add_torque(self, out: np.ndarray, name: str, torque: np.ndarray) -> None:
        """Adds Wᵀτ to forces `out`: (n, r) for τ (n,), (n, r, c) for τ (n, c) of c columns."""
        rows, W = self.lever(name)
        if torque.ndim == 2:
            W = W[:, :, None]
        out[:, rows] += W * torque[:, None]

    def measured(self, names: tuple[str, ...]) -> np.ndarray:
        """Σ Wᵀτ (n, r) [N m | N] of the measured torques of some driven joints."""
        total = np.zeros(self.shape)
        for i, name in enumerate(self.mechanism.driven):
            if name in names:
                self.add_torque(total, name, self.e.tau[self.part, i])
        return total


class Reduced(Samples):
    """The same in the independent coordinates of a mechanism with closures, r = d rows a sample."""

    @property
    def shape(self) -> tuple[int, int]:
        """(n, d)."""
        assert self.e.leverage is not None
        return len(self), self.e.leverage.shape[2]

    def reduce(self, f: np.ndarray) -> np.ndarray:
        """Zᵀ f (n, d, …); Z is the part of K⁺ = [J; W_u]⁺ that belongs to u."""
        assert self.e.pinv is not None
        Z = self.e.pinv[self.part][:, :, -self.shape[1] :]
        return np.einsum("nij,ni->nj", Z, f) if f.ndim == 2 else Z.transpose(0, 2, 1) @ f

    def lever(self, name: str) -> tuple[slice, np.ndarray]:
        """All rows, and the leverage W Z (n, d) of the joint."""
        assert self.e.leverage is not None
        return slice(None), self.e.leverage[self.part, self.mechanism.joint_index[name]]


def reduced(mechanism: Mechanism, e: Experiment, part: slice | np.ndarray) -> Samples:
    """Samples in the independent coordinates, which a tree's generalised coordinates are."""
    return (Samples if e.leverage is None else Reduced)(mechanism, e, part)
