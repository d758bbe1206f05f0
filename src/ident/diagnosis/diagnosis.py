"""The verb `diagnose`: where a model fails, and which effect is missing."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import chain, count, product
from operator import add

import numpy as np

from ident.diagnosis.candidates import Contest, OnProgress, candidates_of, residual_in
from ident.diagnosis.changes import change_within
from ident.diagnosis.effect_set import Member
from ident.diagnosis.found_curves import found_curves
from ident.diagnosis.halves import determined_by_motion
from ident.diagnosis.laws import FoundLaw, laws_of
from ident.diagnosis.null import with_noise
from ident.diagnosis.result import Diagnosis, Explanation, Law, announced, announced_with, errors_of
from ident.diagnosis.search import Selection, select
from ident.diagnosis.selection import (
    NEGATIVE,
    Evidence,
    Ranking,
    can_be,
    has_mass,
    may_be_load,
    simplicity,
)
from ident.diagnosis.unobservable import invisible, relatives_of, unsupported
from ident.display import part
from ident.effects import Effect
from ident.effects.formula import Formula
from ident.equations.unknowns import Point
from ident.errors import FitError, IdentError, check_whole
from ident.faults.data_checks import Health
from ident.faults.fault import Fault, fault_finding, scale_of_time
from ident.finding import Finding
from ident.fit import Fit, identify
from ident.fit.findings import DRIVING
from ident.fit.residual_maps import Periods
from ident.information.estimate import MATERIAL
from ident.information.evidence import ALPHA, EXCESS, EXPLAINED_BELOW, MAIN_CAUSE, RIVAL, Decision

FORMULAS_TRIED = 3  # work: rivals of a formula whose constants are not determined
SHOWN = 3  # shown: candidates that are listed though they are not credible
LISTED = 8  # shown: candidates that are listed at most
VERDICTS = ("missing", "nothing", "unexplained", "undecided")
STEP = 0.08  # tuned: of dry friction's rms, by which it may differ from a step around reversals; a
# simulator's friction, 10 ms early, differs by 0.06, breakaway of eight times as much by 0.1
# tuned: correlation of a residual between periods that noise does not have
REPEATING_CORRELATION = 0.6


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
    columns_progress, effects = part(on_progress, 0.0, 0.3), candidates_of(fit)
    contest = Contest.of(fit, effects, columns_progress, decision=decision, seed=seed)
    on_progress("noise of the sensors", 0.3)
    contest = with_noise(contest)
    diagnosis = conclude(select(contest, part(on_progress, 0.3, 0.6)), part(on_progress, 0.6, 0.9))
    return at_reversals(diagnosis, part(on_progress, 0.9, 1.0))


def at_reversals(
    diagnosis: Diagnosis, on_progress: OnProgress, other: Contest | None = None
) -> Diagnosis:
    """The diagnosis, or where it names nothing the one on the rows at reversals too, if that names
    an effect that acts there, or is more than chance away from them too. What else is found there
    is left open: dry friction is least exact. `other`: the contest on those rows, if it is made.
    """
    if diagnosis.verdict == "missing":
        return diagnosis
    rows, search, conclude_progress = (
        part(on_progress, *x) for x in ((0.0, 0.4), (0.4, 0.7), (0.7, 1.0))
    )
    contest = diagnosis.selection.first.contest
    if (other := other or contest.at_reversals(rows)) is None:
        return diagnosis
    other = with_noise(other)
    chosen = select(other, search)
    elsewhere = seen_elsewhere(diagnosis.selection.first)
    both = tuple(m for m in chosen.members if m.label in elsewhere)
    chosen = replace(chosen, members=both) if both else chosen
    acts = elsewhere | {m.label for m in chosen.members if m.effect.at_reversals}
    first, most = next(iter(chosen.named), None), False
    if first and first.label in acts and first.evidence is not None:
        with suppress(IdentError):
            most = _explains_most(explain(diagnosis.fit, first.evidence), diagnosis.fit)
    if most:
        again = conclude(chosen, conclude_progress)
        if again.best and again.best.label in acts:
            return again
    table = contest.table
    squares = residual_in(table, diagnosis.fit) ** 2
    calm, every = ((squares * use).sum(axis=0) for use in (contest.use, table.informed))
    names = zip(diagnosis.fit.motion.independent, calm < every / 2, strict=True)
    loud = tuple(joint for joint, most in names if most)  # most of it is around reversals
    # dry friction that is no step there is no other effect, and a finding of the fit says so; nor
    # is it in a joint in which it builds up over some speed or is late
    remaining = excess(other)
    more = bool(both) or any(m.effect.at_reversals for m in chosen.members)
    no_step = {j for m in chosen.named if m.effect.needs or m.effect.fault for j in m.effect.joints}
    large = zip(diagnosis.fit.motion.independent, remaining > STEP * other.dry, strict=True)
    more |= any(much and joint not in no_step for joint, much in large)
    if diagnosis.verdict == "nothing" and more:
        return replace(diagnosis, verdict="undecided", loud=loud, reversing=True)
    return diagnosis


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


def conclude(selection: Selection, on_progress: OnProgress) -> Diagnosis:
    """The diagnosis of a fit from the set of effects that explains most."""
    contest, last = selection.first.contest, selection.last.regression
    fit = contest.fit
    loud = _loud(selection.contest)
    beyond_white = _loud(selection.contest, white=True)
    # halves of the log say whether the motion determines what is left; if so it is no noise
    by_motion = bool(beyond_white) and determined_by_motion(selection.contest)
    # a wrong channel must explain more than the effects that were found, in a possible machine
    possible = all(finding.code != DRIVING for finding in fit.findings)
    squares = last.losses / last.weight**2 if possible else None
    checks = replace(fit.checks, table=contest.table, use=contest.use, explained=squares)
    data = checks.health()
    if data.faults and squares is not None:
        refit = left_by_refit(selection, squares)
        data = replace(checks, explained=refit).health() if refit is not None else data
    if not data.faults:  # a joint swings freely by the fitted terms, which wrong channels spoil
        freely = (e for e in fit.findings if e.code == "swings freely")
        data = Health((*data.findings, *freely))
    change = change_within(selection.first) if beyond_white and not data.faults else None
    if change is not None:  # no noise, whatever its colour
        data = Health((change.finding(), *data.findings))
    if by_motion or change is not None:
        loud = loud or beyond_white
    laws: tuple[Law, ...] = ()
    unsearched: tuple[str, ...] = ()
    if not data.faults:
        laws_progress = part(on_progress, 0.0, 0.4)
        lawful, found_laws, unsearched = laws_of(selection, loud, laws_progress)
        on_progress("refitting", 0.4)
        selection, laws = _refit_laws(lawful, found_laws)
        selection, laws = _reprieved(selection, laws)
    first, best = selection.named[0] if selection.named else None, None
    candidates = explanations(selection, first)
    for alternative in () if data.faults else by_rivals(selection):
        name = alternative.named[0]
        again = candidates if name is first else explanations(alternative, name)
        known = [x.effect.label for x in again[:1]] == [name.label]
        if known and _explains(again[0], alternative):
            best, selection, candidates = name, alternative, again
            if (other := least_error(alternative, again)) is not None:
                again = explanations(other, other.named[0])
                if _explains(again[0], other):
                    best, selection, candidates = other.named[0], other, again
            break
    if best is not None and best.effect.sits == "place":
        data = Health((*data.findings, *_clock(fit, candidates[0])))
    residual = fit.residual
    verdict = _verdict(selection, best, bool(loud), bool(laws), residual.periods)
    if verdict in ("nothing", "undecided") and by_motion:
        verdict = "unexplained"
    curves = found_curves(selection, [law.found for law in laws], verdict)
    on_progress("where it fails", 0.8)
    diagnosis = Diagnosis(
        fit=fit,
        verdict=verdict,
        decision=contest.decision,
        health=data,
        where=residual.where,
        periods=residual.periods,
        candidates=tuple(candidates),
        selection=selection,
        invisible=invisible(selection.first),
        unsupported=unsupported(selection.first),
        curves=curves,
        laws=laws,
        unsearched=unsearched,
        relatives=relatives_of(selection, part(on_progress, 0.8, 1.0)) if best else (),
        floor=fit.noise,
        loud=loud,
    )
    if len(diagnosis.group) > 1:
        with suppress(IdentError):  # announced errors stay
            evidence = [m.evidence for m in diagnosis.members_of_group if m.evidence]
            together = errors_of(refit_with(fit, diagnosis.group, evidence))
            return replace(diagnosis, with_group=together)
    return diagnosis


def left_by_refit(selection: Selection, squares: np.ndarray) -> np.ndarray | None:
    """Return left-out squares (blocks, d) as the refit with a spring or play that is named makes
    them; None where none is named, or its refit fails or leaves no less.

    The rows have its slopes where it is small. A link that swings in resonance follows none, and
    another clock, which takes the weight out of the equations, may then leave less.
    """
    first, last = selection.first.regression, selection.last.regression
    named = [m.evidence for m in selection.named if m.effect.extent and m.evidence is not None]
    for evidence in named[:1]:
        with suppress(IdentError):
            x = explain(selection.first.contest.fit, evidence)
            joints = selection.first.contest.fit.motion.independent
            shares = [(x.after[j].rms / x.before[j].rms) ** 2 for j in joints if x.before[j].rms]
            announced = last.losses.sum(axis=0) / first.losses.sum(axis=0)
            if len(shares) == len(joints) and (np.array(shares) < announced).any():
                less = np.minimum(1.0, np.array(shares) / announced)
                return np.asarray(squares * less)
    return None


def _refit_laws(
    selection: Selection, found_laws: Collection[FoundLaw]
) -> tuple[Selection, tuple[Law, ...]]:
    """Refit the laws; what those replaced that fail or do not matter has its name again."""
    laws, contest = list[Law](), selection.contest
    for found_law in of_one_form(found_laws):
        formulas = (
            found_law.fitted,
            *found_law.rivals[:FORMULAS_TRIED],
        )  # the next, where one is not determined
        with_names: list[Sequence[Member | Law]] = [[*selection.named, *laws], laws]
        for formula, others in product(formulas, with_names[not selection.named :]):
            with suppress(IdentError):
                law = refit_law(contest.fit, found_law.instead(formula), others)
                if law.determined and law.matters(contest.decision):
                    laws.append(law)
                    break
    joints = {None, *(law.joint for law in laws)}
    members = tuple(
        m if (m.law and m.law.joints[0]) in joints else replace(m, law=None)
        for m in selection.members
    )
    return replace(selection, members=members), tuple(laws)


def _reprieved(selection: Selection, laws: tuple[Law, ...]) -> tuple[Selection, tuple[Law, ...]]:
    """Return the selection in which nothing speaks any more against a correction whose refit
    explains most of its joint's error, and leaves as little as what spoke against it, or nothing
    but noise; and the other laws. Errors are shares of the torque, which a drive's gain changes.

    The rows have its slopes where the fit is, which a gain that is given wrong by a fifth leaves,
    and unknowns that it drove to the end of their range stay there; a curve may do better than
    slopes, but is no cause.
    """
    fit, first = selection.first.contest.fit, selection.first.regression
    place = {joint: u for u, joint in enumerate(fit.motion.independent)}
    members = list[Member]()
    for m in selection.members:
        with suppress(IdentError):
            if m.rejected and m.effect.corrects and m.evidence is not None:
                explanation = explain(fit, m.evidence)
                joint = explanation.joint
                before, after = explanation.before[joint], explanation.after[joint]
                if not (before.relative and after.relative):
                    raise FitError(f"{joint} has no torque")
                noise = fit.noise[joint] * before.relative / before.rms
                most = [law.after[joint].relative for law in laws if joint in law.effect.joints[:1]]
                least = [share for share in most if share is not None]
                candidates = selection.last.contest.candidates
                curve = next((c for c in candidates if c.effect == m.curve), None)
                if curve is not None and joint in curve.effect.joints[:1]:
                    refit = selection.last.regression.refit(curve.groups[0])
                    shares = refit.loss.sum(axis=0) / first.losses.sum(axis=0)
                    least.append(before.relative * float(np.sqrt(shares[place[joint]])))
                elif m.curve is not None or m.impossible is not None:
                    least.append(noise)
                excess_squares = max(before.relative**2 - noise**2, 0.0)
                explained = after.relative**2 - noise**2 <= (1 - MAIN_CAUSE) * excess_squares
                if explained and after.relative <= EXCESS * min(least, default=np.inf):
                    laws = tuple(law for law in laws if joint not in law.effect.joints[:1])
                    m = replace(m, curve=None, law=None, impossible=None)
        members.append(m)
    return replace(selection, members=tuple(members)), laws


def of_one_form(found_laws: Collection[FoundLaw]) -> list[FoundLaw]:
    """Give laws of several joints one form, the best, where each has it as law or rival."""
    forms = [{e.formula.terms: e for e in (*law.rivals, law.fitted)} for law in found_laws]
    common = set(forms[0]).intersection(*forms[1:]) if len(forms) > 1 else set()
    if not common:
        return list(found_laws)
    losses = [float(law.fitted.loss.sum()) for law in found_laws]
    best = min(
        common,
        key=lambda t: sum(float(f[t].loss.sum()) / x for f, x in zip(forms, losses, strict=True)),
    )
    return [law.instead(form[best]) for law, form in zip(found_laws, forms, strict=True)]


def _explains_most(explanation: Explanation, fit: Fit) -> bool:
    """Whether a candidate explains half of what exceeds the noise in its joint, as a law must."""
    noise, joint = fit.noise[explanation.joint], explanation.joint
    before, remaining = (
        max(e[joint].rms ** 2 - noise**2, 0.0) for e in (explanation.before, explanation.after)
    )
    return remaining <= (1 - MAIN_CAUSE) * before


def _explains(explanation: Explanation, selection: Selection) -> bool:
    """Whether the best is a cause: with which the error falls, of a possible size that the log
    determines, a length changed by no more than a third, a curve that explains half of what exceeds
    the noise, and of no joint on which it acts of which it and what was found with it leave most of
    the torque.
    """
    contest, fit = selection.contest, selection.contest.fit
    errors_there = [x[explanation.joint] for x in (explanation.after, explanation.before)]
    after, before = (e.rms for e in errors_there)
    if explanation.effect.supplies_torque:  # the torque, and its noise, is another one with it
        after, before = (e.relative or e.rms for e in errors_there)
    if after >= before and len(selection.named) > 1:  # alone it may need the others
        after = announced_with(selection, selection.named)[explanation.joint].rms
    if after >= before:
        return False
    if explanation.effect.descriptive and not _explains_most(explanation, fit):
        return False
    values = np.array([value.value for value in explanation.parameters])
    errors = np.array([value.stderr or 0.0 for value in explanation.parameters])
    several = len(explanation.effect.unknowns)
    sizes = [v for v in explanation.parameters[: several or None] if v.stderr]
    if explanation.effect.loaded_link:
        possible = has_mass(fit.mechanism, values, errors) and may_be_load(values, errors)
        if errors[0] and not possible:
            return False
    elif sizes and all(abs(v.value) < NEGATIVE * (v.stderr or 0.0) for v in sizes):
        return False
    if explanation.effect.sits == "place" and not can_be(
        fit.mechanism, explanation.effect, values, 0 * values
    ):
        return False
    first, last = selection.first.regression, selection.last.regression
    assert contest.draws is not None
    remaining = last.losses.sum(axis=0) - last.rows * (last.weight * contest.draws.floor) ** 2
    explained = remaining < EXPLAINED_BELOW**2 * contest.torque
    squares = explanation.evidence.squares(first) * first.weight**2
    acts = squares > contest.decision.material**2 * selection.first.contest.torque
    acts &= (contest.use & contest.table.vary).any(axis=0)  # at rest friction takes a part
    acts[explanation.evidence.coordinate] = True
    return bool(explained[acts].all())


def _clock(fit: Fit, explanation: Explanation) -> Iterator[Finding]:
    """Report a clock 1/√k times as long that does as well as a length that is k times as long."""
    length = fit.mechanism.lengths.get(explanation.effect.joints[0], 0.0)
    k = 1 + explanation.parameters[0].value / length if length else 1.0
    if (before := explanation.error_before) is None or not 0 < k != 1:
        return
    fault = scale_of_time(Fault.none(fit.mechanism.driven), k**-0.5)
    assert fault.state is not None
    logs = tuple(fault.state(fit.mechanism, e)[1] for e in fit.motion.experiments)
    with suppress(IdentError):
        motion = replace(fit.motion, experiments=logs)
        errors = errors_of(identify(fit.mechanism, motion, estimator="least-squares"))
        if all(e.rms < EXCESS * explanation.after[name].rms for name, e in errors.items()):
            after = errors[explanation.joint].relative or 0.0
            yield fault_finding(fit.mechanism, fault, before, after)


def health(fit: Fit) -> Health:
    """Judge the data behind a fit, from `identify`.

    Returns:
        Its findings, gravest first; `print` shows them in words.
    """
    return fit.health


def excess(contest: Contest, white: bool = False) -> np.ndarray:
    """(d,) rms left beyond the sensors' noise [N m | N], which may be `white`; 0 where it is noise
    or immaterial.
    """
    regression, draws = contest.regression, contest.draws
    assert draws is not None
    if not white:
        more = contest.fit.residual.noise_over_white
        times = np.array([more.get(joint, 1.0) for joint in contest.fit.motion.independent])
        draws = replace(draws, floor=times * draws.floor, ceiling=times * draws.ceiling)
    size = np.sqrt(np.maximum(regression.rows, 1)) * regression.weight
    rms, torque = np.sqrt(regression.losses.sum(axis=0)) / size, np.sqrt(contest.torque) / size
    excess_rms = np.sqrt(np.maximum(rms**2 - draws.floor**2, 0.0))
    significant = (rms > EXCESS * draws.ceiling) & (excess_rms > contest.decision.material * torque)
    return np.where(significant, excess_rms, 0.0)


def _loud(contest: Contest, white: bool = False) -> tuple[str, ...]:
    """Return the joints with an excess; see there."""
    joints = contest.fit.motion.independent
    return tuple(j for j, x in zip(joints, excess(contest, white), strict=True) if x)


def _verdict(
    selection: Selection, best: Member | None, loud: bool, lawful: bool, periods: Periods | None
) -> str:
    if best is not None:
        return "missing"
    if selection.members or lawful or (loud and selection.last.curves):
        return "unexplained"
    if (
        loud
        and periods is not None
        and max(periods.rho.values()) > max(REPEATING_CORRELATION, periods.chance)
    ):
        return "unexplained"
    return "undecided" if loud else "nothing"


# --- refits --------------------------------------------------------------------------------------


def by_rivals(selection: Selection) -> Iterator[Selection]:
    """Yield a selection as it is, then with each rival in the place of its first name, if any."""
    if not selection.named:
        return
    yield selection
    simple = sorted(selection.named[0].rivals, key=simplicity)
    for rival in simple:
        yield _with_first(selection, rival, [e for e in simple if e is not rival])


def _with_first(selection: Selection, name: Evidence, rivals: Sequence[Evidence]) -> Selection:
    """Return a selection with another first name, which no other member has, and its rivals."""
    first, label = selection.named[0], name.effect.label
    member = replace(first, effect=name.effect, evidence=name, rivals=tuple(rivals), stands_in=True)
    members = (member if m is first else m for m in selection.members)
    return replace(selection, members=tuple(m for m in members if m is member or m.label != label))


def least_error(selection: Selection, refits: Sequence[Explanation]) -> Selection | None:
    """Return a selection with that rival of its first name in the place of that which leaves least
    when all is refitted, where both are one load on several links, or springs or plays of several
    joints; None where the first name does. `refits`: the first name and its rivals, refitted or
    not.
    """
    first = selection.named[0]
    errors = {
        e.effect.label: float(np.mean([np.log(max(x.rms, 1e-300)) for x in e.after.values()]))
        for e in refits
        if e.fit is not None
    }
    evidence = first.evidence
    if (
        evidence is None
        or first.label not in errors
        or not (first.effect.loaded_link or first.effect.extent)
    ):
        return None
    both = (evidence, *first.rivals)
    same_kind = [
        e
        for e in (*both, *_elsewhere(selection, evidence))
        if e.effect.kind == evidence.effect.kind and e.effect.label in errors
    ]
    best = min(same_kind, key=lambda e: errors[e.effect.label])
    if best is evidence:
        return None
    return _with_first(selection, best, [e for e in both if e is not best])


def _elsewhere(selection: Selection, first: Evidence) -> list[Evidence]:
    """Return what is credible of the same kind as a first name with an extent at other joints: far
    from where a link swings its columns are no more than a hint.
    """
    return [
        e
        for e in selection.first.evidence
        if first.effect.extent and e.credible and e.effect.kind == first.effect.kind
        if e.effect.label != first.effect.label
    ]


def explanations(selection: Selection, best: Member | None) -> list[Explanation]:
    """The best refitted, its rivals and what else is promising, best first."""
    fit = selection.first.contest.fit
    first = [best.evidence, *best.rivals] if best is not None and best.evidence else []
    effects = {evidence.effect.label: evidence.effect for evidence in first}
    rest = [e for e in selection.first.evidence if e.effect.label not in effects]
    rest.sort(key=lambda evidence: not evidence.credible)
    alike = {e.effect.label for e in (_elsewhere(selection, first[0]) if first else ())}
    wanted = [*first, *rest][: max(SHOWN, min(LISTED, len(first) + 1))]
    wanted += [e for e in rest if e.effect.label in alike and e not in wanted]
    cheap = all(effect.linear for effect in fit.mechanism.effects)  # no search of shapes
    explained = []
    for evidence in wanted:
        label = evidence.effect.label
        rivals = tuple(e for n, e in effects.items() if n != label) if label in effects else ()
        refitted = label in alike or (first and evidence is first[0])
        if refitted or (evidence.effect.linear and cheap):
            with suppress(IdentError):  # a correction too large for the loops to close, say
                explained.append(explain(fit, evidence, rivals))
        else:
            explained.append(announced(selection, evidence, rivals))
    return explained


def explain(fit: Fit, evidence: Evidence, rivals: tuple[Effect, ...] = ()) -> Explanation:
    """The refit with a candidate, whose standard errors hold no bias of wrong data."""
    refit = refit_with(fit, [evidence.effect], [evidence])
    effects = refit.effects_with(refit.without_faults)
    values = next(e.parameters for e in effects if e.effect.label == evidence.effect.label)
    return Explanation.of(fit, evidence, refit, errors_of(refit), values, rivals)


def refit_with(
    fit: Fit, effects: Collection[Effect], evidence: Collection[Evidence],
    shapes: Mapping[str, float] | None = None,
) -> Fit:  # fmt: skip
    """Refit everything with further effects; searched shapes set out from where they were found, or
    from `shapes`, by full name.
    """
    point = start_point(fit, evidence)
    point = Point(point.pi, {**point.values, **(shapes or {})})
    model = reduce(add, effects, fit.mechanism)
    return identify(model, fit.motion, start=point, estimator="least-squares")


def start_point(fit: Fit, evidence: Collection[Evidence]) -> Point:
    """The working point of a fit with the shapes of some candidates where they were found."""
    shapes: dict[str, float] = {}
    for candidate in evidence:
        effect = candidate.effect
        present = any(e.label == effect.label for e in fit.mechanism.effects)
        before = fit.point.values if effect.corrects and present else {}
        names = effect.names[len(effect.unknowns) :]
        shapes |= {
            full: candidate.shape[shape.name] + before.get(full, 0.0)
            for full, shape in zip(names, effect.shapes, strict=True)
            if shape.name in candidate.shape
        }
    return Point(fit.point.pi, {**fit.point.values, **shapes})


def refit_law(fit: Fit, found_law: FoundLaw, given: Collection[Member | Law]) -> Law:
    """Refit everything with a law and what is beside it; searches set out from where they ended."""
    others = [member.effect for member in given]
    taken = {effect.kind for effect in (*fit.mechanism.effects, *others)}
    name = next(n for n in chain(["law"], map("law{}".format, count(2))) if n not in taken)
    at = {n: (x, *found_law.bounds[n]) for n, x in found_law.fitted.shape.items()}
    law = replace(found_law.formula, name=name, found=at)
    evidence = [e.evidence for e in given if isinstance(e, Member) and e.evidence is not None]
    shapes = {law.full[n]: x for n, (x, *_) in at.items()}
    refit = refit_with(fit, (*others, law), evidence, shapes)
    effects = refit.effects_with(refit.without_faults)  # beside wrong data there is no law
    entry = next(e for e in effects if e.effect.label == law.label)
    assert isinstance(entry.effect, Formula)
    values = {v.name.rpartition(".")[2]: v.value for v in entry.parameters}
    effect = replace(entry.effect, found={n: (values[n], *at[n][1:]) for n in at})
    before, after = errors_of(fit), errors_of(refit)
    return Law(found_law, effect, tuple(others), refit, tuple(entry.parameters), before, after)
