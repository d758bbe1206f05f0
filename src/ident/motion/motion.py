"""The verb `complete`: logs become the motion of the whole mechanism, a `Motion`."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from ident.display import Displayed, Progress, render
from ident.errors import LogError, MotionError, one_of
from ident.information.evidence import BEYOND, EXPLAINED_BELOW
from ident.log import Log, read_log
from ident.log.log import NoTime, entry_for
from ident.log.poses import are_poses
from ident.log.read import distinct
from ident.log.table import is_frame
from ident.mechanism.mechanism import Mechanism
from ident.motion.at_rest import measure_poses, rest_of
from ident.motion.closures import best_conditioned, check_freedom, independent_joints
from ident.motion.commands import check_commands, servo_cutoff
from ident.motion.knots import by_torques, doubtful, without_time_errors
from ident.motion.misread_poses import check_base
from ident.motion.recipe import (
    AUTO,
    CLEAN,
    Band,
    Recipe,
    band_of,
    checked_cutoff,
    checked_spacing,
    standstill,
    still_speeds,
)
from ident.motion.signals import LogSignals, measure, runs, without_repeats
from ident.motion.smoothing import AS_LOGGED, Derived, derive, together
from ident.motion.spline import Smoothed, grain
from ident.motion.state import State, wrenches
from ident.motion.torque_class import (
    MEASURED,
    TorqueClass,
    TorqueVerdict,
    informing,
    torque_verdicts,
)
from ident.motion.torque_models import torques_of_models
from ident.motion.unforced import unforced_base
from ident.text import shortlist

# columns, and drives of them
COMMANDS = {"ref": "servo", "current": "current", "voltage": "voltage", "duty": "duty"}
Given = Log | str | os.PathLike[str] | Any  # a polars or pandas data frame
AGREE = 1e-9  # numerics: share of its motion below which a logged joint differs by rounding only
MOSTLY = 0.5  # level: of a residual's squares that steps make, from which it is theirs
STEP_ROUNDING = 1e-6  # numerics: of a sampling step, within which two times are the same


@dataclass(frozen=True, eq=False, repr=False)
class Motion(Displayed):
    """Experiments of one mechanism, completed through its closures.

    Attributes:
        experiments: one a log.
        independent: names of the joints in whose coordinates errors are compared.
        band: bandwidth, noise and filter, over all logs.
        closure_error: largest |Φ| left [m | rad].
        notes: what was repaired, derived or left out, in words.
        logs: as they were read, under ident's column names.
        mechanism: that moves; None for a motion without one.
        channels: classes of the torques by the samples of each log, by joint.
    """

    experiments: tuple[State, ...]
    independent: tuple[str, ...]
    band: Band
    closure_error: float
    notes: tuple[str, ...] = ()
    logs: tuple[Log, ...] = ()
    mechanism: Mechanism | None = None
    channels: tuple[Mapping[str, TorqueVerdict], ...] = ()

    @cached_property
    def torques(self) -> Mapping[str, TorqueVerdict]:
        """The class of each joint's torque: what its samples show in some log, or the equations."""
        every = {
            joint: next((x for x in of_logs if not x.measured), of_logs[0])
            for joint in dict.fromkeys(joint for of in self.channels for joint in of)
            for of_logs in ([of[joint] for of in self.channels if joint in of],)
        }
        if self.mechanism is None:
            return every
        of_models = torques_of_models(self.mechanism, self.experiments)
        return every | {
            joint: x
            for joint, x in of_models.items()
            if every.get(joint, MEASURED).measured or x.kind is TorqueClass.COMPUTED
        }

    @property
    def dead(self) -> tuple[str, ...]:
        """Joints of a tree whose torque column is constant or noise in some log."""
        if self.mechanism is None or self.mechanism.closures:
            return ()
        dead = (j for of in self.channels for j, x in of.items() if x.kind is TorqueClass.DEAD)
        return tuple(dict.fromkeys(dead))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the logs."""
        return tuple(experiment.name for experiment in self.experiments)

    @property
    def samples(self) -> int:
        """Over all experiments."""
        return sum(len(experiment) for experiment in self.experiments)

    @property
    def duration(self) -> float:
        """Mean duration of the logs [s]; of an excerpt, of whole logs; of poses, 0."""
        rate = float(np.mean([e.rate for e in self.experiments]))
        return self.samples / rate / len(self.names) if rate else 0.0

    @property
    def poses(self) -> bool:
        """Whether all samples are poses at rest."""
        return all(e.poses for e in self.experiments)

    @property
    def rows(self) -> list[list[str]]:
        """The logs as a table: name, samples, duration, rate, samples left out; the head first."""
        rows = [["log", "samples", "duration", "rate", "left out"]]
        for e in self.experiments:
            out = int(len(e) - e.usable.sum())
            time, rate = f"{e.t[-1] - e.t[0]:.4g} s", f"{e.rate:.4g} Hz"
            time, rate = ("poses", "at rest") if e.poses else (time, rate)
            rows.append([e.name, str(len(e)), time, rate, str(out) if out else "–"])
        return rows

    def view(self) -> Any:
        """The mechanism moving in 3-D: a recording in a notebook, `.serve()` shows it in a browser.

        Raises:
            MotionError: for a motion that was made up without a mechanism.
        """
        if self.mechanism is None:
            raise MotionError(
                "this motion knows no mechanism to show; one of ident.complete(mechanism, log) does"
            )
        return render(self.mechanism, "view", self.experiments)


def complete(
    mechanism: Mechanism,
    logs: Given | Sequence[Given],
    *,
    cutoff: float | str | None = "auto",
    torques: bool = True,
    smoothing: float | str | None = AUTO,
    poses: bool | None = None,
    progress: Progress | None = None,
) -> Motion:
    """All positions, velocities and accelerations, completed through the closures.

    Args:
        mechanism: the mechanism.
        logs: one log or several, or their paths, or polars or pandas data frames: separate
            experiments of the same mechanism.
        cutoff: of the zero-phase filter that the equations will use [Hz]; "auto" chooses it from
            the data, None filters nothing. Knots are not closer than a tenth of its period.
        smoothing: spacing of the knots [s] of the splines that noisy channels are smoothed by;
            "auto" chooses it from the data; None takes all channels as logged.
        torques: whether every driven joint must have its `tau.` column; else missing ones are zero.
        poses: whether each row of the logs is an average over a mechanism at rest, in any order;
            None decides it for each log by its rows.
        progress: called with (what is being done, share done).

    Returns:
        The motion, with everything repaired, derived or left out said in `notes`.

    Raises:
        MotionError: if the logs do not determine the motion or contradict the closures.
        MechanismError: if its loops do not let the mechanism move.
        LogError: if a path or a data frame cannot be read.
    """
    check_freedom(mechanism)
    several = isinstance(logs, Iterable) and not isinstance(logs, str | Mapping)
    given: list[Any] = [*cast(Any, logs)] if several and not is_frame(logs) else [logs]
    if not given:
        raise MotionError(f"{mechanism.name}: no log given")
    read = [log_of(mechanism, item, poses) for item in given]
    read = [log if log.poses else without_repeats(log) for log in read]
    different = zip(read, distinct(log.name for log in read), strict=True)
    read = [log if log.name == name else replace(log, name=name) for log, name in different]
    measured = [(measure_poses if log.poses else measure)(mechanism, log) for log in read]
    moving = [signals for signals in measured if not signals.log.poses]
    notes = [note for signals in measured for note in signals.notes]
    for signals in measured:
        notes += _missing_torques(mechanism, signals, torques)
        if mechanism.drives:
            notes += check_commands(mechanism, signals.log.name, signals.t, signals.columns)
    names = _determining(mechanism, measured)
    band = Band(0.0, 0.0, None)
    channels = [torque_verdicts(mechanism, s.t, s.columns) for s in moving]
    informs = [informing(of_log) for of_log in channels]
    if moving:
        smoothing = checked_spacing(smoothing, moving)
        cutoff = cutoff if cutoff in (None, AUTO) else checked_cutoff(cutoff, moving)
        band = band_of(moving, names, cutoff, informs)

    def derived_with(band: Band) -> list[Derived]:
        return [
            rest_of(signals, names)
            if signals.log.poses
            else derive(signals, names, band, smoothing)
            for signals in measured
        ]

    derived = derived_with(band)
    free = names if mechanism.degrees_of_freedom > 1 else ()  # of one, motion looks the same
    shifted = [
        None if signals.log.poses else without_time_errors(signals, item, free)
        for signals, item in zip(measured, derived, strict=True)
    ]
    for i, corrected_time in enumerate(shifted):
        if corrected_time is not None:
            measured[i], rms = corrected_time
            notes.append(
                f"{read[i].name}: time stamps are off by {1e3 * rms:.2g} ms rms, the same in all "
                "joints (jitter, repeated rows): positions are moved to their stamps"
            )
    # as logged: the smooth part of time errors stays
    white = band.white or not doubtful(derived, band)
    if any(item is not None for item in shifted):
        spacing = min(item.smooth.spacing for item in derived if item.smooth)
        band = replace(band, knots=(spacing, spacing))
        derived = derived_with(band)
    if cutoff == "auto" and band.cutoff is None and band.noise > CLEAN and band.motion > 0:
        notes.append(
            f"the motion reaches {band.motion:.3g} Hz, too near the sampling rate for a filter, "
            f"but some channel is noisy ({100 * band.noise:.2g} % of it): accelerations and "
            "inertias will suffer; log faster, or give --cutoff"
        )
    complete_torques = all(
        f"tau.{name}" in s.columns for s in measured for name in mechanism.measured
    )
    measures = bool(moving and mechanism.measured)
    if measures and smoothing == AUTO and complete_torques and not white:
        if progress:
            progress("choosing knots by the torques", 0.0)
        in_motion = [x for x, y in zip(derived, measured, strict=True) if not y.log.poses]
        before, by_user = band, cutoff != "auto"
        band = by_torques(mechanism, moving, band, in_motion, by_user, informs)
        if band != before:
            derived = derived_with(band)
            if np.isfinite(band.knots[1]):
                notes.append(
                    f"noise of the motion is not white: knots {1e3 * band.knots[1]:.3g} ms, "
                    "with which rigid bodies and friction predict the torques best"
                )
    experiments: list[State] = []
    for i, (signals, item) in enumerate(zip(measured, derived, strict=True)):
        if progress:
            progress(f"completing {signals.log.name}", i / len(measured))
        experiment, more = state_of(mechanism, signals, item)
        experiments.append(experiment)
        notes += more
    independent = best_conditioned(mechanism, np.concatenate([e.q for e in experiments]))
    worst = 0.0
    for i, experiment in enumerate(experiments):
        experiments[i] = experiment.transmitted(mechanism, independent)
        notes += left_out(experiment, experiments[i])
        error = np.abs(mechanism.kinematics.closure_rows(experiment.q).value).max(initial=0.0)
        worst = max(worst, float(error))
    alone = np.ones(experiments[0].leverage.shape[2]) if not moving else None
    states = tuple(
        replace(e, still=still_speeds(e), rest=alone)
        if e.poses
        else replace(e, still=standstill(mechanism, signals, e, names))
        for signals, e in zip(measured, experiments, strict=True)
    )
    sensors = any(f"tau.{name}" in log.columns for log in read for name in mechanism.drives)
    if cutoff == "auto" and band.cutoff is not None and not sensors:
        servos = servo_cutoff(mechanism, states)
        if servos is not None:  # their torques have all that the motion lost by smoothing
            spacings = [e.smooth.spacing for e in states if e.smooth is not None]
            passed = 0.5 / min(spacings) if spacings else np.inf
            band = replace(band, cutoff=min(servos, passed, band.cutoff))
    check_base(mechanism, states, read)
    if missing := unforced_base(mechanism, states):
        if torques:
            raise MotionError(missing)
        notes.append(missing)
    return Motion(
        states, independent, band, worst, tuple(dict.fromkeys(notes)), tuple(read), mechanism,
        tuple(channels),
    )  # fmt: skip


def part_of(mechanism: Mechanism, signals: LogSignals, recipe: Recipe) -> State | None:
    """The state over a part of a log with margins, as the whole has it; None without samples."""
    if not signals.usable.any():
        return None
    derived = derive(signals, recipe.logged, recipe.band, recipe.smoothing, recipe)
    e, _ = state_of(mechanism, signals, derived, recipe)
    e = e.transmitted(mechanism, recipe.independent, recipe.singular)
    still = np.full(len(mechanism.joints), 1e-9) if recipe.still is None else recipe.still
    return replace(e, still=still) if e.usable.any() else None


def prescribed(
    mechanism: Mechanism, name: str, t: np.ndarray, joints: tuple[str, ...], known: np.ndarray
) -> Motion:
    """A given motion on a uniform clock t (n,) [s], without torques, noise and filter.

    `known` are coordinates, rates and accelerations (3, n, d) of joints that determine the motion.

    Raises:
        MechanismError: if its loops do not let the mechanism move.
        MotionError: if the joints do not determine a motion, or the closures cannot follow it.
    """
    check_freedom(mechanism)
    if len(independent_joints(mechanism, joints)) < mechanism.degrees_of_freedom:
        raise MotionError(f"{name}: {', '.join(joints)} do not determine the motion; give more")
    e = State(
        name=name, t=t, tau=np.zeros((len(t), len(mechanism.driven))),
        usable=np.ones(len(t), dtype=bool), logged=joints, independent=joints,
    ).at(mechanism, known, joints, start="follow")  # fmt: skip
    e = e.transmitted(mechanism, best_conditioned(mechanism, e.q))
    e = replace(e, still=still_speeds(e))
    return Motion((e,), e.independent, Band(0.0, 0.0, None), 0.0, mechanism=mechanism)


def log_of(mechanism: Mechanism, given: Given, poses: bool | None = None) -> Log:
    """Return a log with its columns as a mechanism maps them, its rows `poses` or not (None: as
    they look); the error of one without a time has all entries of [log] that its columns suggest.
    """
    if isinstance(given, Log):
        columns = dict(given.columns)
        for name, source in mechanism.sources.items():
            if name not in columns and source.column in columns:
                columns[name] = source.scale * columns[source.column] + source.offset
        look = poses is None and not given.poses and are_poses(columns, given.t)
        return given.as_poses() if (poses or look) and not given.poses else given
    try:
        if isinstance(given, str | os.PathLike):
            return read_log(given, mechanism.sources, poses=poses)
        return Log.from_frame(given, columns=mechanism.sources, poses=poses)
    except NoTime as error:
        entries = _entries(mechanism, error.columns)
        raise LogError(f"{error}{entries and f' and {entries}'}") from None


def _unused(mechanism: Mechanism, columns: Iterable[str]) -> list[str]:
    """The columns of a log that are no channel of a joint."""
    joints = [joint.name for joint in mechanism.joints]
    names = {"t", *(f"{c}.{name}" for c in ("q", "v", "a", "tau") for name in joints)}
    return [x for x in columns if x not in names and not x.startswith("wrench.")]


def _entries(mechanism: Mechanism, columns: Collection[str]) -> str:
    """The entries of [log] that columns suggest for all channels that a log lacks."""
    joints = [joint.name for joint in mechanism.joints]
    has, free = {*columns, *mechanism.columns}, _unused(mechanism, columns)
    entries = (
        entry_for(channel, [name for name in named if f"{channel}.{name}" not in has], free)
        for channel, named in (("q", joints), ("v", joints), ("tau", mechanism.measured))
    )
    return " and ".join(filter(None, entries))


def _missing_torques(mechanism: Mechanism, signals: LogSignals, needed: bool) -> list[str]:
    columns, log = signals.columns, signals.log.name
    missing = [name for name in mechanism.measured if f"tau.{name}" not in columns]
    for drive in mechanism.drives.values() if needed else ():
        if silent := [name for name in drive.reads() if name not in columns]:
            entry = f'[log] "{silent[0]}" = "…"'
            raise MotionError(
                f"{log}: {drive.label} computes a torque from '{silent[0]}', and there is no such "
                f"column ({one_of(silent[0], _unused(mechanism, columns))}); log it, or map it in "
                f"mechanism.toml: {entry}"
            )
    has_positions = any(f"q.{joint.name}" in columns for joint in mechanism.joints)
    if (
        missing and needed and has_positions
    ):  # else no position is mapped either, which is said first
        name, free = missing[0], _unused(mechanism, columns)
        lacking = f"there is no column 'tau.{name}'"
        lacking += f" ({one_of('tau.' + name, free)})" * bool(free)
        if f"tau.{name}" in signals.log.columns:
            lacking = f"column 'tau.{name}' has no value in any of {len(signals.log.t)} rows"
        of_text = (note for note in signals.log.repairs if f"column 'tau.{name}' holds" in note)
        lacking = next(of_text, lacking).removesuffix(", left out")
        entry = entry_for("tau", missing, free)
        raise MotionError(
            f"{log}: joint '{name}' is driven, but {lacking}; log it, map it in mechanism.toml"
            f"{entry and f': [log] {entry}'}, put '{name}' among the passive joints, or hold it: "
            f"--lock {name}, in Python load(…, locked={{'{name}': None}})"
            + f"; without a sensor, leave out its equation: --unmeasured {name}"
            * (not mechanism.closures)
            + "".join(
                f"; or compute it from {command}.{name}: --drive {word}"
                for command, word in COMMANDS.items()
                if f"{command}.{name}" in columns
            )
        )
    shown = ", ".join(f"tau.{name}" for name in missing)
    return [f"{log}: has no {shown}: a motion, no experiment"] if missing else []


def _determining(mechanism: Mechanism, measured: list[LogSignals]) -> tuple[str, ...]:
    """The joints of which all logs have positions; refused if they do not determine the motion."""
    joints, dof = [joint.name for joint in mechanism.joints], mechanism.degrees_of_freedom
    logged = [
        name for name in joints if all(f"q.{name}" in signals.columns for signals in measured)
    ]
    order = [name for name in logged if name in mechanism.driven] + logged
    names = independent_joints(mechanism, order)
    if len(names) >= dof:
        return tuple(logged)
    free = [
        name
        for name in joints
        if name not in logged and len(independent_joints(mechanism, [*names, name])) > len(names)
    ]
    fewest = min(
        measured, key=lambda signals: sum(f"q.{name}" in signals.columns for name in joints)
    )
    fixed = [name for name in logged if not independent_joints(mechanism, [name])]
    given, wanted, still = (
        ", ".join(f"q.{n}" for n in signals) for signals in (logged, free, fixed)
    )
    columns = _unused(mechanism, fewest.log.columns)
    if not logged and columns:
        entries = _entries(mechanism, fewest.log.columns)
        entries = entries or f'"q.{free[0]}" = "…", and so on for the others'
        raise MotionError(
            f"{fewest.log.name}: no column is the position of a joint; write in mechanism.toml: "
            f"[log] {entries}; columns that are not used: {shortlist(columns)}"
        )
    entries = entry_for("q", free, columns)
    check = f": the closures let {still} not move at all, check them" if fixed else ""
    other = f"; or hold what did not move, as --lock {free[0]} does" if free else ""
    other += f"; or map columns that it has in mechanism.toml: [log] {entries}" if entries else ""
    raise MotionError(
        f"{fewest.log.name}: {mechanism.name} has {dof} degrees of "
        f"freedom, but the positions logged ({given or 'none'}) determine only {len(names)}{check};"
        f" log one more of: {wanted or 'none'}{other}"
    )


# --- one log -------------------------------------------------------------------------------------


def state_of(
    mechanism: Mechanism, signals: LogSignals, derived: Derived, recipe: Recipe | None = None
) -> tuple[State, list[str]]:
    """The state of a log, or by a `recipe` of its part, from some joints; and notes."""
    n, log, columns, names = len(signals.t), signals.log.name, signals.columns, derived.names
    driven = [f"tau.{name}" for name in mechanism.driven]
    tau = np.zeros((n, len(driven)))
    for i, name in enumerate(driven):
        tau[:, i] = columns.get(name, 0.0)
    usable = signals.usable.copy()
    for run in runs(signals.usable):
        t, ends = signals.t[run], derived.ends - STEP_ROUNDING * signals.dt
        usable[run] = (t >= t[0] + ends) & (t <= t[-1] - ends)
    usable = usable if usable.any() else signals.usable
    inputs = [x for effect in mechanism.effects if effect.site == "frame" for x in effect.reads()]
    noisy = [f"{channel}.{name}" for name in names for channel in "qva"] + driven + inputs
    base = State(
        name=log, t=signals.t, tau=tau, usable=usable, logged=names, independent=names,
        extra={k: x for k, x in columns.items() if not k.startswith(("q.", "v.", "a."))},
        noise={} if signals.log.poses
        else {k: signals.noise(k) for k in noisy if k in columns},
        smooth=derived.smooth, channels=tuple(derived.table), ends=derived.ends,
        poses=signals.log.poses,
    )  # fmt: skip
    notes: list[str] = []
    experiment = base.at(mechanism, derived.known, names, start="follow")
    if len(names) > mechanism.degrees_of_freedom:
        if recipe is None:  # a part may hardly move, and then disagree by noise alone
            notes = _disagreements(mechanism, experiment, names, derived.known[0])
        if derived.smooth is not None:
            experiment = together(mechanism, signals, experiment, recipe)
    treated: dict[str, list[str]] = {}
    for channel in experiment.channels:
        if channel.how != AS_LOGGED:
            treated.setdefault(channel.how, []).append(channel.column)
    notes = [f"{log}: {', '.join(same)}: {how}" for how, same in treated.items()] + notes
    if recipe is None:
        notes += _in_steps(mechanism, signals, experiment.channels)
    rough = {
        c.column: c.residual / c.noise
        for c in experiment.channels
        if c.spacing and c.residual > BEYOND * c.noise and not c.column.startswith("q.")
    }
    if rough:
        notes.append(
            f"{log}: {', '.join(rough)} disagree with the positions, by up to "
            f"{max(rough.values()):.3g} times their noise"
        )
    if (lost := int((signals.usable & ~base.usable).sum())) > 0:
        notes.append(
            f"{log}: {lost} samples within {1e3 * derived.ends:.3g} ms of where splines end are "
            "left out"
        )
    wrench = wrenches(mechanism, log, columns, experiment.q)
    return replace(experiment, wrench=wrench), notes


def _in_steps(mechanism: Mechanism, signals: LogSignals, channels: Sequence[Smoothed]) -> list[str]:
    """Notes on positions whose noise is mostly that of being rounded to steps."""
    rounded: dict[str, list[tuple[str, float]]] = {}
    for channel in channels:
        if not channel.spacing or not channel.column.startswith("q."):
            continue
        step = grain(signals.log.series(channel.column)[1])
        noise = step / np.sqrt(12)
        if not step or noise**2 < MOSTLY * channel.residual**2:
            continue
        joint = mechanism.joint(channel.column.partition(".")[2])
        words = f"{1e3 * step:.3g} m{joint.unit}"
        if joint.rotational:
            words += f" ({2 * np.pi / step:.0f} a turn, {np.log2(2 * np.pi / step):.3g} bit)"
        words += f": {1e3 * noise:.2g} m{joint.unit} rms"
        rounded.setdefault(words, []).append((channel.column, noise / channel.residual))
    return [
        f"{signals.log.name}: {', '.join(name for name, _ in same)}: rounded to steps of {words}, "
        f"{min(1.0, max(share for _, share in same)):.0%} of the noise that smoothing takes off"
        for words, same in rounded.items()
    ]


def _disagreements(
    mechanism: Mechanism, experiment: State, names: tuple[str, ...], logged: np.ndarray
) -> list[str]:
    notes = []
    for i, name in enumerate(names):
        joint = mechanism.joint(name)
        off = (experiment.y[:, mechanism.joint_index[name]] - logged[:, i])[experiment.usable]
        if joint.rotational:
            off = (off + np.pi) % (2 * np.pi) - np.pi
        rms, spread = float(np.sqrt(np.mean(off**2))), float(np.std(logged[:, i]))
        note = (
            f"{experiment.name}: q.{name} differs from what the closures and the other joints give "
            f"by {rms:.3g} {joint.unit} rms, {np.abs(off).max():.3g} at most"
        )
        # noise of this column is no contradiction, nor is any part of its spread a motion
        noise = min(experiment.noise.get(f"q.{name}", 0.0), spread)
        excursion = float(np.sqrt(spread**2 - noise**2))
        if rms > EXPLAINED_BELOW * excursion + 1.5 * noise:
            raise MotionError(
                f"{note}, while it moves by {spread:.3g} rms: the positions contradict the "
                "closures; check sign, unit and zero of this column and the closures' frames"
            )
        agree = rms <= AGREE * spread
        notes.append(f"{experiment.name}: q.{name} agrees with the closures" if agree else note)
    return notes


def left_out(before: State, after: State) -> list[str]:
    """The note on samples that are near a singular position, and not usable any more."""
    singular = before.usable & ~after.usable
    if not singular.any():
        return []
    cuts = [f"{after.t[x.start]:.4g} to {after.t[x.stop - 1]:.4g}" for x in runs(singular)]
    return [
        f"{after.name}: {int(singular.sum())} of {len(after)} samples are left out, near a "
        f"singular position of {', '.join(after.independent)}: t = {shortlist(cuts)} s; nothing is "
        "filtered across these cuts"
    ]
