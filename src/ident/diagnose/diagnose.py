"""The verb `diagnose`: where a model fails, and which effect is missing."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ident.diagnose.choose import Choice, choose, without_name
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.evidence import CLOSES, REST, Evidence, together, torque_squares
from ident.diagnose.experiment import next_experiment
from ident.diagnose.explanation import Explanation, explain, told_apart
from ident.diagnose.hidden import Invisible, invisible, outright
from ident.diagnose.null import Null, null
from ident.diagnose.quiet import quiet
from ident.diagnose.screen import Screen
from ident.diagnose.search import Search, search
from ident.diagnose.sites import candidates
from ident.diagnose.suggest import Suggestion, suggest
from ident.diagnose.support import CERTAIN, unsupported
from ident.diagnose.words import text_of
from ident.errors import FitError, IdentError
from ident.fit import Fit
from ident.fit.table import Table
from ident.health import health
from ident.health.remainder import free
from ident.progress import Progress
from ident.residual import periods, residual_of, where

SHOWN = 3  # candidates that are refitted though nothing speaks for them
REFITTED = 8  # at most
MOSTLY, CLEARLY = 0.7, 0.2  # of the gap, that an expression closes, and more than names do
STRUCTURE = 1.25  # times the largest of clean logs, from which a residual is no noise


@dataclass(frozen=True, eq=False)
class Judged:
    """All candidates weighed on one fit: what a diagnosis and a growing model rest on."""

    fit: Fit
    table: Table
    screen: Screen
    clean: Null
    search: Search
    absorbed: tuple[Invisible, ...]
    threshold: np.ndarray
    choice: Choice
    better: Suggestion | None = None


def judge(
    fit: Fit,
    *,
    seed: int = 0,
    without: Collection[str] = (),
    progress: Progress | None = None,
) -> Judged:
    """Weighs every effect of the library at every place against what clean logs show.

    Args:
        fit: of the model as it is.
        seed: of the clean logs' noise.
        without: labels of effects that are not candidates.
        progress: called with (what is being done, share done).
    """
    told = progress or _silent
    told("rows", 0.0)
    table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    screen = Screen.of(table, quiet(table), _weights(fit, table), fit.estimate.held)
    clean = null(table, screen, seed, told)
    wanted = [e for e in candidates(fit.mechanism, fit.motion) if e.label not in without]
    absorbed = tuple(x for x in (outright(fit.mechanism, each) for each in wanted) if x)
    given = {each.effect.label for each in absorbed}
    wanted = [each for each in wanted if each.label not in given]
    found = search(table, screen, wanted, clean.R, told)
    threshold = found.null.max(axis=1, initial=0.0)
    chosen = choose(table, screen, clean, threshold, found.candidates)
    judged = Judged(fit, table, screen, clean, found, absorbed, threshold, chosen)
    if _collapsed(fit):
        return replace(judged, choice=without_name(chosen))
    if (better := _beaten(judged)) is not None:
        return replace(judged, choice=without_name(chosen), better=better)
    return judged


def _collapsed(fit: Fit) -> bool:
    """Whether parameters have shrunk to explain a torque that is hardly there.

    A joint that swings freely asks for no inertia at all, noise in accelerations helps, and what
    then seems missing stands for what was lost. Its sign is friction that comes out negative.
    """
    negative = any(
        value.stderr and value.value < -CERTAIN * value.stderr
        for each in fit.effects
        for value, parameter in zip(each.parameters, each.effect.parameters, strict=True)
        if parameter.nonnegative
    )
    return negative and bool(free(fit))


def _beaten(judged: Judged) -> Suggestion | None:
    """An expression that explains far more than the name does, and than effects do together."""
    j, best = judged, judged.choice.best
    if best is None or j.choice.partner is not None or best.closure >= CLOSES:
        return None
    other = suggest(j.table, j.screen, j.clean, j.threshold, best.candidate.coordinate)
    if other is None or other.closure < max(MOSTLY, best.closure + CLEARLY):
        return None
    return other if other.closure > _by_effects(j, best, len(other.terms)) + CLEARLY else None


def _by_effects(j: Judged, best: Evidence, most: int) -> float:
    """Closure of the best sum of as many effects of the same joint, the name among them.

    An effect that explains nothing by itself may be what the others wait for.
    """
    joints = set(best.candidate.effect.joints)
    pool = [
        each.candidate for each in j.choice.evidence
        if each is not best and each.sensible and not each.candidate.effect.rare
        and set(each.candidate.effect.joints) <= joints and each.candidate.effect.joints
    ]  # fmt: skip
    group, closure = [best.candidate], best.closure
    while pool and len(group) < most:
        found = [together(j.table, j.screen, j.clean, j.threshold, [*group, x]) for x in pool]
        closures = [each.closure for each in found]
        at = int(np.argmax(closures))
        group.append(pool.pop(at))
        closure = max(closure, closures[at])
    return closure


def diagnose(fit: Fit, *, seed: int = 0, progress: Progress | None = None) -> Diagnosis:
    """Where the model fails, what is missing, how sure that is, and what to measure next.

    Every effect of the library at every place is judged after refitting everything else: by the
    fall of errors held out in blocks of time, by what clean logs of the fitted model show through
    the same pipeline, and by the share of the gap between residual and noise that it closes.

    Args:
        fit: from `ident.identify`.
        seed: of the clean logs' noise.
        progress: called with (what is being done, share done).

    Returns:
        The diagnosis; `print(diagnosis)` says it in words.

    Raises:
        FitError: if it is given no fit.
    """
    if not isinstance(fit, Fit):
        raise FitError(
            f"diagnose needs a fit, given: {type(fit).__name__}; write "
            "ident.diagnose(ident.identify(mechanism, motion))"
        )
    return told_of(judge(fit, seed=seed, progress=progress), progress)


def told_of(judged: Judged, progress: Progress | None = None) -> Diagnosis:
    """The diagnosis of a fit on which all candidates are weighed."""
    told = progress or _silent
    fit, table, screen, clean = judged.fit, judged.table, judged.screen, judged.clean
    chosen = judged.choice
    told("refitting", 0.7)
    explanations = told_apart(_explanations(fit, chosen))
    if chosen.best is not None and not _leads(chosen.best, explanations):
        chosen = without_name(chosen)  # what cannot be refitted is no name
    residual = residual_of(fit)
    verdict = _verdict(replace(judged, choice=chosen))
    proposal: Suggestion | None = None
    if verdict == "unexplained":
        told("looking for an expression", 0.8)
        worst = _worst(table, screen, clean)
        proposal = judged.better or suggest(table, screen, clean, judged.threshold, worst)
    told("where it fails", 0.9)
    floor = clean.floor / screen.weight
    bare = Diagnosis(
        fit=fit,
        verdict=verdict,
        health=health(fit, fit.motion.logs),
        where=where(residual),
        periods=periods(residual),
        candidates=tuple(explanations),
        choice=chosen,
        invisible=(
            *invisible(fit, table, screen, judged.search.candidates),
            *judged.absorbed,
            *(Invisible(e, f"could not be judged: {why}") for e, why in judged.search.failed),
        ),
        unsupported=unsupported(fit, table, screen),
        suggestion=proposal,
        floor=dict(zip(fit.motion.independent, map(float, floor), strict=True)),
        next_experiment="",
        text="",
    )
    experiment = next_experiment(bare)
    return replace(bare, next_experiment=experiment, text=text_of(bare, experiment))


def _silent(what: str, share: float) -> None:
    """Progress that nobody watches."""


def _verdict(judged: Judged) -> str:
    if judged.choice.best is not None:
        return "missing"
    left = structure(judged.table, judged.screen, judged.clean).any()
    return "unexplained" if left or judged.choice.credible else "nothing"


def _weights(fit: Fit, table: Table) -> np.ndarray:
    """σ (d,) of the fit's rows, or of its residuals where a time basis weighs all rows alike."""
    sigma = fit.estimate.sigma
    if len(sigma) == table.b.shape[1]:
        return sigma
    r = table.b - table.A @ fit.estimate.solution.x
    return np.sqrt((r**2).mean(axis=0)) + 1e-300


