"""The curve of a signal that explains what is left in a joint, with its band.

    θ = S⁺ C̃ᵀr        S = C̃ᵀC̃        f(x) = B(x) θ ± 1.96 s √diag(B S⁺ Bᵀ)

C̃ is what the model's own columns cannot make of the curve's. The number of its pieces is the one
with the least left-out error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.diagnosis.candidates import CandidateColumns, Contest
from ident.diagnosis.law_search import normal_equations
from ident.diagnosis.laws import LossComparison
from ident.effects import Signals
from ident.effects.curve import Curve
from ident.effects.formula import plain
from ident.information.chance import MINE, PARSIMONY
from ident.information.hypotheses import Array, PartialRegression

PIECES = (2, 3, 5, 8, 12, 20)  # work: that are compared
POINTS = 101  # shown: at which the curve is given
BAND = 1.96  # level: standard errors of a 95 % band
NEW = 1e-6  # numerics: share of a column's squares that must be new


@dataclass(frozen=True, eq=False, repr=False)
class FoundCurve:
    """A curve that explains what is left in a joint.

    Attributes:
        effect: with the number of its pieces; joint: of its torque.
        x, torque, lower, upper: (n,) the signal, the torque and its 95 % band; of a product, the
            torque for a second signal of 1.
        ratio: left-out squares of its coordinates with the curve, over those without.
        absorbable: share of its squared torque that the model's own columns could make.
        depends, independent: signals of further curves that would lower the error beside it, and
            that would not.
    """

    effect: Curve
    joint: str
    x: Array
    torque: Array
    lower: Array
    upper: Array
    ratio: float
    absorbable: float
    depends: tuple[str, ...]
    independent: tuple[str, ...]

    def __repr__(self) -> str:
        left = f"{100 * self.ratio:.0f} % of the squared error of {self.joint} left"
        return f"{self.effect.label}, {self.effect.pieces} pieces: {left}"

    def full(self, signal: str) -> str:
        """Return a signal's name as a column of a log: `q` of the own joint is `q.elbow`."""
        return signal if "." in signal or signal == "t" else f"{signal}.{self.joint}"

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"curve_{plain(self.joint)}.csv"

    @property
    def csv(self) -> str:
        """Its content: the signal, the torque, and the band."""
        rows = np.column_stack([self.x, self.torque, self.lower, self.upper])
        lines = (",".join(f"{value:.9g}" for value in row) for row in rows)
        return "\n".join(
            [f"{self.effect.first}.{self.effect.joints[-1]},torque,lower,upper", *lines, ""]
        )


def curve_of(
    contest: Contest, beside: PartialRegression, joint: str, limit: float, rival_se: float,
    least: float,
) -> FoundCurve | None:  # fmt: skip
    """Find the curve that explains most in a joint beside a model; None where none does.

    Args:
        contest: rows and all curves.
        beside: the model, without what has the wrong form.
        joint: of the torque.
        limit: share of the left-out squared error that chance explains.
        rival_se: standard errors within which two curves are equal.
        least: share of the left-out squared error that it must explain.
    """
    mine = [
        e for e in contest.candidates if isinstance(e.effect, Curve) and e.effect.joints[0] == joint
    ]
    if not mine:
        return None
    G = beside.explained(beside.gains([each.groups[0] for each in mine]).by)
    if G.max() <= least:
        return None
    near = [i for i in range(len(mine)) if G[i] >= (1 - PARSIMONY) * G.max()]
    best = min(near, key=lambda i: (len(mine[i].effect.depends_on), -G[i]))  # type: ignore[attr-defined]
    curve = mine[best].effect
    assert isinstance(curve, Curve)
    contest = replace(contest, regression=beside)
    tried = []
    for pieces in PIECES:
        effect = replace(curve, values={"pieces": float(pieces)})
        (shape,) = contest.table.starts(effect)
        C = contest.columns(effect, shape)
        tried.append((beside.refit_with(C), effect, shape, C))
    refit, effect, shape, C = min(tried, key=lambda each: float(each[0].loss.sum()))
    S, g = normal_equations(beside, C)
    size = np.sqrt(np.where(np.diag(S) > 0, np.diag(S), 1.0))
    values, V = np.linalg.eigh(S / size[:, None] / size)
    V = V[:, values > NEW] / size[:, None]
    values = values[values > NEW]
    theta = (V / values) @ (V.T @ g)
    own = sorted({p.coordinate for p, c in zip(beside.parts, C, strict=True) if c.any()})
    noise = float(refit.loss[:, own].sum()) / max(float(beside.rows[own].sum()), 1.0)
    x, B = _on_grid(effect, shape)
    torque = B @ theta
    half = BAND * np.sqrt(noise * ((B @ V) ** 2 / values).sum(axis=1))
    whole = sum(
        float(
            ((c * beside.weight[p.coordinate]) @ theta)
            @ ((c * beside.weight[p.coordinate]) @ theta)
        )
        for p, c in zip(beside.parts, C, strict=True)
    )
    mends = np.flatnonzero(refit.by >= MINE * refit.by.sum())
    compare = LossComparison([int(u) for u in mends], rival_se)
    depends, independent = _signals(contest, C, mine, effect, limit)
    return FoundCurve(
        effect, joint, x, torque, torque - half, torque + half,
        compare.ratio(refit.loss, beside.losses),
        float(np.clip(1 - (theta @ S @ theta) / max(whole, 1e-300), 0.0, 1.0)),
        depends, independent,
    )  # fmt: skip


def _on_grid(effect: Curve, shape: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the signal (n,) and the columns (n, u) there, a second signal being 1."""
    low, high = shape["x0"], shape[f"x{effect.pieces}"]
    x = np.linspace(-high if effect.first == "v" else low, high, POINTS)
    one = np.ones((POINTS, effect.arity))
    load = one if effect.second == "load" else x[:, None]
    signals = Signals(
        t=x, q=one.copy(), v=one.copy(), a=one.copy(), still=np.full(effect.arity, 1e-12),
        shape=shape, predicted=lambda: (x[:, None], load),
    )  # fmt: skip
    if effect.first == "t":
        signals = replace(signals, t=x - x[0])
    elif effect.first == "temperature":
        signals = replace(signals, extra={effect.reads()[0]: x})
    elif effect.second == "q":
        signals.q[:, 1] = x
    elif effect.first != "load":
        getattr(signals, effect.first)[:, 0] = x
    return x, effect.columns(signals)[:, 0]


def _signals(
    contest: Contest, C: list[Array], curves: list[CandidateColumns], effect: Curve, limit: float
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the signals of which further curves lower the error beside a curve, and which not."""
    contest, new = contest.added(C)
    regression = contest.regression.extended(new)
    total = max(float(regression.loss.sum()), 1e-300)  # what no signal explains counts as well
    G = regression.gains([each.groups[0] for each in curves]).G / total
    more = {*effect.depends_on, *(f"q.{name}" for name in effect.joints[1:])}
    for each, gain in zip(curves, G, strict=True):
        if gain > limit:
            more |= set(_names([each]))
    every = dict.fromkeys(_names(curves))
    return tuple(n for n in every if n in more), tuple(n for n in every if n not in more)


def _names(curves: list[CandidateColumns]) -> Iterator[str]:
    """Yield the signals of curves; of another joint's, with its name."""
    for each in curves:
        effect = each.effect
        assert isinstance(effect, Curve)
        if effect.arity > 1:
            yield f"q.{effect.joints[1]}"
        else:
            yield from sorted(effect.depends_on)
