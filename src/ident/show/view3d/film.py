"""Motions for the 3-D view: configurations, reactions of closures and residuals at some moments.

M a + … + Jᵀ λ = τ,  J = ∂Φ/∂q,  so a closure's reaction does the virtual work −λᵀ δΦ
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ident.mechanism import Mechanism
from ident.mechanism.closures import FrameClosure
from ident.mechanism.tree import Placement
from ident.show.view3d.bodies import tied

MOST = 1000  # pictures of all films
WIDTH = 0.1  # [s] over which a residual is averaged, so that colours do not flicker
Poses = tuple[np.ndarray, np.ndarray]  # rotations (n, 3, 3) and origins (n, 3) [m] in the world


@dataclass(frozen=True, eq=False)
class Loads:
    """Reactions over time in world axes, K of them, two a closure: (n, K, 3) each.

    Attributes:
        names: as `pin on rocker`; of a closure first that on a, then that on b.
        at: points of action [m]; force [N]; moment [N m].
    """

    names: tuple[str, ...]
    at: np.ndarray
    force: np.ndarray
    moment: np.ndarray


@dataclass(frozen=True, eq=False)
class Film:
    """A mechanism at n moments of one experiment.

    Attributes:
        name: of the experiment.
        t: (n,) [s]; q: (n, nq) of the mechanism's model.
        gap: (n,) largest |Φ| [m | rad].
        loads: reactions, if they are known.
        misfit: (n,) residual of each joint as a share of its rms torque, by name.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    gap: np.ndarray
    loads: Loads | None = None
    misfit: Mapping[str, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self.t)


def film_of(
    mechanism: Mechanism, experiment: Any, prediction: Any = None, most: int = MOST
) -> Film:
    """Return an experiment as a film of at most some moments.

    Args:
        mechanism: what moves.
        experiment: has `name`, `t` (n,) [s] and `q` (n, nq) of the mechanism's model.
        prediction: of a model on the same clock, whose multipliers become reactions, and whose
            residuals become colours, relative to the rms of the measured torque.
        most: moments.
    """
    t, p = experiment.t, prediction
    moments = frames(t, most)
    q = np.asarray(experiment.q, float)[moments]
    gap = np.abs(mechanism.kinematics.closure_rows(q).value).max(axis=1, initial=0.0)
    film = Film(experiment.name, t[moments], q, gap)
    if p is None:
        return film
    residual = np.where(p.usable[:, None], p.residual, np.nan)
    rms = np.sqrt(np.nanmean(p.measured**2, axis=0))
    misfit = {
        joint: running_rms(t, x / size, WIDTH)[moments]
        for joint, x, size in zip(p.joints, residual.T, rms, strict=True)
        if size > 0
    }
    return replace(film, loads=loads_of(mechanism, q, p.multipliers[moments]), misfit=misfit)


def loads_of(mechanism: Mechanism, q: np.ndarray, multipliers: np.ndarray) -> Loads:
    """Return the reactions of all closures that hold two frames together; NaN where λ is NaN.

    Args:
        mechanism: the mechanism.
        q: configurations (n, nq).
        multipliers: (n, m) λ.
    """
    n = len(q)
    names: list[str] = []
    vectors: list[np.ndarray] = []  # (3, n, 3) each: point, force and moment
    poses = iter(frame_poses(mechanism, q))
    for closure in tied(mechanism):
        (Ra, pa), (Rb, pb) = next(poses), next(poses)
        rows = [
            i
            for i, name in enumerate(mechanism.kinematics.multipliers)
            if name.rpartition(".")[0] == closure.name
        ]
        turned = [R.transpose(1, 0, 2).reshape(3, 3 * n) for R in (Ra, Rb)]
        wrenches = _reaction(closure).map(n)(*turned, pa.T, pb.T, multipliers[:, rows].T)
        Fa, Ma, Fb, Mb = (x.full().T for x in wrenches)
        if closure.sliding:  # both act at b
            Ma, pa = Ma - np.cross(pb - pa, Fa), pb
        names += [f"{closure.name} on {frame.link}" for frame in closure.frames]
        vectors += [np.stack([pa, Fa, Ma]), np.stack([pb, Fb, Mb])]
    return Loads(tuple(names), *(np.stack(vectors, axis=2) if vectors else np.zeros((3, n, 0, 3))))


def frame_poses(mechanism: Mechanism, q: np.ndarray) -> list[Poses]:
    """Return the poses of both frames of each closure of two frames at q (n, nq), a first."""
    frames = [frame for closure in tied(mechanism) for frame in closure.frames]
    data = mechanism.model.createData()
    poses = [(np.zeros((len(q), 3, 3)), np.zeros((len(q), 3))) for _ in frames]
    for k, each in enumerate(q):
        pin.forwardKinematics(mechanism.model, data, each)
        for frame, (R, p) in zip(frames, poses, strict=True):
            place = data.oMi[frame.joint] * frame.placement
            R[k], p[k] = place.rotation, place.translation
    return poses


def _reaction(closure: FrameClosure) -> ca.Function:
    """(R_a, R_b, p_a, p_b, λ) → force and moment on a at p_a, force and moment on b at p_b.

    Each frame is displaced by δ and turned by θ in world axes: F = −(∂Φ/∂δ)ᵀ λ, M = −(∂Φ/∂θ)ᵀ λ.
    """
    Ra, Rb = ca.SX.sym("Ra", 3, 3), ca.SX.sym("Rb", 3, 3)
    pa, pb = ca.SX.sym("pa", 3), ca.SX.sym("pb", 3)
    small = [ca.SX.sym(name, 3) for name in ("da", "ta", "db", "tb")]
    da, ta, db, tb = small
    phi = closure.between(
        Placement(Ra + ca.skew(ta) @ Ra, pa + da), Placement(Rb + ca.skew(tb) @ Rb, pb + db)
    ).phi
    multipliers = ca.SX.sym("lambda", phi.numel())
    work = ca.dot(phi, multipliers)
    wrenches = [-ca.gradient(work, each) for each in small]
    zeros = [ca.SX.zeros(3)] * 4
    return ca.Function(
        "reaction", [Ra, Rb, pa, pb, multipliers], ca.substitute(wrenches, small, zeros)
    )


def frames(t: np.ndarray, most: int) -> np.ndarray:
    """Return the indices of at most some samples of t (n,) [s], evenly in time, with both ends."""
    if len(t) <= most:
        return np.arange(len(t))
    wanted = np.linspace(t[0], t[-1], most)
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    return np.unique(np.where(wanted - t[after - 1] <= t[after] - wanted, after - 1, after))


def running_rms(t: np.ndarray, x: np.ndarray, width: float) -> np.ndarray:
    """Return the rms of x (n,) over `width` [s] around each t (n,); NaN counts as no sample."""
    known = np.isfinite(x)
    power = np.concatenate([[0.0], np.cumsum(np.where(known, x, 0.0) ** 2)])
    count = np.concatenate([[0], np.cumsum(known)])
    first = np.searchsorted(t, t - width / 2, side="left")
    last = np.searchsorted(t, t + width / 2, side="right")
    number = count[last] - count[first]
    mean = (power[last] - power[first]) / np.where(number > 0, number, np.nan)
    return np.sqrt(np.maximum(mean, 0.0))
