"""Curves of signals: torques without a law, which every law of the same signals is a case of.

τ_j = Σ_k c_k B_k(x) w        B_k: cubic B-splines of a signal x; w: 1, or another signal
τ_j = Σ_k c_k x_k             T_k ẋ_k = v − x_k: a linear response to the past of the speed
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import ClassVar

import numpy as np

from ident.effects.effect import NOWHERE, UNITS, Bounds, Effect, Shape, Signals, Unknown, unit_of
from ident.effects.joint import direction_in
from ident.errors import MechanismError, one_of

PIECES = 5  # range: intervals of a curve of one signal
COARSE_PIECES = 3  # range: of a curve that multiplies a signal, and of half a curve of speed
DEGREE = 3  # range
PRODUCTS = (  # the curve's signal, what it multiplies
    "q*sign", "t*sign", "load*sign", "temperature*sign", "q*v", "t*v", "temperature*v", "t*load",
)  # fmt: skip
LAGS = 5  # range: time constants of a response, each twice the one before
OF_TWO = "q*q"  # a curve of the second joint's position, times the first joint's


@dataclass(frozen=True)
class OnFirst(Effect):
    """An effect whose torque acts on the first of its joints; the others give signals alone."""

    @abstractmethod
    def torque(self, s: Signals) -> np.ndarray:
        """E (n, unknowns) of the first joint."""

    @property
    @abstractmethod
    def dry(self) -> bool:
        """Whether it has the sign of its joints' speeds, and is open where one stands still."""

    def columns(self, s: Signals) -> np.ndarray:
        E = np.zeros((*s.q.shape, len(self.unknowns)))
        E[:, 0] = self.torque(s)
        return E

    def informed(self, s: Signals) -> np.ndarray:
        informing = np.ones(s.q.shape, dtype=bool)
        if self.dry:
            informing[:, 0] = (np.abs(s.v) >= s.still).all(axis=1)
        return informing


