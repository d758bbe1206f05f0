"""Poses of bodies as a log has them, and the scalar joints of the mechanism.

    base.x base.y base.z base.qx base.qy base.qz base.qw    of a floating base, or q.<joint>.x …
    q.<joint>.x … q.<joint>.w (or .qx … .qw)                orientation of a ball joint
    base.vx … base.vz, base.wx … base.wz                    rates, in the axes of the body

    R = R_i(α) R_j(β) R_k(γ)          ω = (R_j R_k)ᵀ e_i α̇ + R_kᵀ e_j β̇ + e_k γ̇

A quaternion and its negative are the same orientation. Angles are unwrapped here; the middle one
must stay away from ±90°, where the two others cannot be told apart. Of a body that tumbles a fourth
turn R_g(δ) is before them, and δ(t) a smooth path between the poses where that happens:

    R_g(δ)ᵀ R = R_i R_j R_k       min ∫ (tan² β_j(δ, t) + PACE δ̇²) dt, by dynamic programming
"""

from __future__ import annotations

import numpy as np

from ident.errors import MotionError
from ident.mechanism.chains import BASE, GIMBAL, ORDERS, Chain, angles_of
from ident.mechanism.mechanism import Mechanism
from ident.motion.body_rates import check_angular, check_linear, rotations

UNIT = 0.01  # range: by which the length of a quaternion may differ from 1
STEEPEST = np.radians(80.0)  # range: of the middle angle
JUMP = np.pi / 2  # range: [rad] between two samples that are no gap
LEVELS = 90  # work: of δ in a turn
GRID = 0.05  # work: [s] between the instants of δ's path
FASTEST = 4  # work: levels of δ from one instant to the next
PACE = 0.05  # range: [s²] weight of the speed of δ
KNOTS = 4  # work: instants of δ's path between knots of its spline
# range: [m], or of a quaternion: standard deviation of the pose of a base that stands
STANDS = 2e-3
XYZ = ("x", "y", "z")

Columns = dict[str, np.ndarray]


def check_declared(mechanism: Mechanism, log: str, columns: Columns) -> None:
    """Refuse a log in which a base moves that is the ground of the mechanism.

    Raises:
        MotionError: with what to declare.
    """
    if any(chain.floating for chain in mechanism.chains) or BASE in mechanism.locked:
        return
    pose = [f"{BASE}.{x}" for x in (*XYZ, "qx", "qy", "qz", "qw")]
    moving = [x for x in pose if x in columns and np.nanstd(columns[x].astype(float)) > STANDS]
    if moving:
        raise MotionError(
            f"{log}: {', '.join(moving)} change, and the root of {mechanism.name} is the ground: "
            'write base = { kind = "floating" } in mechanism.toml, or leave these columns out if '
            "it stands"
        )


