"""Which exchange of torque channels explains the log clearly better: swaps, signs, gains.

Hypotheses are tried one by one, the best is kept, and the search goes on from there, so that two
wrong channels are found one after the other. A hypothesis has all parameters refitted, with what
no machine can have (negative inertia or friction) excluded: a missing effect rarely makes another
arrangement of the channels fit, a wrong one leaves several times the error of the right.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ident.health.trial import Result, Trial

MATERIAL = 0.02  # error left by the log as it is, below which no channel can be badly wrong
CLEAR = 0.45  # of the error may be left: right arrangements leave 0.05 to 0.44, others more
JOINT = 0.7  # and each joint concerned must gain
POOR = 0.2  # error of a joint from which it is judged by itself
WORSE = 1.1  # times its error, by which no other joint may then become worse
ALIKE = 1.3  # times the best hypothesis' error: a rival
GROSS = np.sqrt(2.0)  # a gain nearer to 1 is the effect torque_gain
LARGER = {("scale", 1): 1.2, ("sign", 2): 1.2}  # claims, which must do better than a smaller one
GAINS = (1e-3, 1e-2, 0.1, 0.25, 0.5, 0.7, 1.4, 2.0, 4.0, 10.0, 100.0, 1e3)
REFINED = 6  # steps of golden section, each 0.62 of the interval between two gains


@dataclass(frozen=True, eq=False)
class Change:
    """One exchange: `kind` is `swapped`, `sign` or `scale`.

    Attributes:
        joints: places among the driven joints; factor: by which the channel is multiplied.
        take, gain: (J,) the arrangement that it leads to.
        before, after: relative error of the joints concerned, root mean square.
        score: error of all coordinates after it.
        rivals: other changes that are nearly as good.
    """

    kind: str
    joints: tuple[int, ...]
    factor: float
    take: np.ndarray
    gain: np.ndarray
    before: float = np.nan
    after: float = np.nan
    score: float = np.nan
    rivals: tuple[Change, ...] = ()


def changes(trial: Trial) -> list[Change]:
    """All exchanges of torque channels that explain the log clearly better, best first."""
    J = len(trial.driven)
    take, gain = np.arange(J), np.ones(J)
    found: list[Change] = []
    for _ in range(J):
        now = trial.refit(trial.arrangement(take, gain))
        if now.score < MATERIAL:
            break
        tried = []
        for change in _hypotheses(trial, take, gain):
            result = trial.refit(trial.arrangement(change.take, change.gain))
            own = np.array([each in change.joints for each in trial.own])
            if _better(change.kind, now, result, own):
                before, after = (
                    _rms(r.relative[own] if own.any() else r.relative) for r in (now, result)
                )
                tried.append(replace(change, before=before, after=after, score=result.score))
        if not tried:
            break
        tried.sort(key=lambda c: c.score * LARGER.get((c.kind, len(c.joints)), 1.0))
        best, *others = tried
        rivals = tuple(c for c in others if c.score < ALIKE * best.score)
        found.append(replace(best, rivals=rivals))
        take, gain = best.take, best.gain
    return found


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _better(kind: str, now: Result, then: Result, own: np.ndarray) -> bool:
    """Whether all joints together, or the joints concerned alone, do clearly better.

    Joints that a missing effect spoils hide what becomes of the others in the sum; then those
    concerned must have been poor, and no other may become worse. A gain is told by the
    rows of the other joints alone, so where these are spoilt it is not told.
    """
    if not (then.relative[own] < JOINT * now.relative[own]).all():
        return False
    if then.score < CLEAR * now.score:
        return True
    if kind == "scale" or not own.any() or (then.relative[~own] > WORSE * now.relative[~own]).any():
        return False
    before, after = now.relative[own], then.relative[own]
    return bool((before > POOR).all() and (after < CLEAR * before).all())


def _hypotheses(trial: Trial, take: np.ndarray, gain: np.ndarray) -> Iterator[Change]:
    J = len(take)
    for j in range(J):
        turned = gain.copy()
        turned[j] *= -1
        yield Change("sign", (j,), -1.0, take, turned)
        for i in range(j):
            other = take.copy()
            other[i], other[j] = take[j], take[i]
            yield Change("swapped", (i, j), 1.0, other, gain)
            both = turned.copy()
            both[i] *= -1
            yield Change("sign", (i, j), -1.0, take, both)
        factor = _gain(trial, take, gain, j)
        if max(factor, 1 / factor) > GROSS:
            scaled = gain.copy()
            scaled[j] *= factor
            yield Change("scale", (j,), factor, take, scaled)


def _gain(trial: Trial, take: np.ndarray, gain: np.ndarray, j: int) -> float:
    """The factor on joint j's torque that leaves the least error; 1 if none is better."""

    def score(log_factor: float) -> float:
        scaled = gain.copy()
        scaled[j] *= np.exp(log_factor)
        return trial.refit(trial.arrangement(take, scaled)).score

    grid = np.log([*GAINS[:6], 1.0, *GAINS[6:]])
    values = [score(x) for x in grid]
    best = int(np.argmin(values))
    if best == 6:
        return 1.0
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    golden = (np.sqrt(5) - 1) / 2
    a, b = high - golden * (high - low), low + golden * (high - low)
    at_a, at_b = score(a), score(b)
    for _ in range(REFINED):
        if at_a < at_b:
            high, b, at_b = b, a, at_a
            a = high - golden * (high - low)
            at_a = score(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + golden * (high - low)
            at_b = score(b)
    return float(np.exp(a if at_a < at_b else b))
