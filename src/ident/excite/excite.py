"""The verb `excite`: a periodic motion that tells most of a mechanism."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.errors import MotionError
from ident.excite.climb import climb
from ident.excite.course import Course
from ident.excite.criterion import Criterion
from ident.excite.draw import drawn, grown
from ident.excite.excitation import Excitation
from ident.excite.limits import Limits
from ident.excite.outcome import outcome
from ident.excite.prepare import Ready, prepared
from ident.excite.rivals import columns_of, with_rivals
from ident.mechanism.mechanism import Mechanism
from ident.progress import Told

DRAWS = 25  # random courses, the best of which each climb starts from
STEPS = 150  # of each climb, at most
FINE = 10  # times the samples of the search at which the result is checked
SHRINK = 0.99  # of what breaks a limit between the samples
SHRINKS = 20


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
    progress: Told | None = None,
) -> Excitation:
    """The periodic motion of the drives that makes the base parameters most certain.

    Args:
        mechanism: with the effects that are to be identified too.
        duration: of the whole log [s], `periods` times the same motion.
        periods: 2 or more let what repeats be told from noise.
        rate: of the log [Hz].
        harmonics: of the Fourier series, 2 or more; the highest frequency is that many a period.
        limits: in place of the URDF's.
        separate: two effects' labels; then the motion that tells them best apart.
        noise: expected of the torques, by drive [N m | N]; default 1 % of the limit of torque.
        balance: weight of the condition number beside the log-determinant; 0 leaves it alone.
        tries: searches, each from the best of 25 random motions.
        seed: of these; the same seed gives the same motion.
        progress: called with (what is being done, share done).

    Raises:
        MechanismError, MotionError: for limits that exclude every motion, with the one that does;
            for a mechanism with fewer drives than degrees of freedom; for rivals that no motion
            tells apart.
    """
    _check(duration, periods, rate, harmonics, tries)
    if not 0 <= balance < np.inf:
        raise MotionError(f"balance {balance:g}; a number from 0 is expected")
    limits = limits or Limits()
    if separate is not None:
        separate = (separate[0], separate[1])
        mechanism = with_rivals(mechanism, separate)
    ready = prepared(mechanism, limits, duration / periods, harmonics, noise or {}, seed)
    criterion = _criterion(ready, separate, balance)
    best: Course | None = None
    for i in range(tries):
        start = _start(ready, criterion, seed, i)
        if start is None:
            continue

        def told(share: float, i: int = i) -> None:
            if progress:
                progress(f"exciting {mechanism.name}, try {i + 1} of {tries}", (i + share) / tries)

        told(0.0)
        found = climb(start, Course.moved, STEPS, told)
        if best is None or found.worth > best.worth:
            best = found
    if best is None:
        raise MotionError(
            f"{mechanism.name}: no random motion inside the limits determines all parameters; "
            "give wider limits, or more harmonics"
        )
    return outcome(ready, _settled(ready, best, rate), duration, periods, rate, separate, seed)


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


def _criterion(ready: Ready, separate: tuple[str, str] | None, balance: float) -> Criterion:
    """D-optimality, or the separation of two effects.

    Raises:
        MotionError: where an effect's columns are made by others' in every motion.
    """
    r = ready.base.rank
    if separate is None:
        return Criterion.of_all(r, balance)
    stage = ready.track.stage
    a, b = (columns_of(stage.mechanism, stage.columns, ready.base, label) for label in separate)
    return Criterion.of_pair(r, a, b)


def _start(ready: Ready, criterion: Criterion, seed: int, i: int) -> Course | None:
    """The best of some random courses."""
    random = np.random.default_rng([seed, 2, i])
    best: Course | None = None
    for _ in range(DRAWS):
        found = drawn(ready.track, random)
        if found is None:
            continue
        x, seen, z = found
        course = Course.judged(ready.track, criterion, ready.scale, x.reshape(-1), seen, z)
        if course is not None and (best is None or course.worth > best.worth):
            best = course
    return best


def _settled(ready: Ready, course: Course, rate: float) -> np.ndarray:
    """x (d, P), shrunk towards home where a limit is broken between the samples of the search."""
    track = ready.track
    period = track.fourier.period
    n = max(FINE * len(track.rest), int(np.ceil(period * rate)))
    fine = track.at(period * np.arange(n) / n, ready.exact)
    x = course.x.reshape(track.fourier.shape)
    for _ in range(SHRINKS):
        found = grown(fine, x)
        if found is not None and np.allclose(found[0], x, rtol=1e-9, atol=0.0):
            return x
        x = SHRINK * x
    raise MotionError(
        f"{track.stage.mechanism.name}: the motion found breaks a limit between its samples; try "
        "another seed, or fewer harmonics"
    )
