"""Results of `excite`: a motion, its use of the limits, and what a log of it would determine.

The criterion that is maximised: log-determinants of the information of some unknowns.

    W = A_I / σ     M = WᵀW     J = Σ w_j log det M_j − w log κ

D-optimality:  J = log det M / 2r: −J is the mean logarithm of the standard errors. It hardly cares
for the condition number κ of W with unit columns, which costs little to lower: hence w log κ.
Separation:    J = (log det S_a / r_a + log det S_b / r_b) / 4, S_a the information on a where all
else, b too, is refitted: det S_a = det M / det M without a. −J is the same mean, over a and b.

D-optimality: Swevers et al. 1997 (see `trajectory.Fourier`); partial (D_s) optimality: Atkinson,
Donev, Optimum Experimental Designs, 1992, sect. 10.3.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.display import Plotted
from ident.effects import KINDS, parse
from ident.equations.unknowns import Columns, Point
from ident.errors import MechanismError
from ident.excite.limits import LimitUse
from ident.excite.trajectory import MotionRows
from ident.fit.values import base_names
from ident.information import linear
from ident.information.estimate import TOLERANCE, rank_revealing, solve
from ident.information.evidence import SAME_SHARE
from ident.information.linear import Triangle
from ident.information.separation import orthonormal, share_apart, without_columns_of
from ident.log import Log
from ident.mechanism.mechanism import Mechanism

NOTHING = 1e-9  # numerics: of the torques: what an SI unit changes by less has no effect
HALF_TURN = np.pi  # [rad] size of an angle that a joint or a base can be off by, at most
TINY = 1e-13  # numerics: of R's diagonal: below, the columns do not determine some unknown


@dataclass(frozen=True, eq=False)
class Criterion:
    """J as weighted log-determinants of groups of columns of W."""

    parts: tuple[tuple[float, np.ndarray], ...]  # (weight, columns) each
    balance: float = 0.0  # w, the weight of the condition number

    @classmethod
    def of_all(cls, r: int, balance: float) -> Criterion:
        """D-optimality of r unknowns, with a weight of the condition number."""
        return cls(((0.5 / r, np.arange(r)),), balance)

    @classmethod
    def of_pair(cls, r: int, a: Sequence[int], b: Sequence[int]) -> Criterion:
        """Separation of two rivals' columns a and b among r."""
        wa, wb = 0.25 / len(a), 0.25 / len(b)
        every = np.arange(r)
        return cls(((wa + wb, every), (-wa, np.setdiff1d(every, a)), (-wb, np.setdiff1d(every, b))))

    def at(self, W: np.ndarray) -> float | None:
        """Return J of rows W (N, r); None where W does not determine all unknowns."""
        value, R = 0.0, np.asarray(np.linalg.qr(W, mode="r"))
        for weight, columns in self.parts:
            size = np.abs(np.asarray(np.linalg.qr(R[:, columns], mode="r")).diagonal())
            if not size.min(initial=1.0) > TINY * size.max(initial=1.0):
                return None
            value += 2 * weight * float(np.log(size).sum())
        if self.balance:
            _, s, _ = linear.svd(R / np.linalg.norm(R, axis=0))
            value -= self.balance * float(np.log(s[0] / s[-1]))
        return value

    def slope(self, W: np.ndarray) -> np.ndarray:
        """Return ∂J/∂W (N, r) of rows W (N, r) that determine all unknowns.

        J is a function of M alone, so this is W S with a symmetric S (r, r):

            log det M_j    S = 2 M_j⁻¹
            log s_k        S = u uᵀ / s_k² − diag(u²),   u = v_k / norms of W's columns

        s_k, v_k are the singular values and right singular vectors of W with unit columns.
        """
        R = np.asarray(np.linalg.qr(W, mode="r"))
        S = np.zeros((len(R), len(R)))
        for weight, columns in self.parts:
            inverse = np.linalg.inv(np.linalg.qr(R[:, columns], mode="r"))
            S[np.ix_(columns, columns)] += 2 * weight * inverse @ inverse.T
        if self.balance:
            norms = np.linalg.norm(R, axis=0)
            _, s, V = linear.svd(R / norms)
            for k, sign in ((0, -1), (-1, 1)):
                u = V[k] / norms
                S += sign * self.balance * (np.outer(u, u) / s[k] ** 2 - np.diag(u**2))
        return np.asarray(W @ S)


