"""Where a mechanism is when some of its joints are: in the tree, or through the closures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion.close import Closer, integrate, pseudo_inverse
from ident.motion.motion import Experiment

SINGULAR = 50.0  # times the log's median ‖K⁺‖: beyond, a sample is near a singular position
HOPELESS = 1e6  # ‖K⁺‖ at which a position is singular whatever the median is
AGREE = 1e-9  # share of its motion below which a logged joint differs by rounding only
CONTRADICTION = 0.3  # share of its own motion by which a logged joint may miss the closures


def in_tree(
    mechanism: Mechanism, base: Experiment, names: tuple[str, ...], known: np.ndarray
) -> Experiment:
    """The experiment with the coordinates (3, n, d) of all joints: y, ẏ, ÿ."""
    at = [mechanism.joint(name).index for name in names]
    q, v, a = (np.ascontiguousarray(x[:, np.argsort(at)]) for x in known)
    order = [joint.index for joint in mechanism.joints]
    if order == sorted(order):  # the joints' own coordinates: no second copy of long logs
        return replace(base, q=q, v=v, a=a, y=q, yd=v, ydd=a)
    return replace(base, q=q, v=v, a=a, y=q[:, order], yd=v[:, order], ydd=a[:, order])


def through_closures(
    mechanism: Mechanism, base: Experiment, names: tuple[str, ...], known: np.ndarray
) -> Experiment:
    """The experiment completed from the coordinates (3, n, d) of some joints."""
    y = known[0]
    closer = Closer(mechanism, names, np.maximum(y.std(axis=0), 1e-9))
    q = closer.follow(y, base.t)
    return _placed(mechanism, base, closer, q, known)


def again(
    mechanism: Mechanism,
    e: Experiment,
    moved: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> Experiment:
    """An experiment whose logged joints are elsewhere by (δy, δẏ, δÿ), each (n,), or whose
    mechanism has other lengths now.
    """
    known = np.stack(
        [x[:, [mechanism.joint_index[j] for j in e.logged]] for x in (e.y, e.yd, e.ydd)]
    )
    for name, rates in moved.items():
        if name not in e.logged:  # a joint that the closures place is where they place it
            continue
        known[:, :, e.logged.index(name)] += np.stack(rates)
    if not mechanism.closures:
        return in_tree(mechanism, e, e.logged, known)
    closer = Closer(mechanism, e.logged, np.maximum(known[0].std(axis=0), 1e-9))
    q, left = closer.newton(e.q, known[0])
    found = _placed(mechanism, e, closer, q, known)
    found = replace(found, usable=e.usable & (left < 1e-6))
    return reduced(mechanism, found, e.independent)[0]


def at_coordinates(
    mechanism: Mechanism, e: Experiment, names: tuple[str, ...], known: np.ndarray
) -> Experiment:
    """An experiment whose joints `names`, which determine the motion, are at other coordinates
    (3, n, d) near their own.
    """
    if not mechanism.closures:
        return in_tree(mechanism, e, names, known)
    closer = Closer(mechanism, names)
    q, left = closer.newton(e.q, known[0])
    found = _placed(mechanism, e, closer, q, known)
    return replace(found, usable=e.usable & (left < 1e-6))


def at_rates(
    mechanism: Mechanism, e: Experiment, names: tuple[str, ...], known: np.ndarray
) -> Experiment:
    """An experiment where it is, but at other rates and accelerations, (1:3) of known (3, n, d)."""
    if not mechanism.closures:
        return in_tree(mechanism, e, names, known)
    return _placed(mechanism, e, Closer(mechanism, names), e.q, known)


def _placed(
    mechanism: Mechanism, base: Experiment, closer: Closer, q: np.ndarray, known: np.ndarray
) -> Experiment:
    """The experiment at the configurations q (n, nq), from the coordinates (3, n, d)."""
    v, a = closer.rates(q, *known[1:])
    names = tuple(joint.name for joint in closer.joints)
    return stated(mechanism, base, q, v, a, dict(zip(names, known[0].T, strict=True)))


def displaced(
    mechanism: Mechanism, e: Experiment, step: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> Experiment:
    """An experiment whose mechanism is elsewhere by (δq, δv, δa), each (n, nv)."""
    q = integrate(mechanism.model, e.q, step[0])
    logged = {joint.name: e.y[:, i] for i, joint in enumerate(mechanism.joints)}
    found = stated(mechanism, e, q, e.v + step[1], e.a + step[2], logged)
    return reduced(mechanism, found, e.independent)[0]


def stated(
    mechanism: Mechanism,
    base: Experiment,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    logged: Mapping[str, np.ndarray],
) -> Experiment:
    """The experiment at a state, with whole turns of closures' own joints as `logged` has them."""
    rows = Closer(mechanism, tuple(joint.name for joint in mechanism.joints)).coordinates(q, v)
    value = rows.value.copy()
    for i, joint in enumerate(mechanism.joints):
        if joint.rotational and not joint.in_tree:
            value[:, i] = np.unwrap(value[:, i])
            if joint.name in logged:  # its whole turns are the log's
                off = value[:, i] - logged[joint.name]
                value[:, i] -= 2 * np.pi * np.round(off / (2 * np.pi))
    rates = np.einsum("njk,nk->nj", rows.rate, v)
    accelerations = np.einsum("njk,nk->nj", rows.rate, a) + rows.drift
    return replace(base, q=q, v=v, a=a, y=value, yd=rates, ydd=accelerations)


