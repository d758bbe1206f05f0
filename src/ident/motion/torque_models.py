"""Which torques are a model's: computed by it, or measured less a part of it.

Of all torques τ together, of the file's bodies π, or of whatever bodies x fit,

    computed       τ = Γ(q, v, a) π to the digits, or its gravity, or what is left without gravity:
                   a controller's model or a simulator's, of which a fit returns what it was given
    compensated    τ = (Γ(q, v, a) − Γ(q, 0, 0)) x + friction, and not τ = Γ(q, v, a) x + friction:
                   a controller has subtracted gravity
    open tree      τ = Γ(q, v, a) x + friction in all joints of a loop's tree: its closures carry
                   no force
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import regressor
from ident.motion.state import State
from ident.motion.torque_class import TorqueClass, TorqueVerdict

COMPUTED = 2e-3  # numerics: of a torque, by which smoothed motions of clean logs may differ
LOOKED_AT = 300  # work: samples of all logs
EXPLAINS = 0.3  # level: of a torque, that a model which explains it leaves at most
FALL = 0.5  # level: of the error with gravity, that the one without leaves at most
NO_WORSE = 1.1  # level: times a joint's error with gravity, that the one without is at most
NO_FORCE = 0.02  # level: of a torque, that closures leave which carry no force
SPARE = 2  # range: rows for an unknown, at least
NIL = 1e-9  # numerics: of the largest column, which is rounding


@dataclass(frozen=True)
class _Samples:
    """Some samples of all logs: torques (n, d), regressors (n, d, k) and rates (n, d)."""

    tau: np.ndarray
    with_gravity: np.ndarray
    gravity: np.ndarray
    rates: np.ndarray

    def errors(self, gamma: np.ndarray) -> np.ndarray:
        """Return the relative errors (d,) of torques by bodies that fit best, and friction."""
        n, d = self.tau.shape
        size = np.sqrt(np.mean(self.tau**2, axis=0))
        size = np.where(size > 0, size, 1.0)
        terms = np.stack([np.ones((n, d)), self.rates, np.sign(self.rates)], axis=-1)
        friction = (np.eye(d)[:, :, None] * terms[:, :, None, :]).reshape(n, d, 3 * d)
        A = (np.concatenate([gamma, friction], axis=2) / size[:, None]).reshape(n * d, -1)
        columns = np.linalg.norm(A, axis=0)
        A = A[:, columns > NIL * columns.max()]
        if len(A) < SPARE * A.shape[1]:
            return np.ones(d)
        b = (self.tau / size).ravel()
        residual = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
        return np.asarray(np.sqrt(np.mean(residual.reshape(n, d) ** 2, axis=0)))


def torques_of_models(mechanism: Mechanism, states: Sequence[State]) -> dict[str, TorqueVerdict]:
    """Return the classes of torques that a model has computed or corrected, by joint; none where
    these are measurements, or where nothing of the bodies is unknown: values of an earlier fit give
    the torques that they were fitted to.
    """
    states = [e for e in states if not e.poses and len(e)]
    if mechanism.drives or mechanism.unmeasured or not mechanism.unknown or not states:
        return {}
    if any(e.wrench is not None and np.any(e.wrench) for e in states):
        return {}
    samples = _samples(mechanism, states)
    size = np.sqrt(np.mean(samples.tau**2, axis=0))
    if not len(samples.tau) or not size.max():
        return {}
    loud = size > COMPUTED * size.max()
    return (
        _computed(mechanism, samples, size, loud)
        or _compensated(mechanism, samples, loud)
        or _of_open_tree(mechanism, states)
    )


def _computed(
    mechanism: Mechanism, samples: _Samples, size: np.ndarray, loud: np.ndarray
) -> dict[str, TorqueVerdict]:
    """Return the verdicts on torques that are the file's own model: of a loop all, of a tree the
    joints of which they are.
    """
    if not mechanism.prior.any():
        return {}
    both, gravity = (x @ mechanism.prior for x in (samples.with_gravity, samples.gravity))
    models = {
        "gravity and inertia": both,
        "gravity alone": gravity,
        "inertia alone": both - gravity,
    }
    for terms, torque in models.items():
        off = np.sqrt(np.mean((samples.tau - torque) ** 2, axis=0)) / np.where(size > 0, size, 1.0)
        same = loud & (off < COMPUTED)
        if not (same[loud].all() or (not mechanism.closures and same.any())):
            continue
        verdict = TorqueVerdict(
            TorqueClass.COMPUTED, "computed", float(off[same].max()), COMPUTED, terms
        )
        if same[loud].all():
            return dict.fromkeys(mechanism.measured, verdict)
        names = [joint.name for joint in mechanism.joints if joint.in_tree]
        return {names[u]: verdict for u in np.flatnonzero(same)}
    return {}


def _compensated(
    mechanism: Mechanism, samples: _Samples, loud: np.ndarray
) -> dict[str, TorqueVerdict]:
    """Return the verdicts on torques from which gravity was subtracted, all alike."""
    if not np.any(samples.gravity):
        return {}
    without = samples.errors(samples.with_gravity - samples.gravity)[loud]
    if without.max() > EXPLAINS:
        return {}
    with_gravity = samples.errors(samples.with_gravity)[loud]
    if not np.all(without < NO_WORSE * with_gravity) or without.max() > FALL * with_gravity.max():
        return {}
    verdict = TorqueVerdict(
        TorqueClass.COMPENSATED, "compensated", float(without.max()), float(with_gravity.max())
    )
    return dict.fromkeys(mechanism.measured, verdict)


def _of_open_tree(mechanism: Mechanism, states: Sequence[State]) -> dict[str, TorqueVerdict]:
    """Return the verdicts on torques of all joints of a loop's tree that need no closure."""
    names = [joint.name for joint in mechanism.joints if joint.in_tree]
    if not mechanism.closures or {*mechanism.measured} != {*names}:
        return {}
    at = [mechanism.joint_index[name] for name in mechanism.driven]
    tree = _samples(mechanism, states, at)
    size = np.sqrt(np.mean(tree.tau**2, axis=0))
    loud = size > COMPUTED * size.max()
    error = float(tree.errors(tree.with_gravity)[loud].max())
    if error > NO_FORCE:
        return {}
    verdict = TorqueVerdict(TorqueClass.COMPUTED, "open_tree", error, NO_FORCE)
    return dict.fromkeys(mechanism.measured, verdict)


