"""Signals of a log on one uniform clock, and channels of the motion.

Columns may have gaps, empty cells, rates of their own and jittering time stamps; units and signs
that contradict each other are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ident.effects import Effect, Signals
from ident.effects.effect import SAMPLED
from ident.effects.servo import HOLD, Drive
from ident.errors import MotionError, one_of
from ident.log import Log
from ident.log.remember import once_a_series
from ident.mechanism.mechanism import Joint, Mechanism
from ident.motion.encodings import signed, unwrapped
from ident.motion.poses import check_declared, scalar_columns
from ident.motion.spline import ORDERS, Channel, grain, noise_level, quantile, rms
from ident.text import listed, shortlist

PREFIXES = ("q", "v", "a", "tau", "wrench")
LARGEST = 1e30  # range: in any unit; what some loggers write for "no value" lies beyond
# tuned: times the 99 % quantile of a signal's distance from its median: no sensor's range is so
# much larger than what it measures
ABSURD = 30.0
ENOUGH = 4000  # work: samples that show what is usual of a signal
LONE = 5  # range: samples: what differs so much for fewer than half of them is no measurement
UNEVEN = 1e-3  # numerics: jitter, as a share of the step, below which a clock counts as uniform
GAP = 5.0  # range: median steps without a sample that make a gap
SHORTEST = 12.0  # range: median steps that a run between two gaps must last to be used
SHARPEST = 1e-3  # numerics: noise of a derivative over that of what it derives, a log's length
MOVES_BEYOND = 100.0  # range: times the noise of a position over which it has moved
NO_MEASUREMENT = f"is no measurement: more than {ABSURD:g} times what is usual"
NIL = 1e-12  # numerics: rad, m and their rates: what moves less stands still, but for rounding
SPREAD_ROUNDING = 1e-9  # numerics: of its spread, or of 1 rad or m: no channel is trusted better
WINDOW = 0.01  # range: s; increments over it are compared, in which noise is small
CLIPPED = 0.005  # tuned: share of a torque's samples at an extreme, in runs of 3 or more
PILED = 5.0  # level: times as many at the extreme as one step below it; 2.4 where a sine turns
SLOW = 0.03  # tuned: share of a joint's top speed below which it is at rest, or about to reverse
REGULAR = 0.9  # tuned: share of the times that rows or a channel are held, which have one length
SWITCHED = 0.5  # level: share of all samples that are too many to be left out
# range: wrong units of logs in rad or m, and s, of joints that turn and of those that slide
RPM = "revolutions a minute"  # of a velocity alone
TURNING = {"degrees": np.pi / 180, "revolutions": 2 * np.pi, RPM: np.pi / 30}
SLIDING = {"millimetres": 1e-3}


@dataclass(frozen=True, eq=False)
class Clock:
    """The uniform clock of a whole log."""

    t0: float  # its first time [s]
    step: float  # [s]
    count: int  # of instants
    even: bool  # whether the log's own times are uniform, and taken as they are
    grid: int = 1  # instants between those at which parts may begin

    @classmethod
    def of(cls, log: Log) -> Clock:
        """The clock of a log's median step; its own times, where these are uniform."""
        count = round(log.duration / float(np.median(np.diff(log.t)))) + 1
        step = log.duration / (count - 1)
        uniform = log.t[0] + step * np.arange(count)
        even = count == len(log.t) and float(np.abs(uniform - log.t).max()) < UNEVEN * step
        return cls(float(log.t[0]), step, count, even)

    @property
    def t_end(self) -> float:
        """Its last time [s]."""
        return self.t0 + self.step * (self.count - 1)

    def within(self, log: Log) -> np.ndarray:
        """Its instants (n,) [s] within a part of the log."""
        if self.even:
            return np.asarray(log.t)
        first = self.grid * np.ceil((log.t[0] - self.t0) / self.step / self.grid - 1e-9)
        last = np.floor((log.t[-1] - self.t0) / self.step + 1e-9)
        return self.t0 + self.step * np.arange(first, last + 1)


