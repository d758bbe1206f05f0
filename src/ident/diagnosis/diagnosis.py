"""The verb `diagnose`: where a model fails, and which effect is missing."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import chain, count, product
from operator import add

import numpy as np

from ident.diagnosis.candidates import Contest, OnProgress, candidates_of, residual_in
from ident.diagnosis.effect_set import Member
from ident.diagnosis.found_curves import FoundCurve, curve_of
from ident.diagnosis.laws import FoundLaw, laws_of
from ident.diagnosis.null import NoiseDraws, noise
from ident.diagnosis.refitted import (
    by_rivals,
    explain,
    explanations,
    least_error,
    started,
    with_group,
)
from ident.diagnosis.result import Diagnosis, Explanation, Law, announced_with, errors_of
from ident.diagnosis.search import Selection, select
from ident.diagnosis.selection import MOST, NEGATIVE, Decision, Ranking, can_be, torque_squares
from ident.diagnosis.unobservable import invisible, relatives_of, unsupported
from ident.display import part
from ident.effects.formula import Formula
from ident.equations.unknowns import Point
from ident.errors import FitError, IdentError, check_whole
from ident.fit import Fit, identify
from ident.fit.data_checks import DataChecks, Health
from ident.fit.faults import Fault, fault_finding, scale_of_time
from ident.fit.findings import Finding
from ident.fit.residual import residual_of
from ident.fit.residual_maps import Periods
from ident.information.chance import ALPHA, LEAVES, LOUD, RIVAL
from ident.information.estimate import MATERIAL
from ident.information.hypotheses import PartialRegression

TRIED = 3  # work: rivals of a formula whose constants are not determined
VERDICTS = ("missing", "nothing", "unexplained", "undecided")
STEP = 0.08  # tuned: of dry friction's rms, by which it may differ from a step around reversals; a
# simulator's friction, 10 ms early, differs by 0.06, breakaway of eight times as much by 0.1
AGAIN = 0.6  # tuned: correlation of a residual between periods that noise does not have


def diagnose(
    fit: Fit,
    *,
    seed: int = 0,
    alpha: float = ALPHA,
    material: float = MATERIAL,
    rival_se: float = RIVAL,
    progress: OnProgress | None = None,
) -> Diagnosis:
    """Where the model fails, what is missing, how sure that is, and what to measure next.

    Every effect of the library at every place is judged after refitting everything else: by the
    fall of the error of stretches of time that were left out, held against the largest fall that
    any candidate brings on residuals in which nothing is missing.

    Args:
        fit: from `ident.identify`.
        seed: of the residuals in which nothing is missing.
        alpha: chance of a name where nothing is missing.
        material: share of a joint's torque below which an effect does not matter.
        rival_se: standard errors of the difference within which two effects are rivals.
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
    on_progress = part(progress, 0.0, 1.0)
    decision = Decision(alpha, material, rival_se)
    check_whole("seed", seed)
    contest = Contest.of(fit, candidates_of(fit), part(on_progress, 0.0, 0.3))
    on_progress("noise of the sensors", 0.3)
    draws, here = noise(contest, seed), part(on_progress, 0.3, 0.9)
    found = concluded(contest, draws, decision, seed, here)
    return at_reversals(contest, found, decision, seed, part(on_progress, 0.9, 1.0))


def at_reversals(
    contest: Contest, found: Diagnosis, decision: Decision, seed: int, on_progress: OnProgress,
    other: Contest | None = None,
) -> Diagnosis:  # fmt: skip
    """The diagnosis, or where it names nothing the one on the rows at reversals too, if that names
    an effect that acts there, or one that is more than chance away from them too. What else is
    found there is left open: dry friction is least exact. `other`: the contest on those rows, if it
    is made already.
    """
    if found.verdict == "missing":
        return found
    first, second, third = (part(on_progress, *x) for x in ((0.0, 0.4), (0.4, 0.7), (0.7, 1.0)))
    other = other or contest.at_reversals(first)
    if other is None:
        return found
    draws = noise(other, seed)
    chosen = select(other, draws, decision, seed, second)
    seen = seen_elsewhere(found.selection.first)
    both = tuple(m for m in chosen.members if m.label in seen)
    chosen = replace(chosen, members=both) if both else chosen
    acts = seen | {m.label for m in chosen.members if m.effect.at_reversals}
    if _named_at_reversals(chosen, found.fit, acts):
        again = judged(other, draws, chosen, decision, third)
        if again.best and again.best.label in acts:
            return again
    table = contest.table
    squares = residual_in(table, found.fit) ** 2
    few, every = ((squares * use).sum(axis=0) for use in (contest.use, table.informed))
    names = zip(found.fit.motion.independent, few < every / 2, strict=True)
    loud = tuple(joint for joint, most in names if most)  # most of it is around reversals
    # dry friction that is no step there is no other effect, and a finding of the fit says so; nor
    # is it in a joint in which it builds up over some speed or is late
    left = excess(other, draws, other.regression, decision)
    more = bool(both) or any(m.effect.at_reversals for m in chosen.members)
    no_step = {j for m in chosen.named if m.effect.needs or m.effect.fault for j in m.effect.joints}
    large = zip(found.fit.motion.independent, left > STEP * other.dry, strict=True)
    more |= any(much and joint not in no_step for joint, much in large)
    if found.verdict == "nothing" and more:
        return replace(found, verdict="undecided", loud=loud, reversing=True)
    return found


