"""The verb `replay`: the simulated motion against the measured one, window by window.

Each window begins in the measured state and is driven by the measured torques. A machine without
feedback leaves its measured motion sooner or later, however good the model is: errors of the start
and of the torques grow, exponentially where the motion is unstable. Short windows (multiple
shooting; Bock, 1987) show the model and not this growth; one run without restarts shows how long it
takes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from ident.equations.point import Point
from ident.equations.samples import Samples
from ident.equations.scene import Scene
from ident.errors import FitError, MotionError
from ident.fit.fit import Fit
from ident.fit.saved import Saved
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment, Motion
from ident.progress import Told
from ident.residual.predict import NOTHING
from ident.simulate.drives import Series
from ident.simulate.dynamics import Dynamics
from ident.simulate.integrate import rough, surroundings
from ident.simulate.march import March
from ident.simulate.plant import Moment, Plant
from ident.simulate.replayed import Replay, Replayed
from ident.simulate.trace import State

WINDOW = 0.5  # [s]
TOLERANCE = 1e-8  # the torques are measured: no better is needed


def replay(
    *models: Fit | Saved,
    motion: Motion | None = None,
    window: float = WINDOW,
    progress: Told | None = None,
) -> Replay:
    """Simulated against measured motion, restarted from the measured state every `window` seconds.

    Args:
        models: fits, or fit.json files read back.
        motion: the measured motion, with torques; default: that of the first fit.
        window: [s] from one restart to the next.
        progress: called with (what is being done, share done).

    Raises:
        FitError: if there is no model or no motion, or the window is shorter than two samples.
        MechanismError: for an effect that cannot be integrated, or parameters with which forces do
            not determine the motion.
    """
    if not models:
        raise FitError("nothing to simulate; give one fit or several")
    if motion is None and isinstance(models[0], Fit):
        motion = models[0].motion
    if motion is None:
        raise FitError("a fit that was read back has no motion; give motion=…")
    for e in motion.experiments:
        if not 2 <= window * e.rate < np.inf:
            raise FitError(
                f"window {window:g} s: {e.name} has a sample every {1 / e.rate:.4g} s; give two "
                "samples or more"
            )
    runs: dict[str, tuple[Replayed, ...]] = {}
    for i, model in enumerate(models):
        several = isinstance(model, Fit) and len(models) > 1
        name = model.name if isinstance(model, Saved) else f"fit {i + 1}" if several else "fit"
        found = []
        for k, e in enumerate(motion.experiments):
            share = (i + k / len(motion.experiments)) / len(models)
            step = 1 / len(models) / len(motion.experiments)
            found.append(_replayed(model, motion, e, window, _within(progress, share, step)))
        runs[name] = tuple(found)
    return Replay(runs, window)


def _within(told: Told | None, share: float, step: float) -> Told | None:
    """Progress of a part of the work."""
    return told and (lambda what, done: told(what, share + step * done))


def _replayed(
    model: Fit | Saved, motion: Motion, bare: Experiment, window: float, told: Told | None
) -> Replayed:
    scene = Scene.of(model.mechanism, NOTHING, bare, model.point, motion.band.cutoff)
    mechanism, e = scene.mechanism, scene.e
    player = _Player(mechanism, model.point, e, motion.independent)
    simulated = np.full((len(e), len(mechanism.joints)), np.nan)
    starts, failures = [], []
    segments = list(e.segments())
    for segment in segments:
        length = max(2, round(window * e.rate))
        for a in range(segment.start, segment.stop - 1, length):
            b = min(a + length, segment.stop - 1)
            if told:
                told(f"simulating {e.name}", 0.5 * a / len(e))
            try:
                y = player.play(a, b)
            except MotionError as error:
                failures.append(str(error))
                y = np.empty((0, simulated.shape[1]))
            simulated[a + 1 : a + len(y)] = y[1:]
            starts.append(a)
    longest = max(segments, key=lambda run: run.stop - run.start)
    told_ = _within(told, 0.5, 0.5)
    free = _free(player, longest, told_)
    at = [mechanism.joint_index[name] for name in e.logged]
    return Replayed(
        e.name, e.t, e.logged, tuple(mechanism.joint(name).unit for name in e.logged),
        np.where(e.usable[:, None], e.y[:, at], np.nan), simulated[:, at], tuple(starts),
        longest.start, free[:, at], tuple(dict.fromkeys(failures)),
    )  # fmt: skip


def _free(player: _Player, run: slice, told: Told | None) -> np.ndarray:
    """y (≤ n, J) of one run without restarts, until it is far away."""
    try:
        return player.play(run.start, run.stop - 1, far=True, told=told)
    except MotionError:  # far away the motion may meet anything
        return player.last


class _Player:
    """Integrates from measured states with measured torques."""

    def __init__(
        self, mechanism: Mechanism, point: Point, e: Experiment, independent: Sequence[str]
    ) -> None:
        self.mechanism, self.e = mechanism, e
        self.plant = Plant.of(mechanism, point)
        self.around, self.knots = surroundings(mechanism, e), rough(e)
        self.drive = Series(CubicSpline(e.t, e.tau))
        self.independent = tuple(independent)
        self.z = _presliding(mechanism, point, e)
        self.travel = np.ptp(e.y[e.usable], axis=0)
        self.logged = [mechanism.joint_index[name] for name in e.logged]
        self.last = np.empty((0, len(mechanism.joints)))

    def play(self, a: int, b: int, far: bool = False, told: Told | None = None) -> np.ndarray:
        """y (≤ b − a + 1, J) at the samples a to b; with `far` until a joint is away by its travel.

        Raises:
            MotionError: where the motion cannot go on; `last` has what came before.
        """
        e = self.e
        dynamics = Dynamics(self.plant, self.drive, self.around, self.independent)
        dynamics.near = e.y[a]
        until = self._far if far else None
        march = March(dynamics, TOLERANCE, 5 / e.rate, self.knots, until)
        try:
            march.run(State(e.q[a], e.v[a], self.z[a]), e.t[a : b + 1], told)
        finally:
            q = np.array([m.q for m in march.trace.moments])
            self.last = self._coordinates(q, a) if len(q) else self.last[:0]
        return self.last

    def _far(self, m: Moment) -> bool:
        k = int(np.searchsorted(self.e.t, m.t - 1e-9))
        tree = [i for i in self.logged if self.mechanism.joints[i].in_tree]
        off = np.abs(m.y[tree] - self.e.y[k, tree])
        return bool((off > self.travel[tree]).any())

    def _coordinates(self, q: np.ndarray, a: int) -> np.ndarray:
        y = np.empty((len(q), len(self.mechanism.joints)))
        own = None
        for i, joint in enumerate(self.mechanism.joints):
            if joint.in_tree:
                y[:, i] = q[:, joint.index]
                continue
            own = self.mechanism.kinematics.own_rows(q) if own is None else own
            y[:, i] = own.value[:, joint.index]
            if joint.rotational:
                turns = np.unwrap(y[:, i])
                y[:, i] = turns + 2 * np.pi * np.round((self.e.y[a, i] - turns[0]) / (2 * np.pi))
        return y


def _presliding(mechanism: Mechanism, point: Point, e: Experiment) -> np.ndarray:
    """z (n, presliding) along the measured motion."""
    s = Samples(mechanism, e, slice(None), point)
    found = []
    for effect in mechanism.effects:
        c, shape = point.of(effect)
        if any(each.acts == "state" for each in effect.unknowns) and c.any():
            found.append(s.columns(effect, shape)[:, 0, 0])
    return np.stack(found, axis=1) if found else np.zeros((len(e), 0))
