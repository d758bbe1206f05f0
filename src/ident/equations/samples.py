"""Some samples of an experiment: Γ, what effects see, and where joints' torques work.

    generalised coordinates v        f        a joint's torque τ, ẏ = W v, is the force Wᵀτ
    independent coordinates u      Zᵀ f       and there (W Z)ᵀτ, its leverage      J Z = 0, W_uZ = 1

A joint of the tree has a unit row W: its torque stands in one row of all generalised forces, and no
W is written out for it. The leverage of every joint is in the experiment already, so that reduced
equations never evaluate the slow W of closures' own joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ident.effects import Effect, Signals
from ident.equations.point import Point
from ident.equations.predicted import predicted, predicted_multipliers
from ident.equations.regressor import regressor
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment

STEP = 1e-3  # of the range of a shape parameter, for differences
UNIT = np.ones((1, 1))  # W of a joint of the tree, in its own row


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples `part` of an experiment in generalised coordinates, r = nv rows a sample.

    Args:
        mechanism: the mechanism.
        e: the experiment, with q (n, nq), v, a (n, nv) and y, ẏ, ÿ of the named joints.
        part: a slice, or an index of samples.
        point: the working point, for what depends on the present model.
        memo: of what is slow to make for the whole experiment, shared by its parts.
    """

    mechanism: Mechanism
    e: Experiment
    part: slice | np.ndarray
    point: Point | None = None
    memo: dict[object, np.ndarray] = field(default_factory=dict)

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
        """What an effect on these joints sees; nothing of joints where it sits on none."""
        if joints not in self._seen:
            e, part = self.e, self.part
            index = self.mechanism.joint_index
            at = [index[name] for name in joints if name in index]
            bare = replace(self)  # no circle with what it has seen: Γ would outlive its use
            self._seen[joints] = Signals(
                t=e.t[part],
                q=e.y[part][:, at],
                v=e.yd[part][:, at],
                a=e.ydd[part][:, at],
                still=e.still[at],
                extra={name: x[part] for name, x in e.extra.items()},
                present=self.point.values if self.point else {},
                predicted=(lambda: predicted(bare, joints)) if self.point else None,
            )
        return self._seen[joints]

    def columns(self, effect: Effect, shape: Mapping[str, float]) -> np.ndarray:
        """E (n, arity, unknowns) of an effect at a shape."""
        if not effect.memory:
            return effect.columns(replace(self.signals(effect.joints), shape=shape))
        key = (effect.label, *sorted(shape.items()))
        if key not in self.memo:
            whole = replace(self, part=slice(None)).signals(effect.joints)
            self.memo[key] = effect.columns(replace(whole, shape=shape))
        return self.memo[key][self.part]

    def add_effect(
        self, out: np.ndarray, effect: Effect, c: np.ndarray, shape: Mapping[str, float]
    ) -> None:
        """Adds the forces E c of one effect to `out`, in these coordinates.

        The only place where an effect becomes forces: torques E (n, joints, unknowns) of its
        joints, each spread by its W; a payload has its link's columns of Γ.

        Args:
            out: (n, r), or (n, r, c) for c combinations of the effect's unknowns.
            effect: the effect.
            c: values (unknowns,), or combinations (unknowns, c).
            shape: of the effect.
        """
        if effect.loaded_link:
            out += self.gamma[:, :, self.mechanism.bodies.columns(effect.loaded_link)] @ c
            return
        E = self.columns(effect, shape)
        for i, name in enumerate(effect.joints):
            self.add_torque(out, name, E[:, i] @ c)

    def add_sensitivity(
        self,
        out: np.ndarray,
        effect: Effect,
        c: np.ndarray,
        shape: Mapping[str, float],
        name: str,
    ) -> None:
        """Adds ∂(E(s) c)/∂s (n, r) of one shape parameter, by central differences."""
        h = self.step(effect, shape, name)
        for sign in (1, -1):
            beside = {**shape, name: shape[name] + sign * h}
            self.add_effect(out, effect, sign * c / (2 * h), beside)

    def step(self, effect: Effect, shape: Mapping[str, float], name: str) -> float:
        """h of a shape's central difference, from its range over the whole experiment."""
        key = ("range", effect.label, name)
        if key not in self.memo:
            whole = replace(self, part=slice(None)).signals(effect.joints)
            low, high = effect.bounds(replace(whole, shape=shape)).get(name, (0.0, 1.0))
            self.memo[key] = np.array(high - low)
        h = min(STEP * float(self.memo[key]), 1e-2 * abs(shape[name]) or np.inf)
        return max(h, 1e-9)

    def generalised(self, part: slice | np.ndarray) -> Samples:
        """Other samples of the same experiment, in generalised coordinates."""
        return Samples(self.mechanism, self.e, part, self.point, self.memo)

    def multipliers(self) -> np.ndarray:
        """λ (n, m) of the present model."""
        return predicted_multipliers(self)

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


def reduced(
    mechanism: Mechanism,
    e: Experiment,
    part: slice | np.ndarray,
    point: Point | None = None,
    memo: dict[object, np.ndarray] | None = None,
) -> Samples:
    """Samples in the independent coordinates, which a tree's generalised coordinates are."""
    kind = Samples if e.leverage is None else Reduced
    return kind(mechanism, e, part, point, {} if memo is None else memo)