def _samples(mechanism: Mechanism, states: Sequence[State], joints: Sequence[int] = ()) -> _Samples:
    """Return samples in the independent coordinates, or of `joints` of the tree, loops open."""
    driven = [mechanism.joint_index[name] for name in mechanism.driven]
    parts: list[tuple[np.ndarray, ...]] = []
    every = sum(int(e.usable.sum()) for e in states) // LOOKED_AT
    for e in states:
        state = e.at_samples(np.flatnonzero(e.usable)[:: max(1, every)])
        rest = np.zeros_like(state.v)
        both = (regressor(mechanism.model, state.q, v, a)
                for v, a in ((state.v, state.a), (rest, rest)))  # fmt: skip
        if joints:
            with_gravity, gravity = (x[:, joints] for x in both)
            parts.append((state.tau, with_gravity, gravity, state.yd[:, joints]))
            continue
        with_gravity, gravity = (_reduced(state, x) for x in both)
        tau = np.einsum("njd,nj->nd", state.leverage[:, driven], state.tau)
        rates = state.v if e.loop is None else _rates(mechanism, state)
        parts.append((tau, with_gravity, gravity, rates))
    return _Samples(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _rates(mechanism: Mechanism, e: State) -> np.ndarray:
    """Return the rates (n, d) of the independent coordinates."""
    return e.yd[:, [mechanism.joint_index[name] for name in e.independent]]


def _reduced(e: State, gamma: np.ndarray) -> np.ndarray:
    """Return the regressor (n, nv, k) of the tree in the independent coordinates (n, d, k)."""
    if e.loop is None:
        return gamma
    return np.einsum("nvd,nvk->ndk", e.pinv[:, :, -e.leverage.shape[2] :], gamma)
