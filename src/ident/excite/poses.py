"""Poses at rest that determine most of gravity: D-optimal rows of Γ(q, 0, 0) among random ones.

    max log det Σ_i Γ_iᵀ Γ_i / σ²        by exchange of one pose for another (Fedorov, Theory of
                                         Optimal Experiments, 1972), from a greedy choice

Every tenth of the poses is drawn by chance alone: poses that the choice has no use for are what a
model that is wrong shows up in.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.equations.unknowns import Columns
from ident.errors import MechanismError, check_whole
from ident.excite.excitation import ExpectedValue
from ident.excite.limits import Limits
from ident.fit.values import base_names
from ident.information.estimate import TOLERANCE, rank_revealing
from ident.information.linear import Triangle
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import UNITS, regressor

DRAWN = 60  # work: poses that are drawn for one that is chosen
MOST_DRAWN = 4000  # work
SWEEPS = 4  # work: rounds of exchange
TURN = np.pi  # range: rad or m, of a joint without a range, on either side of its start
BY_CHANCE = 0.1  # level: share of the poses that are drawn alone
FRICTION = 0.05  # range: of a joint's torque, what friction at rest may hold of it
NOTHING = 1e-9  # numerics: of the largest torque, which is rounding
SLIGHT = 1e-6  # numerics: of the largest information, with which a first choice begins


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Poses to be held one after the other, and what they determine. From `ident.excite_poses`.

    Attributes:
        log: q.<joint>, one row a pose.
        torque: by joint, the largest that a pose needs [N m | N].
        noise: by joint, what friction at rest may be off by [N m | N].
        parameters: with the errors that the poses leave.
    """

    log: Log
    torque: Mapping[str, float]
    noise: Mapping[str, float]
    parameters: tuple[ExpectedValue, ...]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the poses as a .csv, .parquet or .npz file: `path`."""
        self.log.write(path)

    def __str__(self) -> str:
        rows = [f"  {x.name}: {x.prior:.4g} ± {x.stderr:.2g} {x.unit}" for x in self.parameters]
        limits = ", ".join(f"{name} {x:.2g}" for name, x in self.noise.items())
        head = f"{len(self.log.t)} poses at rest determine {len(rows)} parameters of gravity"
        return "\n".join([f"{head}, with friction at rest of ± {limits}:", *rows])


def excite_poses(
    mechanism: Mechanism,
    count: int,
    *,
    limits: Limits | None = None,
    noise: Mapping[str, float] | None = None,
    seed: int = 0,
) -> PosePlan:
    """Plan poses at rest from which gravity is known best.

    Args:
        mechanism: a tree; its unknown bodies are what is to be determined.
        count: of poses.
        limits: ranges and torques in place of the URDF's.
        noise: by joint, what friction at rest may be off by [N m | N]; by default a share FRICTION
            of the torque of gravity there.
        seed: of the poses that are drawn.

    Raises:
        MechanismError: for closed loops, too few poses, or where gravity acts on no torque.
    """
    if mechanism.closures:
        raise MechanismError(
            f"{mechanism.name}: poses are planned for trees; in closed loops plan a motion "
            "(ident excite) and hold it here and there"
        )
    check_whole("poses", count, 2)
    limits, model, names = limits or Limits(), mechanism.model, [j.name for j in mechanism.joints]
    random = np.random.default_rng(seed)
    home = np.array(mechanism.assembled)
    low, high = np.array([_range(mechanism, limits, name, home) for name in names]).T
    q = np.empty((min(MOST_DRAWN, DRAWN * count), model.nq))
    at = [mechanism.joint(name).index for name in names]
    q[:, at] = random.uniform(low, high, (len(q), len(names)))
    zero = np.zeros((len(q), model.nv))
    columns = Columns.of(mechanism)
    rigid = columns.rigid
    every = regressor(model, q, zero, zero)
    tau = every @ mechanism.prior
    driven = [mechanism.joint(name).index for name in mechanism.measured]
    largest = np.array([_torque(mechanism, limits, name) for name in mechanism.measured])
    good = (np.abs(tau[:, driven]) <= largest).all(axis=1)
    if good.sum() < count:
        raise MechanismError(
            f"{mechanism.name}: {good.sum()} of {len(q)} poses that were drawn can be held within "
            "the limits of torque; give wider ones (--torque, --reserve), or narrower --range"
        )
    q, tau, gamma = q[good], tau[good][:, driven], every[good][:, driven][:, :, rigid]
    rms = np.sqrt((tau**2).mean(axis=0))
    rms = np.where(rms > NOTHING * rms.max(), rms, rms.max())  # gravity does not act there
    given = noise or {}
    sigma = np.array([
        given.get(name, FRICTION * x or 1.0)
        for name, x in zip(mechanism.measured, rms, strict=True)
    ])  # fmt: skip
    W = gamma / sigma[:, None]
    rows = W.reshape(-1, len(rigid))
    base = rank_revealing(Triangle.of(rows, np.zeros(len(rows))), TOLERANCE)
    if not base.rank:
        raise MechanismError(
            f"{mechanism.name}: gravity has no part in any torque of an unknown body; plan a motion"
        )
    W = W[:, :, base.independent]
    chosen = _chosen(W / np.linalg.norm(W, axis=(0, 1)), count - round(BY_CHANCE * count))
    rest = np.setdiff1d(np.arange(len(q)), chosen)
    chosen = np.append(chosen, random.permutation(rest)[: count - len(chosen)])
    chosen = random.permutation(chosen)
    M = np.einsum("nji,njk->ik", W[chosen], W[chosen])
    stderr = np.sqrt(np.diag(np.linalg.inv(M)))
    positions = {f"q.{name}": q[chosen, i] for name, i in zip(names, at, strict=True)}
    log = Log.from_arrays("poses", np.arange(float(count)), positions).as_poses()
    prior = base.combined(mechanism.prior[rigid])
    values = zip(base_names(columns, base), prior, stderr, base.independent, strict=True)
    return PosePlan(
        log,
        dict(zip(mechanism.measured, np.abs(tau[chosen]).max(axis=0).tolist(), strict=True)),
        dict(zip(mechanism.measured, sigma.tolist(), strict=True)),
        tuple(
            ExpectedValue(n, float(x), float(e), UNITS[columns.names[i].rpartition(".")[2]])
            for n, x, e, i in values
        ),
    )


def _chosen(W: np.ndarray, count: int) -> np.ndarray:
    """Return which of the rows W (N, joints, r) of poses determine most together."""
    r = W.shape[2]
    M = SLIGHT * np.eye(r)
    chosen = list[int]()
    for _ in range(count):
        gain = _gains(W, M)
        gain[chosen] = -np.inf
        chosen.append(int(gain.argmax()))
        M = M + W[chosen[-1]].T @ W[chosen[-1]]
    for _ in range(SWEEPS):
        changed = False
        for i in range(count):
            without = M - W[chosen[i]].T @ W[chosen[i]]
            gain = _gains(W, without + SLIGHT * np.eye(r))
            gain[[x for x in chosen if x != chosen[i]]] = -np.inf
            best = int(gain.argmax())
            if best != chosen[i]:
                chosen[i], changed = best, True
                M = without + W[best].T @ W[best]
        if not changed:
            break
    return np.array(chosen)


def _gains(W: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Return by how much log det of M (r, r) rises with each pose (N,): log det (I + W M⁻¹ Wᵀ)."""
    inner = W @ np.linalg.solve(M, W.reshape(-1, len(M)).T).T.reshape(W.shape).transpose(0, 2, 1)
    return np.asarray(np.linalg.slogdet(np.eye(W.shape[1]) + inner)[1])


def _range(
    mechanism: Mechanism, limits: Limits, name: str, home: np.ndarray
) -> tuple[float, float]:
    joint = mechanism.joint(name)
    low, high = limits.range.get(name, (joint.lower, joint.upper))
    middle = float(home[joint.index])
    low = low if np.isfinite(low) else middle - TURN
    high = high if np.isfinite(high) else middle + TURN
    return max(low, min(middle, high) - TURN), min(high, max(middle, low) + TURN)


def _torque(mechanism: Mechanism, limits: Limits, name: str) -> float:
    given, effort = limits.torque, float(mechanism.joint(name).effort)
    effort = effort if effort > 0 else np.inf
    if isinstance(given, Mapping):
        effort = float(given.get(name, effort))
    elif given is not None:
        effort = min(float(given), effort)
    return (1 - limits.reserve) * effort
