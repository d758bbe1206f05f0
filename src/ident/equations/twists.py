"""Columns of bodies whose load twists the spring that they hang on.

    r = τ − Γ(y − δ) π − …,    δ = F(c, D)[L],    L = Γ_i π         i: row of the spring's joint
    −∂r/∂π_j = Γ_j − Σ_k ∂(−r)/∂y⁽ᵏ⁾ F[Γ_ij]⁽ᵏ⁾                     k = 0, 1, 2: link's q, v, a

F, from a joint's load to its twist with two rates, is linear: an oscillator that the link's inertia
decides. L is that of the link where it is, so Γ_i is, too. Without this term parameters of bodies
and of springs would be sought by turns, and errors of either would not know of the other's.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Correction, Effect
from ident.equations.nearby import linearized
from ident.equations.terms import CHUNK, SLIGHTLY, Samples, residual
from ident.equations.unknowns import Columns
from ident.mechanism.mechanism import Mechanism
from ident.motion.state import State


@dataclass(frozen=True, eq=False)
class Twist:
    """What unknowns of bodies do by the twist of one spring, in a whole state."""

    places: np.ndarray  # (m,) in x
    x: np.ndarray  # (m,) their values at the working point
    twists: np.ndarray  # (3, n, m) of unit unknowns, with two rates
    slopes: np.ndarray  # (n, r, 3) of r by the link's q, v, a

    def columns(self, part: slice | np.ndarray) -> np.ndarray:
        """Return what is added to the columns (n, r, m) of the unknowns in some samples."""
        return np.asarray(np.einsum("nrk,knm->nrm", self.slopes[part], self.twists[:, part]))


def twists_of(bare: Samples, at: Samples, columns: Columns) -> tuple[Twist, ...]:
    """Return the twists that unknown bodies make of the springs at the point of `bare`, whose
    corrected state is `at`.
    """
    gamma, places = columns.of_gamma
    if not len(places):
        return ()
    return tuple(
        _twist(bare, at, effect, gamma, places, columns)
        for effect in at.mechanism.effects
        if effect.by_load and bare.point.of(effect)[1].get(effect.extent) and bare.share_of(effect)
        if effect.joints[0] in at.e.logged
    )


def _twist(
    bare: Samples,
    at: Samples,
    effect: Effect,
    gamma: np.ndarray,
    places: np.ndarray,
    columns: Columns,
) -> Twist:
    (name,) = effect.joints
    shares = _shares(at, columns, places)
    loads = _loads(at, name, gamma) * shares
    felt = np.flatnonzero(loads.any(axis=0))
    share = bare.share_of(effect)
    shape = {key: share * value for key, value in bare.point.of(effect)[1].items()}
    signals = replace(bare.signals(effect.acting), shape=shape)
    rest = (_loads(at.at_first_rest(), name, gamma) * shares)[0] if at.begins_at_rest else None
    twists = effect.twists(signals, loads[:, felt], None if rest is None else rest[felt])
    x = bare.point.unknowns(columns)[places[felt]]
    return Twist(places[felt], x, twists, twist_slopes(at, name))


def _shares(at: Samples, columns: Columns, places: np.ndarray) -> np.ndarray:
    """Return how much of each of these unknowns acts in this log (m,)."""
    shares = np.ones(len(columns))
    for effect, own in columns.effects:
        shares[own[own >= 0]] = at.share_of(effect)
    return np.asarray(shares[places])


def _loads(at: Samples, name: str, gamma: np.ndarray) -> np.ndarray:
    """Return the loads (n, m) of a joint by unit unknowns with these columns of Γ."""
    e, n = at.e, len(at.e)
    row = at.mechanism.joint(name).index if e.loop is None else e.independent.index(name)
    loads = np.empty((n, len(gamma)))
    for start in range(0, n, CHUNK):
        part = slice(start, min(start + CHUNK, n))
        loads[part] = at.reduced(part).gamma[:, row, gamma]
    return loads


def twist_slopes(base: Samples, name: str) -> np.ndarray:
    """Return the slopes of r (n, d, 3) along position, rate and acceleration of the link of a
    logged joint, whose motor stays where it is, in a whole state.
    """
    key, e = ("twist slopes", name), base.e
    if key in base.memo:
        return np.asarray(base.memo[key])
    implicit = any(x.implicit and x.unknowns for x in base.mechanism.effects)
    if e.loop is None and base.few_tangents and not implicit:
        joint, pi = base.mechanism.joint(name).index, base.dynamic_parameters
        parts = (slice(i, min(i + CHUNK, len(e))) for i in range(0, len(e), CHUNK))
        every = [-base.tangents(part, pi)[:, :, joint].transpose(2, 1, 0) for part in parts]
        base.memo[key] = np.concatenate(every)
        return np.asarray(base.memo[key])
    known, slopes = e.known(base.mechanism), list[np.ndarray]()
    turned = (Correction(twist={name: np.zeros(0)}),)
    for order, step in enumerate((SLIGHTLY, SLIGHTLY, 1.0)):  # linear in accelerations
        moved = known.copy()
        moved[order, :, e.logged.index(name)] += step
        state = with_motors(base.mechanism, e.at(base.mechanism, moved), e, turned)
        at = linearized(Samples(base.mechanism, state, slice(None), base.point), base)
        slopes.append((residual(at) - residual(base)) / step)
    base.memo[key] = np.stack(slopes, axis=2)
    return np.asarray(base.memo[key])


def with_motors(
    mechanism: Mechanism, e: State, before: State, corrections: Iterable[Correction]
) -> State:
    """Return a state in which joints whose links twist are where their motors are: friction and
    rotor are those of the motor, and bodies, whose coordinates are q, move with the link.
    """
    names = {name for what in corrections for name in what.twist if name in e.logged}
    if not names:
        return e
    at = [mechanism.joint_index[name] for name in names]
    motors = [y.copy() for y in (e.y, e.yd, e.ydd)]
    for of_motor, y in zip(motors, (before.y, before.yd, before.ydd), strict=True):
        of_motor[:, at] = y[:, at]
    return replace(e, y=motors[0], yd=motors[1], ydd=motors[2])