@dataclass(frozen=True)
class ExpectedValue:
    """A base parameter with its prior and its expected standard error."""

    name: str
    prior: float
    stderr: float  # for torques with white noise of `Excitation.noise`, a value a sample
    unit: str
    largest: float = np.inf  # size above which a value is not plausible

    @property
    def determined(self) -> bool:
        """Whether the error expected is below the largest value that there can be."""
        return self.stderr < self.largest


@dataclass(frozen=True)
class Separation:
    """How well a motion distinguishes two effects."""

    first: str  # first, second: their labels
    second: str
    share: float  # of what one predicts beside all else, that the other cannot do, at least
    stderr: tuple[float, float]  # of each one's first unknown when everything is refitted
    units: tuple[str, str]

    @property
    def cosine(self) -> float:
        """The largest of what both predict, all else projected out; 1: no difference."""
        return float(np.sqrt(1.0 - self.share**2))

    def __str__(self) -> str:
        (ea, eb), (ua, ub) = self.stderr, self.units
        text = (
            f"{self.first} and {self.second}: cosine {self.cosine:.4g} beside all else; expected "
            f"standard errors {ea:.2g} {ua} and {eb:.2g} {ub}"
        )
        if self.share > SAME_SHARE:
            return text
        return (
            f"{text}. This motion does not separate them: one can do what the other does. Give "
            "wider limits, measure something else (ident diagnose says what), or take the simpler"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Plotted):
    """A periodic motion of the drives. Made by `ident.excite`.

    Attributes:
        name: of the mechanism.
        log: t, and q, v, a and the predicted tau of every drive; friction is in the torques where
            its size is known or given.
        period: [s]; periods: their number; harmonics: of the series.
        series: by joint (2 H + 1,): c, a_1 … a_H, b_1 … b_H of
            y(t) = c + Σ a_k sin(kωt) + b_k cos(kωt), ω = 2π/period.
        uses: of all limits; home: multiple of ‖K⁺‖ at home that is reached (0 in a tree).
        unknowns: their number; base: the combinations that are identified.
        condition_number: of the rows divided by the noise, columns of unit norm.
        log_det: of the information of the base parameters in SI units, of the whole log.
        noise: expected of the torques, by drive [N m | N].
        separation: of two effects, if that was requested.
        seed: of the random motions from which the search started; notes: assumptions.
        finished: false for the best motion of a search that has not ended.
        without_effect: parameters of effects that change no torque of this motion.
    """

    name: str
    log: Log
    period: float
    periods: int
    harmonics: int
    series: Mapping[str, np.ndarray]
    uses: tuple[LimitUse, ...]
    home: float
    unknowns: int
    base: tuple[ExpectedValue, ...]
    condition_number: float
    log_det: float
    noise: Mapping[str, float]
    separation: Separation | None
    seed: int
    notes: tuple[str, ...] = ()
    finished: bool = True
    without_effect: tuple[str, ...] = ()

    def use(self, joint: str, kind: str) -> LimitUse:
        """Return the use of one limit: of `joint`, its `kind` (position, speed, …)."""
        return next(use for use in self.uses if (use.joint, use.kind) == (joint, kind))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the log to `path`, a .csv, .parquet or .npz, whole or not at all."""
        self.log.write(path)


def informative(rows: MotionRows) -> np.ndarray:
    """Return the columns A (n, d, k) of a motion, zero where all they have is rounding errors."""
    size = np.abs(rows.A).max(axis=(0, 1))
    return np.where(size > NOTHING * np.abs(rows.e.tau).max(initial=0.0), rows.A, 0.0)


class Determined:
    """The base parameters that the rows of a motion determine."""

    def __init__(self, columns: Columns, rows: MotionRows, sigma: np.ndarray) -> None:
        """Factorise the rows of a motion over the noise (d,) of the torques."""
        W = informative(rows) * rows.informed[:, :, None] / sigma[:, None]
        self.columns, self.W = columns, W.reshape(-1, len(columns))  # (N, k) those that inform
        factor = Triangle.of(self.W, np.zeros(len(self.W)))
        self.base = rank_revealing(factor, TOLERANCE)
        R = self.R = factor.restricted(self.base.independent).R
        self.log_det = 2 * float(np.log(np.abs(R.diagonal())).sum())  # of the information
        self.C = solve(factor, self.base).C  # (r, r) covariance of base parameters
        self.stderr = np.sqrt(self.C.diagonal())

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Return names of effects' parameters that change no torque."""
        effective = self.W.any(axis=0)
        rigid = len(self.columns.rigid)
        return tuple(x for i, x in enumerate(self.columns.names) if i >= rigid and not effective[i])

    def expected(self, point: Point) -> tuple[ExpectedValue, ...]:
        """Return prior and standard error of every base parameter."""
        base, columns = self.base, self.columns
        # largest plausible size (k,) of every unknown, infinite where none is known
        most = np.array([HALF_TURN if unit == "rad" else np.inf for unit in columns.units])
        for effect, places in columns.effects:
            for parameter, i in zip(effect.parameters, places, strict=True):
                if i >= 0 and np.isfinite(parameter.largest):
                    most[i] = parameter.largest
        prior = base.combined(point.unknowns(columns)).tolist()
        units = [columns.units[i] for i in base.independent]
        series = (
            base_names(columns, base),
            prior,
            self.stderr.tolist(),
            units,
            most[base.independent],
        )
        return tuple(
            ExpectedValue(*parameter[:-1], float(parameter[-1]))
            for parameter in zip(*series, strict=True)
        )

    def separation(self, pair: tuple[str, str]) -> Separation:
        """Return how well two effects are distinguished, by their predictions beside all else."""
        columns, place = self.columns, {i: k for k, i in enumerate(self.base.independent.tolist())}
        places = [determined_places(columns, label, place) for label in pair]
        a, b = ([place[i] for i in columns_of_one if i in place] for columns_of_one in places)
        e, f = (float(self.stderr[place[i]]) if i in place else np.inf for i, *_ in places)
        share = 0.0
        if np.isfinite(e + f):
            Q = orthonormal(np.delete(self.R, [*a, *b], axis=1))
            one, other = (orthonormal(without_columns_of(Q, self.R[:, x])) for x in (a, b))
            share = share_apart(one, [other])
        units = columns.units[places[0][0]], columns.units[places[1][0]]
        return Separation(*pair, share, (e, f), units)