def seen_elsewhere(first: Ranking) -> set[str]:
    """Return labels of effects at low speed that explain more than chance away from reversals,
    however little: rows at reversals show most of them. They do not of a load, nor of anything
    else that acts at any speed, and they show a width of friction of every machine.
    """
    return {
        c.effect.label
        for c in first.contest.laws
        if c.effect.slow and c.effect.label in first.gains and not c.effect.needs
        if first.gains[c.effect.label][0] > first.limit_of(c)
    }


def _named_at_reversals(selection: Selection, fit: Fit, acts: Collection[str]) -> bool:
    """Whether the first name is of an effect that `acts` has, and explains most at reversals."""
    for first in selection.named[:1]:
        if first.label in acts and first.evidence is not None:
            with suppress(IdentError):
                return _explains_most(explain(fit, first.evidence), fit)
    return False


def concluded(
    contest: Contest, draws: NoiseDraws, decision: Decision, seed: int, on_progress: OnProgress
) -> Diagnosis:
    """The diagnosis of a fit from the rows of all candidates and draws of the sensors' noise."""
    selection = select(contest, draws, decision, seed, part(on_progress, 0.0, 0.5))
    return judged(contest, draws, selection, decision, part(on_progress, 0.5, 1.0))


def judged(
    contest: Contest, draws: NoiseDraws, selection: Selection, decision: Decision,
    on_progress: OnProgress,
) -> Diagnosis:  # fmt: skip
    """The diagnosis of a fit from the set of effects that explains most."""
    fit = contest.fit
    names = fit.motion.independent
    floor = dict(zip(names, map(float, draws.floor), strict=True))
    left = excess(contest, draws, selection.last.regression, decision)
    loud = tuple(name for name, each in zip(names, left, strict=True) if each)
    last = selection.last.regression
    data = _health_beside(contest, last.losses / last.weight**2)
    laws: tuple[Law, ...] = ()
    unsearched: tuple[str, ...] = ()
    if not data.faults:
        here = part(on_progress, 0.0, 0.4)
        lawful, found, unsearched = laws_of(contest, selection, loud, floor, decision, here)
        on_progress("refitting", 0.4)
        selection, laws = _refitted(fit, lawful, found, decision)
    first, best = selection.named[0] if selection.named else None, None
    candidates = explanations(fit, selection, first)
    for each in () if data.faults else by_rivals(selection):
        name = each.named[0]
        again = candidates if name is first else explanations(fit, each, name)
        known = [x.effect.label for x in again[:1]] == [name.label]
        if known and _explains(again[0], contest, draws, each, decision):
            best, selection, candidates = name, each, again
            if (other := least_error(each, again)) is not None:
                again = explanations(fit, other, other.named[0])
                if _explains(again[0], contest, draws, other, decision):
                    best, selection, candidates = other.named[0], other, again
            break
    if best is not None and best.effect.sits == "place":
        data = Health((*data.findings, *_clock(fit, candidates[0])))
    residual = residual_of(fit)
    verdict = _verdict(selection, best, bool(loud), bool(laws), residual.periods)
    curves = found_curves(contest, selection, [law.found for law in laws], verdict, decision)
    on_progress("where it fails", 0.8)
    diagnosis = Diagnosis(
        fit=fit,
        verdict=verdict,
        decision=decision,
        health=data,
        where=residual.where,
        periods=residual.periods,
        candidates=tuple(candidates),
        selection=selection,
        invisible=invisible(selection.first),
        unsupported=unsupported(fit, contest, decision),
        curves=curves,
        laws=laws,
        unsearched=unsearched,
        relatives=relatives_of(contest, selection, decision, part(on_progress, 0.8, 1.0))
        if best
        else (),
        floor=fit.noise,
        loud=loud,
    )
    return with_group(diagnosis)


