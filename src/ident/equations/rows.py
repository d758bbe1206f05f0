"""The reduced rows of the stack: one an independent coordinate and sample, multipliers eliminated.

    Zᵀ (Γ p + E c) = Zᵀ (τ + f_e) − known        J Z = 0, W_u Z = 1

With one free multiplier a sample, these rows and the stack [Γ E | Jᵀ] have the same solution. Row u
is the error of the predicted torque of the independent joint u, which is what is compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ident.effects import Signals
from ident.equations.columns import Columns
from ident.equations.filter import Decimator
from ident.equations.regressor import regressor, supports
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment, Motion

CHUNK = 1024  # samples whose rows are in memory at once
STICKING = 0.2  # share of a filtered row that may come from samples that do not inform it
LEVER = 0.1  # a joint that barely moves with a coordinate may stand still without harm
ROUNDING = 1e-9  # of a joint's largest leverage: below, it does not move with a coordinate


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of consecutive samples.

    With n samples, d independent coordinates and k unknowns:

    Attributes:
        t: (n,) [s]; sample: (n,) index into the experiment.
        A: (n, d, k); b: (n, d), with all that is known moved to the right.
        tau: (n, d), the measured torques Zᵀτ alone.
        informed: (n, d), false where dry friction at standstill leaves the torque open.
    """

    t: np.ndarray
    sample: np.ndarray
    A: np.ndarray
    b: np.ndarray
    tau: np.ndarray
    informed: np.ndarray


def signals(mechanism: Mechanism, e: Experiment, part: slice, joints: tuple[str, ...]) -> Signals:
    """What an effect on these joints sees of some samples."""
    at = [mechanism.joint_index[name] for name in joints]
    return Signals(
        t=e.t[part],
        q=e.y[part][:, at],
        v=e.yd[part][:, at],
        a=e.ydd[part][:, at],
        still=e.still[at],
        extra={name: x[part] for name, x in e.extra.items()},
    )


def leverage(mechanism: Mechanism, e: Experiment, part: slice, joint: str) -> np.ndarray:
    """ẏ_joint (n, d) for a unit rate of each independent coordinate."""
    at = mechanism.joint_index[joint]
    if e.leverage is not None:
        return e.leverage[part, at]
    row = np.zeros(mechanism.model.nv)
    row[mechanism.joints[at].index] = 1.0
    return np.broadcast_to(row, (part.stop - part.start, len(row)))


def reach(mechanism: Mechanism, e: Experiment, joint: str) -> np.ndarray:
    """Largest leverage (d,) of a joint over the experiment."""
    if e.leverage is None:
        return np.abs(leverage(mechanism, e, slice(0, 1), joint)[0])
    return np.abs(e.leverage[e.usable, mechanism.joint_index[joint]]).max(axis=0, initial=0.0)


def project(e: Experiment, part: slice, f: np.ndarray) -> np.ndarray:
    """Zᵀ f of generalised forces f (n, nv, …): (n, d, …)."""
    if e.pinv is None or e.leverage is None:
        return f
    Z = e.pinv[part][:, :, -e.leverage.shape[2] :]
    return np.einsum("nij,ni...->nj...", Z, f) if f.ndim == 2 else Z.transpose(0, 2, 1) @ f


def measured_torque(mechanism: Mechanism, e: Experiment, part: slice) -> np.ndarray:
    """Zᵀτ (n, d): the measured torques in the independent coordinates."""
    total = np.zeros((part.stop - part.start, dof(mechanism, e)))
    for i, name in enumerate(mechanism.driven):
        total = total + leverage(mechanism, e, part, name) * e.tau[part, i : i + 1]
    return total


def dof(mechanism: Mechanism, e: Experiment) -> int:
    """Independent coordinates."""
    return mechanism.model.nv if e.leverage is None else e.leverage.shape[2]


def raw_rows(mechanism: Mechanism, columns: Columns, e: Experiment, part: slice) -> Rows:
    """The rows of some samples as they are, unfiltered."""
    n, d = part.stop - part.start, dof(mechanism, e)
    A = np.zeros((n, d, len(columns)))
    tau = measured_torque(mechanism, e, part)
    b = tau.copy() if e.wrench is None else tau + project(e, part, e.wrench[part])
    gamma = project(e, part, regressor(mechanism.model, e.q[part], e.v[part], e.a[part]))
    np.take(gamma, columns.rigid, axis=2, out=A[:, :, : len(columns.rigid)], mode="clip")
    if len(columns.known):
        b = b - gamma[:, :, columns.known] @ columns.known_values
    informed = np.ones((n, d), dtype=bool)
    for effect, places in columns.effects:
        s = signals(mechanism, e, part, effect.joints)
        E, told = effect.columns(s), effect.informed(s)
        known = np.array([effect.values.get(unknown.name, 0.0) for unknown in effect.unknowns])
        for i, joint in enumerate(effect.joints):
            lever = leverage(mechanism, e, part, joint)
            most = reach(mechanism, e, joint)
            for u in np.flatnonzero(most > ROUNDING * most.max()):
                torque = lever[:, u, None] * E[:, i]
                A[:, u, places[places >= 0]] += torque[:, places >= 0]
                if (places < 0).any():
                    b[:, u] -= torque[:, places < 0] @ known[places < 0]
                informed[:, u] &= told[:, i] | (np.abs(lever[:, u]) <= LEVER * most[u])
    return Rows(e.t[part], np.arange(part.start, part.stop), A, b, tau, informed)


def rows(mechanism: Mechanism, columns: Columns, motion: Motion, e: Experiment) -> Iterator[Rows]:
    """All rows of an experiment in pieces, filtered and decimated as the motion's band says."""
    decimator = Decimator.of(motion.band.cutoff, e.rate)
    for segment in e.segments():
        for inside, part in decimator.pieces(segment, CHUNK):
            raw = raw_rows(mechanism, columns, e, inside)
            if decimator.taps is None:
                yield raw
                continue
            sample = decimator.centres(part, segment)
            A, b, tau = (decimator.apply(x, inside, sample) for x in (raw.A, raw.b, raw.tau))
            open_ = decimator.apply((~raw.informed).astype(float), inside, sample, absolute=True)
            yield Rows(e.t[sample], sample, A, b, tau, open_ < STICKING)


def row_supports(mechanism: Mechanism, columns: Columns, e: Experiment) -> list[np.ndarray]:
    """For each independent coordinate the unknowns that can appear in its rows."""
    k = len(columns)
    if e.leverage is not None:
        return [np.arange(k)] * dof(mechanism, e)
    found = []
    for row, bodies in enumerate(supports(mechanism.model)):
        mine = [i for i, column in enumerate(columns.rigid) if column in set(bodies)]
        for effect, places in columns.effects:
            if any(mechanism.joint(name).index == row for name in effect.joints):
                mine.extend(int(place) for place in places if place >= 0)
        found.append(np.array(mine, dtype=int))
    return found