def determined_places(columns: Columns, label: str, independent: Collection[int]) -> list[int]:
    """Return the indices of an effect's unknowns; of a correction, which has none, its shapes.

    The sensitivity of another effect's shape is zero as long as its unknowns are. Those that are
    independent, if any is: the mass of a load on a link that only turns about an axis acts through
    its moments alone, and of a cable beside a spring what tells them apart is not linear.
    """
    effect, at = next((e, at) for e, at in columns.effects if e.label == label)
    places = [int(i) for i in (at[: len(effect.unknowns)] if effect.unknowns else at) if i >= 0]
    return [i for i in places if i in independent] or places


def with_rivals(mechanism: Mechanism, pair: tuple[str, str]) -> Mechanism:
    """Return the mechanism with two different effects, their parameters unknown.

    If one is a load, the bodies are known, as in the fit of the machine without the load: their own
    inertial parameters act as a load does.
    """
    if len(set(pair)) != 2:
        raise MechanismError(f"separate {' '.join(pair)}: two different effects are expected")
    for label in pair:
        if not any(effect.label == label and not effect.known for effect in mechanism.effects):
            kind, joints, *_ = parse(label)
            if not joints and KINDS[kind].sits != "mechanism":
                raise MechanismError(f"separate {label}: of which joint? write {label}:JOINT")
            mechanism = mechanism.with_effect(label)
    order = sorted(mechanism.effects, key=lambda e: len(e.unknowns) if e.label in pair else 0)
    mechanism = replace(mechanism, effects=tuple(order))  # of two, the richer one has what is left
    loads = {effect.label for effect in mechanism.effects if effect.loaded_link}
    return replace(mechanism, unknown=()) if loads & {*pair} else mechanism
