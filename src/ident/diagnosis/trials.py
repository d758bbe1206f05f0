"""Motions that could be logged next: wider, faster, slower, in strokes, joints one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.log import Log
from ident.mechanism.mechanism import Joint, Mechanism
from ident.motion import Motion

# --- waves ---------------------------------------------------------------------------------------
#
# y = c + h m(w t)        m: three sines of unrelated frequencies, or strokes with rounded ends


WAVES = ((1.0, 0.62, 0.3), (1.73, 0.3, 1.1), (2.91, 0.16, 2.3))  # range: frequency, share, phase
CORNER = 8.0  # range: steepness of a stroke's ends
Series = tuple[np.ndarray, np.ndarray, np.ndarray]  # y, ẏ, ÿ, each (n,)


def sines(low: float, high: float, speed: float, t: np.ndarray, pitch: float = 1.0) -> Series:
    """y, ẏ, ÿ (n,) between low and high, at up to `speed`."""
    fine = np.linspace(0.0, 60.0, 6001)
    shape, slope, _ = _waves(fine, pitch)
    h = (high - low) / (shape.max() - shape.min())
    w = speed / (h * np.abs(slope).max())
    m0, m1, m2 = _waves(w * t, pitch)
    return low + h * (m0 - shape.min()), h * w * m1, h * w**2 * m2


def _waves(x: np.ndarray, pitch: float) -> Series:
    f, a, p = np.array(WAVES).T[:, :, None] * [[[pitch]], [[1.0]], [[1.0]]]
    z = f * x + p
    return sum(a * np.sin(z)), sum(a * f * np.cos(z)), sum(-a * f**2 * np.sin(z))


def strokes(low: float, high: float, speed: float, t: np.ndarray, pitch: float = 1.0) -> Series:
    """y, ẏ, ÿ (n,) to and fro at constant speed, rounded at the ends."""
    w = pitch * speed * np.pi / (high - low)
    fine = np.linspace(0.0, 2 * np.pi, 4001)
    rate = np.tanh(CORNER * np.sin(fine))
    way = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine)))
    h = (high - low) / way.max()
    shape = np.tanh(CORNER * np.sin(w * t))
    bend = CORNER * np.cos(w * t) * (1 - shape**2)
    y = low + h * np.interp(np.mod(w * t, 2 * np.pi), fine, way)
    return y, h * w * shape, h * w**2 * bend


# --- trials --------------------------------------------------------------------------------------


LOG_SAMPLES = 600  # work: a log, or a third of that where a trial has several
APART = 0.137  # range: by which the frequencies of one joint differ from the next one's
SWINGS = 4  # range: of the slowest joint
CYCLES = 3  # range: there and back, in a log worth the name
MOST_CYCLES = 14  # range: of the fastest
LONGEST_STEP_OF_TIME = 0.2  # range: s a sample
SPEEDS = (0.05, 0.15, 0.5)  # range: of strokes, as shares of the top speed
SPEED_SHARE = 0.95  # range: of a limit of speed, above which no motion is proposed
MARGIN = 0.05  # range: of the way between two limits that is kept free
AWAKE = {True: (0.5, 1.0), False: (0.05, 0.1)}  # rotational: half range, speed of a joint at rest
ANOTHER_MOTION = 1.2  # range: times the present range or speed, from which a motion is another one


@dataclass(frozen=True)
class Move:
    """The motion of one joint: from `low` to `high` [rad | m], at up to `speed` [… / s]."""

    joint: Joint
    low: float
    high: float
    speed: float

    @property
    def half(self) -> float:
        """Half of its range [rad | m]."""
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True)
class Trial:
    """A motion that could be logged."""

    kind: str  # same, faster, speeds, turn, limits, wider, strokes, alone or awake
    moves: tuple[Move, ...]  # of every independent joint
    about: tuple[str, ...]  # the joints that move otherwise than now
    shares: tuple[float, ...] = (1.0,)  # of the speed, one log each

    @property
    def changed(self) -> tuple[Move, ...]:
        """The moves of these joints."""
        return tuple(m for m in self.moves if m.joint.name in self.about)

    def reached(self, m: Move) -> Move:
        """One of the moves with the range of its logs: passive joints limit it, perhaps."""
        q = np.concatenate([log.columns[f"q.{m.joint.name}"] for log in self.logs])
        return replace(m, low=float(q.min()), high=float(q.max()))

    @property
    def logs(self) -> list[Log]:
        """q, v and a of the independent joints, one log a speed."""
        n = LOG_SAMPLES if len(self.shares) == 1 else LOG_SAMPLES // 2
        return [_log(self, share, n, f"trial {i}") for i, share in enumerate(self.shares)]

    @property
    def seconds(self) -> float:
        """Duration in which the slowest joint goes to and fro often enough at each speed [s]."""
        once = max((2 * np.pi * m.half / m.speed for m in self.moves if m.speed), default=0.0)
        cycles = 1 if self.kind == "strokes" else CYCLES
        return cycles * once * sum(1 / share for share in self.shares)


def present(mechanism: Mechanism, motion: Motion) -> tuple[Move, ...]:
    """Return the motion of each independent joint, no faster than the URDF allows."""
    moves = []
    for name in motion.independent:
        at = mechanism.joint_index[name]
        y = np.concatenate([e.y[e.usable, at] for e in motion.experiments])
        top = max(np.quantile(np.abs(e.yd[e.usable, at]), 0.99) for e in motion.experiments)
        still = max(e.still[at] for e in motion.experiments)
        joint = mechanism.joint(name)
        speed = min(float(top), SPEED_SHARE * (joint.velocity or np.inf)) if top > still else 0.0
        moves.append(Move(joint, float(y.min()), float(y.max()), speed))
    return tuple(moves)


def trials(now: tuple[Move, ...], about: Sequence[str]) -> Iterator[Trial]:
    """The simplest first; `about` are the joints that are to move otherwise."""
    moving = tuple(move for move in now if move.speed > 0)
    names = tuple(m.joint.name for m in moving if m.joint.name in about) or tuple(
        m.joint.name for m in moving
    )
    yield Trial("same", now, names)
    factor = min([2.0, *(0.9 * m.joint.velocity / m.speed for m in moving)])
    quick = tuple(replace(m, speed=factor * m.speed) for m in now)
    if factor > ANOTHER_MOTION:
        yield Trial("faster", quick, names)
        yield Trial("speeds", quick, names, (0.25, 1.0))
    for moves in (now, quick) if factor > ANOTHER_MOTION else (now,):
        for kind in ("turn", "limits", "wider"):
            other = tuple(_wider(m, kind) if m.joint.name in names else m for m in moves)
            changed = tuple(m.joint.name for m, o in zip(now, other, strict=True) if m.low != o.low)
            if changed:
                yield Trial(kind, other, changed)
    yield Trial("strokes", now, names, SPEEDS)
    if len(moving) > 1:
        for name in names:
            alone = tuple(m if m.joint.name == name else replace(m, speed=0.0) for m in now)
            yield Trial("alone", alone, (name,))
    asleep = tuple(m.joint.name for m in now if not m.speed)
    if asleep:
        yield Trial("awake", tuple(_awake(m) for m in now), asleep)


def _wider(m: Move, kind: str) -> Move:
    """The same over a full turn about the middle of its range, or as near to that as limits allow,
    nearly from limit to limit where that is less than a turn, or over twice its range; as it is
    where that is hardly more.
    """
    lower, upper = m.joint.lower, m.joint.upper
    margin = MARGIN * (upper - lower)
    turns, able = m.joint.rotational and upper - lower >= 2 * np.pi - 1e-6, True
    if kind == "turn":
        middle = max(min(0.5 * (m.low + m.high), upper - np.pi), lower + np.pi)
        low, high, able = middle - np.pi, middle + np.pi, turns
    elif kind == "limits":
        low, high, able = lower + margin, upper - margin, bool(np.isfinite(margin)) and not turns
    else:
        low, high = m.low - m.half, m.high + m.half
        if np.isfinite(margin):
            low, high = max(low, lower + margin), min(high, upper - margin)
    return (
        replace(m, low=low, high=high)
        if able and high - low > ANOTHER_MOTION * (m.high - m.low)
        else m
    )


def _awake(m: Move) -> Move:
    """A joint at rest, moved a little within its limits."""
    if m.speed:
        return m
    half, speed = AWAKE[m.joint.rotational]
    low, high = max(m.low - half, m.joint.lower), min(m.high + half, m.joint.upper)
    return Move(m.joint, low, high, min(speed, 0.9 * m.joint.velocity))


def _log(trial: Trial, share: float, n: int, name: str) -> Log:
    """The trial's motion at a share of its speeds."""
    curve = strokes if trial.kind == "strokes" else sines
    moving = [m for m in trial.moves if m.speed > 0 and m.half > 0]
    pace = [share * m.speed / m.half for m in moving]  # [1/s] at which the phases run
    swings = SWINGS / 2 if curve is strokes else SWINGS
    T = min(2 * np.pi * swings / min(pace), 2 * np.pi * MOST_CYCLES / max(pace)) if pace else 1.0
    T = min(T, LONGEST_STEP_OF_TIME * n)
    t = np.linspace(0.0, T, n)
    columns = {}
    for i, m in enumerate(trial.moves):
        series: Series = np.full(n, 0.5 * (m.low + m.high)), np.zeros(n), np.zeros(n)
        if m in moving:
            series = curve(m.low, m.high, share * m.speed, t, 1 + APART * i)
        for channel, x in zip("qva", series, strict=True):
            columns[f"{channel}.{m.joint.name}"] = x
    return Log.from_arrays(name, t, columns)


# --- allowed -------------------------------------------------------------------------------------


SLACK = 1e-6  # numerics


def allowed(mechanism: Mechanism, now: Motion, then: Motion) -> bool:
    """Return whether a motion keeps all limits of the URDF that the present one keeps."""
    for i, joint in enumerate(mechanism.joints):
        for series, low, high in (
            ("y", joint.lower, joint.upper),
            ("yd", -joint.velocity, joint.velocity),
        ):
            before, after = (_extent(m, series, i) for m in (now, then))
            slack = SLACK * (1 + abs(after[0]) + abs(after[1]))
            if before[0] >= low and after[0] < low - slack:
                return False
            if before[1] <= high and after[1] > high + slack:
                return False
    for i, name in enumerate(mechanism.driven):
        was, is_ = (max(map(abs, _extent(m, "tau", i))) for m in (now, then))
        if was <= (most := mechanism.joint(name).effort) and is_ > most > 0:
            return False
    return True


def _extent(motion: Motion, series: str, i: int) -> tuple[float, float]:
    x = np.concatenate([getattr(e, series)[e.usable, i] for e in motion.experiments])
    return float(x.min()), float(x.max())
