"""What rows at rest are off by: dry friction holds the joint, and only its limit F is known.

    |τ − Γ p| ≤ F    enters as a Gaussian of its width:    σ_rest² = σ² + F²/3

σ: of the coordinate's rows in motion. F is what the model's dry friction has just above standstill;
without a model of it σ_rest is what is left of the rows at rest, where these are many. A row
stands for a stretch at rest, or for a pose, as long as it lasts (`equations.rows`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.equations.problem import Problem
from ident.equations.terms import Samples
from ident.equations.unknowns import Point
from ident.information.estimate import Estimate
from ident.motion import Motion

# level: standard deviation of friction at rest over its limit, all values within it alike: a joint
# that its drive has just moved has 1, one that was tapped less
WIDTH = 3**-0.5
JUST_ABOVE = 1.01  # numerics: times the speed of standstill, at which friction is at its limit
LOOKED_AT = 100  # work: samples of a log from which a limit is taken
FEWEST_RESTS = 8  # level: stretches from which what is left of them shows what they are off by
PASSES = 6  # work
SETTLED = 1e-2  # numerics


def friction_at_rest(problem: Problem, point: Point) -> np.ndarray:
    """Return the limits F (d,) of dry friction, rms over the logs; 0 where the model has none."""
    mechanism, squares = problem.mechanism, list[np.ndarray]()
    for e in problem.motion.experiments:
        every = np.arange(0, len(e), max(1, len(e) // LOOKED_AT))
        s = Samples(mechanism, e, every, point)
        limits = np.zeros((len(every), len(mechanism.joints)))
        for effect in mechanism.effects:
            c, shape = point.of(effect)
            if not effect.local or not effect.unknowns or len(shape) < len(effect.shapes):
                continue
            signals = s.signals(effect.joints)
            if effect.memory or effect.informed(replace(signals, v=0 * signals.v)).all():
                continue
            ahead = np.broadcast_to(JUST_ABOVE * signals.still, signals.v.shape)
            both = [
                np.abs(effect.columns(replace(signals, v=v, shape=shape)) @ c)
                for v in (ahead, -ahead)
            ]
            at = [mechanism.joint_index[name] for name in effect.joints]
            limits[:, at] += np.maximum(*both)
        levers = np.abs(e.leverage[every])  # (n, J, d)
        joints = levers.shape[1]
        squares.append((np.einsum("njd,nj->nd", levers, limits[:, :joints]) ** 2).mean(axis=0))
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def with_rest(problem: Problem, fitted: Estimate) -> tuple[Problem, Estimate]:
    """Return the problem with its rows at rest among those that inform, and its estimate.

    `fitted`: the estimate by the rows in motion. Both as they are where no row is at rest.
    """
    rest_rows = problem.information.rest_rows
    rows = np.array([count for _, count in rest_rows])
    if problem.stacked or problem.motion.poses or not rows.any():
        return problem, fitted
    in_motion = np.array([t.rows > 0 for t in problem.information.totals])
    limit = friction_at_rest(problem, problem.point_at(fitted.x))
    sigma = np.where(in_motion, fitted.sigma, 0.0)
    used = (rows > 0) & ((limit > 0) | (rows >= FEWEST_RESTS))
    if not used.any():
        return problem, fitted
    noise, now, at_rest = np.hypot(WIDTH * limit, sigma), fitted, problem
    for _ in range(PASSES):
        residuals = [t.residual_norm(now.x) / np.sqrt(max(n, 1.0)) for t, n in rest_rows]
        before, noise = noise, np.where(limit > 0, noise, np.maximum(sigma, residuals))
        noise = np.where(noise > 0, noise, 1.0)
        weights = np.where(in_motion & (sigma > 0), sigma, noise)
        at_rest = weighed(problem, weights, np.where(used, weights / noise, 0.0))
        now = at_rest.estimate()
        if (limit[used] > 0).all() or _change(noise[used], before[used]) < SETTLED:
            break
    return at_rest, now


def _change(now: np.ndarray, before: np.ndarray) -> float:
    """Return the largest change of positive numbers, as a share; before may be 0."""
    return float(np.abs(now / np.maximum(before, np.finfo(float).tiny) - 1).max())


def weighed(problem: Problem, sigma: np.ndarray, rest: np.ndarray) -> Problem:
    """Return a problem in which rows at rest have the weights `rest` (d,) over those in motion, and
    coordinates the noise `sigma` (d,).
    """
    states = tuple(e.with_rest(rest) for e in problem.motion.experiments)
    information = problem.information.with_rest(rest)
    motion = replace(problem.motion, experiments=states)
    return replace(problem, motion=motion, information=information, sigma=sigma)


def unweighed(motion: Motion) -> Motion:
    """Return the motion as it is before an estimate: what rows at rest weigh is open."""
    if motion.poses or all(e.rest is None for e in motion.experiments):
        return motion
    return replace(motion, experiments=tuple(e.with_rest(None) for e in motion.experiments))
