"""The verb `complete`: a log becomes the motion of the whole mechanism."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from ident.errors import MotionError, one_of
from ident.log import Log, read_log
from ident.log.frames import is_frame
from ident.mechanism.mechanism import Mechanism
from ident.motion.band import band_of
from ident.motion.derive import AUTO
from ident.motion.experiment import experiment_of
from ident.motion.freedom import check_freedom
from ident.motion.independent import best_conditioned, independent_joints
from ident.motion.measure import Signals, measure
from ident.motion.motion import Experiment, Motion
from ident.motion.place import reduced
from ident.motion.rest import standstill
from ident.motion.spectrum import CLEAN
from ident.progress import Told

Given = Log | str | os.PathLike[str] | Any  # a polars or pandas data frame


def complete(
    mechanism: Mechanism,
    logs: Given | Sequence[Given],
    *,
    cutoff: float | str | None = "auto",
    torques: bool = True,
    smoothing: float | str | None = AUTO,
    progress: Told | None = None,
) -> Motion:
    """All positions, velocities and accelerations, completed through the closures.

    Args:
        mechanism: the mechanism.
        logs: one log or several, or their paths, or polars or pandas data frames: separate
            experiments of the same mechanism.
        cutoff: of the zero-phase filter that the equations will use [Hz]; "auto" chooses it from
            the data, None filters nothing.
        smoothing: spacing of the knots [s] of the splines that noisy channels are smoothed by;
            "auto" chooses it from the data; None takes all channels as logged.
        torques: whether every driven joint must have its `tau.` column; else missing ones are zero.
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
    read = _distinct([_log(mechanism, each) for each in given])
    measured = [measure(mechanism, log) for log in read]
    for signals in measured if torques else []:
        _check_torques(mechanism, signals)
    names = _determining(mechanism, measured)
    smoothing = _checked_smoothing(smoothing, measured)
    band = band_of(mechanism, measured, names)
    if cutoff != "auto":
        band = replace(band, cutoff=None if cutoff is None else _checked(cutoff, measured))
    notes = [note for signals in measured for note in signals.notes]
    for signals in [] if torques else measured:
        missing = [f"tau.{n}" for n in mechanism.driven if f"tau.{n}" not in signals.columns]
        if missing:
            notes.append(
                f"{signals.log.name}: has no {', '.join(missing)}: a motion, no experiment"
            )
    if band.cutoff is None and cutoff == "auto" and band.noise > CLEAN:
        notes.append(
            f"the motion reaches {band.motion:.3g} Hz, too near the sampling rate for a filter, "
            f"but some channel is noisy ({100 * band.noise:.2g} % of it): accelerations and "
            "inertias will suffer; log faster, or give --cutoff"
        )
    experiments: list[Experiment] = []
    for i, signals in enumerate(measured):
        if progress:
            progress(f"completing {signals.log.name}", i / len(measured))
        experiment, said = experiment_of(mechanism, signals, names, band, smoothing)
        experiments.append(experiment)
        notes += said
    independent, worst = names, 0.0
    if mechanism.closures:
        independent = best_conditioned(mechanism, np.concatenate([e.q for e in experiments]))
        for i, experiment in enumerate(experiments):
            experiments[i], error, said = reduced(mechanism, experiment, independent)
            notes += said
            worst = max(worst, error)
    for i, signals in enumerate(measured):
        still = standstill(mechanism, signals, experiments[i], names)
        experiments[i] = replace(experiments[i], still=still)
    noted = tuple(dict.fromkeys(notes))
    return Motion(tuple(experiments), independent, band, worst, noted, tuple(read), mechanism)


def _log(mechanism: Mechanism, given: Given) -> Log:
    if isinstance(given, Log):
        return given
    if isinstance(given, str | os.PathLike):
        return read_log(given, mechanism.columns)
    return Log.from_frame(given, columns=mechanism.columns)


def _distinct(logs: list[Log]) -> list[Log]:
    """The logs with names that differ: run.csv of two folders become run.csv and run.csv (2)."""
    seen: dict[str, int] = {}
    found = []
    for log in logs:
        seen[log.name] = seen.get(log.name, 0) + 1
        count = seen[log.name]
        found.append(log if count == 1 else replace(log, name=f"{log.name} ({count})"))
    return found


def _checked(cutoff: float | str, measured: list[Signals]) -> float:
    slowest = max(measured, key=lambda signals: signals.dt)
    nyquist = 0.5 / slowest.dt
    try:
        value = float(cutoff)
    except (TypeError, ValueError):
        raise MotionError(f"cut-off {cutoff!r}; valid: a number [Hz], 'auto' or none") from None
    lowest = 1 / max(float(signals.t[-1] - signals.t[0]) for signals in measured)
    if 0 < value < lowest:
        raise MotionError(
            f"cut-off {value:g} Hz: no log is long enough for it; valid: above {lowest:.3g} Hz"
        )
    if not 0 < value < nyquist:
        raise MotionError(
            f"{slowest.log.name}: cut-off {value:g} Hz; valid: above 0 and below {nyquist:.4g} Hz, "
            "half this log's rate, or none"
        )
    return value


def _check_torques(mechanism: Mechanism, signals: Signals) -> None:
    for name in mechanism.driven:
        if f"tau.{name}" not in signals.columns:
            has = [c for c in signals.columns if c.startswith("tau.")]
            raise MotionError(
                f"{signals.log.name}: joint '{name}' is driven, but there is no column 'tau.{name}'"
                f" ({one_of('tau.' + name, has or signals.columns)}); log it, map it in [log], or "
                f"put '{name}' among the passive joints"
            )


def _determining(mechanism: Mechanism, measured: list[Signals]) -> tuple[str, ...]:
    logged = [
        joint.name
        for joint in mechanism.joints
        if all(f"q.{joint.name}" in signals.columns for signals in measured)
    ]
    order = [name for name in logged if name in mechanism.driven] + logged
    names = independent_joints(mechanism, order)
    if len(names) == mechanism.degrees_of_freedom:
        return tuple(logged)
    if len(names) < mechanism.degrees_of_freedom:
        free = [
            joint.name
            for joint in mechanism.joints
            if joint.name not in logged
            and len(independent_joints(mechanism, [*names, joint.name])) > len(names)
        ]
        shown = ", ".join(f"q.{name}" for name in free) or "none"
        fewest = min(
            measured, key=lambda s: sum(f"q.{j.name}" in s.columns for j in mechanism.joints)
        )
        has = ", ".join(f"q.{name}" for name in logged) or "none"
        held = [f"q.{name}" for name in logged if not independent_joints(mechanism, [name])]
        fixed = f": the closures let {', '.join(held)} not move at all, check them" if held else ""
        raise MotionError(
            f"{fewest.log.name}: {mechanism.name} has {mechanism.degrees_of_freedom} degrees of "
            f"freedom, but the positions logged ({has}) determine only {len(names)}{fixed}; "
            f"log one more of: {shown}"
        )
    return names


def _checked_smoothing(spacing: float | str | None, measured: list[Signals]) -> float | str | None:
    if spacing is None or spacing == AUTO:
        return spacing
    finest = max(signals.dt for signals in measured)
    longest = min(float(signals.t[-1] - signals.t[0]) for signals in measured) / 2
    try:
        value = float(spacing)
    except (TypeError, ValueError):
        raise MotionError(
            f"smoothing {spacing!r}; valid: knots' spacing [s], 'auto' or none"
        ) from None
    if not finest <= value <= longest:
        raise MotionError(
            f"smoothing {value:g} s; valid: knots every {finest:.3g} s (one sample) to "
            f"{longest:.3g} s"
        )
    return value
