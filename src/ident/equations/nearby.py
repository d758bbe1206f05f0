"""Forces in a state that is a small step away from another, of which most is made once.

    f(q + δq, v + δv, a + δa) π ≈ f π + ∂f/∂q δq + ∂f/∂v δv + ∂f/∂a δa

Rigid bodies to first order, with derivatives for all joints from one pass (`mechanism.batched`),
and effects anew only where their joints have moved: friction that jumps does so here too. For
columns of corrections and gains of the motion's noise, which are differences over small steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Effect
from ident.equations.terms import NEARBY, Samples
from ident.mechanism.parameters import rigid_tangents

MOST_BYTES = 100_000_000  # work: of derivatives that are kept with a state
FEWEST = 30  # work: samples from which one pass of derivatives is faster than several of forces


@dataclass(frozen=True, eq=False)
class Nearby:
    """What a state shares with another one.

    Attributes:
        base: the whole other state.
        steps: (3, n, nv) from it, of q, v and a.
        unmoved: joints that are where they were.
    """

    base: Samples
    steps: np.ndarray
    unmoved: frozenset[str]

    def rigid(self, part: slice, pi: np.ndarray) -> np.ndarray:
        """Return Γ π (n, nv) of some samples, π (10 · bodies,)."""
        base, key = self.base, ("tangents", part.start, part.stop, pi.tobytes())
        if key not in base.memo:
            e = base.e
            base.memo[key] = rigid_tangents(
                base.mechanism.model, e.q[part], e.v[part], e.a[part], pi
            )
        total = base.generalised(part).rigid(pi).copy()
        for tangent, step in zip(base.memo[key], self.steps[:, part], strict=True):
            for j in np.flatnonzero(step.any(axis=0)):
                total += (tangent[:, j] * step[:, j]).T
        return total

    def keeps(self, effect: Effect) -> bool:
        """Return whether an effect's forces are those of the other state."""
        explicit = effect.local and not effect.implicit
        return explicit and self.base.e.loop is None and self.unmoved.issuperset(effect.joints)

    def force(
        self, part: slice, effect: Effect, c: np.ndarray, shape: Mapping[str, float]
    ) -> np.ndarray:
        """Return the forces (n, r) of an effect that is kept, in some samples."""
        key = ("force", effect.label, part.start, part.stop, c.tobytes(), *shape.items())
        if key not in self.base.memo:
            self.base.memo[key] = self.base.reduced(part).force_of(effect, c, shape)
        made: np.ndarray = self.base.memo[key]
        return made


def linearized(s: Samples, base: Samples) -> Samples:
    """Return samples of a whole state whose forces are made from those of one nearby, where that is
    possible and pays.
    """
    e, near, model = s.e, base.e, base.mechanism.model
    usual = s.mechanism.model is model and model.nq == model.nv and len(e) == len(near)
    if s is base or not usual or not FEWEST <= len(e) <= MOST_BYTES / (24 * model.nv**2):
        return s
    if e.q is near.q and e.v is near.v and e.a is near.a:
        return s  # forces of rigid bodies are shared already
    steps = np.stack([e.q - near.q, e.v - near.v, e.a - near.a])
    changed = (e.y != near.y) | (e.yd != near.yd) | (e.ydd != near.ydd)
    still = ~changed.any(axis=0) & (e.still == near.still)
    joints = frozenset(joint.name for joint, x in zip(s.mechanism.joints, still, strict=True) if x)
    return replace(s, memo={NEARBY: Nearby(base, steps, joints)})
