"""From a log's columns to signals on one uniform clock, with every repair said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ident.errors import MotionError, one_of
from ident.log import Log
from ident.mechanism.mechanism import Joint, Mechanism

UNEVEN = 1e-3  # jitter, as a share of the step, below which a clock counts as uniform
GAP = 5.0  # median steps without a sample that make a gap
PREFIXES = ("q", "v", "a", "tau", "wrench")
FACTORS = {
    180 / np.pi: "degrees",
    np.pi / 180: "the other way round, radians taken for degrees",
    1e3: "millimetres or milliseconds",
    1e-3: "metres in a column of millimetres, or milliseconds",
    30 / np.pi: "revolutions a minute",
    np.pi / 30: "revolutions a minute",
    1 / (2 * np.pi): "revolutions",
}


@dataclass(frozen=True, eq=False)
class Signals:
    """One log on a uniform clock.

    Attributes:
        t: (n,) [s]; columns: by log name, each (n,), NaN nowhere; raw: (t, x) as logged.
        usable: (n,), false inside gaps.
        exact: whether `columns` are the log's own samples and not interpolated.
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


def measure(mechanism: Mechanism, log: Log) -> Signals:
    """A log's columns on a uniform clock of its median step.

    Raises:
        MotionError: if a column's unit or sign contradicts another column, or one that is needed
            is missing.
    """
    log = _mapped(mechanism, log)
    notes = [f"{log.name}: {repair}" for repair in log.repairs]
    notes += _unknown_names(mechanism, log)
    t, even = _clock(log)
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
    columns = {}
    for name in log.columns:
        at, x = log.series(name)
        if len(x) < 2:
            continue
        columns[name] = x if even and len(x) == n else np.interp(t, at, x)
        if _is_signal(name):
            holes = _holes(t, at)
            if (count := int((holes & usable).sum())) > 0:
                notes.append(
                    f"{log.name}: {name} has no sample near {count} of {n} instants "
                    f"(first at t = {t[np.argmax(holes)]:.4g} s); they are left out"
                )
            usable &= ~holes
            if len(x) < len(log.t):
                notes.append(
                    f"{log.name}: {name} is empty in {len(log.t) - len(x)} of {len(log.t)} rows; "
                    "values between are interpolated"
                )
    signals = Signals(log, t, columns, usable, even, tuple(notes))
    for joint in mechanism.joints:
        _check_scale(signals, joint)
    return signals


def _mapped(mechanism: Mechanism, log: Log) -> Log:
    """The log under ident's names, where it still has this robot's own."""
    columns = dict(log.columns)
    for name, source in mechanism.columns.items():
        if name != "t" and name not in columns and source.column in columns:
            columns[name] = source.scale * columns[source.column] + source.offset
    return Log(log.name, columns, log.t, log.repairs, log.sha256)


def _is_signal(name: str) -> bool:
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


def _clock(log: Log) -> tuple[np.ndarray, bool]:
    dt = float(np.median(np.diff(log.t)))
    count = round(log.duration / dt) + 1
    uniform = log.t[0] + log.duration / (count - 1) * np.arange(count)
    even = count == len(log.t) and float(np.abs(uniform - log.t).max()) < UNEVEN * dt
    return (np.asarray(log.t), True) if even else (uniform, False)


def _holes(t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """True where no sample is within GAP/2 of the column's own steps."""
    step = float(np.median(np.diff(at)))
    right = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    outside = (t < at[0] - 0.5 * step) | (t > at[-1] + 0.5 * step)
    return outside | (at[right] - at[right - 1] > GAP * step) & (
        np.minimum(np.abs(at[right] - t), np.abs(t - at[right - 1])) > 1e-9
    )


def _check_scale(signals: Signals, joint: Joint) -> None:
    columns, dt, name = signals.columns, signals.dt, signals.log.name
    for low, high in (("q", "v"), ("v", "a")):
        first, second = columns.get(f"{low}.{joint.name}"), columns.get(f"{high}.{joint.name}")
        if first is None or second is None or np.std(second) == 0 or np.std(first) == 0:
            continue
        smooth = max(1, round(0.01 / dt))  # compare increments over 10 ms, where noise is small
        rise = first[smooth:] - first[:-smooth]
        area = np.cumsum(np.concatenate([[0.0], 0.5 * dt * (second[1:] + second[:-1])]))
        expected = area[smooth:] - area[:-smooth]
        ratio = float(rise @ expected / (expected @ expected))
        match = float(rise @ expected / np.linalg.norm(rise) / np.linalg.norm(expected))
        where = f"{name}: {low}.{joint.name} and {high}.{joint.name} disagree"
        if match < -0.5:
            raise MotionError(f"{where}: one has the wrong sign; give it scale = -1 in [log]")
        if match > 0.8 and not 0.5 < ratio < 2.0:
            near = min(FACTORS, key=lambda factor: abs(np.log(abs(ratio) / factor)))
            guess = f" ({FACTORS[near]}?)" if abs(np.log(abs(ratio) / near)) < 0.1 else ""
            raise MotionError(
                f"{where} by a factor of {ratio:.4g}{guess}; logs are in rad, m and s: give the "
                "wrong one a scale in [log] of mechanism.toml"
            )
    q = columns.get(f"q.{joint.name}")
    if q is not None and joint.rotational and np.isfinite(joint.upper - joint.lower):
        most, reach = float(np.abs(q).max()), max(abs(joint.lower), abs(joint.upper))
        if most > 3.0 * reach and most * np.pi / 180 <= 1.2 * reach:
            raise MotionError(
                f"{name}: q.{joint.name} reaches {most:.4g}, beyond the joint's limit of "
                f"{reach:.4g} rad, and looks like degrees; logs are in rad: give it "
                "scale = 0.017453292519943295 in [log] of mechanism.toml"
            )
