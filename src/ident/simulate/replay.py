"""The verb `replay`: the simulated motion against the measured one, window by window.

Each window begins in the measured state and is driven by the measured torques. A machine without
feedback leaves its measured motion sooner or later, however good the model is: errors of the start
and of the torques grow, exponentially where the motion is unstable. Short windows (multiple
shooting; Bock, 1987) show the model and not this growth; one run without restarts shows how long it
takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ident.display import Displayed, render
from ident.equations.corrections import Scene
from ident.equations.terms import Samples
from ident.equations.unknowns import NOTHING
from ident.errors import FitError, MotionError
from ident.files import write_all
from ident.fit.files import Saved
from ident.fit.result import Fit
from ident.information.blocks import Error
from ident.motion import Motion, State
from ident.motion.state import joint_coordinates
from ident.progress import Progress
from ident.simulate.balance import Dynamics
from ident.simulate.drives import torque_series
from ident.simulate.integrate import STEPS, rough_times, surroundings
from ident.simulate.integration import Integration
from ident.simulate.plant import InstantTerms, Plant

WINDOW = 0.5  # [s]
TOLERANCE = 1e-8  # the torques are measured: a smaller one gains nothing
AWAY = 0.05  # of a joint's travel: farther away, the simulation has left the measurement


@dataclass(frozen=True, eq=False)
class ReplayedLog:
    """One model on one log with n samples and j logged joints.

    Attributes:
        t: (n,) [s]; joints: the logged ones, with their units.
        measured: (n, j), NaN where there is none.
        simulated: (n, j), at a restart the end of the window before; NaN where there is none.
        starts: samples at which a window begins.
        since, free: a run without restarts, from this sample on, (≤ n, j).
        failures: reasons why windows could not be integrated to their end.
    """

    name: str
    t: np.ndarray
    joints: tuple[str, ...]
    units: tuple[str, ...]
    measured: np.ndarray
    simulated: np.ndarray
    starts: tuple[int, ...]
    since: int
    free: np.ndarray
    failures: tuple[str, ...] = ()

    @property
    def errors(self) -> dict[str, Error]:
        """By joint: rms of simulated − measured, and that over the rms of the measured way from
        each window's start.
        """
        begin = np.searchsorted(self.starts, np.arange(len(self.t)), side="left") - 1
        way = self.measured - self.measured[np.array(self.starts)[np.maximum(begin, 0)]]
        off = self.simulated - self.measured
        errors = {}
        for j, (joint, unit) in enumerate(zip(self.joints, self.units, strict=True)):
            known = np.isfinite(off[:, j])
            rms = float(np.sqrt(np.mean(off[known, j] ** 2))) if known.any() else np.nan
            size = float(np.sqrt(np.mean(way[known, j] ** 2))) if known.any() else 0.0
            errors[joint] = Error(rms, rms / size if size > 0 else None, unit)
        return errors

    @property
    def within(self) -> dict[str, float | None]:
        """By joint: seconds without restart until it is 5 % of its travel away; None: never."""
        own = slice(self.since, self.since + len(self.free))
        travel = np.nanmax(self.measured, axis=0) - np.nanmin(self.measured, axis=0)
        away = np.abs(self.free - self.measured[own]) > AWAY * travel
        t = self.t[own] - self.t[self.since]
        return {
            joint: float(t[away[:, j].argmax()]) if away[:, j].any() else None
            for j, joint in enumerate(self.joints)
        }

    @property
    def lasted(self) -> float:
        """Length [s] of the run without restarts."""
        return float(self.t[self.since + max(len(self.free) - 1, 0)] - self.t[self.since])


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Displayed):
    """Models' simulated motion against the measured one. Made by `ident.replay`.

    Attributes:
        runs: by model, one an experiment.
        window: [s] from one restart to the next.
    """

    runs: Mapping[str, tuple[ReplayedLog, ...]]
    window: float

    @property
    def notes(self) -> tuple[str, ...]:
        """Windows that could not be integrated."""
        return tuple(
            f"{run.name}: some windows could not be integrated to their end: {why}"
            for logs in self.runs.values()
            for run in logs
            for why in run.failures
        )

    def plot(self, experiment: int = 0) -> Any:
        """Draw measured and simulated coordinate of every logged joint, with differences below.

        Args:
            experiment: its number, from 0.
        """
        return render(self, "plot", experiment)

    def save(self, path: str | Path) -> None:
        """Write the plot of the first experiment as .png, .svg, .pdf or .html, whole or not at all.

        Args:
            path: of the file, whose suffix decides.

        Raises:
            FitError: for another suffix.
        """
        self.plot().save(path)

    def write(self, folder: str | Path) -> list[Path]:
        """Write replay.html, with all charts in it, and replay.json.

        Raises:
            IdentError: if the folder cannot be written; then no file of it has changed.
        """
        return write_all(Path(folder), render(self, "files"))


def replay(
    *models: Fit | Saved,
    motion: Motion | None = None,
    window: float = WINDOW,
    progress: Progress | None = None,
) -> Replay:
    """Compare simulated with measured motion, restarted from the measured state every `window` s.

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
    runs: dict[str, tuple[ReplayedLog, ...]] = {}
    step = 1 / len(models) / len(motion.experiments)
    for i, model in enumerate(models):
        several = isinstance(model, Fit) and len(models) > 1
        name = model.name if isinstance(model, Saved) else f"fit {i + 1}" if several else "fit"
        logs = []
        for k, e in enumerate(motion.experiments):
            part = _part(progress, i / len(models) + k * step, step)
            logs.append(_replayed(model, motion, e, window, part))
        runs[name] = tuple(logs)
    return Replay(runs, window)


