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

RATE, MOST, LEAST = 120.0, 6000, 2000  # pictures of a film, in a second, at most and at least
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
        misfit: (n,) residual of each joint as a share of `unit`, by name.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    gap: np.ndarray
    loads: Loads | None = None
    misfit: Mapping[str, np.ndarray] | None = None
    unit: str = ""

    def __len__(self) -> int:
        return len(self.t)

    def at(self, index: np.ndarray) -> Film:
        """Some moments only, (k,) indices."""
        x, misfit = self.loads, self.misfit
        return replace(
            self, t=self.t[index], q=self.q[index], gap=self.gap[index],
            loads=x and Loads(x.names, x.at[index], x.force[index], x.moment[index]),
            misfit=misfit and {name: each[index] for name, each in misfit.items()},
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """The motion of a mechanism in one experiment, n samples, and the predictions of a model.

    Attributes:
        name: the experiment's.
        t: (n,) [s]; q: (n, nq) of the mechanism's model.
        multipliers: (n, m) λ, or None.
        residual: (n,) measured − predicted torque by joint [N m | N].
        torque: (n,) measured torque by joint, to whose rms the residual is compared; without it
            the residual is compared to its own rms.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    multipliers: np.ndarray | None = None
    residual: Mapping[str, np.ndarray] | None = None
    torque: Mapping[str, np.ndarray] | None = None

    @staticmethod
    def of(experiment: Any, prediction: Any = None) -> ShownMotion:
        """Return an experiment and a prediction on the same clock."""
        e, p = experiment, prediction
        if p is None:
            return ShownMotion(e.name, e.t, e.q)
        residual = np.where(p.usable[:, None], p.residual, np.nan)
        by_joint = (dict(zip(p.joints, x.T, strict=True)) for x in (residual, p.measured))
        return ShownMotion(e.name, e.t, e.q, p.multipliers, *by_joint)


def film_of(mechanism: Mechanism, motion: ShownMotion) -> Film:
    """Return a motion at the moments that are shown, at most `MOST`."""
    moments = frames(motion.t, RATE, MOST, LEAST)
    q = np.asarray(motion.q, float)[moments]
    phi = mechanism.kinematics.closure_rows(q).value
    loads = None
    if motion.multipliers is not None:
        loads = loads_of(mechanism, q, np.asarray(motion.multipliers, float)[moments])
    misfit, unit = _misfit(motion)
    if misfit is not None:
        misfit = {name: each[moments] for name, each in misfit.items()}
    gap = np.abs(phi).max(axis=1, initial=0.0)
    return Film(motion.name, motion.t[moments], q, gap, loads, misfit, unit)


def _misfit(motion: ShownMotion) -> tuple[dict[str, np.ndarray] | None, str]:
    """Return the residual of each joint (n,) over a tenth of a second, as a share, and of what."""
    if not motion.residual:
        return None, ""
    misfit, scale = {}, motion.torque or motion.residual
    for name, residual in motion.residual.items():
        rms = float(np.sqrt(np.nanmean(np.square(scale.get(name, np.nan)))))
        if rms > 0:
            misfit[name] = running_rms(motion.t, residual / rms, WIDTH)
    unit = f"rms over {WIDTH:g} s, in % of the rms {'torque' if motion.torque else 'residual'}"
    return misfit, unit


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


def nearest(t: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the indices (k,) of the samples of t (n,), ascending, nearest to `wanted` (k,)."""
    if len(t) == 1:
        return np.zeros(len(wanted), dtype=int)
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    return np.where(wanted - t[after - 1] <= t[after] - wanted, after - 1, after)


def frames(t: np.ndarray, rate: float, most: int, least: int = 2) -> np.ndarray:
    """Return the indices (k,) of samples of t (n,) [s] that become frames, evenly in time.

    First and last are among them; `rate` frames a second [Hz], `most` and, of a short motion to be
    watched slowly, `least` frames.
    """
    span = float(t[-1] - t[0])
    count = int(np.clip(round(rate * span) + 1, least, most))
    if count >= len(t):
        return np.arange(len(t))
    return np.unique(nearest(t, np.linspace(t[0], t[-1], count)))


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
