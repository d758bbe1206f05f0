"""An interior-point search that never leaves what is allowed.

    F(x) = −J(x) + μ B(x),   μ falling: the barrier B grows without bound at every limit

Quasi-Newton steps (BFGS with Armijo's backtracking, which also backs away from what is not allowed:
Nocedal, Wright, Numerical Optimization, 2006, ch. 6 and 19.6). It knows no robot.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

MU = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0003)  # of B in units of J: to the middle first
ARMIJO = 1e-4
BACK = 0.4
SHORTEST = 1e-4  # share of a step below which there is no way on
LONGEST = 1.0  # of a step, in x
ENOUGH = 1e-4  # of J: a stage whose next step promises less is done


class Spot(Protocol):
    """A point at which everything is allowed."""

    @property
    def x(self) -> np.ndarray:
        """(N,)."""

    @property
    def worth(self) -> float:
        """J."""

    @property
    def barrier(self) -> float:
        """B."""

    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """∂J/∂x and ∂B/∂x, (N,) each."""


Place = TypeVar("Place", bound=Spot)
Move = Callable[[Place, np.ndarray], Place | None]


def climb(
    start: Place, move: Move[Place], steps: int, told: Callable[[float], None] | None = None
) -> Place:
    """The best spot that is reached from `start`.

    Args:
        start: where everything is allowed.
        move: the spot at x (N,), come to from another one; None where something is not allowed.
        steps: at most, in all; a μ that needs fewer leaves the others more.
        told: called with the share of the steps that is done.
    """
    here, H, left = start, np.eye(start.x.size), steps
    for i, mu in enumerate(MU):
        mine = left // (len(MU) - i)
        here, H, spent = _stage(here, H, mu, move, mine)
        left -= spent
        if told:
            told((i + 1) / len(MU))
    return here


def _stage(
    here: Place, H: np.ndarray, mu: float, move: Move[Place], steps: int
) -> tuple[Place, np.ndarray, int]:
    """At one μ: the spot reached, H ≈ (∂²F/∂x²)⁻¹ there, and the steps taken."""
    g = _slope(here, mu)
    fresh = False
    for spent in range(steps):
        p = -H @ g
        promised = -float(g @ p)
        if promised < ENOUGH and fresh:
            return here, H, spent
        found = _searched(here, p, mu, promised, move) if promised > 0 else None
        if found is None or promised < ENOUGH:
            if fresh:
                return here, H, spent
            H, fresh = _scale(g) * np.eye(len(g)), True
            here = found or here
            g = _slope(here, mu)
            continue
        s, y = found.x - here.x, _slope(found, mu) - g
        H, fresh = _updated(H, s, y), False
        here, g = found, g + y
    return here, H, steps


def _slope(spot: Spot, mu: float) -> np.ndarray:
    dJ, dB = spot.slopes()
    return -dJ + mu * dB


def _scale(g: np.ndarray) -> float:
    """Of the first step: a tenth of the longest."""
    return 0.1 * LONGEST / max(float(np.linalg.norm(g)), 1e-300)


def _searched(
    here: Place, p: np.ndarray, mu: float, promised: float, move: Move[Place]
) -> Place | None:
    """A spot along p at which F falls enough."""
    now = -here.worth + mu * here.barrier
    step = min(1.0, LONGEST / float(np.linalg.norm(p)))
    shortest = SHORTEST * step
    while step > shortest:
        there = move(here, here.x + step * p)
        if there is not None:
            then = -there.worth + mu * there.barrier
            if then <= now - ARMIJO * step * promised:
                return there
        step *= BACK
    return None


def _updated(H: np.ndarray, s: np.ndarray, y: np.ndarray) -> np.ndarray:
    """BFGS' inverse Hessian after a step s along which the slope changed by y."""
    sy = float(s @ y)
    if sy <= 1e-10 * float(np.linalg.norm(s) * np.linalg.norm(y)):
        return H
    V = np.eye(len(s)) - np.outer(s, y) / sy
    return V @ H @ V.T + np.outer(s, s) / sy