def scalar_columns(
    mechanism: Mechanism, log: str, t: np.ndarray, columns: Columns, *, ordered: bool = True
) -> None:
    """Replace the columns of poses in a log by those of scalar joints.

    Args:
        mechanism: its `chains` are the ball and floating joints.
        log: its name, for messages.
        t: (n,) [s].
        columns: changed in place; each (n,), NaN in an empty cell.
        ordered: whether rows follow each other in time, so that a pose cannot jump.

    Raises:
        MotionError: for quaternions of another length than 1, that jump, or whose angles come near
            a pose at which they are not determined.
    """
    floating = [chain for chain in mechanism.chains if chain.floating]
    for chain in mechanism.chains:
        prefixes = [f"q.{chain.name}."]
        if chain.floating and (chain.name == BASE or len(floating) == 1):
            prefixes.insert(0, f"{BASE}.")
        R = None
        for prefix in prefixes:
            if chain.floating:
                for axis in XYZ:
                    if f"{prefix}{axis}" in columns:
                        columns[f"q.{chain.name}.{axis}"] = columns.pop(f"{prefix}{axis}")
            elif f"{prefix}w" in columns:
                for axis in (*XYZ, "w"):
                    if f"{prefix}{axis}" in columns:
                        columns[f"{prefix}q{axis}"] = columns.pop(f"{prefix}{axis}")
            quaternion = _taken(columns, prefix, ("qx", "qy", "qz", "qw"), log)
            if quaternion is not None:
                R = _rotations(quaternion, t, f"{log}: {prefix}qx … {prefix}qw", ordered)
                _add_angles(chain, R, t, columns, log, ordered)
        for prefix in (*prefixes, f"v.{chain.name}."):
            linear = _taken(columns, prefix, ("vx", "vy", "vz"), log)
            angular = _taken(columns, prefix, ("wx", "wy", "wz"), log)
            if linear is None and angular is None:
                continue
            angles = [columns.get(f"q.{name}") for name in chain.turns]
            if any(x is None for x in angles):
                raise MotionError(
                    f"{log}: {prefix}{'v' if angular is None else 'w'}x …: rates in the axes of a "
                    f"body need its orientation: log {prefixes[0]}qx … {prefixes[0]}qw"
                )
            turns = _turns(np.stack(angles, axis=1), chain.order)  # type: ignore[arg-type]
            rotation = turns[0] @ turns[1] @ turns[2]
            if chain.gimbal:
                turn = columns[f"q.{chain.name}.{GIMBAL}"]
                rotation = _turns(turn[:, None], chain.gimbal)[0] @ rotation
            if linear is not None:
                if ordered and all(f"q.{name}" in columns for name in chain.slides):
                    p = np.stack([columns[f"q.{name}"] for name in chain.slides], axis=1)
                    check_linear(f"{log}: {prefix}", t, p, rotation, linear)
                along = np.einsum("nij,nj->ni", rotation, linear)
                columns |= {f"v.{name}": x for name, x in zip(chain.slides, along.T, strict=True)}
            if angular is not None:
                if ordered:
                    check_angular(f"{log}: {prefix}", t, rotation, angular)
                if chain.gimbal:  # its own rate is prescribed
                    turn = columns[f"q.{chain.name}.{GIMBAL}"]
                    speed = np.gradient(turn, t)
                    columns[f"v.{chain.name}.{GIMBAL}"] = speed
                    about = (turns[0] @ turns[1] @ turns[2])[:, "xyz".index(chain.gimbal), :]
                    angular = angular - speed[:, None] * about
                rates = np.linalg.solve(_axes(turns, chain.order), angular[:, :, None])[:, :, 0]
                columns |= {f"v.{name}": x for name, x in zip(chain.turns, rates.T, strict=True)}


def _taken(columns: Columns, prefix: str, words: tuple[str, ...], log: str) -> np.ndarray | None:
    """Take columns (n, words) out; None where there is none of them."""
    present = [word for word in words if f"{prefix}{word}" in columns]
    if not present:
        return None
    if missing := [word for word in words if word not in present]:
        raise MotionError(
            f"{log}: has {prefix}{present[0]} without {', '.join(prefix + x for x in missing)}; "
            "log all of them"
        )
    return np.stack([columns.pop(f"{prefix}{word}") for word in words], axis=1).astype(float)


def _rotations(quaternion: np.ndarray, t: np.ndarray, where: str, ordered: bool) -> np.ndarray:
    """Return R (n, 3, 3) of quaternions (n, 4), x y z w; NaN where a cell is empty."""
    length = np.linalg.norm(quaternion, axis=1)
    off = np.abs(length - 1.0)
    if np.nanmax(off, initial=0.0) > UNIT:
        k = int(np.nanargmax(off))
        raise MotionError(
            f"{where} has the length {length[k]:.4g} at t = {t[k]:.6g} s; an orientation is a "
            "quaternion of length 1: check the columns, or leave such cells empty"
        )
    R = rotations(quaternion / length[:, None])
    known = np.flatnonzero(np.isfinite(length))
    cosine = np.abs(
        np.einsum("ni,ni->n", *(quaternion[known[i]] for i in (slice(1, None), slice(-1))))
    )
    step = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    usual = np.diff(t[known]) < 3 * np.median(np.diff(t[known]))
    if ordered and (jumps := np.flatnonzero((step > JUMP) & usual)).size:
        k = jumps[0]
        raise MotionError(
            f"{where} jumps by {np.degrees(step[k]):.3g}° at t = {t[known[k + 1]]:.6g} s; check "
            "the order of the columns (x y z w), or leave such cells empty"
        )
    return R


