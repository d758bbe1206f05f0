"""The verb `where`: joint by joint, how much a model fails, when, and on what that depends.

    share_j = (rms_j / rms(τ_j))² / Σ_i (rms_i / rms(τ_i))²

Joints weigh by their measured torque, so that N m and N, strong joints and weak ones can be added.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ident.fit.residual import Residual
from ident.residual.failure import Dependence, Failure
from ident.residual.maps import depends_on
from ident.residual.noise import memory_of
from ident.residual.periods import Periods, periods
from ident.residual.regimes import regimes
from ident.residual.signals import Candidate, candidates, fine, folds
from ident.residual.windows import worst
from ident.residual.words import seen

ROUNDING = 1e-9  # of the torque: below, nothing is left


def where(residual: Residual) -> tuple[Failure, ...]:
    """Where the model of a `residual` fails: one entry a joint, the largest share first."""
    weights = _weights(residual)
    squares = np.array([residual.errors[j].rms for j in residual.joints]) ** 2 * weights
    shares = squares / squares.sum() if squares.sum() > 0 else np.zeros(len(squares))
    maps = candidates(residual)
    fold = folds(residual.traces)
    again = periods(residual)
    found = [
        _failure(residual, joint, float(share), maps, fold, again)
        for joint, share in zip(residual.joints, shares, strict=True)
    ]
    return tuple(sorted(found, key=lambda each: -each.share))


def _weights(residual: Residual) -> np.ndarray:
    """1 / rms(τ_j)² (d,); a joint without torque gets the weight of the strongest."""
    torque = residual.parts["measured"]
    strongest = float(torque.max(initial=0.0)) or 1.0
    return np.asarray(1 / np.where(torque > 0, torque, strongest) ** 2)


def _failure(
    residual: Residual,
    joint: str,
    share: float,
    maps: list[Candidate],
    fold: np.ndarray,
    again: Periods | None,
) -> Failure:
    u, error = residual.joints.index(joint), residual.errors[joint]
    runs = [trace.residual[run, u] for trace in residual.traces for run in trace.runs()]
    memory = memory_of(runs, residual.motion.band.cutoff, residual.rate)
    r = np.concatenate(runs)
    nothing = error.rms <= ROUNDING * float(residual.parts["measured"].max(initial=0.0))
    steps, threshold = [], 1.0
    if not nothing:
        informed = np.concatenate([trace.informed[:, u] for trace in residual.traces])
        mine = sorted([*maps, *fine(residual, joint)], key=lambda each: each.joint != joint)
        if not informed.all():
            mine = [_of_rows(each, informed) for each in mine]
        lengths = [len(run) for run in runs]
        ends = np.concatenate([[0], np.cumsum(informed)])[np.cumsum([0, *lengths])]
        kept = [slice(int(a), int(b)) for a, b in pairwise(ends) if b - a > 3]
        told = depends_on(r[informed], fold[informed], mine, kept)
        steps, threshold = list(told.steps), told.threshold
    return Failure(
        joint=joint,
        unit=error.unit,
        rms=error.rms,
        relative=error.relative,
        share=share,
        offset=float(r.mean()),
        worst=() if nothing else worst(residual, joint, memory.effective),
        regimes=() if nothing else regimes(residual, joint, memory.effective),
        depends_on=tuple(
            Dependence(step.candidate.name, step.after - step.before, seen(step, error.unit))
            for step in steps
        ),
        memory=memory,
        threshold=threshold,
        repeats=again.rho[joint] if again else None,
        white=nothing or (memory.noise and not steps and not _repeats(again, joint)),
    )


def _repeats(again: Periods | None, joint: str) -> bool:
    """Whether the residual comes again with the motion, beyond what noise would by chance."""
    return again is not None and again.rho[joint] > again.chance


def _of_rows(each: Candidate, rows: np.ndarray) -> Candidate:
    return Candidate(
        each.name, each.kind, each.joint, each.unit, each.columns[rows], each.knots, each.stiff
    )
