"""Effects that the data cannot show, and effects of the model that the data do not support."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.diagnosis.candidates import Contest, absorbed, possible
from ident.diagnosis.selection import HIDDEN, Decision, Ranking, torque_squares
from ident.effects import Effect
from ident.fit import Fit
from ident.information import linear
from ident.information.chance import zscore
from ident.information.hypotheses import PartialRegression

CERTAIN = 3.0  # standard errors below zero
SHARE = 0.05  # of a column, from which an unknown is named as one that carries it
NAMED = 4  # unknowns that are named
STILL = 1e-9  # of other effects' columns: below, the motion does not feel this one at all


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
class Unsupported:
    """An effect in the model that should be removed or examined."""

    effect: Effect
    why: str
    absurd: bool

    def json(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        return {**name_of(self.effect), "why": self.why, "absurd": self.absurd}


def invisible(first: Ranking) -> tuple[Invisible, ...]:
    """Candidates of which the model leaves nothing to see, or that could not be judged, given all
    on the model as it is.
    """
    contest, regression, fit = first.contest, first.contest.regression, first.contest.fit
    found: list[Invisible] = []
    squares = regression.squares @ regression.weight**2
    still = STILL**2 * max(regression.rank, 1)
    for each in contest.laws:
        if all(squares[group].sum() <= still for group in each.groups):
            found.append(Invisible(each.effect, _motionless(fit, each.effect)))
        elif first.gains[each.effect.label][1] < HIDDEN:
            found.append(Invisible(each.effect, _why(fit, regression, each.groups[0])))
    found += [Invisible(e, f"could not be judged: {why}") for e, why in contest.failed]
    every = ((e, absorbed(fit.mechanism, e)) for e in possible(fit.mechanism, fit.motion))
    return (*found, *(Invisible(effect, why) for effect, why in every if why))


def _motionless(fit: Fit, effect: Effect) -> str:
    if effect.corrects:
        return "no torque changes with it: gravity does not feel it in this motion"
    if fit.mechanism.closures:
        return f"the closures hide it: {effect.joints[0]} does not move with any drive"
    return f"{', '.join(effect.joints)} does not move in this motion"


def _why(fit: Fit, regression: PartialRegression, group: np.ndarray) -> str:
    """Name the unknowns that absorb the columns of an effect most: C ≈ A_I K."""
    own = fit.estimate.base.independent
    A, C = (
        np.concatenate([
            part.taken(columns) * regression.weight[part.coordinate] for part in regression.parts
        ])
        for columns in (own, group)
    )  # fmt: skip
    norms = np.linalg.norm(A, axis=0)
    A = A / np.where(norms > 0, norms, 1.0)
    carriers: dict[str, float] = {}
    for c in C.T:
        K = linear.lstsq(A, c, rcond=1e-10)[0] / max(float(np.linalg.norm(c)), 1e-300)
        for i in np.flatnonzero(np.abs(K) > SHARE):
            name = fit.columns.names[own[i]]
            carriers[name] = max(carriers.get(name, 0.0), abs(float(K[i])))
    names = sorted(carriers, key=lambda name: -carriers[name])
    if not names:
        return "absorbed by the model's own parameters"
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    exact = regression.refit(group).visible < 1e-6
    same = "same columns as" if exact else "nearly the same columns as"
    return f"absorbed: {same} {', '.join(names[:NAMED])}{more}"


def unsupported(fit: Fit, contest: Contest, decision: Decision) -> tuple[Unsupported, ...]:
    """Effects of the model without which the left-out error is no larger, and absurd ones."""
    found = []
    regression = contest.regression
    torque = max(float(torque_squares(contest, regression).sum()), 1e-300)
    for effect, places in fit.columns.effects:
        mine = np.array([p for p in places if p >= 0 and not fit.estimate.held[p]], dtype=int)
        absurd = _absurd(fit, effect)
        if absurd:
            why = (
                f"{', '.join(absurd)} is negative beyond its error, which no such effect can be: "
                "something else is missing, or a sign is wrong"
            )
            found.append(Unsupported(effect, why, True))
        elif len(mine):
            D = (regression.without(mine).losses - regression.losses).sum(axis=1)
            size = float(np.sqrt(max(D.sum(), 0.0) / torque))
            if zscore(D) < decision.rival_se or D.sum() <= 0:
                why = f"without it the held-out error is no larger (z = {zscore(D):.1f})"
                found.append(Unsupported(effect, why, False))
            elif size < decision.material / 10:
                why = f"it explains {100 * size:.2g} % of the torque only"
                found.append(Unsupported(effect, why, False))
    return tuple(found)


def _absurd(fit: Fit, effect: Effect) -> list[str]:
    """Name the parameters of an effect of the model that are negative beyond their error, and must
    not be; errors are worked out where some value is negative.
    """
    pairs = zip(effect.names, effect.parameters, strict=True)
    if not any(each.nonnegative and fit.point.values.get(name, 0.0) < 0 for name, each in pairs):
        return []
    values = next(each.parameters for each in fit.effects if each.effect.label == effect.label)
    return [
        v.name
        for v, parameter in zip(values, effect.parameters, strict=True)
        if parameter.nonnegative and v.stderr is not None and v.value < -CERTAIN * v.stderr
    ]
