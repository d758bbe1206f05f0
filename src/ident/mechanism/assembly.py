"""A configuration at which all closures hold, from a start that may be far from one.

    e(q) = [log6(M_a⁻¹ M_b) of fixed closures; Φ of the others]      (JᵀJ + μ 1) δ = −Jᵀ e

Levenberg-Marquardt steps; log6 is the length of the way between two frames, where the sines of Φ
have zeros at half a turn. If the start leads to no assembled configuration, others at random are
tried: angles are changed, lengths stay, as limits of stroke are shorter than turns.

Sources: J. Moré, The Levenberg-Marquardt algorithm, 1978; log6 and its derivative: J. Solà, J.
Deray, D. Atchuthan, A micro Lie theory, 2018.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ident.information import linear
from ident.mechanism.closures import FixedClosure, FrameClosure
from ident.mechanism.kinematics import Kinematics

CLOSED = 1e-9  # numerics: [rad | m] of e up to which a loop is assembled
STEPS = 400  # work: of Levenberg and Marquardt from one start
LARGEST_STEP = 0.5  # numerics: [rad | m]
DAMPING = (1e-2, 1e-12, 1e6)  # numerics: μ at first, at least, and where no step helps
SPREADS = (0.0, 0.2, 0.5, 1.0, 1.5)  # work: [rad] of the first starts at random
SEARCH = 5.0  # work: [s] of processor for all starts
ALONE = 0.3  # work: [s] of processor for each closure by itself, where not all close


@dataclass(frozen=True, eq=False)
class Assembly:
    """A configuration with what is left open of each closure there."""

    q: np.ndarray  # (nq,)
    gaps: dict[str, float]  # [rad | m], by closure
    starts: int  # that were tried beyond Newton's steps from the mechanism's own start
    alone: tuple[str, ...] = ()  # closures that stay open whatever the others do

    @property
    def closed(self) -> bool:
        """Whether all closures hold."""
        return max(self.gaps.values(), default=0.0) < CLOSED


def assemble(kinematics: Kinematics, start: np.ndarray, turning: np.ndarray) -> Assembly:
    """Return the assembled configuration nearest to the start, or the least open one.

    Args:
        kinematics: the tree and its closures.
        start: (nq,) where the search begins.
        turning: (nv,) whether each velocity of the tree is an angle's, which a new start changes.
    """
    q, error = kinematics.assemble(start)
    direct = Assembly(q, _gaps(kinematics, q), 0)
    if error < CLOSED and direct.closed:
        return direct
    best = _searched(kinematics, start, turning, direct, SEARCH)
    if not best.closed and len(kinematics.closures) > 1:
        alone = []
        for closure in kinematics.closures:
            if isinstance(closure, FrameClosure) and best.gaps[closure.name] >= CLOSED:
                one = kinematics.with_closures((closure,))
                begin = Assembly(start, _gaps(one, start), 0)
                if not _searched(one, start, turning, begin, ALONE).closed:
                    alone.append(closure.name)
        best = replace(best, alone=tuple(alone))
    if best.closed:  # its equations to rounding, as Newton leaves them
        q, _ = kinematics.assemble(best.q)
        best = Assembly(q, _gaps(kinematics, q), best.starts)
    return best


def _searched(
    kinematics: Kinematics, start: np.ndarray, turning: np.ndarray, best: Assembly, seconds: float
) -> Assembly:
    """Return an assembly found from starts at random about the given one, or the least open one."""
    random, end, count = np.random.default_rng(0), time.process_time() + seconds, 0
    angles = turning.astype(float)
    while not best.closed and time.process_time() < end:
        spread = SPREADS[count] if count < len(SPREADS) else random.uniform(SPREADS[1], SPREADS[-1])
        step = spread * angles * random.normal(size=len(angles))
        q = _damped(kinematics, pin.integrate(kinematics.model, start, step), end)
        count += 1
        trial = Assembly(q, _gaps(kinematics, q), count)
        if max(trial.gaps.values()) < max(best.gaps.values()):
            best = trial
    return best


def _damped(kinematics: Kinematics, q: np.ndarray, end: float) -> np.ndarray:
    """Return the end of Levenberg and Marquardt's way from q, at the latest at a time [s]."""
    damping, least, most = DAMPING
    e, J = _residual(kinematics, q)
    for _ in range(STEPS):
        if time.process_time() > end:
            break
        step = linear.lstsq(
            np.vstack([J, np.sqrt(damping) * np.eye(J.shape[1])]),
            np.append(-e, np.zeros(J.shape[1])),
        )[0]
        step *= min(1.0, LARGEST_STEP / max(np.abs(step).max(), 1e-300))
        shifted = pin.integrate(kinematics.model, q, step)
        e_there, J_there = _residual(kinematics, shifted)
        if e_there @ e_there < e @ e:
            q, e, J, damping = shifted, e_there, J_there, max(damping / 5, least)
        else:
            damping *= 8
        if np.abs(e).max() < 0.01 * CLOSED or damping > most:
            break
    return q


def _residual(kinematics: Kinematics, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return e (m,) and its Jacobian (m, nv)."""
    rows = kinematics.closure_rows(q[None])
    e, J = rows.value[0].copy(), rows.rate[0].copy()
    model, data = kinematics.model, kinematics.model.createData()
    pin.computeJointJacobians(model, data, q)
    for closure, at in zip(kinematics.closures, kinematics.rows_of_closures, strict=True):
        if isinstance(closure, FixedClosure):
            (M_a, J_a), (M_b, J_b) = (
                (
                    data.oMi[frame.joint] * frame.placement,
                    frame.placement.toActionMatrixInverse()
                    @ pin.getJointJacobian(model, data, frame.joint, pin.LOCAL),
                )
                for frame in closure.frames
            )
            between = M_a.inverse() * M_b
            e[at] = pin.log6(between).vector
            J[at] = pin.Jlog6(between) @ (J_b - between.toActionMatrixInverse() @ J_a)
    return e, J


def _gaps(kinematics: Kinematics, q: np.ndarray) -> dict[str, float]:
    """Return what is left open of each closure [rad | m]; half a turn where axes point apart."""
    e, _ = _residual(kinematics, q)
    data = kinematics.model.createData()
    pin.forwardKinematics(kinematics.model, data, q)
    gaps = {}
    for closure, at in zip(kinematics.closures, kinematics.rows_of_closures, strict=True):
        gaps[closure.name] = float(np.abs(e[at]).max(initial=0.0))
        if isinstance(closure, FrameClosure) and "rx" in closure.rotation:
            z_a, z_b = ((data.oMi[f.joint] * f.placement).rotation[:, 2] for f in closure.frames)
            if z_a @ z_b < 0:
                gaps[closure.name] = float(np.pi)
    return gaps
