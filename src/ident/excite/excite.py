"""The verb `excite`: the periodic motion that determines the unknown parameters best."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.errors import MotionError
from ident.excite.design import DesignProblem, ExcitingMotion
from ident.excite.excitation import Excitation, with_rivals
from ident.excite.limits import Limits
from ident.mechanism.mechanism import Mechanism
from ident.progress import Progress

DRAWS = 25  # random motions, the best of which each search starts from


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
    progress: Progress | None = None,
) -> Excitation:
    """Return the periodic motion of the drives that makes the base parameters most certain.

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
        tries: searches, each from the best of 25 random motions.
        seed: of these; the same seed gives the same motion.
        progress: called with (what is being done, share done).

    Raises:
        MechanismError, MotionError: for limits that exclude every motion, with the one that does;
            for a mechanism with fewer drives than degrees of freedom; for rivals that no motion
            distinguishes.
    """
    _check(duration, periods, rate, harmonics, tries)
    if not 0 <= balance < np.inf:
        raise MotionError(f"balance {balance:g}; a number from 0 is expected")
    if separate is not None:
        separate = (separate[0], separate[1])
        mechanism = with_rivals(mechanism, separate)
    problem = DesignProblem.of(
        mechanism, limits or Limits(), duration / periods, harmonics, noise or {}, seed
    )
    criterion = problem.criterion(separate, balance)
    best: ExcitingMotion | None = None
    for i in range(tries):
        if progress:
            progress(f"exciting {mechanism.name}, try {i + 1} of {tries}", i / tries)
        random = np.random.default_rng([seed, 2, i])
        starts = [problem.draw(random, criterion) for _ in range(DRAWS)]
        known = [start for start in starts if start is not None]
        if known:
            found = problem.search(max(known, key=lambda c: c.J), criterion)
            best = found if best is None or found.J > best.J else best
    if best is None:
        raise MotionError(
            f"{mechanism.name}: no random motion inside the limits determines all parameters; "
            "give wider limits, or more harmonics"
        )
    if progress:
        progress(f"exciting {mechanism.name}", 1.0)
    return problem.excitation(problem.inside(best.x, rate), duration, periods, rate, separate, seed)


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