def _refitted(
    fit: Fit, selection: Selection, found: Collection[FoundLaw], decision: Decision
) -> tuple[Selection, tuple[Law, ...]]:
    """Refit the laws, with what is named beside them; without those that cannot be refitted or do
    not matter, and what these replaced has its name again.
    """
    laws: list[Law] = []
    for each in of_one_form(found):
        formulas = (each.found, *each.rivals[:TRIED])  # the next, where one is not determined
        with_names: list[Sequence[Member | Law]] = [[*selection.named, *laws], laws]
        for formula, others in product(formulas, with_names[not selection.named :]):
            with suppress(IdentError):
                law = refitted(fit, each.instead(formula), others)
                if law.determined and law.matters(decision):
                    laws.append(law)
                    break
    good = tuple(laws)
    joints = {law.joint for law in good}
    members = tuple(
        m if m.law is None or m.law.joints[0] in joints else replace(m, law=None)
        for m in selection.members
    )
    return replace(selection, members=members), good


def of_one_form(found: Collection[FoundLaw]) -> list[FoundLaw]:
    """Give laws of several joints one form, with constants of its own at each, where a formula of
    these terms is the law or a rival of it at every joint; of several forms the best in all.
    """
    forms = [{e.formula.terms: e for e in (*law.rivals, law.found)} for law in found]
    common = set(forms[0]).intersection(*forms[1:]) if len(forms) > 1 else set()
    if not common:
        return list(found)
    losses = [float(law.found.loss.sum()) for law in found]
    best = min(
        common,
        key=lambda t: sum(float(f[t].loss.sum()) / x for f, x in zip(forms, losses, strict=True)),
    )
    return [law.instead(form[best]) for law, form in zip(found, forms, strict=True)]


def _explains_most(found: Explanation, fit: Fit) -> bool:
    """Whether a candidate explains half of what exceeds the noise in its joint, as a law must."""
    noise = fit.noise[found.joint]
    before, left = (
        max(e[found.joint].rms ** 2 - noise**2, 0.0) for e in (found.before, found.after)
    )
    return left <= (1 - MOST) * before


def _explains(
    found: Explanation, contest: Contest, draws: NoiseDraws, selection: Selection,
    decision: Decision,
) -> bool:  # fmt: skip
    """Whether the best is a cause: with which the error falls, of a possible size that the log
    determines, a length changed by no more than a third, a curve that explains half of what exceeds
    the noise, as a law must, and of no joint of which it and what was found with it leave most of
    the torque, whichever of those on which it acts it mends.
    """
    fit = contest.fit
    after, before = found.after[found.joint].rms, found.before[found.joint].rms
    if after >= before and len(selection.named) > 1:  # alone it may need the others
        after = announced_with(fit, selection, selection.named)[found.joint].rms
    if after >= before:
        return False
    if found.effect.descriptive and not _explains_most(found, fit):
        return False
    several = 1 if found.effect.loaded_link else len(found.effect.unknowns)  # of a body, its mass
    sizes = [v for v in found.parameters[: several or None] if v.stderr]
    if sizes and all(abs(v.value) < NEGATIVE * (v.stderr or 0.0) for v in sizes):
        return False
    values = np.array([value.value for value in found.parameters])
    if found.effect.sits == "place" and not can_be(fit.mechanism, found.effect, values, 0 * values):
        return False
    first, last = selection.first.regression, selection.last.regression
    left = last.losses.sum(axis=0) - last.rows * (last.weight * draws.floor) ** 2
    explained = left < LEAVES**2 * torque_squares(contest, last)
    own = found.evidence.squares(first) * first.weight**2
    acts = own > decision.material**2 * torque_squares(contest, first)
    acts[found.evidence.coordinate] = True
    return bool(explained[acts].all())


def _clock(fit: Fit, found: Explanation) -> Iterator[Finding]:
    """Report a scale of time that does as well as a length that is k times as long: lengths k times
    as long and a clock 1/√k times as long make nearly the same torques.
    """
    length = fit.mechanism.lengths.get(found.effect.joints[0], 0.0)
    k = 1 + found.parameters[0].value / length if length else 1.0
    if (before := found.error_before) is None or not 0 < k != 1:
        return
    fault = scale_of_time(Fault.none(fit.mechanism.driven), k**-0.5)
    assert fault.state is not None
    logs = tuple(fault.state(fit.mechanism, e)[1] for e in fit.motion.experiments)
    with suppress(IdentError):
        motion = replace(fit.motion, experiments=logs)
        errors = errors_of(identify(fit.mechanism, motion, estimator="least-squares"))
        if all(e.rms < LOUD * found.after[name].rms for name, e in errors.items()):
            after = errors[found.joint].relative or 0.0
            yield fault_finding(fit.mechanism, fault, before, after)


def health(fit: Fit) -> Health:
    """Judge the data behind a fit, from `identify`.

    Returns:
        Its findings, gravest first; `print` shows them in words.
    """
    return fit.health


