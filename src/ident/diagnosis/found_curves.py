"""The curve of a signal that explains what is left in a joint, with its band.

    θ = S⁺ C̃ᵀr        S = C̃ᵀC̃        f(x) = B(x) θ ± 1.96 s √diag(B S⁺ Bᵀ)

C̃ is what the model's own columns cannot make of the curve's. The number of its pieces is the one
with the least left-out error.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.diagnosis.candidates import CandidateColumns, Contest
from ident.diagnosis.law_search import inverse_root, normal_equations
from ident.diagnosis.laws import FoundLaw, LossComparison
from ident.diagnosis.search import Selection
from ident.effects import Effect, Signals
from ident.effects.curve import Curve
from ident.effects.formula import Formula, file_name_of
from ident.fit.values import Value
from ident.information import linear
from ident.information.evidence import nearly_best
from ident.information.hypotheses import Array, PartialRegression

PIECES = (2, 3, 5, 8, 12, 20)  # work: that are compared
POINTS = 101  # shown: at which the curve is given
BAND = 1.96  # level: standard errors of a 95 % band


@dataclass(frozen=True, eq=False, repr=False)
class FoundCurve:
    """A curve that explains what is left in a joint.

    Attributes:
        effect: with the number of its pieces; joint: of its torque.
        x, torque, lower, upper: (n,) the signal, the torque and its 95 % band [N m | N]; of a
            product, the torque for a second signal of 1.
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
        remaining = f"{100 * self.ratio:.0f} % of the squared error of {self.joint} left"
        return f"{self.effect.label}, {self.effect.pieces} pieces: {remaining}"

    def torque_of_formula(self, formula: Formula, values: Sequence[Value]) -> Array | None:
        """Return the torque (n,) of a formula with some values on the curve's signal, with the
        curve's offset and slope, which the model's parameters often make; None where it depends on
        other signals than the curve.
        """
        curve = self.effect
        if len(formula.joints) > 1 or curve.arity > 1 or formula.depends_on != curve.depends_on:
            return None
        known = {v.name.rpartition(".")[2]: v.value for v in values}
        second = {"load" if curve.second == "load" else "v": 1.0} if curve.second else {}
        y = formula.of_signal(curve.first, self.x, {**known, **second})
        weight = 1 / np.maximum(self.upper - self.lower, 1e-12)
        A = np.stack([np.ones_like(self.x), self.x], axis=1)[:, : 1 if curve.second else 2]
        rest = linear.lstsq(A * weight[:, None], (self.torque - y) * weight)[0]
        return np.asarray(y + A @ rest)

    def full(self, signal: str) -> str:
        """Return a signal's name as a column of a log: `q` of the own joint is `q.elbow`."""
        return signal if "." in signal or signal == "t" else f"{signal}.{self.joint}"

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"curve_{file_name_of(self.joint)}.csv"

    @property
    def csv(self) -> str:
        """Its content: the signal, the torque, and the band."""
        rows = np.column_stack([self.x, self.torque, self.lower, self.upper])
        lines = (",".join(f"{value:.9g}" for value in row) for row in rows)
        return "\n".join(
            [f"{self.effect.first}.{self.effect.joints[-1]},torque,lower,upper", *lines, ""]
        )


