"""Poses: rows of which each is an average over a mechanism at rest.

    q as logged        v = a = 0        no order: nothing is smoothed, filtered, differentiated

What holds a joint at rest is its torque and dry friction, of which only its limits are known: a row
is off by that, and rows are weighed by what they are off (`equations.rest`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.effects.servo import AS_IT_ACTS, HOLD
from ident.errors import MotionError
from ident.log import Log
from ident.log.poses import FEWEST_POSES
from ident.mechanism.mechanism import Mechanism
from ident.motion.poses import scalar_columns
from ident.motion.signals import LogSignals, check_units, is_signal
from ident.motion.smoothing import AS_LOGGED, Derived
from ident.motion.spline import ORDERS, Smoothed


def measure_poses(mechanism: Mechanism, log: Log) -> LogSignals:
    """Return the poses of a log that have all signals.

    Raises:
        MotionError: if too few are left.
    """
    columns = dict(log.columns)  # this robot's own names become ident's
    for name, source in mechanism.sources.items():
        if name != "t" and name not in columns and source.column in columns:
            columns[name] = source.scale * columns[source.column] + source.offset
    if mechanism.chains:
        scalar_columns(mechanism, log.name, log.t, columns, ordered=False)
    for name in mechanism.unmeasured:
        columns.pop(f"tau.{name}", None)
    columns = {name: x for name, x in columns.items() if np.isfinite(x).any()}
    complete_rows = np.ones(len(log.t), dtype=bool)
    for name, x in columns.items():
        if is_signal(name) and name.split(".")[0] not in ("v", "a"):
            complete_rows &= np.isfinite(x)
    count = int(complete_rows.sum())
    if count < FEWEST_POSES:
        raise MotionError(
            f"{log.name}: {count} poses have all positions and torques; at least {FEWEST_POSES} "
            "are needed: fill their cells, or leave out columns that are mostly empty"
        )
    notes = [*log.repairs]
    if lost := len(complete_rows) - count:
        notes.append(f"{lost} of {len(complete_rows)} poses have an empty cell and are left out")
    notes.append(
        f"{count} poses at rest, each a row: velocities and accelerations are 0, and what friction "
        "holds is left of the torques"
    )
    columns = {name: np.nan_to_num(x[complete_rows]) for name, x in columns.items()}
    for joint in mechanism.joints:
        at_rest = {name: x for name, x in columns.items() if name[:2] not in ("v.", "a.")}
        check_units(log.name, at_rest, 1.0, joint)
    # a pose's command is the one that holds it, however late a drive follows
    columns |= {HOLD + name: np.full(count, AS_IT_ACTS) for name in mechanism.drives}
    t = np.arange(count, dtype=float)
    notes_of_log = tuple(f"{log.name}: {note}" for note in notes)
    return LogSignals(log, t, columns, np.ones(count, dtype=bool), True, notes_of_log)


def rest_of(signals: LogSignals, names: Sequence[str]) -> Derived:
    """Return the coordinates of joints as logged; their rates and accelerations are 0."""
    known = np.zeros((len(ORDERS), len(signals.t), len(names)))
    known[0] = np.stack([signals.columns[f"q.{name}"] for name in names], axis=1)
    table = [Smoothed(f"q.{name}", AS_LOGGED, 0.0, 0.0) for name in names]
    return Derived(tuple(names), known, 0.0, None, table)