def _health_beside(contest: Contest, explained: np.ndarray) -> Health:
    """The same beside a diagnosis, on its rows: a wrong channel must explain more than the effects
    that it found, which leave squares (blocks, d) of blocks that were left out.
    """
    fit = contest.fit
    checks = DataChecks(
        fit.problem, fit.estimate, fit.relative, contest.table, contest.use, explained
    )
    health = checks.health()
    # a joint swings freely by the fitted terms, which wrong channels spoil
    freely = () if health.faults else (e for e in fit.findings if e.code == "swings freely")
    return Health((*health.findings, *freely))


def excess(
    contest: Contest, noise: NoiseDraws, regression: PartialRegression, decision: Decision
) -> np.ndarray:
    """(d,) rms that a model leaves beyond the sensors' noise [N m | N], 0 where it is that of some
    noise or does not matter.
    """
    rows = np.maximum(regression.rows, 1)
    rms = np.sqrt(regression.losses.sum(axis=0) / rows) / regression.weight
    torque = np.sqrt(torque_squares(contest, regression) / rows) / regression.weight
    found = np.sqrt(np.maximum(rms**2 - noise.floor**2, 0.0))
    seen = (rms > LOUD * noise.ceiling) & (found > decision.material * torque)
    return np.where(seen, found, 0.0)


def _verdict(
    selection: Selection, best: Member | None, loud: bool, lawful: bool, periods: Periods | None
) -> str:
    if best is not None:
        return "missing"
    if selection.members or lawful or (loud and selection.last.curves):
        return "unexplained"
    if loud and periods is not None and max(periods.rho.values()) > max(AGAIN, periods.chance):
        return "unexplained"
    return "undecided" if loud else "nothing"


def refitted(fit: Fit, found: FoundLaw, beside: Collection[Member | Law]) -> Law:
    """Refit everything with a law and what is beside it; searches set out from where they ended."""
    others = [each.effect for each in beside]
    taken = {effect.kind for effect in (*fit.mechanism.effects, *others)}
    name = next(n for n in chain(["law"], map("law{}".format, count(2))) if n not in taken)
    at = {n: (x, *found.bounds[n]) for n, x in found.found.shape.items()}
    law = replace(found.formula, name=name, found=at)
    evidence = [e.evidence for e in beside if isinstance(e, Member) and e.evidence is not None]
    point = started(fit.point, fit, evidence)
    full = dict(zip((p.name for p in law.parameters), law.names, strict=True))
    start = Point(point.pi, {**point.values, **{full[n]: x for n, (x, *_) in at.items()}})
    refit = identify(
        reduce(add, (*others, law), fit.mechanism),
        fit.motion,
        start=start,
        estimator="least-squares",
    )
    effects = refit.effects_with(refit.without_faults)  # beside wrong data there is no law
    own = next(e for e in effects if e.effect.label == law.label)
    assert isinstance(own.effect, Formula)
    values = {v.name.rpartition(".")[2]: v.value for v in own.parameters}
    effect = replace(own.effect, found={n: (values[n], *at[n][1:]) for n in at})
    return Law(
        found, effect, tuple(others), refit, tuple(own.parameters), errors_of(fit), errors_of(refit)
    )  # fmt: skip


def found_curves(
    contest: Contest, selection: Selection, laws: Collection[FoundLaw], verdict: str,
    decision: Decision,
) -> tuple[FoundCurve, ...]:  # fmt: skip
    """Find the curves of the joints that have a law, or where the model fails unexplained."""
    last = selection.last
    places = {law.joint: law.beside for law in laws}
    if verdict == "unexplained" and not places:
        rest = last.regression.judging([p.Y[:, :1] for p in last.regression.parts])
        for member in selection.members:
            rest = rest.without(member.columns) if member.rejected else rest
        curves = [curve for curve, _ in (*last.curves, *selection.first.curves)]
        curves += [m.curve for m in selection.members if m.curve is not None]
        places = {curve.joints[0]: rest for curve in curves[:1]}
    found = (
        curve_of(
            last.contest,
            beside,
            joint,
            last.limit_at(joint),
            decision.rival_se,
            0.0 if laws else last.limit_at(joint),  # a law has the evidence
        )
        for joint, beside in places.items()
    )
    used = {name for law in laws for name in law.formula.logged}
    errors = errors_of(contest.fit)
    return tuple(
        replace(each, independent=tuple(n for n in each.independent if each.full(n) not in used))
        for each in found
        if each is not None
        and (
            each.joint not in errors  # in a loop it is felt elsewhere
            or decision.matters(
                1.0, each.ratio, 1 / max(errors[each.joint].relative or 1.0, 1e-9) ** 2
            )
        )
    )
