"""What the data cannot show: effects, those of the model among them, and laws like a name's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.diagnosis.candidates import HIDDEN, absorbed, possible
from ident.diagnosis.law_search import FittedFormula, LawSearch, OnProgress
from ident.diagnosis.laws import LossComparison
from ident.diagnosis.search import Selection
from ident.diagnosis.selection import Ranking
from ident.effects import KINDS, Effect, Signals
from ident.fit import Fit
from ident.information import linear
from ident.information.evidence import CERTAIN, zscore
from ident.information.hypotheses import Array, PartialRegression

SHARE = 0.05  # shown: of a column, from which an unknown is named as one that carries it
NAMED = 4  # shown: unknowns that are named
# numerics: of other effects' columns: below, the motion does not feel this one at all
UNFELT = 1e-9


def name_of(effect: Effect) -> dict[str, Any]:
    """`{"effect": …, "joints": […]}`."""
    signal = {"signal": effect.signal} if effect.signal else {}
    return {"effect": effect.kind, "joints": list(effect.joints), **signal}


@dataclass(frozen=True, eq=False)
class Invisible:
    """An effect whose columns the model has already, or the motion does not feel."""

    effect: Effect
    why: str

    def json(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        return {**name_of(self.effect), "why": self.why}


@dataclass(frozen=True, eq=False)
class Unsupported(Invisible):
    """An effect in the model that should be removed or examined."""

    absurd: bool

    def json(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        return {**super().json(), "absurd": self.absurd}


def invisible(first: Ranking) -> tuple[Invisible, ...]:
    """Candidates of which the model as it is leaves nothing to see, or that could not be judged."""
    contest, regression, fit = first.contest, first.contest.regression, first.contest.fit
    hidden: list[Invisible] = []
    squares = regression.squares @ regression.weight**2
    still = UNFELT**2 * max(regression.rank, 1)
    shown = {law.effect.label for law in first.credible}  # the little of it that is visible does
    for law in contest.laws:
        if law.effect.label in shown:
            continue
        if all(squares[group].sum() <= still for group in law.groups):
            hidden.append(Invisible(law.effect, _motionless(fit, law.effect)))
        elif first.gains[law.effect.label][1] < HIDDEN:
            hidden.append(Invisible(law.effect, _why(fit, regression, law.groups[0])))
    hidden += [Invisible(e, f"could not be judged: {why}") for e, why in contest.failed]
    every = ((e, absorbed(fit.mechanism, e)) for e in possible(fit.mechanism, fit.motion))
    return (*hidden, *(Invisible(effect, why) for effect, why in every if why))


def _motionless(fit: Fit, effect: Effect) -> str:
    if effect.corrects:
        return "no torque changes with it: gravity does not feel it in this motion"
    if fit.mechanism.closures:
        return f"the closures hide it: {effect.joints[0]} does not move with any drive"
    if {*effect.joints} <= {*fit.mechanism.unmeasured}:
        return f"the torque of {', '.join(effect.joints)} is not measured"
    return f"{', '.join(effect.joints)} does not move in this motion"


def _why(fit: Fit, regression: PartialRegression, group: np.ndarray) -> str:
    """Name the unknowns that absorb the columns of an effect most: C ≈ A_I K."""
    independent = fit.estimate.base.independent
    A, C = (
        np.concatenate([
            part.taken(columns) * regression.weight[part.coordinate] for part in regression.parts
        ])
        for columns in (independent, group)
    )  # fmt: skip
    norms = np.linalg.norm(A, axis=0)
    A = A / np.where(norms > 0, norms, 1.0)
    carriers: dict[str, float] = {}
    for c in C.T:
        K = linear.lstsq(A, c, rcond=1e-10)[0] / max(float(np.linalg.norm(c)), 1e-300)
        for i in np.flatnonzero(np.abs(K) > SHARE):
            name = fit.columns.names[independent[i]]
            carriers[name] = max(carriers.get(name, 0.0), abs(float(K[i])))
    names = sorted(carriers, key=lambda name: -carriers[name])
    if not names:
        return "absorbed by the model's own parameters"
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    exact = regression.refit(group).visible < 1e-6
    same = "same columns as" if exact else "nearly the same columns as"
    return f"absorbed: {same} {', '.join(names[:NAMED])}{more}"


def unsupported(first: Ranking) -> tuple[Unsupported, ...]:
    """Effects of the model that lower the left-out error no more than chance, and absurd ones."""
    contest, regression = first.contest, first.regression.bare
    doubtful, fit, decision = list[Unsupported](), contest.fit, contest.decision
    torque = max(float(contest.torque.sum()), 1e-300)
    for effect, places in fit.columns.effects:
        columns = np.array([p for p in places if p >= 0 and not fit.estimate.fixed[p]], dtype=int)
        absurd, why = _absurd(fit, effect), ""
        if absurd:
            why = (
                f"{', '.join(absurd)} is negative beyond its error, which no such effect can be: "
                "something else is missing, or a sign is wrong"
            )
        elif len(columns):
            D = (regression.without(columns).losses - regression.losses).sum(axis=1)
            size, z = float(np.sqrt(max(D.sum(), 0.0) / torque)), zscore(D)
            if D.sum() <= 0:
                why = "without it the held-out error of all joints together is no larger"
            elif z < decision.rival_se:
                why = "without it the held-out error is larger by no more than chance makes it "
                why += f"(z = {z:.1f})"
            elif size < decision.material / 10:
                why = f"it explains {100 * size:.2g} % of the torque only"
        doubtful += [Unsupported(effect, why, bool(absurd))] if why else []
    return tuple(doubtful)


def _absurd(fit: Fit, effect: Effect) -> list[str]:
    """Name the parameters of an effect that are negative beyond their error, and must not be."""
    pairs = zip(effect.names, effect.parameters, strict=True)
    if not any(
        parameter.nonnegative and fit.point.values.get(name, 0.0) < 0 for name, parameter in pairs
    ):
        return []  # errors take time
    values = next(e.parameters for e in fit.logged_effects if e.effect.label == effect.label)
    return [
        v.name
        for v, parameter in zip(values, effect.parameters, strict=True)
        if parameter.nonnegative and v.stderr is not None and v.value < -CERTAIN * v.stderr
    ]


# range: times the travelled range, over which laws that do as well are compared
EXTRAPOLATION = 2.0
DIFFERENT = 0.2  # tuned: of a torque (rms) there, from which two are two laws


def relatives_of(selection: Selection, on_progress: OnProgress) -> tuple[FittedFormula, ...]:
    """Return laws of the literature that do as well as the first name, which is one of position:
    over the travelled range the data cannot tell them from it. One of each kind, the best first;
    effects of the library are the name's rivals instead.
    """
    best = selection.named[0] if selection.named else None
    if best is None or not best.effect.of_position or best.stands_in:
        return ()  # where it stands for another effect, its columns are of that one
    last, joint = selection.last, best.effect.joints[0]
    regression = last.regression.bare
    bare = regression.without(best.columns)
    contest, none = selection.contest.with_model(bare), np.zeros(len(bare.rows))
    limit, rival_se = last.limit_at(joint), contest.decision.rival_se
    search = LawSearch(contest, joint, "", limit, none, on_progress, of_position=True)
    formulas = sorted(search.extended(None), key=lambda fitted: float(fitted.loss.sum()))
    equal: dict[str, FittedFormula] = {}
    for fitted in formulas:
        name = fitted.formula.terms[0].known_as
        compare = LossComparison(fitted.refit.affected_coordinates, rival_se)
        as_good = compare.better(fitted.refit.loss, regression.losses) < rival_se
        if name and name not in KINDS and as_good and fitted.determined(bare):
            equal.setdefault(name, fitted)
    theta, _ = regression.solved
    order = np.argsort(regression.model)
    coefficients = theta[order[np.searchsorted(regression.model, best.columns, sorter=order)]]
    shape = best.evidence.shape if best.evidence is not None else {}
    index = contest.table.mechanism.joint_index[joint]
    q = np.concatenate([scene.e.y[scene.e.usable, index] for scene in contest.table.scenes])
    x = np.mean(q) + EXTRAPOLATION * (np.linspace(q.min(), q.max(), 101) - np.mean(q))
    known = _beyond(best.effect, shape, coefficients, x)
    others = ((e, _beyond(e.formula, e.shape, e.refit.theta, x)) for e in equal.values())
    apart = np.linalg.norm
    return tuple(e for e, f in others if apart(f - known) > DIFFERENT * apart(known))


def _beyond(effect: Effect, shape: Mapping[str, float], theta: Array, x: Array) -> Array:
    """Return the torque (n,) of an effect at positions x (n,), less what gravity can make."""
    one = np.ones((len(x), 1))
    s = Signals(x, x[:, None], one, one, np.full(1, 1e-12), shape=shape)
    f = effect.columns(s)[:, 0] @ theta[: len(effect.unknowns)]
    A = np.stack([one[:, 0], np.sin(x), np.cos(x)], axis=1)
    return np.asarray(f - A @ linear.lstsq(A, f)[0])
