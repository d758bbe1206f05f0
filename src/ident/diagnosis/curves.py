"""Curves of signals: what a law of the same signals is a special case of.

    τ_j = Σ_k c_k B_k(x) w        B_k: cubic B-splines of a signal x; w: 1, or another signal

A law whose residual such a curve still explains has the wrong form.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ident.effects import Effect, Signals, Unknown
from ident.effects.friction import direction

KNOTS = 5  # intervals of a curve of one signal
FEW = 3  # of a curve that multiplies another signal
DEGREE = 3
FAMILIES = {  # signals: the curve's own, then what it multiplies
    "q": (), "v": (), "a": (), "t": (), "load": (),
    "q*sign": ("v",), "t*sign": ("v",), "load*sign": ("v",),
    "q*v": ("v",), "t*v": ("v",),
}  # fmt: skip


@dataclass(frozen=True)
class Curve(Effect):
    """A spline of signals of one joint, or of another joint's position times its own.

    Attributes:
        family: `q`, `v`, `a`, `t`, `load`, `q*sign`, …: the curve's signal, and what it multiplies.
    """

    kind: ClassVar[str] = "curve"
    equation: ClassVar[str] = "a cubic spline of signals"
    signature: ClassVar[str] = "the residual against the signal is a curve"
    source: ClassVar[str] = "de Boor, A Practical Guide to Splines, 1978"
    implicit: ClassVar[bool] = True
    family: str = field(default="q", kw_only=True)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        """One coefficient a B-spline; a curve of speed has its even and its odd part."""
        pieces = KNOTS if self.family in ("q", "a", "t", "load") else FEW
        count = (pieces + DEGREE) * (2 if self.family == "v" else 1)
        return tuple(Unknown(f"c{i}", ("N m", "N"), "coefficient") for i in range(count))

    @property
    def label(self) -> str:
        """`curve of v:elbow`."""
        return f"curve of {self.family}:{','.join(self.joints)}"

    @property
    def local(self) -> bool:
        """It acts on its first joint alone."""
        return True

    @property
    def signals(self) -> frozenset[str]:
        """Signals on which it depends."""
        first, _, second = self.family.partition("*")
        return frozenset([first, *([{"sign": "v"}.get(second, second)] if second else [])])

    def columns(self, s: Signals) -> np.ndarray:
        """E (n, 1, unknowns)."""
        first, _, second = self.family.partition("*")
        v = s.v[:, 0]
        turn = direction(v, s.still[0])
        if first == "v":
            B = basis(np.abs(v), FEW)
            return np.concatenate([B * turn[:, None], B], axis=1)[:, None, :]
        x = {"q": s.q[:, 0], "a": s.a[:, 0], "t": s.t, "load": None}[first]
        B = basis(s.load[:, 0] if x is None else x, FEW if second else KNOTS)
        w = {"": np.ones_like(v), "sign": turn, "v": v}[second]
        return (B * w[:, None])[:, None, :]


@dataclass(frozen=True)
class Crossed(Curve):
    """A spline of another joint's position times the joint's own position."""

    arity: ClassVar[int] = 2

    @property
    def signals(self) -> frozenset[str]:
        """Positions."""
        return frozenset(["q"])

    @property
    def unknowns(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        """One coefficient a B-spline."""
        return tuple(Unknown(f"c{i}", ("N m", "N"), "coefficient") for i in range(FEW + DEGREE))

    def columns(self, s: Signals) -> np.ndarray:
        """E (n, 2, unknowns), nothing on the second joint."""
        E = np.zeros((len(s.t), 2, FEW + DEGREE))
        E[:, 0] = basis(s.q[:, 1], FEW) * s.q[:, :1]
        return E


def basis(x: np.ndarray, pieces: int) -> np.ndarray:
    """B (n, pieces + 3) of a signal x (n,), as many samples in each piece."""
    inner = np.unique(np.quantile(x, np.linspace(0, 1, pieces + 1)))
    if len(inner) < pieces + 1:  # a signal that is constant over most of the log
        low, high = float(x.min()), float(x.max())
        inner = np.linspace(low, high if high > low else low + 1.0, pieces + 1)
    knots = np.concatenate([[inner[0]] * DEGREE, inner, [inner[-1]] * DEGREE])
    from scipy.interpolate import BSpline  # takes 0.2 s to import

    return np.asarray(
        BSpline.design_matrix(np.clip(x, inner[0], inner[-1]), knots, DEGREE).toarray()
    )


def curves(joints: tuple[str, ...], moving: tuple[str, ...]) -> Iterator[Curve]:
    """All curves of all joints, and of pairs of those that move."""
    for name in joints:
        for family in FAMILIES:
            yield Curve((name,), family=family)
    for name in moving:
        for other in moving:
            if other != name:
                yield Crossed((name, other), family="q*q")
