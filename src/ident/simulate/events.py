"""When a joint with dry friction stops or breaks away, within one step of an integration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

REST = 1e-11  # [rad/s | m/s] speed below which a joint is at rest
LOOKS = 8  # instants of a step at which sliding joints are looked at
HALVINGS = 60


@dataclass(frozen=True, eq=False)
class Event:
    """A change of mode: which sliding joints stop (dry,), and whether a stuck one broke away."""

    t: float
    stopped: np.ndarray
    broke: bool


@dataclass(frozen=True, eq=False)
class Look:
    """At one instant: speeds and accelerations (dry,) of joints with dry friction; whether stuck
    ones hold.
    """

    u: np.ndarray
    du: np.ndarray
    holding: bool


def overrun(modes: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(dry,) sliding joints whose speed has the other sign."""
    return modes * u < -REST


def suspect(modes: np.ndarray, h: float, a: Look, b: Look) -> bool:
    """Whether modes may have changed in a step of h [s]: by the cubic through both ends' speeds."""
    if not b.holding:
        return True
    s = np.linspace(0, 1, LOOKS + 1)[1:, None]
    c = 1 - s
    cubic = c * c * ((1 + 2 * s) * a.u + s * h * a.du) + s * s * ((3 - 2 * s) * b.u - c * h * b.du)
    return bool(overrun(modes, cubic).any())


def first_event(
    a: float,
    b: float,
    over: Callable[[float], np.ndarray],
    holds: Callable[[float], bool] | None,
) -> Event | None:
    """The first change of mode between two times [s].

    Args:
        over: (dry,) sliding joints whose speed has turned, at a time.
        holds: whether all stuck joints hold, at a time; None: none is stuck.
    """
    stop = _first([float(t) for t in np.linspace(a, b, LOOKS + 1)], lambda t: bool(over(t).any()))
    last = b if stop is None else stop
    middle = 0.5 * (a + last)
    breaks = None if holds is None else _first([a, middle, last], lambda t: not holds(t))
    if breaks is not None and (stop is None or breaks < stop):
        return Event(breaks, over(breaks), True)
    return None if stop is None else Event(stop, over(stop), False)


def _first(times: list[float], is_bad: Callable[[float], bool]) -> float | None:
    """From above, the first time at which something is bad; looked at at these times."""
    good = times[0]
    for bad in times[1:]:
        if is_bad(bad):
            return _halved(good, bad, is_bad)
        good = bad
    return None


def _halved(good: float, bad: float, is_bad: Callable[[float], bool]) -> float:
    for _ in range(HALVINGS):
        middle = 0.5 * (good + bad)
        if not good < middle < bad:
            break
        good, bad = (good, middle) if is_bad(middle) else (middle, bad)
    return bad
