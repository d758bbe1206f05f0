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
from ident.effects.drive import TorqueGain
from ident.equations.terms import CHUNK, NEARBY, WIDE, Samples
from ident.mechanism import batched


@dataclass(frozen=True, eq=False)
class Nearby:
    """What a state shares with another one.

    Attributes:
        base: the whole other state.
        steps: (n,) from it that are not 0 throughout, by order (0 of q, 1 of v, 2 of a) and column.
        unmoved: joints that are where they were.
    """

    base: Samples
    steps: Mapping[tuple[int, int], np.ndarray]
    unmoved: frozenset[str]

    def rigid(self, part: slice, pi: np.ndarray) -> np.ndarray:
        """Return Γ π (n, nv) of some samples, π (10 · bodies,)."""
        change = self.along(part, pi, self.steps)
        return np.asarray(self.base.generalised(part).rigid(pi) + change.T)

    def along(
        self, part: slice, pi: np.ndarray, steps: Mapping[tuple[int, int], np.ndarray]
    ) -> np.ndarray:
        """Return the change (nv, n) of Γ π along `steps` of the whole state, in some samples."""
        tangents = self.base.tangents(part, pi)
        total = np.zeros((tangents.shape[1], tangents.shape[3]))
        for (order, j), step in steps.items():
            total += tangents[order, :, j] * step[part]
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

    def torque(
        self, effect: Effect, place: int, c: np.ndarray, shape: Mapping[str, float]
    ) -> np.ndarray:
        """Return the torque (n,) of an effect that is kept, at the joint at `place` among those at
        which it acts.
        """
        key = ("torque", effect.label, place, c.tobytes(), *shape.items())
        if key not in self.base.memo:
            n = len(self.base.e)
            parts = (slice(i, min(i + WIDE, n)) for i in range(0, n, WIDE))
            every = (self.base.generalised(part).columns(effect, shape) for part in parts)
            self.base.memo[key] = np.concatenate([E[:, place] @ c for E in every])
        made: np.ndarray = self.base.memo[key]
        return made


def linearized(s: Samples, base: Samples) -> Samples:
    """Return samples of a whole state whose forces are made from those of one nearby, where that is
    possible and pays.
    """
    e, near, model = s.e, base.e, base.mechanism.model
    usual = s.mechanism.model is model and len(e) == len(near) and base.few_tangents
    if s is base or not usual:
        return s
    if e.q is near.q and e.v is near.v and e.a is near.a:
        return s  # forces of rigid bodies are shared already
    steps, changed = dict[tuple[int, int], np.ndarray](), e.still != near.still
    for order, names in enumerate((("q", "y"), ("v", "yd"), ("a", "ydd"))):
        (x, y), (x_near, y_near) = ([getattr(state, name) for name in names] for state in (e, near))
        differ = _columns_that_differ(x, x_near)
        steps |= {(order, int(j)): x[:, j] - x_near[:, j] for j in differ}
        of_joints = y is x and y_near is x_near
        changed[differ if of_joints else _columns_that_differ(y, y_near)] = True
    joints = frozenset(
        joint.name for joint, x in zip(s.mechanism.joints, changed, strict=True) if not x
    )
    return replace(s, memo={NEARBY: Nearby(base, steps, joints)})


