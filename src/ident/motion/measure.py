"""From a log's columns to signals on one uniform clock, with every repair said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ident.errors import MotionError, one_of
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion.clock import SHORTEST, at_own_rate, holes, runs, uniform_clock, without_short_runs
from ident.motion.decided import Decided
from ident.motion.units import check_units

LARGEST = 1e30  # in any unit; what some loggers write for "no value" lies beyond
PREFIXES = ("q", "v", "a", "tau", "wrench")


@dataclass(frozen=True, eq=False)
class Signals:
    """One log on a uniform clock.

    Attributes:
        t: (n,) [s]; columns: by log name, each (n,), NaN nowhere; raw: (t, x) as logged.
        usable: (n,), false inside gaps.
        exact: whether the clock is the log's own.
    """

    log: Log
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    usable: np.ndarray
    exact: bool
    notes: tuple[str, ...] = field(default=())

    @property
    def dt(self) -> float:
        """The step of the clock [s]."""
        return float(self.t[1] - self.t[0])

    def even(self, name: str) -> tuple[np.ndarray, float]:
        """A column (m,) in the longest run, uniform, no finer than its samples; its step [s]."""
        longest = max(runs(self.usable), key=lambda run: run.stop - run.start)
        return at_own_rate(self.t[longest], *self.log.series(name))


def measure(mechanism: Mechanism, log: Log, decided: Decided | None = None) -> Signals:
    """A log's columns on a uniform clock of its median step.

    Args:
        mechanism: the mechanism.
        log: the log, or a part of one.
        decided: of a part: what the whole log has decided, and has been checked for.

    Raises:
        MotionError: if a column's unit or sign contradicts another column, or one that is needed
            is missing.
    """
    log = _mapped(mechanism, log)
    notes = [f"{log.name}: {repair}" for repair in log.repairs]
    notes += _unknown_names(mechanism, log)
    t, even = uniform_clock(log)
    if decided is not None:
        t, even = decided.clock.within(log), decided.clock.even
    n = len(t)
    largest, rms = log.jitter
    dt = float(np.median(np.diff(log.t)))
    if not even:
        notes.append(
            f"{log.name}: time stamps are uneven (step {1e3 * dt:.4g} ms ± {1e3 * rms:.2g} ms rms, "
            f"largest {1e3 * largest:.3g} ms); everything is evaluated on a uniform clock of "
            f"{n} samples"
        )
    usable = np.ones(n, dtype=bool)
    columns, steps = {}, [dt]
    for name in log.columns:
        at, x = log.series(name)
        if is_signal(name) and (absurd := np.abs(x) > LARGEST).any():
            k = int(absurd.argmax())
            raise MotionError(
                f"{log.name}: {name} = {x[k]:.4g} at t = {at[k]:.6g} s is no measurement; leave "
                "the cell empty where there is no value"
            )
        if len(x) < 2:
            continue
        columns[name] = x if even and len(x) == n else np.interp(t, at, x)
        if is_signal(name):
            empty = holes(t, at)
            steps.append(float(np.median(np.diff(at))))
            if (count := int((empty & usable).sum())) > 0:
                notes.append(
                    f"{log.name}: {name} has no sample near {count} of {n} instants "
                    f"(first at t = {t[np.argmax(empty)]:.4g} s); they are left out"
                )
            usable &= ~empty
            if len(x) < len(log.t):
                notes.append(
                    f"{log.name}: {name} is empty in {len(log.t) - len(x)} of {len(log.t)} rows; "
                    "values between are interpolated"
                )
    shortest = round(SHORTEST * max(steps) / (t[1] - t[0]))
    long = without_short_runs(usable, min(shortest, n))
    if not long.any() and decided is None:
        raise MotionError(
            f"{log.name}: no run of {shortest} instants at which all columns have samples; log "
            "all joints together, or remove columns that are mostly empty"
        )
    if (count := int((usable & ~long).sum())) > 0:
        notes.append(f"{log.name}: {count} samples in short runs between gaps are left out")
    signals = Signals(log, t, columns, long, even, tuple(notes))
    for joint in mechanism.joints if decided is None else ():
        check_units(log.name, columns, signals.dt, joint)
    return signals


def _mapped(mechanism: Mechanism, log: Log) -> Log:
    """The log under ident's names, where it still has this robot's own."""
    columns = dict(log.columns)
    for name, source in mechanism.columns.items():
        if name != "t" and name not in columns and source.column in columns:
            columns[name] = source.scale * columns[source.column] + source.offset
    return Log(log.name, columns, log.t, log.repairs, log.sha256)


def is_signal(name: str) -> bool:
    """Whether a column is motion, torque or wrench, without which a sample takes no part."""
    return name.split(".", 1)[0] in PREFIXES and "." in name


def _unknown_names(mechanism: Mechanism, log: Log) -> list[str]:
    notes = []
    names = [joint.name for joint in mechanism.joints]
    for column in log.columns:
        prefix, _, rest = column.partition(".")
        if prefix in ("q", "v", "a", "tau") and rest and rest not in names:
            notes.append(
                f"{log.name}: column '{column}' names no joint and is not used; "
                f"{one_of(rest, names)}"
            )
    return notes
