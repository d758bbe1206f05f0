"""The integration: smooth pieces by Runge-Kutta methods, ended where a joint stops or breaks away.

Within a piece the right side is smooth; after every step the state is projected onto Φ = 0,
J v = 0 and w v = 0 of the joints that stick. A piece ends where a sliding joint's speed changes its
sign, or a stuck joint needs more friction than it can have; there a complementarity problem decides
how each joint at rest goes on. Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I,
II.5-6; event-driven schemes: Acary, Brogliato, Numerical Methods for Nonsmooth Dynamical Systems,
ch. 8.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853, RK45, OdeSolver

from ident.errors import MotionError
from ident.progress import Told
from ident.simulate.dynamics import Dynamics
from ident.simulate.events import REST, Event, Look, first_event, overrun, suspect
from ident.simulate.instant import STICK, SURE
from ident.simulate.plant import Moment
from ident.simulate.trace import State, Trace, Transition

CHATTER, MOMENT = 200, 1e-9  # so many changes of mode, each within so many seconds: no progress
WATCHED = 0.01  # [s] longest step where a joint has dry friction
MOST = 100_000, 30_000  # evaluations of the right side, in all cases and a simulated second
LOOSE = 1e-9  # tolerance above which a method of order 5 is cheaper than one of order 8
WILD = 1e4  # [rad | m | …/s] beyond which no machine goes


@dataclass(frozen=True, eq=False)
class Step:
    """A step up to t: the projected state there, the states before, and what ends the piece."""

    t: float
    x: np.ndarray
    sol: Callable[[float], np.ndarray]
    event: Event | None = None


class March:
    """One integration. `run` does it.

    Args:
        dynamics: the equations.
        tolerance: relative error a step; absolute: a hundredth of it [rad | m | …].
        longest: step [s].
        knots: times at which an input is not smooth, where steps end.
        until: called with every sample's moment; where true, the integration ends there.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        tolerance: float,
        longest: float = np.inf,
        knots: np.ndarray | None = None,
        until: Callable[[Moment], bool] | None = None,
    ) -> None:
        self.dynamics, self.tolerance, self.knots, self.until = dynamics, tolerance, knots, until
        self.names = [each.name for each in dynamics.plant.laws.dry]
        self.longest = min(longest, WATCHED) if self.names else longest
        model = dynamics.plant.mechanism.model
        self._cuts = (model.nq, model.nq + model.nv)
        self.trace = Trace()
        self.modes = np.zeros(len(self.names), dtype=int)
        self._most = 0.0
        self._look: Look | None = None  # at the state of the last evaluation

    def run(self, start: State, times: np.ndarray, told: Told | None = None) -> Trace:
        """Integrates from times[0] over all times (n,) [s].

        Raises:
            MotionError: where the motion cannot go on: singular, unstable, or chattering.
        """
        t, x = float(times[0]), start.flat
        self._most = MOST[0] + MOST[1] * (float(times[-1]) - t)
        self._settle(t, x, np.abs(self._speeds(x)) <= REST, broke=False)
        x = self._projected(t, x)
        self._keep(t, x)
        quick, last = 0, -np.inf
        while not self._done(times):
            for step in self._piece(t, x, float(times[-1])):
                t, x = step.t, step.x
                self._keep_until(step, times)
                if told:
                    told("integrating", float((t - times[0]) / (times[-1] - times[0])))
                if self._done(times):
                    break
                if step.event is not None:
                    quick, last = quick + 1 if t - last < MOMENT else 0, t
                    self._check_progress(t, quick)
                    x = self._turned(t, x, step.event)
        return self.trace

    def _done(self, times: np.ndarray) -> bool:
        trace = self.trace
        return len(trace.t) == len(times) or (
            self.until is not None and self.until(trace.moments[-1])
        )

    def _keep_until(self, step: Step, times: np.ndarray) -> None:
        """Keeps the samples that a step has passed."""
        while not self._done(times) and (at := float(times[len(self.trace.t)])) <= step.t:
            self._keep(at, self._projected(at, step.sol(at)) if at < step.t else step.x)

    def _check_progress(self, t: float, quick: int) -> None:
        if quick > CHATTER:
            raise MotionError(
                f"{self._name}: at t = {t:.6g} s dry friction of {', '.join(self.names)} changes "
                "without end; check Fc and the torques"
            )

    def _turned(self, t: float, x: np.ndarray, event: Event) -> np.ndarray:
        """The state after a change of mode."""
        resting = event.stopped | (self.modes == STICK) | (np.abs(self._speeds(x)) <= REST)
        self._settle(t, x, resting, event.broke)
        return self._projected(t, x)

    @property
    def _name(self) -> str:
        return self.dynamics.plant.mechanism.name

    def _split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b = self._cuts
        return x[:a], x[a:b], x[b:]

    def _moment(self, t: float, x: np.ndarray) -> Moment:
        return self.dynamics.moment(t, *self._split(x))

    def _speeds(self, x: np.ndarray) -> np.ndarray:
        q, v, _ = self._split(x)
        _, W, _ = self.dynamics.plant.joints(q, v)
        return self.dynamics.plant.dry @ (W @ v)

    def _slope(self, t: float, x: np.ndarray) -> np.ndarray:
        self.trace.evaluations += 1
        if self.trace.evaluations > self._most:
            raise MotionError(
                f"{self._name}: at t = {t:.6g} s the integration has become too slow (steps of "
                "microseconds): the motion is stiff or unstable; a larger --tolerance, a shorter "
                "--duration or less stiff effects help"
            )
        m = self._moment(t, x)
        b = self.dynamics.balance(m, self.modes)
        self._look = Look(self.dynamics.plant.dry @ m.yd, b.rates, b.holding)
        return np.concatenate([self.dynamics.plant.qdot(m.q, m.v), b.a, self.dynamics.zdot(m)])

    def _piece(self, t: float, x: np.ndarray, end: float) -> Iterator[Step]:
        """Steps up to a change of mode."""
        method = RK45 if self.tolerance > LOOSE else DOP853
        solver = method(
            self._slope, t, x, end, rtol=max(self.tolerance, 1e-13), atol=1e-2 * self.tolerance,
            max_step=self.longest,
        )  # fmt: skip
        self._slope(t, x)
        while solver.t < end:
            before = self._look
            solver.t_bound, solver.status = self._bound(solver.t, end), "running"
            said = solver.step()
            if solver.status == "failed" or not np.abs(solver.y).max() < WILD:
                raise MotionError(
                    f"{self._name}: at t = {solver.t:.6g} s the motion cannot be integrated "
                    f"({said or 'it grows beyond all bounds'}); it is unstable, or its effects are "
                    "too stiff"
                )
            sol = _Later(solver)
            assert before is not None
            assert self._look is not None
            if suspect(self.modes, solver.t - solver.t_old, before, self._look):
                event = self._event(solver.t_old, solver.t, sol)
                if event is not None:
                    yield Step(event.t, sol(event.t), sol, event)
                    return
            x = self._projected(solver.t, solver.y)
            yield Step(solver.t, x, sol)
            if x is not solver.y:
                solver.y = x
                solver.f = self._slope(solver.t, x)

    def _bound(self, t: float, end: float) -> float:
        """Where a step must end: at the next sample of an input that is not smooth."""
        if self.knots is None:
            return end
        k = int(np.searchsorted(self.knots, t, side="right"))
        return min(end, float(self.knots[k])) if k < len(self.knots) else end

    def _event(self, a: float, b: float, sol: Callable[[float], np.ndarray]) -> Event | None:
        def holds(t: float) -> bool:
            return self.dynamics.balance(self._moment(t, sol(t)), self.modes).holding

        def over(t: float) -> np.ndarray:
            return overrun(self.modes, self._speeds(sol(t)))

        return first_event(a, b, over, holds if (self.modes == STICK).any() else None)

    def _settle(self, t: float, x: np.ndarray, resting: np.ndarray, broke: bool) -> None:
        """Decides the modes of joints at rest, and of all others by their speed."""
        if not self.names:
            return
        modes = np.where(resting, STICK, np.sign(self._speeds(x))).astype(int)
        if resting.any():
            b = self.dynamics.balance(self._moment(t, x), modes, resting)
            least = SURE * np.abs(b.rates).max(initial=0.0)
            slides = (b.sides != 0) & resting & (broke | (b.sides * b.rates > least))
            modes = np.where(slides, b.sides, modes)
        for k in np.flatnonzero(modes != self.modes) if self.trace.t else ():
            self.trace.transitions.append(Transition(t, self.names[k], int(modes[k])))
        self.modes = modes

    def _projected(self, t: float, x: np.ndarray) -> np.ndarray:
        """The state on the closures, with stuck joints at rest; x itself where that is nothing."""
        plant, stuck = self.dynamics.plant, self.modes == STICK
        if not plant.mechanism.closures and not stuck.any():
            return x
        q, v, z = self._split(x)
        _, W, _ = plant.joints(q, v)
        q, v = plant.closed(t, q, v, plant.dry[stuck] @ W)
        self.dynamics.near, _, _ = plant.joints(q, v, self.dynamics.near)
        return np.concatenate([q, v, z])

    def _keep(self, t: float, x: np.ndarray) -> None:
        m = self._moment(t, x)
        self.trace.t.append(t)
        self.trace.moments.append(m)
        self.trace.balances.append(self.dynamics.balance(m, self.modes))
        self.trace.modes.append(self.modes)


class _Later:
    """The states within a solver's last step, worked out when they are first asked for.

    It must be asked before the solver's state is changed, or never.
    """

    def __init__(self, solver: OdeSolver) -> None:
        self._solver, self._at = solver, solver.t
        self._dense: Callable[[float], np.ndarray] | None = None

    def __call__(self, t: float) -> np.ndarray:
        if self._dense is None:
            assert self._solver.t == self._at
            self._dense = self._solver.dense_output()
        return self._dense(t)