def _columns_that_differ(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the numbers of the columns of two arrays (n, c) in which they differ."""
    if x is y:
        return np.empty(0, dtype=int)
    return np.flatnonzero((x != y).any(axis=0))


def difference(one: Samples, other: Samples, base: Samples) -> np.ndarray | None:
    """Return by how much r = b − A x (n, nv) of one state of a tree is more than that of another,
    from what differs alone; None where all of it is to be made.

    Both are `linearized` about `base`, or of its motion, and share values but of corrections.
    """
    mechanism, e = one.mechanism, one.e
    if mechanism.model is not other.mechanism.model:
        return _of_placements(one, other, base)
    near, far = _nearby(one, base), _nearby(other, base)
    if near is None or far is None or mechanism.effects != other.mechanism.effects:
        return None
    corrections = {name for x in mechanism.effects if x.corrects for name in x.names}
    both = one.point.values, other.point.values
    differ = {
        name for name in both[0].keys() | both[1].keys() if both[0].get(name) != both[1].get(name)
    }
    if differ - corrections or (one.point.pi != other.point.pi).any() or e.wrench is not None:
        return None
    n = len(e)
    # measured torques, forces of the model, and of what hangs on these in another way than a gain
    measured, model, implicit = np.zeros((3, mechanism.model.nv, n)).transpose(0, 2, 1)
    if e.tau is not other.e.tau:
        for sign, s in ((1, one), (-1, other)):
            measured += sign * s.generalised(slice(None)).measured(mechanism.driven)
    steps = dict(near.steps)
    for key, step in far.steps.items():
        steps[key] = steps[key] - step if key in steps else -step
    for start in range(0, n if steps else 0, CHUNK):
        part = slice(start, min(start + CHUNK, n))
        model[part] += near.along(part, one.point.pi, steps).T
        for effect in mechanism.effects:
            c, shape = one.point.of(effect)
            known = effect.unknowns and len(shape) == len(effect.shapes) and c.any()
            kept = isinstance(effect, TorqueGain) or (near.keeps(effect) and far.keeps(effect))
            if known and not kept:
                out = implicit if effect.implicit else model
                for sign, s in ((1, one), (-1, other)):
                    s.generalised(part).add_effect(out[part], effect, sign * c, shape)
    gains, change = _gains(one), measured - implicit
    change -= model * (1 + gains) if gains.any() else model
    return np.asarray(change)


def _gains(s: Samples) -> np.ndarray:
    """Return by how much (nv,) torques that the model of a tree predicts are read too large."""
    gains = np.zeros(s.mechanism.model.nv)
    for effect in s.mechanism.effects:
        if isinstance(effect, TorqueGain):
            joint = s.mechanism.joint(effect.joints[0])
            gains[joint.index] += s.share_of(effect) * s.point.of(effect)[0][0]
    return gains


def _of_placements(one: Samples, other: Samples, base: Samples) -> np.ndarray | None:
    """Return the same of trees in one motion in which one joint is placed elsewhere, about the
    place that it has in `base`: to first order, which a difference about the middle is, too.
    """
    states, models = (one.e, other.e, base.e), [s.mechanism.model for s in (one, other, base)]
    effects = one.mechanism.effects
    if any(s.mechanism.closures for s in (one, other)) or any(
        (x.implicit and not isinstance(x, TorqueGain))
        or not (x.corrects or x.local or x.loaded_link)
        for x in effects
    ):
        return None
    both = [(getattr(e, x), getattr(base.e, x)) for e in states[:2] for x in "qva"]
    same = all(x is before or np.array_equal(x, before) for x, before in both)
    if not same or one.e.tau is not other.e.tau or effects != other.mechanism.effects:
        return None
    if any((s.point.pi != base.point.pi).any() for s in (one, other)) or one.e.wrench is not None:
        return None
    if not all(np.array_equal(m.gravity.linear, models[2].gravity.linear) for m in models[:2]):
        return None
    if not (joints := batched.joints_of(models[2])) or not base.few_tangents:
        return None
    places = [np.array([x.homogeneous for x in m.jointPlacements])[1:] for m in models]
    step, off = places[0] - places[1], 0.5 * (places[0] + places[1]) - places[2]
    moved = np.flatnonzero(step.any(axis=(1, 2)))
    if step[:, :3, :3].any() or len(moved) != 1 or np.abs(off).max() > np.abs(step).max():
        return None
    n, out, pi = len(one.e), np.zeros((len(one.e), models[2].nv)), base.dynamic_parameters
    for start in range(0, n, CHUNK):
        part = slice(start, min(start + CHUNK, n))
        key = ("dynamics", part.start, part.stop, pi.tobytes())
        if key not in base.memo:
            q, v, a = (x[part] for x in (base.e.q, base.e.v, base.e.a))
            base.memo[key] = batched.Dynamics.of(models[2], joints, q, v, a, pi)
        out[part] -= base.memo[key].slopes(int(moved[0]), step[moved[0], :3, 3]).T
    return (1 + _gains(one)) * out


def _nearby(s: Samples, base: Samples) -> Nearby | None:
    """Return what a state of a tree shares with another one, None where that is nothing."""
    near, e = s.memo.get(NEARBY), base.e
    if len(s.mechanism.closures):
        return None
    if near is not None:
        return near if near.base is base else None
    if not s.same_motion(base) or s.e.yd is not e.yd or (s.e.still != e.still).any():
        return None
    return Nearby(base, {}, frozenset(joint.name for joint in s.mechanism.joints))