def structure(table: Table, screen: Screen, clean: Null) -> np.ndarray:
    """(d,) whether a coordinate's residual is more than noise, and matters."""
    squares = screen.loss.sum(axis=0) / np.maximum(screen.rows, 1)
    torque = torque_squares(table, screen) / np.maximum(screen.rows, 1)
    excess = np.sqrt(np.maximum(squares - clean.floor**2, 0.0))
    return (np.sqrt(squares) > STRUCTURE * clean.ceiling) & (excess > REST * np.sqrt(torque))


def _worst(table: Table, screen: Screen, clean: Null) -> int:
    """The coordinate with the largest gap between residual and noise, by its torque."""
    gap = np.maximum(screen.loss.sum(axis=0) - clean.floor**2 * screen.rows, 0.0)
    torque = torque_squares(table, screen)
    return int((gap / np.where(torque > 0, torque, np.inf)).argmax())


def _leads(best: Evidence, explanations: list[Explanation]) -> bool:
    return bool(explanations) and explanations[0].effect.label == best.candidate.effect.label


def _explanations(fit: Fit, chosen: Choice) -> list[Explanation]:
    """Refits of the best, its rivals, and what else is promising, best first."""
    first: list[Evidence] = [] if chosen.best is None else [chosen.best, *chosen.rivals]
    rest = [each for each in chosen.evidence if each not in first]
    rest.sort(key=lambda each: not each.credible)
    wanted = [*first, *rest][: max(SHOWN, min(REFITTED, len(first) + 1))]
    found = []
    group = [each.candidate.effect for each in first]
    for each in wanted:
        rivals = tuple(e for e in group if e is not each.candidate.effect) if each in first else ()
        with suppress(IdentError):  # a correction too large for the loops to close, say
            found.append(explain(fit, each, rivals))
    return found