def reduced(
    mechanism: Mechanism, experiment: Experiment, independent: tuple[str, ...]
) -> tuple[Experiment, float, list[str]]:
    """With K⁺ and leverages in the independent coordinates; samples near a singularity left out."""
    experiment, error = with_leverage(mechanism, experiment, independent)
    size = nearness(experiment)
    usable = experiment.usable
    singular = usable & ~(size < min(HOPELESS, SINGULAR * float(np.median(size))))
    if not (usable & ~singular).any():
        raise MotionError(
            f"{experiment.name}: every sample is near a singular position of {mechanism.name}; "
            "nothing can be identified from it"
        )
    notes = []
    if singular.any():
        notes.append(
            f"{experiment.name}: {int(singular.sum())} of {len(size)} samples are near a singular "
            f"position of {', '.join(independent)} (first at t = "
            f"{experiment.t[np.argmax(singular)]:.4g} s) and are left out"
        )
    return replace(experiment, usable=usable & ~singular), error, notes


def with_leverage(
    mechanism: Mechanism, e: Experiment, independent: tuple[str, ...]
) -> tuple[Experiment, float]:
    """With K⁺ and leverages in the independent coordinates, and the largest |Φ| [m | rad]."""
    J = mechanism.kinematics.closure_rows(e.q)
    every = Closer(mechanism, tuple(joint.name for joint in mechanism.joints)).coordinates(e.q)
    W = every.rate[:, [mechanism.joint_index[name] for name in independent]]
    Kp = pseudo_inverse(np.concatenate([J.rate, W], axis=1))
    leverage = every.rate @ Kp[:, :, J.rate.shape[1] :]
    placed = replace(e, pinv=Kp, leverage=leverage, independent=independent)
    return placed, float(np.abs(J.value).max())


def nearness(e: Experiment) -> np.ndarray:
    """‖K⁺‖ (n,) of every sample: it grows towards a singular position."""
    assert e.pinv is not None
    return np.asarray(np.linalg.norm(e.pinv, axis=(1, 2)))


def disagreements(
    mechanism: Mechanism, experiment: Experiment, names: tuple[str, ...], logged: np.ndarray
) -> list[str]:
    """More joints logged than needed: how far the closures' answer is from what was logged."""
    notes = []
    for i, name in enumerate(names):
        joint = mechanism.joint(name)
        off = (experiment.y[:, mechanism.joint_index[name]] - logged[:, i])[experiment.usable]
        if joint.rotational:
            off = (off + np.pi) % (2 * np.pi) - np.pi
        rms, spread = float(np.sqrt(np.mean(off**2))), float(np.std(logged[:, i]))
        said = (
            f"{experiment.name}: q.{name} differs from what the closures and the other joints give "
            f"by {rms:.3g} {joint.unit} rms, {np.abs(off).max():.3g} at most"
        )
        # noise of this column is no contradiction, nor is any part of its spread a motion
        noise = min(experiment.noise.get(f"q.{name}", 0.0), spread)
        own = float(np.sqrt(spread**2 - noise**2))
        if rms > CONTRADICTION * own + 1.5 * noise:
            raise MotionError(
                f"{said}, while it moves by {spread:.3g} rms: the positions contradict the "
                "closures; check sign, unit and zero of this column and the closures' frames"
            )
        agree = rms <= AGREE * spread
        notes.append(f"{experiment.name}: q.{name} agrees with the closures" if agree else said)
    return notes