def curve_of(
    contest: Contest, regression: PartialRegression, joint: str, limit: float, least: float
) -> FoundCurve | None:
    """Find the curve that explains most in a joint beside a model; None where none does.

    Args:
        contest: rows and all curves; regression: the model, without what has the wrong form.
        limit: share of the left-out squares that chance explains; least: that it must explain.
    """
    candidates = [
        e for e in contest.candidates if isinstance(e.effect, Curve) and e.effect.joints[0] == joint
    ]
    if not candidates:
        return None
    G = regression.shares([candidate.groups[0] for candidate in candidates])
    if G.max() <= least:
        return None
    curves = [candidate.effect for candidate in candidates if isinstance(candidate.effect, Curve)]
    near = np.flatnonzero(nearly_best(G)).tolist()
    curve = curves[min(near, key=lambda i: (len(curves[i].depends_on), -G[i]))]
    contest = contest.with_model(regression)
    trials = []
    for pieces in PIECES:
        effect = replace(curve, values={"pieces": float(pieces)})
        (shape,) = contest.table.starts(effect)
        C = contest.columns(effect, shape)
        trials.append((regression.refit_with(C), effect, shape, C))
    refit, effect, shape, C = min(trials, key=lambda trial: float(trial[0].loss.sum()))
    S, g = normal_equations(regression, C)
    root = inverse_root(S)
    theta = root @ (root.T @ g)
    coordinates = sorted(
        {p.coordinate for p, c in zip(regression.parts, C, strict=True) if c.any()}
    )
    noise = float(refit.loss[:, coordinates].sum()) / max(
        float(regression.rows[coordinates].sum()), 1.0
    )
    x, B = _on_grid(effect, shape)
    torque = B @ theta
    half = BAND * np.sqrt(noise) * np.linalg.norm(B @ root, axis=1)
    weights = [regression.weight[part.coordinate] for part in regression.parts]
    squares = sum(float(np.sum((c @ theta * w) ** 2)) for w, c in zip(weights, C, strict=True))
    compare = LossComparison(refit.affected_coordinates, contest.decision.rival_se)
    depends, independent = _signals(contest, C, candidates, effect, limit)
    return FoundCurve(
        effect, joint, x, torque, torque - half, torque + half,
        compare.ratio(refit.loss, regression.losses),
        float(np.clip(1 - (theta @ S @ theta) / max(squares, 1e-300), 0.0, 1.0)),
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
    regression = contest.extended(C)[0].regression
    total = max(float(regression.loss.sum()), 1e-300)  # what no signal explains counts as well
    G = regression.gains([candidate.groups[0] for candidate in curves]).G / total
    names = [_names(candidate.effect) for candidate in curves]
    more = {*effect.depends_on, *(f"q.{name}" for name in effect.joints[1:])}
    more |= {
        name for signals, gain in zip(names, G, strict=True) if gain > limit for name in signals
    }
    every = dict.fromkeys(name for signals in names for name in signals)
    return tuple(n for n in every if n in more), tuple(n for n in every if n not in more)


def _names(effect: Effect) -> list[str]:
    """Return the signals of a curve; of another joint's, with its name."""
    assert isinstance(effect, Curve)
    return [f"q.{effect.joints[1]}"] if effect.arity > 1 else sorted(effect.depends_on)


def found_curves(
    selection: Selection, laws: Collection[FoundLaw], verdict: str
) -> tuple[FoundCurve, ...]:
    """Find the curves of the joints that have a law, or where the model fails unexplained."""
    last, contest = selection.last, selection.contest
    places = {law.joint: law.regression for law in laws}
    if verdict == "unexplained" and not places:
        rest = last.regression.bare
        for member in selection.members:
            rest = rest.without(member.columns) if member.rejected else rest
        curves = [curve for curve, _ in (*last.curves, *selection.first.curves)]
        curves += [m.curve for m in selection.members if m.curve is not None]
        places = {curve.joints[0]: rest for curve in curves[:1]}
    curves_found = []
    for joint, regression in places.items():
        limit = last.limit_at(joint)
        curves_found.append(curve_of(contest, regression, joint, limit, 0.0 if laws else limit))
    used = {name for law in laws for name in law.formula.logged}
    errors = contest.fit.held_out or contest.fit.train
    return tuple(
        replace(curve, independent=tuple(n for n in curve.independent if curve.full(n) not in used))
        for curve in curves_found
        if curve is not None
        and (
            curve.joint not in errors  # in a loop it is felt elsewhere
            or contest.decision.matters(
                1.0, curve.ratio, 1 / max(errors[curve.joint].relative or 1.0, 1e-9) ** 2
            )
        )
    )