def _part(on_progress: Progress | None, share: float, step: float) -> Progress | None:
    """Return the progress callback of a part of the work."""
    return on_progress and (lambda what, done: on_progress(what, share + step * done))


def _replayed(
    model: Fit | Saved, motion: Motion, bare: State, window: float, on_progress: Progress | None
) -> ReplayedLog:
    player = _Player(model, motion, bare)
    e, at, joints = player.e, player.logged, player.mechanism.joints
    simulated = np.full((len(e), len(joints)), np.nan)
    starts, failures = [], []
    segments = list(e.segments())
    length = max(2, round(window * e.rate))
    for segment in segments:
        for a in range(segment.start, segment.stop - 1, length):
            if on_progress:
                on_progress(f"simulating {e.name}", 0.5 * a / len(e))
            y, failure = player.play(a, min(a + length, segment.stop - 1))
            if failure:
                failures.append(failure)
            else:
                simulated[a + 1 : a + len(y)] = y[1:]
            starts.append(a)
    longest = max(segments, key=lambda run: run.stop - run.start)
    # far from the measurement the motion may meet anything, so its failure is no news
    free, _ = player.play(longest.start, longest.stop - 1, True, _part(on_progress, 0.5, 0.5))
    return ReplayedLog(
        e.name, e.t, e.logged, tuple(joints[i].unit for i in at),
        np.where(e.usable[:, None], e.y[:, at], np.nan), simulated[:, at], tuple(starts),
        longest.start, free[:, at], tuple(dict.fromkeys(failures)),
    )  # fmt: skip


class _Player:
    """Integrates from measured states with measured torques."""

    def __init__(self, model: Fit | Saved, motion: Motion, bare: State) -> None:
        scene = Scene.of(model.mechanism, NOTHING, bare, model.point, motion.band.cutoff)
        self.mechanism, self.e = mechanism, e = scene.mechanism, scene.e
        self.plant = Plant.of(mechanism, model.point)
        around, self.knots = surroundings(mechanism, e), rough_times(e)
        self.equations = self.plant, torque_series(e), around, motion.independent
        self.travel = np.ptp(e.y[e.usable], axis=0)
        self.logged = [mechanism.joint_index[name] for name in e.logged]
        s = Samples(mechanism, e, slice(None), model.point)
        states = [s.columns(law.effect, law.shape)[:, 0, 0] for law in self.plant.laws.states]
        self.z = np.stack(states, axis=1) if states else np.zeros((len(e), 0))

    def play(
        self, a: int, b: int, far: bool = False, on_progress: Progress | None = None
    ) -> tuple[np.ndarray, str]:
        """Return y (≤ b − a + 1, J) at the samples a to b, and why it ended before, if it did.

        With `far` it ends where a joint is away by its travel.
        """
        e, failure = self.e, ""
        until = self._is_far if far else None
        integration = Integration(
            Dynamics(*self.equations), TOLERANCE, STEPS / e.rate, self.knots, until, e.y[a]
        )
        try:
            integration.run((e.q[a], e.v[a], self.z[a]), e.t[a : b + 1], on_progress)
        except MotionError as error:
            failure = str(error)
        terms = integration.record.terms
        if not terms:
            return np.empty((0, len(self.mechanism.joints))), failure
        q, v = (np.array([getattr(m, key) for m in terms]) for key in "qv")
        y, _, _ = joint_coordinates(self.mechanism, q, v, np.zeros_like(v), {})
        for i, joint in enumerate(self.mechanism.joints if self.mechanism.closures else ()):
            if joint.rotational and not joint.in_tree:  # turns are counted from the sample a
                y[:, i] += 2 * np.pi * np.round((e.y[a, i] - y[0, i]) / (2 * np.pi))
        return y, failure

    def _is_far(self, m: InstantTerms) -> bool:
        k = int(np.searchsorted(self.e.t, m.t - 1e-9))
        tree = [i for i in self.logged if self.mechanism.joints[i].in_tree]
        return bool((np.abs(m.y[tree] - self.e.y[k, tree]) > self.travel[tree]).any())