def longest_step(at: np.ndarray) -> float:
    """Return the longest step of times [s] that is no gap: many times one that few exceed."""
    median, large = np.quantile(np.diff(at), (0.5, 0.9))
    return GAP * float(min(large, GAP * median))


def gaps(t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """True (n,) where t lies in a gap of a column that has samples at the times `at`."""
    longest = longest_step(at)
    step = longest / GAP
    right = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    outside = (t < at[0] - 0.5 * step) | (t > at[-1] + 0.5 * step)
    return outside | (at[right] - at[right - 1] > longest) & (
        np.minimum(np.abs(at[right] - t), np.abs(t - at[right - 1])) > 1e-9
    )


def runs(usable: np.ndarray) -> list[slice]:
    """The runs of true values (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


# --- signals -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LogSignals:
    """One log on a uniform clock."""

    log: Log
    t: np.ndarray  # (n,) [s]
    columns: Mapping[str, np.ndarray]  # by log name, each (n,), NaN nowhere
    usable: np.ndarray  # (n,), false inside gaps
    exact: bool  # whether the clock is the log's own
    notes: tuple[str, ...] = ()
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # torques end there

    @property
    def dt(self) -> float:
        """The step of the clock [s]."""
        return float(self.t[1] - self.t[0])

    @cached_property
    def _longest(self) -> slice:
        """The longest run."""
        return max(runs(self.usable), key=lambda run: run.stop - run.start)

    @cached_property
    def _clock_step(self) -> float:
        """The median step of the log's own times [s]."""
        return float(np.median(np.diff(self.log.t)))

    def _step_of(self, at: np.ndarray) -> float:
        """The median step of a column's times [s], most of which are those of the whole log."""
        return self._clock_step if len(at) == len(self.log.t) else float(np.median(np.diff(at)))

    @cached_property
    def _own_clock(self) -> bool:
        """Whether the clock's times are the log's."""
        return np.array_equal(self.t, self.log.t)

    @cached_property
    def _levels(self) -> dict[str, float]:
        return {}

    def noise(self, name: str) -> float:
        """The noise of a column (`spline.noise_level`), found once."""
        if name not in self._levels:
            self._levels[name] = noise_level(self.even(name)[0])
        return self._levels[name]

    def even(self, name: str) -> tuple[np.ndarray, float]:
        """A column (m,) in the longest run, uniform, no finer than its samples; its step [s]."""
        run = self._longest
        t, (at, x) = self.t[run], self.log.series(name)
        dt, step = float(t[1] - t[0]), self._step_of(at)
        if len(x) == len(self.t) and self._own_clock:
            return x[run], dt
        if step > 1.5 * dt:
            first, last = np.searchsorted(at, (t[0] - 0.5 * dt, t[-1] + 0.5 * dt))
            t, dt = np.arange(at[first], at[last - 1] + 1e-6 * step, step), step
        return np.interp(t, at, x), dt


def without_repeats(log: Log) -> Log:
    """The log with one row of those that are equal, where all are repeated, about as often.

    A logger that is faster than what it logs writes the same numbers several times. Of rows that
    stay equal for longer, as at rest, one is kept in as many.
    """
    every = np.array([x for name, x in log.columns.items() if is_signal(name)])
    if not len(every):
        return log
    equal = (every[:, 1:] == every[:, :-1]) | (np.isnan(every[:, 1:]) & np.isnan(every[:, :-1]))
    first = np.flatnonzero(np.append(True, ~equal.all(axis=0)))
    lengths = np.diff(first)
    usual = np.median(lengths) if len(lengths) >= SHORTEST else 1.0
    mean = lengths[lengths <= 1.5 * usual].mean() if usual >= 2 else 1.0
    if mean == 1.0 or (np.abs(lengths - mean) < 1).mean() < REGULAR:
        return log
    lengths = np.diff(np.append(first, len(log.t)))
    count = np.maximum(np.round(lengths / mean), 1).astype(int)  # rows that are kept of each run
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    rows = np.repeat(first, count) + np.floor(within * np.repeat(lengths / count, count)).astype(
        int
    )
    note = (
        f"each row is repeated, {mean:.3g} equal ones in a row: the first of them is kept, "
        f"{len(rows)} of {len(log.t)}"
    )
    columns = {name: x[rows] for name, x in log.columns.items()}
    return replace(log, t=log.t[rows], columns=columns, repairs=(*log.repairs, note))


def measure(
    mechanism: Mechanism,
    log: Log,
    clock: Clock | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> LogSignals:
    """A log's columns on a uniform clock of its median step; or, of a part of a log, on the `clock`
    and with the `limits` of torques of the whole, which was checked before.
    """
    columns = dict(log.columns)  # this robot's own names become ident's
    for name, source in mechanism.sources.items():
        if name != "t" and name not in columns and source.column in columns:
            columns[name] = source.scale * columns[source.column] + source.offset
    for source in mechanism.columns.values() if mechanism.motors else ():
        prefix, _, name = source.column.partition(".")  # of a joint, while it is a motor's column
        is_channel = prefix in PREFIXES and name in mechanism.joint_index
        if is_channel and source.column in log.columns and source.column not in mechanism.columns:
            columns.pop(source.column, None)
    check_declared(mechanism, log.name, columns)
    if mechanism.chains:
        scalar_columns(mechanism, log.name, log.t, columns)
    notes = list(log.repairs)
    for name in filter(is_signal, columns):
        if (lone := absurd_samples(columns[name])).size:
            k, others = lone[0], f" and {len(lone) - 1} more" if len(lone) > 1 else ""
            notes.append(
                f"{name} = {columns[name][k]:.4g} in row {k + 1} (t = {log.t[k]:.6g} s){others} "
                f"{NO_MEASUREMENT}; left out"
            )
            columns[name] = columns[name].astype(float)
            columns[name][lone] = np.nan
    for changed, remarks in (
        signed(columns, mechanism.sources),
        unwrapped(mechanism, log.t, columns, longest_step(log.t)),
    ):
        columns |= changed
        notes += remarks
    for name in mechanism.unmeasured:
        columns.pop(f"tau.{name}", None)
    if still := _rates_of_nothing(columns):
        notes.append(
            f"{listed(still)}: always 0 while the joint moves: no measurement; derived from the "
            "positions"
        )
    supplied = {
        name: _supplied(drive, log, columns)
        for name, drive in mechanism.drives.items()
        if f"tau.{name}" not in log.columns  # a sensor goes first
        if f"q.{name}" in columns and {*drive.reads()} <= {*columns}
    }
    columns |= {f"tau.{name}": x for name, x in supplied.items()}
    if mechanism.drives:
        step = np.full(len(log.t), float(np.median(np.diff(log.t))))
        columns |= {SAMPLED + name: step for name in supplied}
        columns |= {
            HOLD + name: 0.0 * step if drive.goes_straight(columns) else step
            for name, drive in mechanism.drives.items()
            if isinstance(drive, Drive)
        }
    limits = torque_limits(columns) if limits is None else limits
    notes += _without_limits(columns, limits)
    log = replace(log, columns=columns)
    names = [joint.name for joint in mechanism.joints]
    for column in columns:
        prefix, _, rest = column.partition(".")
        if prefix in ("q", "v", "a", "tau") and rest and rest not in {*names, *mechanism.locked}:
            notes.append(f"column '{column}' names no joint and is not used; {one_of(rest, names)}")
    own_clock = clock or Clock.of(log)
    t, even = own_clock.within(log), own_clock.even
    n, dt = len(t), float(np.median(np.diff(log.t)))
    step = np.diff(log.t)
    off = np.abs(step - dt)[step <= longest_step(log.t)]
    if not even and off.max(initial=0.0) > UNEVEN * dt:
        notes.append(
            f"time stamps are uneven (step {1e3 * dt:.4g} ms ± {1e3 * rms([off]):.2g} ms rms, "
            f"largest {1e3 * off.max():.3g} ms); everything is evaluated on a uniform clock of {n} "
            "samples"
        )
    in_gap = gaps(t, log.t)
    usable = ~in_gap
    if (count := int((~usable).sum())) > 0:
        holes = np.flatnonzero(step > longest_step(log.t))
        several = f"{len(holes)} gaps of up to" if len(holes) > 1 else "a gap of"
        first = log.t[holes].min(initial=np.inf)
        notes.append(
            f"{several} {step.max():.3g} s (first at t = {first:.4g} s): no sample near {count} of "
            f"{n} instants, which are left out"
        )
    columns, steps = {}, [dt]
    holes_of: dict[bytes, tuple[list[str], str]] = {}  # columns that are empty in the same rows
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
        if is_signal(name) and clock is None and len(x) < min(SHORTEST, n):
            raise MotionError(
                f"{log.name}: {name} has {len(x)} samples in {n} rows; valid: "
                f"{SHORTEST:.0f} or more, or leave out the column"
            )
        columns[name] = x if even and len(x) == n else np.interp(t, at, x)
        if not is_signal(name):
            continue
        complete = len(at) == len(log.t)  # its times are the log's: nothing to be found out again
        empty = in_gap if complete else gaps(t, at)
        steps.append(dt if complete else float(np.median(np.diff(at))))
        consequence = "values between are interpolated"
        if (count := int((empty & usable).sum())) > 0:
            consequence = (
                f"no sample near {count} of {n} instants (first at t = "
                f"{t[np.argmax(empty)]:.4g} s), which are left out"
            )
        holes_of.setdefault(np.isfinite(log.columns[name]).tobytes(), ([], consequence))[0].append(
            name
        )
        usable &= ~empty
    for rows, (names, consequence) in holes_of.items():
        if cells := rows.count(0):
            where = f"{shortlist(names)} {'are' if names[1:] else 'is'} empty in"
            notes.append(f"{where} {cells} of {len(rows)} rows: {consequence}")
    shortest = round(SHORTEST * max(steps) / (t[1] - t[0]))
    short = [run for run in runs(usable) if run.stop - run.start < min(shortest, n)]
    for run in short:
        usable[run] = False
    if short:
        count = sum(run.stop - run.start for run in short)
        notes.append(f"{count} samples in short runs between gaps are left out")
    if not usable.any() and clock is None:
        raise MotionError(
            f"{log.name}: no run of {shortest} instants at which all columns have samples; log "
            "all joints together, or remove columns that are mostly empty"
        )
    notes = [f"{log.name}: {note}" for note in notes]
    signals = LogSignals(log, t, columns, usable, even, tuple(notes), limits)
    for joint in mechanism.joints if clock is None else ():
        check_units(log.name, columns, signals.dt, joint)
    return signals


def _supplied(drive: Effect, log: Log, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the torque (n,) that a drive makes by the logged position, before the motion is known.

    Its scale is 1 where none is given.
    """
    q = columns[f"q.{drive.joints[0]}"][:, None]
    shape = {**dict.fromkeys((parameter.name for parameter in drive.shapes), 0.0), drive.scale: 1.0}
    v = np.gradient(q, log.t, axis=0)
    s = Signals(log.t, q, v, 0 * q, np.zeros(1), columns, {**shape, **drive.values})
    return drive.correction(s).torque[drive.joints[0]]


def _rates_of_nothing(columns: dict[str, np.ndarray]) -> list[str]:
    """Take out velocities that are always zero though the position moves, beyond its noise, where
    no acceleration says otherwise; return their names.
    """
    removed = []
    for name in [
        name for name in columns if name.startswith("v.") and f"a.{name[2:]}" not in columns
    ]:
        q = columns.get(f"q.{name[2:]}", np.zeros(0))
        q = q[np.isfinite(q)]
        moves = len(q) > 1 and np.ptp(q) > MOVES_BEYOND * max(noise_level(q), NIL)
        if moves and not np.nansum(abs(columns[name])):
            removed.append(name)
            del columns[name]
    return removed


def usual_range(x: np.ndarray) -> tuple[float, float]:
    """Median of a signal (n,), and the distance from it beyond which a sample is absurd."""
    x = x[:: -(-len(x) // ENOUGH)] if len(x) else x
    x = np.clip(x[np.isfinite(x)], -LARGEST, LARGEST)
    if not len(x):
        return 0.0, np.inf
    centre = quantile(x, 0.5)
    size = quantile(np.abs(x - centre), 0.99)
    return centre, ABSURD * size if size > 0 else np.inf


@once_a_series
def absurd_samples(x: np.ndarray) -> np.ndarray:
    """Places in a signal (n,) of lone samples that are absurdly far from all others."""
    centre, half_range = usual_range(x)
    x = np.clip(x, -LARGEST, LARGEST)
    with np.errstate(invalid="ignore"):  # NaN of any bits, as broken files hold
        far = np.flatnonzero(np.abs(x - centre) > half_range)
    around = [x[max(0, i - LONE // 2) : i + LONE // 2 + 1] for i in far]
    lone = [
        abs(x[i] - np.nanmedian(near)) > half_range for i, near in zip(far, around, strict=True)
    ]
    return far[np.array(lone, dtype=bool)]


@once_a_series
def at_limit(x: np.ndarray) -> np.ndarray:
    """Return where (n,) a torque (n,) stays at an extreme of its channel, not only turns there."""
    at_extreme = np.zeros(len(x), dtype=bool)
    for y in (x, -x):
        known = y[np.isfinite(y)]
        if not len(known) or not (known.max() > 0 and np.ptp(known) > 0):
            continue
        top = y == known.max()
        if top.sum() <= CLIPPED * len(known):
            continue
        below = (y == known[known < known.max()].max()).sum()
        if top.sum() > PILED * below:
            for run in runs(top):
                at_extreme[run] = run.stop - run.start >= 3
    return at_extreme if at_extreme.sum() > CLIPPED * len(x) else np.zeros(len(x), dtype=bool)


def torque_limits(columns: Mapping[str, np.ndarray]) -> dict[str, tuple[float, float]]:
    """Return the least and the largest value of each torque that stays at one of them."""
    torques = {name: x for name, x in columns.items() if name.startswith("tau.")}
    clipped = {name: x[at_limit(x.astype(float))] for name, x in torques.items()}
    return {
        name: (x.min() if x.min() < 0 else -np.inf, x.max() if x.max() > 0 else np.inf)
        for name, x in clipped.items()
        if len(x)
    }


def _without_limits(
    columns: dict[str, np.ndarray], limits: Mapping[str, tuple[float, float]]
) -> list[str]:
    """Empty the torques of moving joints at the limits of their channels; return what is said."""
    clipped_of = {}
    for name, (low, high) in limits.items():
        if name not in columns:
            continue
        clipped = (columns[name] <= low) | (columns[name] >= high)
        q = columns.get("q." + name.partition(".")[2], np.array([np.nan]))
        for run in runs(clipped):
            n = run.stop - run.start - 1
            if n > 1 and np.isfinite(q).all():
                travel = float(np.sqrt(np.mean((q[n:] - q[:-n]) ** 2)))
                clipped[run] = np.ptp(q[run]) > SLOW * travel
            elif n < 2:
                clipped[run] = False
        if clipped.any():
            clipped_of[name] = clipped
    if not clipped_of or np.any(list(clipped_of.values()), axis=0).mean() > SWITCHED:
        return []
    for name, clipped in clipped_of.items():
        columns[name] = np.where(clipped, np.nan, columns[name])
    return [
        f"{name} stays at an extreme in {clipped.sum()} of {len(clipped)} samples, where the range "
        "of its drive or its sensor may end; left out"
        for name, clipped in clipped_of.items()
    ]


def is_signal(name: str) -> bool:
    """Whether a column is motion, torque or wrench, without which a sample takes no part."""
    return name.split(".", 1)[0] in PREFIXES and "." in name


def check_units(name: str, columns: Mapping[str, np.ndarray], dt: float, joint: Joint) -> None:
    """Refuse q, v, a of a joint, on a clock of step dt [s], that disagree, and q in degrees."""
    for low, high in (("q", "v"), ("v", "a")):
        first, second = columns.get(f"{low}.{joint.name}"), columns.get(f"{high}.{joint.name}")
        if first is None or second is None:
            continue
        smooth = min(max(1, round(WINDOW / dt)), len(first) - 1)
        rise = first[smooth:] - first[:-smooth]
        area = np.cumsum(np.concatenate([[0.0], 0.5 * dt * (second[1:] + second[:-1])]))
        expected = area[smooth:] - area[:-smooth]
        lengths = float(np.linalg.norm(rise)), float(np.linalg.norm(expected))
        if not all(lengths):
            continue
        ratio = float(rise @ expected) / lengths[1] ** 2
        match = float(rise @ expected) / lengths[0] / lengths[1]
        where = f"{name}: {low}.{joint.name} and {high}.{joint.name} disagree"
        if match < -0.5:
            raise MotionError(f"{where}: one has the wrong sign; give it scale = -1 in [log]")
        if match > 0.8 and not 0.5 < ratio < 2.0:
            raise MotionError(
                f"{where} by a factor of {ratio:.4g}{_wrong_unit(ratio, low + high, joint)}; logs "
                "are in rad, m and s: give the wrong one a scale in [log] of mechanism.toml; if "
                "all joints are off by the same factor, give t one"
            )
    q, limit = columns.get(f"q.{joint.name}"), max(abs(joint.lower), abs(joint.upper))
    if q is None or not joint.rotational or not np.isfinite(limit):
        return
    most = float(np.abs(q).max())
    if most > 3.0 * limit and np.deg2rad(most) <= 1.2 * limit:
        raise MotionError(
            f"{name}: q.{joint.name} reaches {most:.4g}, beyond the joint's limit of "
            f"{limit:.4g} rad, and looks like degrees; logs are in rad: give it "
            "scale = 0.017453292519943295 in [log] of mechanism.toml (or the inverse of the gear "
            "ratio, if it is the motor's)"
        )


def _wrong_unit(ratio: float, letters: str, joint: Joint) -> str:
    """Return which of two channels, of which this ratio should be 1, may be in which unit."""
    off = {
        (letter, unit): abs(np.log(ratio * size**power))
        for unit, size in (TURNING if joint.rotational else SLIDING).items()
        for letter, power in zip(letters, (1, -1), strict=True)
        if letter == "v" or unit != RPM
    }
    letter, unit = near = min(off, key=off.__getitem__)
    return f" ({letter} in {unit}?)" if off[near] < 0.1 else ""


# --- channels of the motion ----------------------------------------------------------------------


def channels_of(signals: LogSignals, names: Sequence[str]) -> list[Channel]:
    """All motion channels that a log has of some joints."""
    channels: list[Channel] = []
    for name in names:
        for order, letter in enumerate(ORDERS):
            column = f"{letter}.{name}"
            if column not in signals.columns:
                continue
            t, x = signals.log.series(column)
            spread = float(np.std(x)) if float(np.ptp(x)) > NIL else 0.0
            sigma = max(signals.noise(column), float(grain(x) / np.sqrt(12.0)))
            sigma = max(sigma, SPREAD_ROUNDING * (spread or 1.0))
            if channels and channels[-1].joint == name:  # beside noisy positions no rate is exact
                sigma = max(sigma, SHARPEST * channels[-1].sigma / float(np.ptp(t)))
            channels.append(Channel(name, order, t, x, sigma, spread))
    return channels
