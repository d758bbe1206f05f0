"""The verb `replay`: the simulated motion against the measured one, window by window.

Each window begins in the measured state and is driven by the measured torques, or by drives that
play the logged commands. A machine without
feedback leaves its measured motion sooner or later, however good the model is: errors of the start
and of the torques grow, exponentially where the motion is unstable. Short windows (multiple
shooting; Bock, 1987) show the model and not this growth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.display import Plotted, Progress
from ident.equations.rows import Scene
from ident.equations.terms import Samples
from ident.equations.unknowns import NOTHING
from ident.errors import FitError, IdentError, MotionError
from ident.fit.files import Saved
from ident.fit.result import Fit
from ident.information.blocks import Error, Squares
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, State
from ident.simulate.commands import command_laws, commanded, steps_of
from ident.simulate.dynamics import Dynamics
from ident.simulate.events import Integration
from ident.simulate.integrate import STEPS, interpolated, rough_times, torque_series
from ident.simulate.plant import Plant
from ident.simulate.twisting import twisting

WINDOW = 0.5  # range: [s]
PLAYED = 4  # work: windows of a log in which a model is tried
# numerics: of a step: 1e-8 moves the windows of a clean log by 4e-8 rad, errors by 1e-6 of them
TOLERANCE = 1e-6
EXACT = 1e-7  # numerics: [rad | m] of the same; a joint that sticks has a band without width


@dataclass(frozen=True, eq=False)
class ReplayedLog:
    """One model on one log with n samples and j logged joints."""

    name: str
    t: np.ndarray  # (n,) [s]
    joints: tuple[str, ...]  # the logged ones
    units: tuple[str, ...]  # theirs
    measured: np.ndarray  # (n, j), NaN where there is none
    simulated: np.ndarray  # (n, j), the same; at a restart the end of the window before
    starts: tuple[int, ...]  # samples at which a window begins
    failures: tuple[str, ...]  # why windows could not be integrated to their end
    coordinates: np.ndarray  # (n, nq) simulated ones of the tree
    band: np.ndarray | None = None  # (n, j) half of the width of the simulated one's 95 % band

    @property
    def errors(self) -> dict[str, Error]:
        """By joint: rms of simulated − measured, and that over the rms of the measured way from
        each window's start.
        """
        begin = np.searchsorted(self.starts, np.arange(len(self.t)), side="left") - 1
        way = self.measured - self.measured[np.array(self.starts)[np.maximum(begin, 0)]]
        off = self.simulated - self.measured
        known = np.isfinite(off)
        error, size = ((np.where(known, x, 0.0) ** 2).sum(axis=0) for x in (off, way))
        error[~known.any(axis=0)] = np.nan
        sums = np.stack([error, size, known.sum(axis=0)])
        return Squares(sums, np.zeros(sums.shape)).errors(self.joints, self.units)

    @property
    def within(self) -> dict[str, float]:
        """By joint: the share of samples whose measured coordinate lies in the band; empty where
        there is none. Samples at which a window begins do not count.
        """
        if self.band is None:
            return {}
        off = np.abs(self.simulated - self.measured) - self.band
        off[list(self.starts)] = np.nan
        return {
            joint: float(np.mean(off[known, j] <= EXACT))
            for j, joint in enumerate(self.joints)
            if (known := np.isfinite(off[:, j])).any()
        }


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Plotted):
    """Models' simulated motion against the measured one. Made by `ident.replay`.

    Its plot shows measured and simulated coordinates of every logged joint, with differences below.

    Attributes:
        runs: by model, one an experiment.
        window: [s] from one restart to the next.
    """

    runs: Mapping[str, tuple[ReplayedLog, ...]]
    window: float

    def with_band(self, model: str, widths: Sequence[np.ndarray]) -> Replay:
        """The same with the half widths (n, j) of a model's 95 % bands, one a log."""
        logs = (replace(run, band=x) for run, x in zip(self.runs[model], widths, strict=True))
        return replace(self, runs={**self.runs, model: tuple(logs)})

    @property
    def notes(self) -> tuple[str, ...]:
        """Windows that could not be integrated."""
        return tuple(
            f"{run.name}: some windows could not be integrated to their end: {why}"
            for logs in self.runs.values()
            for run in logs
            for why in run.failures
        )


