"""Commands of drives as a log has them: what cannot be one, and how they are held.

A command that cannot be that of its joint would be fitted by a wrong gain, so it is refused before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.effects import Effect
from ident.effects.servo import Servo
from ident.errors import MotionError
from ident.information import linear
from ident.mechanism.mechanism import Mechanism
from ident.motion.recipe import ROWS_OVER_MOTION_LEAST
from ident.motion.spline import motion_bandwidth
from ident.motion.state import State
from ident.text import listed, percent

DEGREES = (40.0, 80.0)  # range: slope of a command over its position that is one of degrees, 57.3
ALIKE = 0.9  # level: correlation of a command with the position that follows it …
UNLIKE = 0.5  # level: … and below which it is that of another joint
LONGEST_DELAY = 0.1  # range: share of a log by which a drive may be late
SLOW = 0.2  # range: share of a command's squares that is its slowest part
# range: [rad] 10° at least by which a servo above its resonance is ahead of −1 times its command;
# a feedforward 2 ms ahead reaches it at 14 Hz
CLEARLY_AHEAD = 0.175
FULL = 1.0 + 1e-6  # numerics: largest duty
SATURATED = 0.98  # level: share of samples at the limit from which no gain shows
ON_ABOVE = 0.5  # range: `on.` below it is off
# level: of the way of a joint whose command changes: one that goes less far with a constant one is
# held by its drive, one that goes farther has another command
STANDS = 0.2
SERVO_COLUMNS = ("ref", "dref", "feedforward", "kp", "on")  # of a joint


def check_commands(
    mechanism: Mechanism, log: str, t: np.ndarray, columns: Mapping[str, np.ndarray]
) -> list[str]:
    """Refuse commands and settings of drives that cannot be those of their joints; return notes on
    those that hold their joint still while others move.

    Args:
        mechanism: with drives.
        log: its name; t: (n,) [s]; columns: (n,) each, by ident's names.

    Raises:
        MotionError: one line: which column, what was found, and what to write.
    """
    drives = mechanism.drives
    for name in drives:
        for gain in ("kp", "kd", "on"):
            others = [f"{gain}.{other}" for other in drives if f"{gain}.{other}" in columns]
            if others and f"{gain}.{name}" not in columns and f"ref.{name}" in columns:
                raise MotionError(
                    f"{log}: there is {listed(others[:3])}, and no '{gain}.{name}'; log it for "
                    "every drive, or leave the column out for all"
                )
            if gain != "on" and f"{gain}.{name}" in columns:
                _check_gain(log, name, gain, columns)
    still = _standing(mechanism, columns)
    for drive in drives.values():
        late = drive.values.get("delay", 0.0)
        if late > LONGEST_DELAY * (t[-1] - t[0]):
            raise MotionError(
                f"{log}: {drive.label}: delay = {late:g} s is more than a tenth of the log's "
                f"{t[-1] - t[0]:.3g} s; a delay is in s, usually 0.001 to 0.05"
            )
        for column in drive.reads():
            if column in columns:
                _check_command(mechanism, log, drive, column, columns, still)
        _check_saturation(log, drive, columns)
    _check_on(mechanism, log, columns)
    return [
        f"{log}: {column} never changes and {name} stands still: its gain shows in the load it "
        "carries alone"
        for name, column in still.items()
    ]


def _check_gain(log: str, name: str, gain: str, columns: Mapping[str, np.ndarray]) -> None:
    column, x = f"{gain}.{name}", columns[f"{gain}.{name}"]
    known = x[np.isfinite(x)]
    least = known.min(initial=0.0)
    if least < 0:
        raise MotionError(
            f"{log}: {column} reaches {least:.4g}; a gain is 0 or more: check which column it is, "
            f'or write [log] "{column}" = {{ column = "…", scale = -1 }}'
        )
    others = (columns.get(f"{other}.{name}") for other in ("kd", "feedforward"))
    if gain == "kp" and not known.any() and not any(x is not None and x.any() for x in others):
        raise MotionError(
            f"{log}: {column} is 0 in all samples, so its drive has no torque; log the gain that "
            f"was set, leave out the columns kp., or write on.{name} = 0 where the drive is off"
        )


def _standing(mechanism: Mechanism, columns: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Return joints that stand still at a command that never changes, with its column; none if no
    command changes.
    """
    ways, still = dict[bool, float](), dict[str, str]()
    constant = dict[str, str]()
    for name, drive in mechanism.drives.items():
        column, turns = drive.reads()[0], mechanism.joint(name).rotational
        if column in columns and f"q.{name}" in columns:
            if _way(columns[column]) > 0:
                ways[turns] = max(ways.get(turns, 0.0), _way(columns[f"q.{name}"]))
            else:
                constant[name] = column
    for name, column in constant.items() if ways else ():
        farthest = ways.get(mechanism.joint(name).rotational, max(ways.values()))
        if _way(columns[f"q.{name}"]) < STANDS * farthest:
            still[name] = column
    return still


