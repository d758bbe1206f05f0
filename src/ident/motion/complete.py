"""The verb `complete`: a log becomes the motion of the whole mechanism."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.errors import MotionError, one_of
from ident.log import Log, read_log
from ident.mechanism.mechanism import Mechanism
from ident.motion.band import band_of
from ident.motion.channels import Smoothed, channels_of
from ident.motion.clock import runs
from ident.motion.derive import AS_LOGGED, AUTO, derive, smoothed
from ident.motion.fuse import along, fused, missed, reweighted, through_motion
from ident.motion.independent import best_conditioned, independent_joints
from ident.motion.measure import Signals, measure
from ident.motion.motion import Band, Experiment, Motion
from ident.motion.place import disagreements, in_tree, reduced, through_closures
from ident.motion.rest import standstill
from ident.motion.spectrum import CLEAN, noise_level
from ident.motion.wrench import wrenches
from ident.progress import Told


def complete(
    mechanism: Mechanism,
    logs: Log | str | os.PathLike[str] | Sequence[Log | str | os.PathLike[str]],
    *,
    cutoff: float | str | None = "auto",
    torques: bool = True,
    smoothing: float | str | None = AUTO,
    progress: Told | None = None,
) -> Motion:
    """All positions, velocities and accelerations, completed through the closures.

    Args:
        mechanism: the mechanism.
        logs: one log or several (or their paths): separate experiments of the same mechanism.
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
        LogError: if a path cannot be read.
    """
    given = [logs] if isinstance(logs, Log | str | os.PathLike) else list(logs)
    if not given:
        raise MotionError(f"{mechanism.name}: no log given")
    read = _distinct([x if isinstance(x, Log) else read_log(x, mechanism.columns) for x in given])
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
        experiment, said = _experiment(mechanism, signals, names, band, smoothing)
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
    return Motion(tuple(experiments), independent, band, worst, noted, tuple(read))


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


def _experiment(
    mechanism: Mechanism,
    signals: Signals,
    names: tuple[str, ...],
    band: Band,
    smoothing: float | str | None,
) -> tuple[Experiment, list[str]]:
    n, log = len(signals.t), signals.log.name
    derived = derive(signals, names, band, smoothing)
    tau = np.zeros((n, len(mechanism.driven)))
    for i, name in enumerate(mechanism.driven):
        tau[:, i] = signals.columns.get(f"tau.{name}", 0.0)
    base = Experiment(
        name=log, t=signals.t, q=np.empty(0), v=np.empty(0), a=np.empty(0), y=np.empty(0),
        yd=np.empty(0), ydd=np.empty(0), tau=tau, wrench=None, pinv=None, leverage=None,
        usable=_without_ends(signals, derived.ends), still=np.empty(0), logged=names,
        independent=names,
        extra={k: x for k, x in signals.columns.items() if not k.startswith(("q.", "v.", "a."))},
        noise=_noise(mechanism, signals, names), smooth=derived.smooth,
        channels=tuple(derived.table),
    )  # fmt: skip
    place = through_closures if mechanism.closures else in_tree
    experiment = place(mechanism, base, names, derived.known)
    if len(names) > mechanism.degrees_of_freedom:
        notes = disagreements(mechanism, experiment, names, derived.known[0])
        if derived.smooth is not None:
            experiment = _together(mechanism, signals, experiment, band, smoothing)
    else:
        notes = []
    said: dict[str, list[str]] = {}
    for channel in experiment.channels:
        if channel.how != AS_LOGGED:
            said.setdefault(channel.how, []).append(channel.column)
    notes = [f"{log}: {', '.join(same)}: {how}" for how, same in said.items()] + notes
    if (lost := int((signals.usable & ~base.usable).sum())) > 0:
        notes.append(
            f"{log}: {lost} samples within {1e3 * derived.ends:.3g} ms of where splines end are "
            "left out"
        )
    return replace(experiment, wrench=wrenches(mechanism, signals, experiment)), notes


def _together(
    mechanism: Mechanism,
    signals: Signals,
    e: Experiment,
    band: Band,
    smoothing: float | str | None,
) -> Experiment:
    """More joints logged than needed, with noise: one smooth motion made by all their channels."""
    names = best_conditioned(mechanism, e.q)
    channels = channels_of(signals, e.logged)
    through = through_motion(mechanism, e, names)
    e = along(mechanism, e, smoothed(signals, through, names, band, smoothing)[0])
    smooth = fused(mechanism, e, channels)
    channels = reweighted(mechanism, along(mechanism, e, smooth), channels)
    smooth = fused(mechanism, along(mechanism, e, smooth), channels)
    e = along(mechanism, e, smooth)
    how = f"spline in {', '.join(names)}, knots {1e3 * smooth.spacing:.3g} ms"
    table = [
        Smoothed(c.column, how, c.sigma, float(np.sqrt(np.mean(off**2))), smooth.spacing)
        for c, off in zip(channels, missed(mechanism, e, channels), strict=True)
    ]
    return replace(e, channels=tuple(table))


def _noise(mechanism: Mechanism, signals: Signals, names: tuple[str, ...]) -> dict[str, float]:
    wanted = [f"{channel}.{name}" for name in names for channel in "qva"]
    wanted += [f"tau.{name}" for name in mechanism.driven]
    return {name: noise_level(signals.even(name)[0]) for name in wanted if name in signals.columns}


def _without_ends(signals: Signals, ends: float) -> np.ndarray:
    """Usable samples (n,) that are `ends` [s] away from both ends of their run, if any are."""
    usable = signals.usable.copy()
    for run in runs(signals.usable):
        t = signals.t[run]
        usable[run] = (t >= t[0] + ends) & (t <= t[-1] - ends)
    return usable if usable.any() else signals.usable
