"""Loop closures: which joints determine a motion, and all coordinates from theirs, by continuation.

    K = [J; W_u]         W_u: rates of the independent joints u
    position   K δq = [−Φ; y − y_u(q)]              (Newton, from a neighbouring sample)
    velocity   v = K⁺ [0; ẏ]
    acceleration a = K⁺ [−J̇v; ÿ − Ẇv]

Where more joints are measured than there are degrees of freedom, these are least-squares solutions,
then projected on the closures (by J⁺), so that the closures hold and every measurement counts.
K⁺ also gives the reduced equations and the multipliers: W_uᵀτ_u − Jᵀλ = f  ⟹  [−λ; τ_u] = K⁺ᵀ f.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import combinations, islice, pairwise

import numpy as np
import pinocchio as pin

from ident.errors import MechanismError, MotionError
from ident.information import linear
from ident.mechanism.kinematics import ConstraintRows
from ident.mechanism.mechanism import Mechanism

STRIDE = 64  # work: samples between the anchors that are solved one after the other
CLOSED = 1e-11  # numerics: [m | rad] largest equation that Newton leaves
OPEN = 1e-10  # numerics: [m | rad] largest equation at which a configuration counts as closed
STEPS = 12  # work
CHORDS = 8  # work: steps with one K⁺
FAR = 0.1  # numerics: [rad | m] of a step beyond which K⁺ of a state close by says nothing
FARTHEST = 1000.0  # range: [rad | m] from the start to the nearest sample; beyond, a unit is wrong
BENT = 0.2  # numerics: share of a step by which the tangents at its ends may mispredict it
DEPENDENT = 1e-9  # numerics: of the largest singular value of [J; W_u]: u is no set of coordinates
PARALLEL = 1e-6  # numerics: sine of the angle between axes that are meant to be parallel
REPEATED = 1e-10  # numerics: of the largest entry of J, within which its rows repeat each other
SETS = 500  # work: sets of independent joints that are compared
LEAP = 20.0  # range: [rad | m] from one sample to the next


def pseudo_inverse(K: np.ndarray) -> np.ndarray:
    """K⁺ (n, nv, m + d) of stacked K (n, m + d, nv) with full column rank."""
    try:
        if K.shape[1] == K.shape[2]:
            return np.linalg.inv(K)
        Q, R = np.linalg.qr(K)
        return np.linalg.solve(R, Q.transpose(0, 2, 1))
    except np.linalg.LinAlgError:
        return linear.pinv(K)


def inverse_with_coordinates(J: np.ndarray, at: Sequence[int]) -> np.ndarray:
    """K⁺ (n, nv, m + d) of K = [J; W_u] of J (n, m, nv) where the coordinates u are those `at` of
    the tree: only the columns of the others are inverted, δq_o = J_o⁺ (r − J_u δy).

    That is K⁺ where J_u = J_o J_o⁺ J_u: equations that are more than needed repeat the others.
    """
    n, m, nv = J.shape
    if n > 1 and J.strides[0] == 0:  # the same of all samples, in the memory of one
        same = inverse_with_coordinates(J[:1], at)
        return np.broadcast_to(same, (n, *same.shape[1:]))
    others = np.setdiff1d(np.arange(nv), at)
    if m >= len(others) and len(others) + len(at) == nv:
        inverse = pseudo_inverse(J[:, :, others])
        of_coordinates = inverse @ J[:, :, at]
        off = J[:, :, at] - J[:, :, others] @ of_coordinates
        if np.abs(off).max(initial=0.0) <= REPEATED * np.abs(J).max(initial=0.0):
            K = np.zeros((n, nv, m + len(at)))
            K[:, others, :m], K[:, others, m:] = inverse, -of_coordinates
            K[:, at, np.arange(m, m + len(at))] = 1.0
            return K
    W = np.broadcast_to(np.eye(nv)[list(at)], (n, len(at), nv))
    return pseudo_inverse(np.concatenate([J, W], axis=1))


def _times(M: np.ndarray, x: np.ndarray) -> np.ndarray:
    """M x (n, i) of stacked M (n, i, j) and x (n, j)."""
    if len(M) and M.strides[0] == 0:  # all the same
        return np.asarray(x @ M[0].T)
    return np.asarray(np.einsum("nij,nj->ni", M, x))


class LoopSolver:
    """Finds configurations at which Φ = 0 and the joints `names` have given coordinates.

    Where they are more than needed, their coordinates are divided by `scale` (d,).
    """

    def __init__(
        self, mechanism: Mechanism, names: Iterable[str], scale: np.ndarray | None = None
    ) -> None:
        self.mechanism = mechanism
        self.joints = tuple(mechanism.joint(name) for name in names)
        self.surplus = len(self.joints) > mechanism.degrees_of_freedom
        self.scale = np.ones(len(self.joints)) if scale is None or not self.surplus else scale

    @cached_property
    def places(self) -> list[int] | None:
        """The joints' coordinates in q; None where one is a closure's own."""
        if all(joint.in_tree for joint in self.joints):
            return [joint.index for joint in self.joints]
        return None

    def inverse(self, q: np.ndarray, J: np.ndarray) -> np.ndarray:
        """K⁺ (n, nv, m + d) at q of J (n, m, nv), with rates over their `scale`."""
        if self.places is not None and not self.surplus:
            return inverse_with_coordinates(J, self.places)
        W = self.coordinates(q).rate / self.scale[:, None]
        return pseudo_inverse(np.concatenate([J, W], axis=1))

    def coordinates(self, q: np.ndarray, v: np.ndarray | None = None) -> ConstraintRows:
        """y (n, d), W_u (n, d, nv) and Ẇ_u v (n, d) of the joints."""
        n, d, nv = len(q), len(self.joints), self.mechanism.model.nv
        y, W, drift = np.empty((n, d)), np.zeros((n, d, nv)), np.zeros((n, d))
        rates = None
        if self.places is None:
            rates = self.mechanism.kinematics.own_rows(q, v)
        for i, joint in enumerate(self.joints):
            at = joint.index
            if joint.in_tree or rates is None:
                y[:, i], W[:, i, at] = q[:, at], 1.0
            else:
                y[:, i], W[:, i], drift[:, i] = (
                    rates.value[:, at],
                    rates.rate[:, at],
                    rates.drift[:, at],
                )
        return ConstraintRows(y, W, drift)

    def _residual(self, q: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        closure, coordinates = self.mechanism.kinematics.closure_rows(q), self.coordinates(q)
        off = self._turned(target - coordinates.value)
        K = np.concatenate([closure.rate, coordinates.rate / self.scale[:, None]], axis=1)
        return np.concatenate([-closure.value, off / self.scale], axis=1), K

    def _turned(self, off: np.ndarray) -> np.ndarray:
        """Return differences (n, d) of coordinates, changed in place: angles of closures' own
        joints are known up to whole turns.
        """
        for i, joint in enumerate(self.joints):
            if joint.rotational and not joint.in_tree:
                off[:, i] = (off[:, i] + np.pi) % (2 * np.pi) - np.pi
        return off

    def _off(self, q: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return how far the joints' coordinates at q are from the target (n, d)."""
        if self.places is not None:
            return target - q[:, self.places]
        return self._turned(target - self.coordinates(q).value)

    def newton(self, q: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Configurations (n, nq) near q at the targets (n, d), and the largest |Φ| there (n,)."""
        model, m = self.mechanism.model, len(self.mechanism.kinematics.multipliers)
        for _ in range(STEPS):
            off, K = self._residual(q, target)
            try:
                square = K.shape[1] == K.shape[2]
                step = np.linalg.solve(K, off[:, :, None])[:, :, 0] if square else None
            except np.linalg.LinAlgError:
                step = None
            step = _times(pseudo_inverse(K), off) if step is None else step
            largest = np.abs(step).max(axis=1, keepdims=True)
            q = integrate(model, q, step * np.minimum(1.0, 0.5 / (largest + 1e-300)))
            if largest.max() < CLOSED:
                break
        else:
            off, _ = self._residual(q, target)
        for _ in range(3 * self.surplus):
            rows = self.mechanism.kinematics.closure_rows(q)
            q = integrate(model, q, -_times(linear.pinv(rows.rate, 1e-9), rows.value))
            off, _ = self._residual(q, target)
        return q, np.abs(off[:, :m] if self.surplus else off).max(axis=1, initial=0.0)

    def near(
        self, q: np.ndarray, inverse: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `newton` where q is near already: steps by K⁺ (n, nv, m + d) of a state close by, so
        that only Φ is evaluated; Newton's for samples at which these do not end.
        """
        model, start, last = self.mechanism.model, q, np.full(len(q), np.inf)
        for _ in range(CHORDS):
            values = self.mechanism.kinematics.closure_values(q)
            off = np.concatenate([-values, self._off(q, target)], axis=1)
            step = _times(inverse, off)
            last = np.abs(step).max(axis=1, initial=0.0)
            q = integrate(model, q, np.where(np.abs(step) < FAR, step, 0.0))
            if (last < CLOSED).all():
                break
        values = self.mechanism.kinematics.closure_values(q)
        gap = np.abs(np.concatenate([values, self._off(q, target)], axis=1)).max(axis=1, initial=0)
        open_samples = ~(last < CLOSED)
        if open_samples.any():
            at = np.flatnonzero(open_samples)
            q = q.copy()
            q[at], gap[at] = self.newton(start[at], target[at])
        return q, gap

    def rates(
        self, q: np.ndarray, yd: np.ndarray, ydd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """v and a (n, nv) that keep the closures, from the joints' rates (n, d)."""
        return self.completed(q, yd, ydd)[:2]

    def completed(
        self, q: np.ndarray, yd: np.ndarray, ydd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """v and a (n, nv) as `rates`, and K⁺ (n, nv, m + d) with rates over their `scale`."""
        kinematics = self.mechanism.kinematics
        J = kinematics.closure_rates(q)
        Kp = self.inverse(q, J)
        v = _times(Kp[:, :, J.shape[1] :], yd / self.scale)
        Jp = linear.pinv(J, 1e-9) if self.surplus else None
        if Jp is not None:
            v = v - _times(Jp, _times(J, v))
        closing = kinematics.closure_drift(q, v)
        wanted = (ydd - self.coordinates(q, v).drift) / self.scale
        a = _times(Kp, np.concatenate([-closing, wanted], axis=1))
        if Jp is not None:
            a = a - _times(Jp, _times(J, a) + closing)
        return v, a, Kp

    def follow(self, target: np.ndarray, t: np.ndarray) -> np.ndarray:
        """All configurations (n, nq) along the targets (n, d), on the branch of the start."""
        assembled = self.mechanism.assembled
        y = self.coordinates(assembled[None]).value[0]
        first = int(np.abs(target - y).max(axis=1).argmin())  # the branch is surest there
        q = self._travel(assembled, y, target[first], t[first], FARTHEST)
        after, before = (
            self.onward(q, target[first], target[side], t[side])
            for side in (slice(first + 1, None), slice(first - 1, None, -1) if first else slice(0))
        )
        return np.concatenate([before[::-1], q[None], after])

    def onward(self, q: np.ndarray, y: np.ndarray, target: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Configurations (n, nq) along the targets (n, d), which come after q (nq,) at y (d,)."""
        n, model = len(target), self.mechanism.model
        path, target = np.tile(q, (n + 1, 1)), np.concatenate([y[None], target])
        if 0 < n < STRIDE:
            path[1:], gap = self.newton(path[1:], target[1:])
            if gap.max(initial=0.0) < OPEN and self._straight(path, np.diff(target, axis=0)).all():
                return path[1:]
            path[1:] = q
        t = np.concatenate([t[:1], t])
        known = np.array([*range(0, n, STRIDE), n])
        for a, b in pairwise(known):
            self._bridge(path, target, t, int(a), int(b))
        while len(known) <= n:  # halve the distances; each level is one call for all samples
            lower, upper = known[:-1], known[1:]
            wide = upper - lower > 1
            lower, upper = lower[wide], upper[wide]
            middle = (lower + upper) // 2
            step = _difference(model, path[lower], path[upper])
            path[middle], gap = self.newton(
                integrate(model, path[lower], 0.5 * step), target[middle]
            )
            for bad in np.flatnonzero(gap > OPEN):
                self._bridge(path, target, t, int(lower[bad]), int(middle[bad]))
            known = np.union1d(known, middle)
        return path[1:]

    def _bridge(self, q: np.ndarray, target: np.ndarray, t: np.ndarray, a: int, b: int) -> None:
        """Set q[b] from q[a], over the samples between them where that is too far."""
        near, gap = self.newton(q[a : a + 1], target[b : b + 1])
        change = target[b] - target[a]
        if gap[0] < OPEN and self._straight(np.stack([q[a], near[0]]), change[None])[0]:
            q[b] = near[0]
        elif abs(b - a) > 1:
            middle = (a + b) // 2
            self._bridge(q, target, t, a, middle)
            self._bridge(q, target, t, middle, b)
        else:
            q[b] = self._travel(q[a], target[a], target[b], t[b], LEAP)

    def _straight(self, q: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(n,) whether the tangents at both ends of each step between configurations q (n + 1, nq)
        lead from one to the other, where the joints have moved by (n, d).

        Newton may land on another branch where a singular position is near; there the step between
        the two is not the predicted one, K⁺ [0; δy].
        """
        step = _difference(self.mechanism.model, q[:-1], q[1:])
        size = np.abs(step).max(axis=1)
        near = size < 0.2 + 3 * np.abs(change).max(axis=1)
        _, K = self._residual(q, np.zeros((len(q), len(self.joints))))
        Z = pseudo_inverse(K)[:, :, K.shape[1] - change.shape[1] :]
        predicted = 0.5 * _times(Z[:-1] + Z[1:], change / self.scale)
        return np.asarray(near & (np.abs(step - predicted).max(axis=1) < 0.02 + BENT * size))

    def _travel(
        self, q: np.ndarray, y: np.ndarray, goal: np.ndarray, t: float, farthest: float
    ) -> np.ndarray:
        """From q at coordinates y to the goal in steps that Newton can take."""
        far = int(np.abs(goal - y).argmax())
        if abs(goal[far] - y[far]) > farthest:
            raise MotionError(
                f"{self.mechanism.name}: at t = {t:.4g} s {self.joints[far].name} jumps from "
                f"{y[far]:.4g} to {goal[far]:.4g} {self.joints[far].unit}; give the column a scale "
                "to rad or m in [log] (encoder counts, degrees?), or correct this sample"
            )
        done, step = 0.0, 1.0 / max(1.0, np.ceil(np.abs(goal - y).max() / 0.1))
        while done < 1.0:
            share = min(1.0, done + step)
            near, gap = self.newton(q[None], (y + share * (goal - y))[None])
            change = np.abs(_difference(self.mechanism.model, q[None], near)).max()
            if gap[0] < OPEN and change < 1.0:
                q, done, step = near[0], share, step * 1.5
            elif step > 1e-4:
                step *= 0.5
            else:
                wanted = ", ".join(
                    f"{joint.name} = {value:.4g} {joint.unit}"
                    for joint, value in zip(self.joints, y + share * (goal - y), strict=True)
                )
                raise MotionError(
                    f"{self.mechanism.name}: the closures cannot follow at t = {t:.4g} s: nothing "
                    f"closes at {wanted} (left open by {gap[0]:.2g}); check the unit, sign and "
                    "zero of these columns, [joints] start and the closures' frames"
                )
        return q


def integrate(model: pin.Model, q: np.ndarray, step: np.ndarray) -> np.ndarray:
    """q ⊕ step for all samples: a sum for scalar joints, on the quaternion for free bodies."""
    if model.nq == model.nv:
        return q + step
    return np.array([pin.integrate(model, a, b) for a, b in zip(q, step, strict=True)])


def _difference(model: pin.Model, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """b ⊖ a (n, nv) of configurations (n, nq)."""
    if model.nq == model.nv:
        return b - a
    steps = [pin.difference(model, x, y) for x, y in zip(a, b, strict=True)]
    return np.reshape(steps, (len(a), model.nv))


# --- which joints determine the motion -----------------------------------------------------------


def independent_joints(mechanism: Mechanism, preferred: Iterable[str]) -> tuple[str, ...]:
    """The first of the preferred joints whose rates determine all others through the closures.

    As many names as there are degrees of freedom, or fewer if these joints do not determine the
    motion, in the mechanism's order.
    """
    names = list(dict.fromkeys(preferred))
    in_order = [joint.name for joint in mechanism.joints]
    if not mechanism.closures:
        return tuple(name for name in in_order if name in names)
    q = mechanism.general[None]
    J = mechanism.kinematics.closure_rows(q).rate[0]
    W = LoopSolver(mechanism, names).coordinates(q).rate[0]
    _, sizes, directions = linear.svd(J)
    basis = directions[: int((sizes > 1e-8 * max(1.0, sizes.max(initial=0))).sum())]
    chosen: list[str] = []
    for strictness in (1e-3, 1e-7):  # a nearly dependent joint only if nothing better is there
        for name, w in zip(names, W, strict=True):
            if len(basis) == mechanism.model.nv or name in chosen:
                continue
            rest = w - (w @ basis.T) @ basis
            rest -= (rest @ basis.T) @ basis
            if np.linalg.norm(rest) > strictness * np.linalg.norm(w):
                basis = np.vstack([basis, rest / np.linalg.norm(rest)])
                chosen.append(name)
    return tuple(name for name in in_order if name in chosen)


def best_conditioned(mechanism: Mechanism, q: np.ndarray) -> tuple[str, ...]:
    """The independent joints in which a motion q (n, nq) is compared with measurements: driven
    before passive ones, and of those the farthest from a singular position.
    """
    if not mechanism.closures:
        return tuple(joint.name for joint in mechanism.joints)
    d = mechanism.degrees_of_freedom
    q = q[:: max(1, len(q) // 200)]
    fixed = independent_joints(mechanism, mechanism.driven)
    if len(fixed) == d == len(mechanism.driven):
        return fixed
    others = list(mechanism.driven)
    if len(fixed) < d:
        others = [joint.name for joint in mechanism.joints if joint.name not in fixed]
    else:
        fixed = ()
    names = tuple(dict.fromkeys((*fixed, *others)))
    J = mechanism.kinematics.closure_rows(q).rate
    W = LoopSolver(mechanism, names).coordinates(q).rate
    sets = [(*fixed, *more) for more in islice(combinations(others, d - len(fixed)), SETS + 1)]
    if len(sets) > SETS:
        middle = len(q) // 2
        sets = [_most_independent(names, len(fixed), J[middle], W[middle])]
    best, least = sets[0], np.inf
    for joints in sets:
        K = np.concatenate([J, W[:, [names.index(name) for name in joints]]], axis=1)
        values = np.linalg.svd(K[len(K) // 2], compute_uv=False)
        if values[mechanism.model.nv - 1] < DEPENDENT * values[0]:
            continue  # they do not determine the motion, at any position
        with np.errstate(all="ignore"):
            size = np.linalg.norm(pseudo_inverse(K), axis=(1, 2)).max()
        if size < 0.99 * least:
            best, least = joints, size
    return tuple(joint.name for joint in mechanism.joints if joint.name in best)


def _most_independent(
    names: Sequence[str], first: int, J: np.ndarray, W: np.ndarray
) -> tuple[str, ...]:
    """Return the `first` of the names and those that are least determined by J and the ones before,
    one after the other (pivoted QR of the rates W in the freedoms that J leaves).
    """
    _, sizes, directions = linear.svd(J)
    free = directions[int((sizes > 1e-8 * max(1.0, sizes.max(initial=0))).sum()) :]
    rest, chosen = W @ free.T, []
    for k in range(len(free)):
        norms = np.linalg.norm(rest, axis=1)
        chosen.append(k if k < first else int(norms.argmax()))
        axis = rest[chosen[-1]] / (norms[chosen[-1]] or 1.0)
        rest = rest - np.outer(rest @ axis, axis)
        rest[chosen] = 0.0
    return tuple(names[i] for i in chosen)


def check_freedom(mechanism: Mechanism) -> None:
    """Refuse a mechanism that its loops hold still, with the axes that stand apart."""
    if mechanism.degrees_of_freedom > 0:
        return
    name, model = mechanism.name, mechanism.model
    if not mechanism.closures:
        raise MechanismError(
            f"{name}: no joint of it moves; valid: one revolute or prismatic, or more"
        )
    problem = f"{name}: the loops leave 0 degrees of freedom, so nothing can move"
    if mechanism.locked:
        raise MechanismError(f"{problem}; lock fewer joints than {', '.join(mechanism.locked)}")
    J = pin.computeJointJacobians(model, model.createData(), mechanism.assembled)
    axes = {j.name: J[3:, j.index] for j in mechanism.joints if j.in_tree and j.rotational}
    parallel = [
        [name for name, axis in axes.items() if np.linalg.norm(np.cross(one, axis)) < PARALLEL]
        for one in axes.values()
    ]
    most = max(parallel, key=len, default=[])
    apart = [name for name in axes if name not in most]
    if 0 < len(apart) < len(most):
        problem += (
            f"; the axis of {', '.join(apart)} is not parallel to those of {', '.join(most)}, as "
            "it is in a planar loop (without an <axis> it is x of the joint's frame)"
        )
    raise MechanismError(f"{problem}; check the closures' kinds and frames, and the joints' <axis>")