def _way(x: np.ndarray) -> float:
    """Return how far the values (n,) of a column that are known lie apart."""
    known = x[np.isfinite(x)]
    return float(np.ptp(known)) if len(known) else 0.0


def _check_command(
    mechanism: Mechanism,
    log: str,
    drive: Effect,
    column: str,
    columns: Mapping[str, np.ndarray],
    still: Mapping[str, str],
) -> None:
    kind, _, name = column.partition(".")
    x = columns[column]
    known = x[np.isfinite(x)]
    if not len(known):
        raise MotionError(f"{log}: column '{column}' has no value in any of {len(x)} rows")
    if np.ptp(known) == 0 and name in still:
        return
    if np.ptp(known) == 0:
        raise MotionError(
            f"{log}: {column} is always {known[0]:.4g}: a drive whose command never changes shows "
            "no gain; log the command that it was sent, in a motion"
        )
    if kind == "duty" and np.abs(known).max() > FULL:
        most = np.abs(known).max()
        raise MotionError(
            f"{log}: {column} reaches {most:.4g}; a duty is a share of the supply, -1 to 1: write "
            f'[log] "{column}" = {{ column = "…", scale = {_share(most):g} }}'
        )
    q = columns.get(f"q.{name}")
    if kind != "ref" or q is None:
        return
    likeness, slope = _correlation(x, q)
    joint = mechanism.joint(name)
    if joint.rotational and likeness > ALIKE and DEGREES[0] < slope < DEGREES[1]:
        raise MotionError(
            f"{log}: {column} is {slope:.3g} times q.{name}: in degrees, not in rad; write [log] "
            f'"{column}" = {{ column = "…", scale = 0.017453293 }}'
        )
    if likeness < -ALIKE and _follows_turned(x, q):
        raise MotionError(
            f"{log}: {column} is against q.{name} (correlation {likeness:.2f}): its sign is "
            f'another; write [log] "{column}" = {{ column = "…", scale = -1 }}'
        )
    others = {
        other: _correlation(x, columns[f"q.{other}"])[0]
        for other in mechanism.drives
        if other != name and f"q.{other}" in columns
    }
    nearest = max(others, key=lambda other: others[other], default="")
    if likeness < UNLIKE and nearest and others[nearest] > ALIKE:
        raise MotionError(
            f"{log}: {column} is not followed by q.{name} (correlation {likeness:.2f}) but by "
            f"q.{nearest} ({others[nearest]:.2f}): it is the command of another joint; map it in "
            f'[log] "ref.{nearest}" = "{column}"'
        )


def _share(most: float) -> float:
    """Return the scale of a duty in percent, in counts of 8 to 16 bit, or over its largest."""
    full = next((x for x in (100.0, 255.0, 1000.0, 1023.0, 4095.0, 32767.0) if most <= x), most)
    return float(f"{1 / full:.6g}")


def _check_saturation(log: str, drive: Effect, columns: Mapping[str, np.ndarray]) -> None:
    name, values = drive.joints[0], drive.values
    ref, q = columns.get(f"ref.{name}"), columns.get(f"q.{name}")
    if "kp" not in values or "limit" not in values or ref is None or q is None:
        return
    gain = columns.get(f"kp.{name}", np.ones(len(q)))
    error = np.abs(values["kp"] * gain * (ref - q))
    error = error[np.isfinite(error)]
    at_limit = float((error >= values["limit"]).mean()) if len(error) else 0.0
    if at_limit > SATURATED:
        raise MotionError(
            f"{log}: {drive.label} is at its limit of {values['limit']:g} in "
            f"{percent(at_limit)} of the samples, so its command shows no torque; check limit and "
            "kp, or command a smaller motion"
        )