def replay(
    *models: Fit | Saved,
    motion: Motion | None = None,
    window: float = WINDOW,
    most: int | None = None,
    progress: Progress | None = None,
) -> Replay:
    """Compare simulated with measured motion, restarted from the measured state every `window` s.

    Args:
        models: fits, or fit.json files read back.
        motion: the measured motion, with torques; default: that of the first fit.
        window: [s] from one restart to the next.
        most: windows of a log that are simulated, evenly over it; None: all.
        progress: called with (what is being done, share done).

    Raises:
        FitError: if there is no model or no motion, a log has poses, or the window is shorter than
            two samples.
        MechanismError: for an effect that cannot be integrated, or parameters with which forces do
            not determine the motion.
    """
    if not models:
        raise FitError("nothing to simulate; give one fit or several")
    motion = models[0].motion if motion is None else motion
    if motion is None:
        raise FitError("a fit that was read back has no motion; give motion=…")
    for e in motion.experiments:
        if e.poses:
            raise FitError(
                f"{e.name}: has poses at rest, which are no motion; give logs of motions"
            )
        if not 2 <= window * e.rate < np.inf:
            raise FitError(
                f"window {window:g} s: {e.name} has a sample every {1 / e.rate:.4g} s; give two "
                "samples or more"
            )
    runs: dict[str, tuple[ReplayedLog, ...]] = {}
    for i, model in enumerate(models):
        label = f"fit {i + 1}" if len(models) > 1 else "fit"
        logs = (_replayed(model, motion, e, window, most, progress) for e in motion.experiments)
        runs[model.name if isinstance(model, Saved) else label] = tuple(logs)
    return Replay(runs, window)


def unplayable(fit: Fit) -> str:
    """Return why the motion that a fit's drives make cannot be simulated, "" where it can.

    Some windows of every log are played, but of poses. A machine some of whose torques are measured
    is left out, as it leaves its motion sooner or later; so is one with an effect that has no
    forward law.
    """
    mechanism = fit.mechanism
    if not mechanism.drives or {*mechanism.drives} != {*mechanism.driven}:
        return ""
    if any(effect.not_integrable for effect in mechanism.effects):
        return ""
    moving = tuple(e for e in fit.motion.experiments if not e.poses)
    if not moving:
        return ""
    try:
        run = replay(fit, motion=replace(fit.motion, experiments=moving), most=PLAYED)
    except IdentError as error:
        return str(error)
    return next(iter(run.notes), "")


def _replayed(
    model: Fit | Saved, motion: Motion, bare: State, window: float, most: int | None,
    on_progress: Progress | None,
) -> ReplayedLog:  # fmt: skip
    scene = Scene.of(model.mechanism, NOTHING, bare, model.point, motion.band.cutoff)
    mechanism, point, divided = twisting(scene.mechanism, model.point, scene.e)
    e = scene.e if divided is None else divided
    logged = tuple(mechanism.joint_index[name] for name in e.logged)
    plant = Plant(mechanism, point, logged)
    laws = command_laws(mechanism, point, e)
    torques, extra = commanded(laws, torque_series(e)), interpolated(e)
    s = Samples(mechanism, e, slice(None), point)
    states = [s.columns(law.effect, law.shape)[:, 0, 0] for law in plant.laws.states]
    z = np.stack(states, axis=1) if states else np.zeros((len(e), 0))
    measured = len(laws) < len(mechanism.driven)  # some torques are those of a log
    knots, since = rough_times(e) if measured else None, float(e.t[0])
    jumps = steps_of(laws)

    simulated, starts, failures = np.full(e.y.shape, np.nan), [], []
    length = max(2, round(window * e.rate))
    windows = [
        (a, min(a + length, segment.stop - 1))
        for segment in e.segments()
        for a in range(segment.start, segment.stop - 1, length)
    ]
    if most is not None and len(windows) > most:
        windows = [windows[i] for i in np.linspace(0, len(windows) - 1, most).astype(int)]
    for a, stop in windows:
        if on_progress:
            on_progress(f"simulating {e.name}", a / len(e))
        starts.append(a)
        times = e.t[a : stop + 1]
        dynamics = Dynamics(plant, torques, motion.independent, extra, since)
        integration = Integration(dynamics, TOLERANCE, STEPS / e.rate, knots, e.y[a], jumps)
        try:
            integration.run((e.q[a], e.v[a], z[a]), times)
        except MotionError as error:
            failures.append(str(error))
            continue
        simulated[a + 1 : a + len(times)] = [m.y for m, _, _ in integration.samples[1:]]
    return ReplayedLog(
        e.name,
        e.t,
        e.logged,
        tuple(mechanism.joints[i].unit for i in logged),
        np.where(e.usable[:, None], e.y[:, logged], np.nan),
        simulated[:, logged],
        tuple(starts),
        tuple(dict.fromkeys(failures)),
        simulated[:, tree_columns(mechanism)],
    )


def tree_columns(mechanism: Mechanism) -> list[int]:
    """Return where the coordinates q (nq,) of the tree are among those of all joints."""
    tree = sorted((j.index, j.name) for j in mechanism.joints if j.in_tree)
    return [mechanism.joint_index[name] for _, name in tree]
