"""Integration over time in smooth pieces, which end where a joint stops or breaks away.

Within a piece the right side is smooth, as Runge-Kutta methods need; after every step the state is
projected onto Φ = 0, J v = 0 and w v = 0 of the joints that stick. A piece ends where a sliding
joint's speed changes its sign, or a stuck joint needs more friction than it can have; there a
complementarity problem decides how each joint at rest goes on. SciPy's event functions cannot do
this: the mode changes the right side, and a sliding speed may cross zero twice within a step.

Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, II.5-6; event-driven schemes:
Acary, Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, ch. 8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.integrate import DOP853, RK45, OdeSolver

from ident.display import Progress
from ident.errors import MotionError
from ident.simulate.dynamics import STICK, Balance, Dynamics
from ident.simulate.plant import InstantTerms

REST = 1e-11  # numerics: [rad/s | m/s] speed below which a joint is at rest
SURE = 1e-14  # numerics: of the largest acceleration, above which one has a sign
LOOKS, HALVINGS = 8, 60  # work: instants of a step at which modes are checked; bisections
WATCHED = 0.01  # range: [s] longest step where a joint has dry friction
# work: evaluations of the right side, in all cases and a simulated second
MOST_EVALUATIONS = (100_000, 30_000)
LOOSE = 1e-9  # numerics: tolerance above which a method of order 5 is cheaper than one of order 8
WILD = 1e4  # range: [rad | m | …/s] beyond which no machine moves
States = Callable[[float], np.ndarray]  # the states within a step by time [s]
ModeChange = tuple[float, np.ndarray, bool]  # t [s], sliding joints that stop (dry,), a break-away


@dataclass(frozen=True)
class Transition:
    """A joint that stops, breaks away or turns round."""

    t: float  # [s]
    joint: str
    mode: int  # 0 it sticks, +1 it slides forwards, −1 backwards

    def __str__(self) -> str:
        what = {0: "sticks", 1: "slides forwards", -1: "slides backwards"}[self.mode]
        return f"{self.t:.6g} s: {self.joint} {what}"


@dataclass(eq=False)
class Integration:
    """One integration over time: `run` performs it, its attributes hold what it has reached."""

    dynamics: Dynamics
    tolerance: float  # relative error of a step
    longest: float = np.inf  # a step may be [s]
    knots: np.ndarray | None = None  # times at which steps end, where an input is not smooth [s]
    near: np.ndarray | None = None  # (J,) coordinates from which whole turns are counted
    jumps: np.ndarray | None = None  # times [s] from which an input has another value

    def __post_init__(self) -> None:
        self.plant = self.dynamics.plant
        self.names = [joint.name for joint in self.plant.laws.dry]
        self.longest = min(self.longest, WATCHED) if self.names else self.longest
        model = self.plant.mechanism.model
        self._cuts = model.nq, model.nq + model.nv
        # terms, forces and modes (dry,) at the times passed so far
        self.samples: list[tuple[InstantTerms, Balance, np.ndarray]] = []
        self.transitions: list[Transition] = []
        self.evaluations = 0  # of the right side
        self.modes = np.zeros(len(self.names), dtype=int)
        self._most = 0.0
        self._ends = np.unique(
            np.concatenate([x for x in (self.knots, self.jumps, np.zeros(0)) if x is not None])
        )
        self._jump = np.inf  # [s] the next one: within a step inputs are those before it
        # speeds and accelerations (dry,) of the last evaluation, and whether stuck joints hold
        self._rates = np.empty(0), np.empty(0), True

    def run(
        self, start: tuple[np.ndarray, ...], times: np.ndarray, on_progress: Progress | None = None
    ) -> None:
        """Integrate from q (nq,), v (nv,), z (states,) at times[0] over all times (n,) [s].

        Refuses a motion that cannot go on: singular, unstable, or chattering.
        """
        t, x, end = float(times[0]), np.concatenate(start), float(times[-1])
        self._most = MOST_EVALUATIONS[0] + MOST_EVALUATIONS[1] * (end - t)
        self._decide(t, x, np.abs(self._speeds(x)) <= REST, broke=False)
        x = self._projected(t, x)
        self._sample(t, x)
        while len(self.samples) < len(times):
            method = RK45 if self.tolerance > LOOSE else DOP853
            rtol, atol = max(self.tolerance, 1e-13), 1e-2 * self.tolerance
            solver = method(self._slope, t, x, end, rtol=rtol, atol=atol, max_step=self.longest)
            solver.f, change = self._slope(t, x), None
            while change is None and len(self.samples) < len(times):
                states, change = self._step(solver)
                t = solver.t if change is None else change[0]
                x = self._projected(t, solver.y) if change is None else states(t)
                while len(self.samples) < len(times) and times[len(self.samples)] <= t:
                    at = float(times[len(self.samples)])
                    self._sample(at, self._projected(at, states(at)) if at < t else x)
                if on_progress:
                    on_progress("integrating", float((t - times[0]) / (end - times[0])))
                jumped, self._jump = t >= self._jump, np.inf
                if change is None and (jumped or x is not solver.y):
                    solver.y, solver.f = x, self._slope(t, x)
            if change is not None:
                _, stopped, broke = change
                stuck = (self.modes == STICK) | (np.abs(self._speeds(x)) <= REST)
                self._decide(t, x, stopped | stuck, broke)
                x = self._projected(t, x)

    def _sample(self, t: float, x: np.ndarray) -> None:
        m = self._terms(t, x)
        self.samples.append((m, self.dynamics.balance(m, self.modes), self.modes))

    def _parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b = self._cuts
        return x[:a], x[a:b], x[b:]

    def _terms(self, t: float, x: np.ndarray) -> InstantTerms:
        q, v, z = self._parts(x)
        return self.plant.terms(t, q, v, z, self.near)

    def _speeds(self, x: np.ndarray) -> np.ndarray:
        q, v, _ = self._parts(x)
        _, W, _ = self.plant.joints(q, v)
        return np.asarray(self.plant.dry @ (W @ v))

    def _slope(self, t: float, x: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        if self.evaluations > self._most:
            raise MotionError(
                f"{self.plant.mechanism.name}: at t = {t:.6g} s the integration has become too "
                "slow (steps of microseconds): the motion is stiff or unstable, or dry friction "
                "changes without end; a larger --tolerance, a shorter --duration or less stiff "
                "effects help"
            )
        m = self._terms(t if t < self._jump else np.nextafter(self._jump, -np.inf), x)
        b = self.dynamics.balance(m, self.modes)
        self._rates = self.plant.dry @ m.yd, b.rates, b.holding
        states = zip(self.plant.laws.states, m.z[:, None], strict=True)
        zdot = [law.effect.state_rate(z, m.yd[[law.at[0]]], law.shape)[0] for law, z in states]
        return np.concatenate([self.plant.qdot(m.q, m.v), b.a, zdot])

    def _step(self, solver: OdeSolver) -> tuple[States, ModeChange | None]:
        """Make one step; return its states, and the first change of mode within it."""
        before, end = self._rates, solver.t_bound
        if len(self._ends):  # a step ends at the next sample of a rough input, and at a jump
            at = np.searchsorted(self._ends, solver.t, side="right")
            solver.t_bound = min(end, *self._ends[at : at + 1].tolist())
        if self.jumps is not None:
            at = np.searchsorted(self.jumps, solver.t, side="right")
            self._jump = min([*self.jumps[at : at + 1].tolist(), np.inf])
        failure = solver.step()
        if solver.status == "failed" or not np.abs(solver.y).max() < WILD:
            raise MotionError(
                f"{self.plant.mechanism.name}: at t = {solver.t:.6g} s the motion cannot be "
                f"integrated ({failure or 'it grows beyond all bounds'}); it is unstable, or its "
                "effects are too stiff"
            )
        solver.t_bound, solver.status = end, "running"
        dense = cache(solver.dense_output)  # evaluated only if a state in between is needed

        def states(t: float) -> np.ndarray:
            return np.asarray(dense()(t))

        # modes may have changed where the cubic through both ends says so
        h, s = solver.t - solver.t_old, np.linspace(0, 1, LOOKS + 1)[1:, None]
        (u0, du0, _), (u1, du1, holding), c = before, self._rates, 1 - s
        cubic = c * c * ((1 + 2 * s) * u0 + s * h * du0) + s * s * ((3 - 2 * s) * u1 - c * h * du1)
        if holding and not self._overrun(cubic).any():
            return states, None
        return states, self._change(solver.t_old, solver.t, states)

    def _overrun(self, u: np.ndarray) -> np.ndarray:
        """Return (dry,) or (n, dry) sliding joints whose speed has the other sign."""
        return self.modes * u < -REST

    def _change(self, a: float, b: float, states: States) -> ModeChange | None:
        """Return the first change of mode between two times [s]."""

        def limits_exceeded(t: float) -> np.ndarray:
            return self._overrun(self._speeds(states(t)))

        def slips(t: float) -> bool:
            return not self.dynamics.balance(self._terms(t, states(t)), self.modes).holding

        stop = _first(
            np.linspace(a, b, LOOKS + 1).tolist(), lambda t: bool(limits_exceeded(t).any())
        )
        last = min(b, stop)
        breaks = (
            _first([a, 0.5 * (a + last), last], slips) if (self.modes == STICK).any() else np.inf
        )
        first = min(breaks, stop)
        return (first, limits_exceeded(first), breaks < stop) if first < np.inf else None

    def _decide(self, t: float, x: np.ndarray, resting: np.ndarray, broke: bool) -> None:
        """Decide the modes of joints at rest, and of all others by their speed."""
        if not self.names:
            return
        modes = np.where(resting, STICK, np.sign(self._speeds(x))).astype(int)
        if resting.any():
            b = self.dynamics.balance(self._terms(t, x), modes, resting)
            least = SURE * np.abs(b.rates).max(initial=0.0)
            slides = (b.sides != 0) & resting & (broke | (b.sides * b.rates > least))
            modes = np.where(slides, b.sides, modes)
        for k in np.flatnonzero(modes != self.modes) if self.samples else ():
            self.transitions.append(Transition(t, self.names[k], int(modes[k])))
        self.modes = modes

    def _projected(self, t: float, x: np.ndarray) -> np.ndarray:
        """Return the state on the closures, with stuck joints at rest; x itself without either."""
        plant, stuck = self.plant, self.modes == STICK
        if not plant.mechanism.closures and not stuck.any():
            return x
        q, v, z = self._parts(x)
        _, W, _ = plant.joints(q, v)
        q, v = plant.closed(t, q, v, plant.dry[stuck] @ W)
        self.near, _, _ = plant.joints(q, v, self.near)
        return np.concatenate([q, v, z])


def _first(times: list[float], is_bad: Callable[[float], bool]) -> float:
    """Return the first time, to rounding, at which a condition is true; checked at these times, ∞
    where it is at none.
    """
    good = times[0]
    for bad in times[1:]:
        if is_bad(bad):
            for _ in range(HALVINGS):
                middle = 0.5 * (good + bad)
                if not good < middle < bad:
                    break
                good, bad = (good, middle) if is_bad(middle) else (middle, bad)
            return bad
        good = bad
    return np.inf
