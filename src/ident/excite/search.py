"""The verb `excite`: searches for the periodic motion that determines the unknowns best.

An interior-point search for the x of the largest J(x) with low < z(x) < high, from a point inside:

    min φ(x) = −J(x) − μ Σ log s            s = (z − low, high − z) > 0
    (B + Zᵀ D Z) δ = −∇φ                    Z = ∂z/∂x, D = Σ λ / s of both sides
    λ ← λ + α (μ / s − λ − λ ∂s/∂x δ / s)   multipliers: λ s → μ → 0

B, of SciPy's damped BFGS, estimates the Hessian of −J − λᵀs alone: the curvature of φ near a limit,
which is much larger, is in D. So thousands of limits cost one product ZᵀDZ a step, and every point
is inside all of them: a motion can be used before the search ends. CasADi's IPOPT is inside at the
end only.

Source: Nocedal, Wright, Numerical Optimization, 2nd ed. 2006, chapter 19 and procedure 18.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import chain, islice
from time import monotonic

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ident.display import Progress, no_progress
from ident.errors import MotionError, check_whole
from ident.excite.around import around_motion
from ident.excite.design import DesignProblem, ExcitingMotion
from ident.excite.excitation import Criterion, Excitation, with_rivals
from ident.excite.limits import Limits
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

DRAWS = 25  # work: random motions, the best of which each search starts from
ROUND, STEPS = 30, 150  # work: steps of every search, and of the best one after these, at most
CENTRED = 1e-2  # numerics: μ of the first problem of a search, times the number of drives
DIRECT = 1e-3  # numerics: μ, likewise, of every second search for a separation
HAND_OUT_INTERVAL = 5.0  # shown: s between two motions that are handed out before the end


def excite(
    mechanism: Mechanism,
    *,
    duration: float = 30.0,
    periods: int = 3,
    rate: float = 100.0,
    harmonics: int = 5,
    limits: Limits | None = None,
    separate: tuple[str, str] | None = None,
    noise: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    around: Motion | None = None,
    as_logged: bool = False,
    balance: float = 0.5,
    tries: int = 4,
    seed: int = 0,
    better: Callable[[Excitation], None] | None = None,
    progress: Progress | None = None,
) -> Excitation:
    """Return the periodic motion of the drives that makes the base parameters most certain.

    After Ctrl-C it returns the best motion so far, as soon as there is one.

    Args:
        mechanism: with the effects that are to be identified too.
        duration: of the whole log [s], `periods` times the same motion.
        periods: 2 or more distinguish what repeats from noise.
        rate: of the log [Hz].
        harmonics: of the Fourier series, 2 or more; the highest frequency is that many a period.
        limits: in place of the URDF's.
        separate: two effects' labels; then the motion that distinguishes them best.
        noise: expected of the torques, by drive [N m | N]; default 1 % of the limit of torque.
        values: of parameters that are to be identified, as of an earlier fit: in place of the
            mechanism's masses, and of effects, whose torque then counts in the limits.
        around: a motion of the machine: home is in its middle, and it gives the range and speed of
            joints that have no limit.
        as_logged: joints that `limits` does not name keep the range and speed of that motion.
        balance: weight of the condition number beside the log-determinant; 0 ignores it.
        tries: searches, each from the best of 25 random motions; the best of them is finished.
        seed: of these; the same seed gives the same motion.
        better: called with the first motion that keeps the limits, a random one, within seconds,
            and about every 5 s with a better one.
        progress: called with (what is being done, share done).

    Raises:
        MechanismError, MotionError: for limits that exclude every motion, with the one that does;
            for a mechanism with fewer drives than degrees of freedom; for rivals that no motion
            distinguishes.
    """
    check_whole("seed", seed)
    if not 0 < duration < np.inf or not 0 < rate < np.inf:
        raise MotionError(
            f"duration {duration:g} s, rate {rate:g} Hz; numbers above 0 are expected"
        )
    if periods < 1 or harmonics < 2 or tries < 1:
        raise MotionError(
            f"periods {periods}, harmonics {harmonics}, tries {tries}; valid: 1 period and try or "
            "more, 2 harmonics or more, for one alone cannot begin at rest"
        )
    top = harmonics * periods / duration
    if rate < 10 * top:
        raise MotionError(
            f"rate {rate:g} Hz: the highest harmonic is at {top:.3g} Hz; give at least "
            f"{10 * top:.3g} Hz, fewer harmonics or a longer period"
        )
    if not 0 <= balance < np.inf:
        raise MotionError(f"balance {balance:g}; a number from 0 is expected")
    if separate is not None:
        if isinstance(separate, str) or len(separate) != 2:
            raise MotionError(
                f"separate {separate!r}; valid: two effects, as ('drag:a', 'viscous:a')"
            )
        mechanism = with_rivals(mechanism, separate)
    limits = limits or Limits()
    if around is not None:
        mechanism, limits = around_motion(mechanism, limits, around, as_logged=as_logged)
    say = progress or no_progress
    say(f"random motions of {mechanism.name}", 0.0)
    problem = DesignProblem(
        mechanism, limits, duration / periods, harmonics, noise or {}, seed, values
    )
    criterion = problem.criterion(separate, balance)

    def excitation(c: ExcitingMotion, finished: bool) -> Excitation:
        x = problem.inside(c.x, rate)
        return problem.excitation(x, duration, periods, rate, separate, seed, finished)

    best: ExcitingMotion | None = None
    handed_out, at, finished = -np.inf, -np.inf, False
    try:
        for what, share, c in _searches(problem, criterion, tries, seed):
            say(f"exciting {mechanism.name}, {what}", share)
            best = c if best is None or c.J > best.J else best
            if better and handed_out < best.J and monotonic() > at + HAND_OUT_INTERVAL:
                better(excitation(best, finished))
                handed_out, at = best.J, monotonic()
        finished = True
    except KeyboardInterrupt:
        if best is None:
            raise
    if best is None:
        raise MotionError(
            f"{mechanism.name}: no random motion inside the limits determines all parameters; "
            "give wider limits, or more harmonics"
        )
    say(f"exciting {mechanism.name}", 1.0)
    return excitation(best, finished)


def _searches(
    problem: DesignProblem, criterion: Criterion, tries: int, seed: int
) -> Iterator[tuple[str, float, ExcitingMotion]]:
    """Yield what is done, the share that is done, and a motion, after each step of all searches.

    All make the first steps; the best of them then goes on until it gains no more.
    """
    most, begun = tries * ROUND + STEPS, []
    for i in range(tries):
        random = np.random.default_rng([seed, 2, i])
        starts = [*filter(None, (problem.draw(random, criterion) for _ in range(DRAWS)))]
        if not starts:
            continue
        start = max(starts, key=lambda c: c.J)
        centred = DIRECT if i % 2 and len(criterion.parts) > 1 else CENTRED
        steps, J = ascent(problem, start, criterion, centred), start.J
        for k, c in enumerate(chain([start], islice(steps, ROUND))):
            yield f"search {i + 1} of {tries}", (i * ROUND + k) / most, c
            J = c.J
        begun.append((J, -i, steps))
    if begun:
        _, i, steps = max(begun, key=lambda search: search[:2])
        for k, c in enumerate(islice(steps, STEPS)):
            yield f"finishing search {1 - i}, the best", (tries * ROUND + k) / most, c


def ascent(
    problem: DesignProblem, start: ExcitingMotion, criterion: Criterion, centred: float = CENTRED
) -> Iterator[ExcitingMotion]:
    """Yield the motion after each step of a climb from a start; all are inside the limits.

    `centred` is μ of its first problem, times the number of drives.
    """
    n, box, limited = len(start.rows.e), problem.box, problem.limited

    def at(x: np.ndarray, near: ExcitingMotion) -> ExcitingMotion | None:
        rows = problem.family.motion(x, near.rows.e)
        return None if rows is None else problem.candidate(x, rows, criterion)

    low, high = (np.tile(x[limited], n) for x in (box.low, box.high))
    first = centred / len(problem.names)
    return climb(start, at, lambda c: problem.slopes(c, criterion), low, high, first)


# --- interior points ------------------------------------------------------------------------------

LAST, SMALLER = 1e-5, 0.3  # numerics: μ of the last problem; ratio of one μ to the one before
SOLVED = 5.0  # numerics: multiple of μ by which a step must lower φ; below, μ becomes smaller
WALL = 0.95  # numerics: share of the way to the nearest limit that a step may go
ARMIJO = 1e-4  # numerics: share of the predicted decrease of φ that a step must have
HALVINGS = 12  # work: of a step at most
APART = 100.0  # numerics: factor by which λ s may differ from μ
CURVED = 0.2  # numerics: share of B's curvature along a step, below which it is damped
DAMPING = 1e-12  # numerics: of a step's mean diagonal, added to it against rounding
Near = Callable[[np.ndarray, ExcitingMotion], ExcitingMotion | None]
"""The point at x, from one near it; None where there is none."""


def climb(
    start: ExcitingMotion,
    at: Near,
    slopes: Callable[[ExcitingMotion], tuple[np.ndarray, np.ndarray]],
    low: np.ndarray,
    high: np.ndarray,
    first: float,
) -> Iterator[ExcitingMotion]:
    """Yield the point after each step; all are inside the limits, the last is a local optimum.

    Args:
        start: a point inside.
        at: returns the point at x from one near it; None where there is none.
        slopes: returns ∂J/∂x (k,) and ∂z/∂x (m, k) of a point.
        low, high: (m,) limits of z; infinite where there are none.
        first: μ of the first problem. A small one is faster at first, and ends at worse optima,
            since the points soon lie close to some limits.
    """
    from scipy.optimize import BFGS  # takes 0.2 s to import

    def room(c: ExcitingMotion) -> np.ndarray:
        """Return s (2, m); infinite where there is no limit."""
        return np.stack([c.z.reshape(-1) - low, high - c.z.reshape(-1)])

    def phi(c: ExcitingMotion) -> float:
        s = room(c)[np.isfinite(room(c))]
        return -c.J - mu * float(np.log(s).sum()) if s.min(initial=1.0) > 0 else np.inf

    c, s, mu = start, room(start), first
    (g, Z), k = slopes(c), start.x.size
    multipliers, B = mu / s, BFGS("damp_update", CURVED)
    B.initialize(k, "hess")
    while True:
        slope = -g - Z.T @ (mu / s[0] - mu / s[1])
        H = B.get_matrix() + Z.T @ ((multipliers / s).sum(axis=0)[:, None] * Z)
        H[np.diag_indices(k)] += DAMPING * np.trace(H) / k
        step = cho_solve(cho_factor(H), -slope)
        ds = Z @ step * np.array([[1.0], [-1.0]])
        fall = -float(slope @ step)
        longest = min(1.0, WALL / float((-ds / s).max(initial=WALL)))
        for share in longest * 0.5 ** np.arange(HALVINGS if fall >= SOLVED * mu else 0):
            target = at(c.x + (share * step).reshape(c.x.shape), c)
            if target is not None and phi(target) <= phi(c) - ARMIJO * share * fall:
                break
        else:
            if mu <= LAST:
                return
            mu = max(SMALLER * mu, LAST)
            continue
        multipliers = multipliers + share * (mu / s - multipliers - multipliers * ds / s)
        s = room(target)
        multipliers = np.clip(multipliers, mu / s / APART, mu / s * APART)
        g_there, Z_there = slopes(target)
        d = (target.x - c.x).reshape(-1)
        y = g - g_there - (Z_there - Z).T @ (multipliers[0] - multipliers[1])
        if y.any():  # zero where J and z are linear
            B.update(d, y)
        c, g, Z = target, g_there, Z_there
        yield c