def _check_on(mechanism: Mechanism, log: str, columns: Mapping[str, np.ndarray]) -> None:
    names = [name for name in mechanism.drives if f"on.{name}" in columns]
    known = np.setdiff1d(mechanism.bodies.names, mechanism.unknown)
    has_mass = any(mechanism.prior[mechanism.bodies.names.index(name)] for name in known)
    off = [name for name in names if not (columns[f"on.{name}"] > ON_ABOVE).any()]
    if off and len(off) == len(mechanism.driven) and not has_mass:
        raise MotionError(
            f"{log}: all drives are off throughout and no body is known, so everything is free up "
            "to one factor; give a known body ([parameters] unknown without its link), or a log "
            "with the drives on"
        )


def _follows_turned(x: np.ndarray, q: np.ndarray) -> bool:
    """Return whether a position (n,) follows a command (n,) times −1 in the command's slowest part:
    above its resonance a servo goes against its command too, but clearly ahead of −1 times it.
    """
    both = np.isfinite(x) & np.isfinite(q)
    X, Q = (np.fft.rfft(y[both] - y[both].mean()) for y in (x, q))
    power = np.cumsum(np.abs(X) ** 2)
    slow = slice(0, int(np.searchsorted(power, SLOW * power[-1])) + 1)
    against = -complex(np.vdot(X[slow], Q[slow]))
    return against.real > 0 and bool(np.angle(against) < CLEARLY_AHEAD)


def _correlation(x: np.ndarray, q: np.ndarray) -> tuple[float, float]:
    """Return the correlation of a command with a position, and the slope of the first over it."""
    both = np.isfinite(x) & np.isfinite(q)
    x, q = x[both] - x[both].mean(), q[both] - q[both].mean()
    squares = float(q @ q), float(x @ x)
    if min(squares) <= 0:
        return 0.0, 0.0
    return float(x @ q / np.sqrt(squares[0] * squares[1])), float(x @ q / squares[0])


def servo_cutoff(mechanism: Mechanism, experiments: Sequence[State]) -> float | None:
    """Return the cut-off [Hz] of rows beyond which servos follow nothing; None where some torque
    is not that of a position servo, or where a servo's bandwidth does not show.

    The noise of such rows is that of positions alone, |kp − M ω²| times as large in N m: beyond the
    servo's own √(kp / M) they hold noise of accelerations, which shrinks inertia and damping, and
    nothing that a command made. That is the weight of an error of the motion, which the servo's
    response filters, M q̈ + kd q̇ + kp q = kp ref. M / kp is the share of q̈ in ref − q, beside speed,
    dry friction and gravity of the joint itself. No less passes than twice what commands reach.
    """
    drives = mechanism.drives
    if not drives or {*drives} != {*mechanism.driven}:
        return None
    bands = []
    for name, drive in drives.items():
        if not isinstance(drive, Servo) or name not in mechanism.joint_index:
            return None
        at, largest = mechanism.joint_index[name], 0.0
        rows, errors = list[np.ndarray](), list[np.ndarray]()
        for e in experiments:
            if e.poses or f"ref.{name}" not in e.extra:
                return None
            named = {key: e.extra.get(f"{key}.{name}") for key in SERVO_COLUMNS}
            x = {key: series for key, series in named.items() if series is not None}
            used = e.usable & (x.get("on", np.ones(len(e))) > ON_ABOVE)
            q, v, a = e.y[:, at], e.yd[:, at], e.ydd[:, at]
            gain = x.get("kp", np.ones(len(e)))
            largest = max(largest, float(gain[used].max(initial=0.0)))
            columns = [a, v, np.sign(v), np.ones(len(q)), np.sin(q), np.cos(q)]
            columns += [x[key] for key in ("dref", "feedforward") if key in x]
            rows.append(np.stack(columns, axis=1)[used])
            errors.append((gain * (x["ref"] - q))[used])
            bands.append(ROWS_OVER_MOTION_LEAST * motion_bandwidth(x["ref"], 1 / e.rate, 0))
        if len({part.shape[1] for part in rows}) > 1:
            return None
        share = float(linear.lstsq(np.concatenate(rows), np.concatenate(errors), rcond=1e-9)[0][0])
        if min(share, largest) <= 0:
            return None
        bands.append(float(np.sqrt(largest / share)) / (2 * np.pi))
    return max(bands)
