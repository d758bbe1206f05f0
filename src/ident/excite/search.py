"""The verb `excite`: searches for the periodic motion that determines the unknowns best."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import chain, islice
from time import monotonic

import numpy as np

from ident.display import Progress, quiet
from ident.errors import MotionError, check_whole
from ident.excite.design import CENTRED, DesignProblem, ExcitingMotion
from ident.excite.excitation import Criterion, Excitation, with_rivals
from ident.excite.limits import Limits
from ident.mechanism.mechanism import Mechanism

DRAWS = 25  # random motions, the best of which each search starts from
ROUND, STEPS = 30, 150  # steps of every search, and of the best one after these, at most
DIRECT = 1e-3  # μ, likewise, of every second search for a separation: either may end higher
KEPT = 5.0  # s between two motions that are handed out before the end


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
    _check(duration, periods, rate, harmonics, tries)
    if not 0 <= balance < np.inf:
        raise MotionError(f"balance {balance:g}; a number from 0 is expected")
    if separate is not None:
        if isinstance(separate, str) or len(separate) != 2:
            raise MotionError(
                f"separate {separate!r}; valid: two effects, as ('drag:a', 'viscous:a')"
            )
        mechanism = with_rivals(mechanism, separate)
    say = progress or quiet
    say(f"random motions of {mechanism.name}", 0.0)
    problem = DesignProblem(
        mechanism, limits or Limits(), duration / periods, harmonics, noise or {}, seed
    )
    criterion = problem.criterion(separate, balance)

    def excitation(c: ExcitingMotion, finished: bool) -> Excitation:
        x = problem.inside(c.x, rate)
        return problem.excitation(x, duration, periods, rate, separate, seed, finished)

    best: ExcitingMotion | None = None
    kept, at, finished = -np.inf, -np.inf, False
    try:
        for what, share, c in _searches(problem, criterion, tries, seed):
            say(f"exciting {mechanism.name}, {what}", share)
            best = c if best is None or c.J > best.J else best
            if better and kept < best.J and monotonic() > at + KEPT:
                better(excitation(best, finished))
                kept, at = best.J, monotonic()
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
        starts = [problem.draw(random, criterion) for _ in range(DRAWS)]
        known = [start for start in starts if start is not None]
        if not known:
            continue
        start = max(known, key=lambda c: c.J)
        centred = DIRECT if i % 2 and len(criterion.parts) > 1 else CENTRED
        steps, J = problem.search(start, criterion, centred), start.J
        for k, c in enumerate(chain([start], islice(steps, ROUND))):
            yield f"search {i + 1} of {tries}", (i * ROUND + k) / most, c
            J = c.J
        begun.append((J, -i, steps))
    if begun:
        _, i, steps = max(begun, key=lambda each: each[:2])
        for k, c in enumerate(islice(steps, STEPS)):
            yield f"finishing search {1 - i}, the best", (tries * ROUND + k) / most, c


def _check(duration: float, periods: int, rate: float, harmonics: int, tries: int) -> None:
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