@dataclass(frozen=True)
class OfSignals(OnFirst):
    """A torque that is a function of signals of its joints."""

    not_integrable = ""  # its state is the time
    second_rotational: bool = field(default=True, kw_only=True)  # whether the second joint turns

    @property
    @abstractmethod
    def depends_on(self) -> frozenset[str]:
        """Signals on which it depends."""

    @property
    def implicit(self) -> bool:  # type: ignore[override]
        return "load" in self.depends_on

    @property
    def memory(self) -> bool:  # type: ignore[override]
        return "t" in self.depends_on  # it counts from the log's first sample

    @property
    def asks(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple({"a", "load"} & self.depends_on)

    def placed(self, rotational: Sequence[bool]) -> Effect:
        return replace(self, rotational=rotational[0], second_rotational=rotational[-1])

    def reads(self) -> tuple[str, ...]:
        return (f"temperature.{self.joints[0]}",) if "temperature" in self.depends_on else ()


@dataclass(frozen=True)
class Curve(OfSignals):
    """A torque that is a smooth curve of a signal, or of a signal times another one."""

    kind = "curve"
    candidate_sites = (
        NOWHERE  # a diagnosis compares laws with curves, and proposes one where no law holds
    )
    signals = (*UNITS, *PRODUCTS, OF_TWO)
    settings: ClassVar = {"pieces": 0.0}
    equation = "Σ c_k B_k(x) w, B_k cubic B-splines of x, with x w the signal: q, v, a, load, t, …"
    signature = "the residual against the signal is a curve"
    confused_with = ("cable", "ripple", "gravity over a small range")
    source = "de Boor, A Practical Guide to Splines, 1978"

    @property
    def arity(self) -> int:  # type: ignore[override]
        return 2 if self.signal == OF_TWO else 1

    def __post_init__(self) -> None:
        if self.signal not in self.signals:
            raise MechanismError(
                f"effect 'curve': of which signal? given: '{self.signal}'; write curve:joint:q; "
                f"{one_of(self.signal, self.signals)}"
            )
        pieces = self.setting("pieces")
        if pieces not in range(41):
            raise MechanismError(
                f"effect '{self.label}': pieces = {pieces:g}; valid: 1 to 40, or 0"
            )
        super().__post_init__()

    @classmethod
    def example(cls) -> Effect:
        return cls(("joint1",), signal="q")

    @property
    def first(self) -> str:
        """The curve's own signal."""
        return self.signal.partition("*")[0]

    @property
    def second(self) -> str:
        """The signal that it multiplies; empty for most."""
        return self.signal.partition("*")[2]

    @property
    def pieces(self) -> int:
        """Number of its intervals."""
        coarse = self.second or self.first == "v"
        return int(self.setting("pieces")) or (COARSE_PIECES if coarse else PIECES)

    @property
    def depends_on(self) -> frozenset[str]:
        second = "v" if self.second == "sign" else self.second
        return frozenset(signal for signal in (self.first, second) if signal)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        # a curve of speed has an odd half, which is dry friction, and an even one
        odd = "dry" if self.first == "v" or self.second == "sign" else "torque"
        halves = {"c": odd, "e": "torque"} if self.first == "v" else {"c": odd}
        powers = {self.second: -1.0} if self.second in UNITS else {}
        units = tuple(unit_of(powers, turns, turns, 1.0) for turns in (True, False))
        return tuple(
            Unknown(f"{half}{i}", units, "coefficient", acts=acts)
            for half, acts in halves.items()
            for i in range(self.pieces + DEGREE)
        )

    @property
    def shapes(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        """The ends of its intervals, as the data have them."""
        units = UNITS[self.first]
        if self.arity > 1:  # knots are of the second joint
            units = (units[not self.second_rotational],) * 2
        return tuple(Unknown(f"x{i}", units, "knot", discrete=True) for i in range(self.pieces + 1))

    @property
    def dry(self) -> bool:
        return "v" in self.depends_on and self.second != "v"

    def _argument(self, s: Signals) -> np.ndarray:
        """x (n,) of the curve; of speed its size."""
        if self.first in ("t", "temperature"):
            return s.t - s.t[0] if self.first == "t" else s.extra[self.reads()[0]]
        x: np.ndarray = getattr(s, self.first)[:, -1 if self.first == "q" else 0]
        return np.abs(x) if self.first == "v" else x

    def torque(self, s: Signals) -> np.ndarray:
        x, v = self._argument(s), s.v[:, 0]
        turn = direction_in(s, self.joints)[:, 0]
        knots = np.array([s.shape[f"x{i}"] for i in range(self.pieces + 1)])
        if self.first == "v":
            B = basis(x, knots)
            return np.concatenate([B * turn[:, None], B], axis=1)
        w = {"": np.ones_like(v), "sign": turn, "v": v, "q": s.q[:, 0]}.get(self.second)
        return basis(x, knots) * (s.load[:, 0] if w is None else w)[:, None]

    def bounds(self, s: Signals) -> Bounds:
        x = self._argument(s)
        return {shape.name: (float(x.min()), float(x.max())) for shape in self.shapes}

    def starts(self, s: Signals) -> list[Shape]:
        # knots with as many samples in each piece
        x = self._argument(s)
        knots = np.quantile(x, np.linspace(0, 1, self.pieces + 1))
        if len(np.unique(knots)) < len(knots):  # constant over most of the log
            low, high = float(x.min()), float(x.max())
            knots = np.linspace(low, high if high > low else low + 1.0, len(knots))
        return [{f"x{i}": float(knot) for i, knot in enumerate(knots)}]


@dataclass(frozen=True)
class PastSpeed(Effect):
    """A linear response to the past of a joint's speed, with a spectrum of time constants.

    With inertia, viscous friction and a spring it spans all torques whose ratio to the speed is a
    smooth function of frequency, of which each of these laws has a constant one. A diagnosis judges
    the form of laws by it; it is no effect to be added.
    """

    kind = "curve"
    candidate_sites = NOWHERE
    signals = ("past v",)
    settings: ClassVar = {"T": 1.0}  # the shortest time constant [s]
    unknowns = tuple(Unknown(f"c{i}", ("N m s/rad", "N s/m"), "coefficient") for i in range(LAGS))
    equation = "Σ c_k x_k, T_k ẋ_k = v − x_k, T_k = 2ᵏ T"
    signature = "the residual follows the speed of a while ago"
    source = "Ferry, Viscoelastic Properties of Polymers, 1980, ch. 3"
    memory = True
    fades = True

    def columns(self, s: Signals) -> np.ndarray:
        from scipy.linalg import solve_banded  # takes 0.2 s to import

        # x_i − (1 − k) x_{i−1} = k v_i, x_0 = v_0; scipy.signal takes half a second to be imported
        v, step = s.v[:, 0], float(np.median(np.diff(s.t))) if len(s.t) > 1 else 1.0
        memories = []
        for k in -np.expm1(-step / (self.setting("T") * 2.0 ** np.arange(LAGS))):
            bands = np.stack([np.ones(len(v)), np.full(len(v), k - 1.0)])
            memories.append(solve_banded((1, 0), bands, np.append(v[:1], k * v[1:])))
        return np.stack(memories, axis=1)[:, None, :]


def basis(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """B (n, pieces + 3) of a signal x (n,), constant outside the knots (pieces + 1,)."""
    from scipy.interpolate import BSpline  # takes 0.2 s to import

    count = len(knots) - 1 + DEGREE
    if knots[0] == knots[-1]:  # of a signal that stays where it is
        return np.zeros((len(x), count))
    every = np.concatenate([[knots[0]] * DEGREE, knots, [knots[-1]] * DEGREE])
    x = np.clip(x, knots[0], knots[-1])
    # a third of the time of BSpline.design_matrix, which makes a sparse matrix
    return np.asarray(BSpline(every, np.eye(count), DEGREE)(x))


def curves(
    joints: tuple[str, ...], moving: tuple[str, ...], columns: Collection[str] = ()
) -> Iterator[Curve]:
    """Yield all curves of all joints, and of pairs of those that move, given a log's columns."""
    for name in joints:
        every = (Curve((name,), signal=signal) for signal in (*UNITS, *PRODUCTS))
        yield from (curve for curve in every if {*columns}.issuperset(curve.reads()))
    yield from (Curve(pair, signal=OF_TWO) for pair in permutations(moving, 2))
