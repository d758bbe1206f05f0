"""What an integration leaves behind."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ident.simulate.instant import Balance
from ident.simulate.plant import Moment


@dataclass(frozen=True)
class Transition:
    """A joint that stops, breaks away or turns round.

    Attributes:
        t: [s]; joint: its name; mode: 0 it sticks, +1 it slides forwards, −1 backwards.
    """

    t: float
    joint: str
    mode: int

    def __str__(self) -> str:
        what = {0: "sticks", 1: "slides forwards", -1: "slides backwards"}[self.mode]
        return f"{self.t:.6g} s: {self.joint} {what}"


@dataclass(frozen=True, eq=False)
class State:
    """q (nq,), v (nv,) and the states z (presliding,) of friction springs."""

    q: np.ndarray
    v: np.ndarray
    z: np.ndarray

    @property
    def flat(self) -> np.ndarray:
        """(nq + nv + presliding,)."""
        return np.concatenate([self.q, self.v, self.z])


@dataclass(eq=False)
class Trace:
    """Filled as the integration goes: one entry a sample."""

    t: list[float] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    balances: list[Balance] = field(default_factory=list)
    modes: list[np.ndarray] = field(default_factory=list)
    transitions: list[Transition] = field(default_factory=list)
    evaluations: int = 0