def _add_angles(
    chain: Chain, R: np.ndarray, t: np.ndarray, columns: Columns, log: str, ordered: bool
) -> None:
    known = np.isfinite(R[:, 0, 0])
    if chain.gimbal:
        turn = gimbal_path(R[known], t[known], chain, ordered)
        columns[f"q.{chain.name}.{GIMBAL}"] = np.full(len(R), np.nan)
        columns[f"q.{chain.name}.{GIMBAL}"][known] = turn
        R = R.copy()
        R[known] = _turns(turn[:, None], chain.gimbal)[0].transpose(0, 2, 1) @ R[known]
    angles = angles_of(R[known], chain.order)
    steepest = {order: float(np.abs(angles_of(R[known], order)[:, 1]).max()) for order in ORDERS}
    if steepest[chain.order] > STEEPEST:
        best = min(steepest, key=lambda order: steepest[order])
        k = int(np.abs(angles[:, 1]).argmax())
        what = (
            f"{log}: the {chain.order[1]} angle of '{chain.name}' comes to "
            f"{np.degrees(angles[k, 1]):.3g}° at t = {t[known][k]:.6g} s, and beyond 80° angles "
            "in this order are not determined"
        )
        key = "[base] order" if chain.name == BASE else f"[joints] order = {{ {chain.name} = …"
        remedy = f'{key}: "{best}" keeps it below {np.degrees(steepest[best]):.3g}°'
        if steepest[best] > STEEPEST:
            remedy = f'nor in any other: the body tumbles; {key}: "xzyx" has a fourth turn for that'
            if chain.gimbal:
                remedy = "nor with a fourth turn; cut the log where it does"
        raise MotionError(f"{what}; {remedy}")
    for name, x in zip(chain.turns, np.unwrap(angles, axis=0).T, strict=True):
        columns[f"q.{name}"] = np.full(len(R), np.nan)
        columns[f"q.{name}"][known] = x


def gimbal_path(R: np.ndarray, t: np.ndarray, chain: Chain, ordered: bool) -> np.ndarray:
    """Return δ (n,) [rad] of the turn before the three, smooth in time t (n,) if rows are
    `ordered`, so that the middle angle of the three stays small.
    """
    levels = 2 * np.pi * np.arange(LEVELS) / LEVELS
    i, _, k = ("xyz".index(axis) for axis in chain.order)
    around = _turns(levels[:, None], chain.gimbal)[0][:, :, i]  # R_g e_i, (levels, 3)
    grid = np.arange(t[0], t[-1] + GRID, GRID) if ordered else t
    near = np.clip(np.searchsorted(t, grid), 0, len(t) - 1)
    sine = np.clip(R[near][:, :, k] @ around.T, -0.9999, 0.9999)  # of the middle angle
    cost = 1.0 / (1.0 - sine**2) - 1.0
    if not ordered:
        return levels[cost.argmin(axis=1)]
    step = np.arange(-FASTEST, FASTEST + 1)
    speed = PACE * (step * 2 * np.pi / LEVELS / GRID) ** 2
    total, before = cost[0], np.zeros(cost.shape, dtype=int)
    for row in range(1, len(cost)):
        every = np.stack([np.roll(total, s) for s in step]) + speed[:, None]
        before[row] = every.argmin(axis=0)
        total = every.min(axis=0) + cost[row]
    path = np.empty(len(cost), dtype=int)
    path[-1] = at = int(total.argmin())
    for row in range(len(cost) - 1, 0, -1):
        at -= step[before[row, at % LEVELS]]
        path[row - 1] = at
    delta = path * 2 * np.pi / LEVELS
    if len(grid) < 3 * KNOTS:
        return np.full(len(t), delta.mean())
    from scipy.interpolate import make_lsq_spline  # takes 0.2 s to import

    inner = grid[KNOTS:-KNOTS:KNOTS]
    knots = np.concatenate([np.full(6, grid[0]), inner, np.full(6, grid[-1])])
    return np.asarray(make_lsq_spline(grid, delta, knots, k=5)(t))


def _turns(angles: np.ndarray, order: str) -> list[np.ndarray]:
    """Return the three rotations (n, 3, 3) of angles (n, 3)."""
    turns = []
    for angle, axis in zip(angles.T, order, strict=True):
        i = "xyz".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        R = np.zeros((len(angle), 3, 3))
        R[:, i, i] = 1.0
        R[:, j, j] = R[:, k, k] = np.cos(angle)
        R[:, k, j] = np.sin(angle)
        R[:, j, k] = -R[:, k, j]
        turns.append(R)
    return turns


def _axes(turns: list[np.ndarray], order: str) -> np.ndarray:
    """Return the axes (n, 3, 3) of the three turns in the body's axes, one a column."""
    i, j, k = ("xyz".index(axis) for axis in order)
    _, R_j, R_k = turns
    last = np.broadcast_to(np.eye(3)[k], (len(R_k), 3))
    return np.stack([(R_j @ R_k)[:, i, :], R_k[:, j, :], last], axis=2)
