"""Poses of a body that were read in another way than they were written.

Forces that are known, on a base that floats, hold a pose to its word: with the world's axes of the
slides, the base's acceleration a and gravity g, of the forces f in these axes there is left

    r = min over M  |f − M (a − g)| / |f|       f = R F,   F in the axes of the base

and of another reading of R (order of a quaternion, its inverse), of g, or of the time of f far less
where that is the right one. A share of r stays where limbs move beside the base, or air resists.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.effects import Signals
from ident.errors import MotionError
from ident.log import Log
from ident.mechanism.chains import BASE, Chain
from ident.mechanism.mechanism import Mechanism
from ident.motion.body_rates import rotations, turned
from ident.motion.state import State

ORDER_READ, ORDER_SCALAR_FIRST = "x y z w", "w x y z"
MISREAD = 0.1  # range: r from which on another reading is looked for
BETTER = 0.5  # range: r of another reading over that of the log's, below which it is the right one
LATEST = 0.5  # range: [s] of a pose behind the forces, or before them
FINEST = 50  # work: times on either side that are tried
EARLIEST = 2  # range: samples: less is no other clock
LOOKED_AT = 4000  # work: samples of a log
SLOW = 1e-9  # numerics: rad/s, m/s: nothing stands still
XYZ = ("x", "y", "z")


def check_base(mechanism: Mechanism, states: Sequence[State], logs: Sequence[Log]) -> None:
    """Refuse logs whose pose of a floating base and whose forces agree in another reading only.

    Raises:
        MotionError: with the reading that would agree.
    """
    chain = next((chain for chain in mechanism.chains if chain.floating), None)
    if chain is None or mechanism.closures or not np.any(mechanism.model.gravity.linear):
        return
    for e, log in zip(states, logs, strict=True):
        if e.poses or not e.usable.any():
            continue
        force = _forces(mechanism, e, chain)
        if force is not None and (text := _misread(mechanism, e, log, chain, force)):
            raise MotionError(f"{e.name}: {text}")


def _forces(mechanism: Mechanism, e: State, chain: Chain) -> np.ndarray | None:
    """Return f (n, 3) along the slides, of wrenches and of effects that depend on logged inputs,
    with factors of 1 where they have none; None where there is no force.
    """
    at = [mechanism.joint(name).index for name in chain.slides]
    total = np.zeros((len(e), 3))
    if e.wrench is not None:
        total += e.wrench[:, at]
    known = np.any(total)
    for effect in mechanism.effects:
        if effect.sits != "frame" or not effect.reads() or {*effect.reads()} - {*e.extra}:
            continue
        if known and not effect.known:
            return None  # a size that is open beside one that is not
        if effect.shapes:
            continue
        names = [*effect.acting]
        joints = [mechanism.joint_index[name] for name in names]
        q, v, a = (x[:, joints] for x in (e.y, e.yd, e.ydd))
        still = np.full(len(names), SLOW)
        columns = effect.columns(Signals(e.t, q, v, a, still, dict(e.extra)))
        factors = [dict(effect.values).get(x.name, 1.0) for x in effect.unknowns]
        where = [names.index(name) for name in chain.slides if name in names]
        if len(where) == len(at):
            total -= columns[:, where] @ np.array(factors)
    return total if np.any(total) else None


def _misread(mechanism: Mechanism, e: State, log: Log, chain: Chain, force: np.ndarray) -> str:
    used = np.flatnonzero(e.usable)
    used = used[:: max(1, len(used) // LOOKED_AT)]
    at = [mechanism.joint_index[name] for name in chain.slides]
    a, gravity = e.ydd[:, at], np.array(mechanism.model.gravity.linear)
    f, pull = force[used], a[used] - gravity
    share = _unexplained(f, pull)
    if share < MISREAD:
        return ""
    readings: dict[str, float] = {}
    raw = _quaternion(log, chain, e.t)
    if raw is not None:
        R = rotations(raw)[used]
        body = np.einsum("nji,nj->ni", R, f)
        scalar_first = rotations(np.roll(raw, -1, axis=1))[used]
        readings[
            f"its columns are in the order {ORDER_SCALAR_FIRST}, and {ORDER_READ} is asked; rename "
            "the first one qw and the others qx qy qz"
        ] = _unexplained(turned(scalar_first, body), pull)
        readings[
            "it turns the world into the body, and the body's orientation in the world is asked; "
            "change the signs of qx qy qz"
        ] = _unexplained(turned(R.transpose(0, 2, 1), body), pull)
    size = float(np.linalg.norm(gravity))
    for axis in range(3):
        for sign in (1.0, -1.0):
            other = np.zeros(3)
            other[axis] = sign * size
            if not np.allclose(other, gravity):
                words = ", ".join(f"{x:.4g}" for x in other)
                readings[
                    "it is in other axes of the world than gravity and the joints; write gravity "
                    f"= [{words}] in mechanism.toml if its axes are meant, or turn it"
                ] = _unexplained(f, a[used] - other)
    late, least = _lateness(e, force, a - gravity, None if raw is None else rotations(raw))
    if abs(late) >= EARLIEST / e.rate:
        readings[
            f"it is {abs(late):.3g} s {'behind' if late > 0 else 'before'} the forces, by another "
            "clock; bring both to one"
        ] = least
    best = min(readings, key=lambda text: readings[text])
    if readings[best] > BETTER * share:
        return ""
    return (
        f"the pose of '{chain.name}' and the forces on it contradict each other ({share:.0%} of "
        f"the forces are left, {readings[best]:.0%} if so): {best}"
    )


def _unexplained(f: np.ndarray, pull: np.ndarray) -> float:
    """Return r of forces f (n, 3) and a − g (n, 3)."""
    mass = max(float((f * pull).sum() / max((pull**2).sum(), 1e-300)), 0.0)
    return float(np.sqrt(((f - mass * pull) ** 2).sum() / (f**2).sum()))


def _lateness(
    e: State, force: np.ndarray, pull: np.ndarray, R: np.ndarray | None
) -> tuple[float, float]:
    """Return by how much the pose is behind the forces [s], and r with that taken off."""
    farthest = int(LATEST * e.rate)
    body = force if R is None else turned(R.transpose(0, 2, 1), force)
    best = 0, np.inf
    for k in range(-farthest, farthest + 1, max(1, farthest // FINEST)):
        n = len(force) - abs(k)
        if n < len(force) // 2:
            continue
        early, late = slice(max(-k, 0), max(-k, 0) + n), slice(max(k, 0), max(k, 0) + n)
        f = body[early] if R is None else turned(R[late], body[early])
        usable = e.usable[early] & e.usable[late]
        if usable.any() and (share := _unexplained(f[usable], pull[late][usable])) < best[1]:
            best = k, share
    return best[0] / e.rate, best[1]


def _quaternion(log: Log, chain: Chain, t: np.ndarray) -> np.ndarray | None:
    """Return the logged quaternion (n, 4) at the times t (n,), x y z w; None where none is."""
    for prefix in (f"{BASE}.", f"q.{chain.name}."):
        names = [f"{prefix}q{x}" for x in (*XYZ, "w")]
        if {*names} <= {*log.columns}:
            return _at(log.columns, names, log.t, t)
    return None


def _at(
    columns: Mapping[str, np.ndarray], names: Sequence[str], stamps: np.ndarray, t: np.ndarray
) -> np.ndarray:
    raw = np.stack([columns[name] for name in names], axis=1).astype(float)
    known = np.isfinite(raw).all(axis=1)
    raw, stamps = raw[known], stamps[known]
    steps = np.append(1.0, np.where((raw[1:] * raw[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    raw = raw * np.cumprod(steps)[:, None]  # of either sign: along one path
    values = np.stack([np.interp(t, stamps, x) for x in raw.T], axis=1)
    return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True))
