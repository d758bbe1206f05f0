"""Delay of torque channels against positions.

    S(d) = min_x Σ_u ‖X_u x − known − τ_u(t + d)‖² / σ_u²,    d > 0: the torque is late

Torques shifted by whole samples are right-hand sides too. S is looked at there alone, for a torque
interpolated between two samples has less noise, and its minimum is that of a parabola.
"""

from __future__ import annotations

import numpy as np

from ident.fit import Fit
from ident.health.bounded import least
from ident.health.check import Check
from ident.health.trial import Trial

SAMPLES = 2.0  # a shorter delay is the effect `delay`
CERTAIN = 3.0  # standard errors
FALL = 0.5  # of the joint's sum of squares: less is not material
EXPLAINED = 0.3  # relative error that may be left: a delay that leaves more explains nothing
LEAST = 0.02  # relative error below which nothing is to be gained
ALIKE = 1.5  # times the squares left by delays of their own, that one delay of all may leave


def delays(fit: Fit, trial: Trial, idle: frozenset[str] = frozenset()) -> list[Check]:
    """The delay of each torque channel but those of idle joints; those that matter are bad."""
    if not trial.square or not len(trial.lags):
        return []
    gram, J = _grams(trial), len(trial.driven)
    zero = np.full(J, int((trial.lags < 0).sum()))
    at, d, sharp = zero.copy(), np.zeros(J), np.zeros(J)
    for _ in range(2):  # a delay of one joint is in the others' parameters
        for j in range(J):
            at[j], d[j], sharp[j] = _best(trial, gram, at, j)
    place, common, bend = _best(trial, gram, zero, slice(None))
    alone, both = (_left(gram, _shifted(trial, x)) for x in (at, np.full(J, place)))
    together = J > 1 and bool((both <= ALIKE * alone).all())
    if together:
        at, d, sharp = np.full(J, place), np.full(J, common), np.full(J, bend)
    # standard error √(S / (n S″/2)), n the samples that are independent at the motion's bandwidth
    effective = 2.0 * max(fit.motion.band.motion, 0.1) * _duration(fit)
    stderr = 1 / np.sqrt(np.maximum(effective * sharp, 1e-300))
    before, after = (_left(gram, _shifted(trial, x)) for x in (zero, at))
    fell = {j: 1 - after[u] / max(before[u], 1e-300) for u, j in enumerate(trial.own)}
    size = {j: float(np.sqrt(before[u])) for u, j in enumerate(trial.own)}
    found = []
    for j, name in enumerate(trial.driven):
        certain = abs(d[j]) / stderr[j]
        bad = (
            abs(d[j]) >= SAMPLES * trial.dt
            and certain >= CERTAIN
            and fell[j] >= FALL
            and size[j] >= LEAST
            and size[j] * np.sqrt(1 - fell[j]) <= EXPLAINED
            and name not in idle
        )
        word = "late" if d[j] > 0 else "early"
        text = (
            f"{1e3 * abs(d[j]):.3g} ms {word} against the positions; without the delay its sum of "
            f"squared errors falls by {100 * fell[j]:.3g} %"
            if bad
            else "no delay that matters"
        )
        found.append(
            Check(
                "delay", (f"tau.{name}",), 1e3 * d[j] if bad else 0.0, 1e3 * SAMPLES * trial.dt,
                bad, text, f"shift the column, or add the effect delay:{name}", "ms",
            )
        )  # fmt: skip
    fall = 1 - float(after.sum() / max(before.sum(), 1e-300))
    if together and fall >= FALL and any(check.bad for check in found):
        return [_common(found, 1e3 * common)]
    return found


def _common(found: list[Check], ms: float) -> Check:
    text = (
        f"all torques are {abs(ms):.3g} ms {'late' if ms > 0 else 'early'} against the positions: "
        "two clocks, or a filter on one of them"
    )
    remedy = "shift the torque columns together, or filter positions and torques alike"
    channels = tuple(c.channels[0] for c in found)
    return Check("delay", channels, ms, found[0].threshold, True, text, remedy, "ms")


def _grams(trial: Trial) -> list[np.ndarray]:
    """EᵀE of each coordinate, E what a refit leaves of every right-hand side."""
    size = trial.torque(trial.as_logged)
    scale = np.where(size > 0, size, 1.0)
    stack = [T / s for T, s in zip(trial.triangles, scale, strict=True)]
    whole = np.concatenate(stack)
    x = least(whole[:, : trial.width], whole[:, trial.width :])
    left = [T[:, trial.width :] - T[:, : trial.width] @ x for T in stack]
    return [E.T @ E for E in left]


def _left(gram: list[np.ndarray], c: np.ndarray) -> np.ndarray:
    return np.array([max(float(c @ G @ c), 0.0) for G in gram])  # rounding apart


def _shifted(trial: Trial, at: np.ndarray) -> np.ndarray:
    """c with τ_j(t + d), d the at[j]-th of the shifts and 0 in order of size."""
    J, L = len(trial.driven), len(trial.lags)
    zero = int((trial.lags < 0).sum())
    c = trial.as_logged.copy()
    for j in range(J):
        if at[j] != zero:
            c[1 + J * j + j] = 0.0
            c[1 + J * J + L * j + at[j] - (at[j] > zero)] = 1.0
    return c


Profile = tuple[int, float, float]  # the best shift's place, d [s], S″/2 over the joint's own S


def _best(trial: Trial, gram: list[np.ndarray], at: np.ndarray, j: int | slice) -> Profile:
    """The shift of one joint, or of all, that leaves least, the others as they are."""
    nodes = np.insert(trial.lags, int((trial.lags < 0).sum()), 0.0)
    left = np.empty(len(nodes))
    for i in range(len(nodes)):
        other = at.copy()
        other[j] = i
        left[i] = _left(gram, _shifted(trial, other)).sum()
    best = int(np.clip(left.argmin(), 1, len(nodes) - 2))
    x = nodes[best - 1 : best + 2] - nodes[best]
    bend, slope, _ = np.polyfit(x, left[best - 1 : best + 2], 2)
    if bend <= 0:
        return int(left.argmin()), float(nodes[left.argmin()]), 0.0
    d = float(np.clip(-slope / (2 * bend), x[0], x[2]))
    other = at.copy()
    other[j] = int(left.argmin())
    noise = _left(gram, _shifted(trial, other))  # of its own rows: others may have faults of theirs
    bottom = max(float(noise.sum() if isinstance(j, slice) else noise[trial.own.index(j)]), 1e-300)
    return int(left.argmin()), float(nodes[best] + d), float(bend / bottom)


def _duration(fit: Fit) -> float:
    return sum(float(e.usable.mean() * (e.t[-1] - e.t[0])) for e in fit.motion.experiments)
