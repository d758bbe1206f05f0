"""A diagnosis as text: first lines for a terminal, tables, and all of it in plain words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ident.assess.assessment import Assessment
from ident.assess.diagnosis import assess_diagnosis, inseparable_effects
from ident.assess.errors import NOISY
from ident.assess.experiment import next_experiment
from ident.assess.repairs import correcting_step
from ident.assess.verdict import failing_joints, incomplete_before, spoiling_faults
from ident.diagnosis.changes import CODE
from ident.diagnosis.result import Diagnosis, Explanation, errors_of
from ident.display import renders
from ident.effects import Effect
from ident.effects.library import by_kind, named
from ident.fit.findings import IN_PROPORTION
from ident.information.evidence import odds_ratio
from ident.request import PYTHON, Request, Step, with_noun
from ident.show.card import Bar, Card
from ident.show.experiment import effect_words, formula_noun, motion_words
from ident.show.headline import good_enough_words
from ident.show.html import Sheet
from ident.show.laws import NONE, curve_name, curves, laws, numbers
from ident.show.next_step import effects_of, step_words
from ident.show.residual import errors_of_fit, failure_text
from ident.show.verdict import RAREST, certainty, known_values, verdict_line
from ident.text import lines_of, listed, percent, places, shortlist, significant, two_digits

SENTENCE_END = re.compile(r"(?<=\.) (?=[A-Z])")
LINES = 22  # of a diagnosis in a terminal, if one joint and the words leave place
BRIEF = 4  # bars of joints that are worth more than further sentences
MOST_DESCRIBED = 3  # joints and candidates that are described
CANDIDATES = (
    "what adding an effect would do: held-out error; share of all squares (what chance does)"
)
Rows = list[list[str]]


# --- the first lines ------------------------------------------------------------------------------


def card(
    d: Diagnosis, added: Sequence[Effect] = (), request: Request = PYTHON,
    assessment: Assessment | None = None,
) -> Card:  # fmt: skip
    """Return the verdict, how sure it is, the error by joint, and the command to copy."""
    a = assessment or assess_diagnosis(d, acceptable=request.acceptable, added=added)
    request = with_noun(request, "diagnosis.fit")
    known = "The earlier model lacked it too: its own log shows as much. "
    sure = known * bool(d.best and incomplete_before(d)) + certainty(d)
    good = good_enough_words(a.good_enough)
    parts = [*health_words(d), good, sure, *aside(d)]
    remedies = "; ".join(finding.remedy for finding in d.health.findings if finding.remedy)
    within = all(finding.code == CODE for finding in d.health.findings)
    if a.doubts:
        parts = [f"Put this right, then diagnose again: {remedies}." * (not within), good]
    sentences = " ".join(filter(None, parts))
    line, change = f"{a.subject}: {verdict_line(d, a)}.", " → ".join(filter(None, a.compared))
    bars = tuple(map(Bar.of, a.errors))
    if not d.health.good and not correcting_step("diagnose", d.health.findings):
        # another log is needed, of which no command knows the name
        return Card(line, sentences, bars, then=f"{remedies}." * within, first=a.worst)
    command, (then, how) = request.line(a.next), next_words(d, a)
    return Card(line, sentences, bars, command, then, change, first=a.worst, step=a.next, how=how)


def next_words(d: Diagnosis, a: Assessment) -> tuple[str, str]:
    """Return what the next step of a diagnosis is for, and of a motion what it is."""
    step, experiment = a.next, next_experiment(d)
    answers = a.good_enough
    if step.verb == "excite" and (step.range or step.speed) and experiment.motion:
        return motion_words(experiment.motion, d.fit.mechanism)
    if not d.health.good:
        return (
            f"diagnose with {effects_of(step)} in the model, if the columns stay as they are.",
            "",
        )
    if step.verb in ("add", "diagnose") and d.best is not None:
        effects = named(d.group)
        if apart := inseparable_effects(d):
            words = effect_words(apart)
            return f"no motion can tell {words} apart: take the simplest, {effects}.", ""
        return f"add {effects}: no other effect explains it as well.", ""
    return step_words(step, fits=answers.fits or d.verdict == "nothing"), ""


def planning(d: Diagnosis, added: Step, request: Request = PYTHON) -> str:
    """Return the command that plans the first motion of the next experiment, of a model with the
    effects of the step `added`.
    """
    step = next_experiment(d).step
    if not step or not d.health.good:
        return ""
    return request.line(replace(step, effects=added.effects, grown=added.grown))


def experiment_steps(advice: str) -> list[str]:
    """Return the sentences of a next experiment, the most urgent first."""
    return SENTENCE_END.split(advice)


# --- text -----------------------------------------------------------------------------------------


@renders(Diagnosis, "short")
def short(d: Diagnosis, top: Card | None = None, request: Request = PYTHON) -> str:
    """Return what a person needs first, in some twenty lines: verdict, errors, what to do.

    Of more, `--verbose` has what is left out: first the formulas, then the reason for the next
    experiment, then bars of joints down to FEW, then sentences. The experiment stays.
    """
    shown: Card = top or card(d, request=request)
    words, formula = (
        laws(d, request),
        "the formula" + ", which --out DIR writes" * (not request.folder),
    )
    if d.verdict in ("unexplained", "undecided") and not d.laws and not spoiling_faults(d):
        words, formula = [*_nearest(d), *curves(d)], "what comes nearest"
    further = len(experiment_steps(d.next_experiment)) > 1 and d.health.good
    sentences, bars = SENTENCE_END.split(shown.sure), min(shown.most, len(shown.bars))
    brief, count = min(BRIEF, bars), len(sentences)
    sizes = [(most, count) for most in range(bars, brief - 1, -1)]
    sizes += [(brief, n) for n in range(count - 1, 1, -1)]
    sizes += [(most, n) for n in (2, 1) for most in range(brief, 0, -1)]
    forms = [(shown, words), (shown, [])]
    for most, n in sizes:
        least = replace(shown, how="", most=most, sure=" ".join(sentences[:n]))
        forms.append((least, []))
    hides, result = len(d.invisible), ""
    for form, entry_ in forms:
        left_out = {
            "the whole verdict": form.sure != shown.sure,
            formula: entry_ != words,
            "more about the next experiment": further or form.how != shown.how,
            "more candidates": any(mark(d, candidate) != "*" for candidate in d.candidates),
            f"{hides} effect{'s' * (hides > 1)} this log hides": hides,
        }
        more = ", ".join(item for item, element in left_out.items() if element)
        rest = f"--verbose: {more}; {d.decision}" if more else f"{d.decision}"
        result = Sheet(form, paragraphs=[*entry_, rest], indent="  ").text()
        if lines_of(result) <= LINES + lines_of(shown.ladder) * bool(shown.ladder):
            break
    return result


@renders(Diagnosis, "sheet")
def sheet(d: Diagnosis, request: Request = PYTHON, top: Card | None = None) -> Sheet:
    """Return the verdict, or another first card, two tables, and all of it in words."""
    tables = {"where it fails": where_rows(d)}
    if d.candidates:
        # its values and its chance are in the words
        tables[CANDIDATES] = [[*row[:4], row[5]] for row in candidate_rows(d)]
    paragraphs = [*d.text.split("\n\n"), f"decided with {d.decision}"]
    return Sheet(top or card(d, request=request), tables=tables, paragraphs=paragraphs)


def where_rows(d: Diagnosis) -> Rows:
    """Return joint by joint the held-out error, the noise, and on what the residual depends."""
    repeats = ["repeats"] if d.periods is not None else []
    rows = [["joint", "held out", "", "noise", "of misfit", *repeats, "depends on"]]
    for f in d.where:
        error = errors_of(d.fit)[f.joint]
        signals = ", ".join(item.signal for item in f.depends_on[:2])
        noise, unnamed = d.floor[f.joint], error.rms <= NOISY * d.floor[f.joint]
        sizes = [f"{significant(error.rms)} {f.unit}", percent(error.relative)]
        sizes += [f"{significant(noise, 2)} {f.unit}", f"{100 * f.share:.0f} %"]
        again = ["" if f.repeats is None else f"{f.repeats:.2f}"] * len(repeats)
        signals = signals or ("noise" if f.white and unnamed else "no single signal")
        rows.append([f.joint, *sizes, *again, signals])
    return rows


def candidate_rows(d: Diagnosis) -> Rows:
    """Return a row a kind, best first, below it one a candidate; `*` is named, `=` its rivals."""
    rows = [["effect", "joint", "error", "explains", "by chance", "visible", "values"]]
    shown = [item for item in d.every if item in d.candidates or mark(d, item) == "*"]
    for group in similar(d, shown):
        sign = mark(d, group[0])
        if len(group) > 1:
            sites = places(",".join(element.effect.joints) for element in group)
            name = f"{group[0].effect.kind} in {sites}"  # a code name, as in the rows below
            best = max(group, key=lambda explanation: explanation.evidence.gain)
            best = replace(best, after=d.after) if sign == "*" else best
            rows.append([f"{sign} {name}", *_cells(d, best)[:-1], ""])
        indent = "  " * (len(group) > 1)
        rows += [[f"{indent}{sign} {entry_.effect.label}", *_cells(d, entry_)] for entry_ in group]
    return rows


def similar(d: Diagnosis, shown: Iterable[Explanation]) -> list[list[Explanation]]:
    """Return candidates of one kind and mark together, in the order of the first of each."""
    groups: dict[tuple[str, str], list[Explanation]] = {}
    for item in shown:
        groups.setdefault((mark(d, item), item.effect.kind), []).append(item)
    return list(groups.values())


def bar_of(d: Diagnosis, explanation: Explanation) -> Bar:
    """Return the error of the joint that a candidate mends most, without it and with it."""
    joint = explanation.joint
    return Bar(joint, explanation.before[joint], explanation.after[joint], d.floor[joint])


def _cells(d: Diagnosis, explanation: Explanation) -> list[str]:
    e = explanation.evidence
    visible = f"{100 * e.refit.visible:.0f} %"
    chance = f"< {100 * RAREST:g} %" if e.p < RAREST else f"{two_digits(100 * e.p)} %"
    chance = "–" if np.isnan(e.p) else chance
    share = f"{two_digits(100 * e.gain)} ({two_digits(100 * e.limit)}) %"
    return [
        explanation.joint,
        bar_of(d, explanation).words,
        share,
        chance,
        visible,
        numbers(explanation.parameters),
    ]


def mark(d: Diagnosis, explanation: Explanation) -> str:
    """Return `*` for what is named, `=` for its rivals."""
    label = explanation.effect.label
    if any(effect.label == label for effect in d.group):
        return "*"
    return "=" if any(effect.label == label for effect in d.rivals) else " "


# --- in words -------------------------------------------------------------------------------------


@renders(Diagnosis, "words")
def words(d: Diagnosis, experiment: str | None = None) -> str:
    """Return all of a diagnosis in short paragraphs, parted by empty lines."""
    several = len(d.fit.motion.experiments) > 1
    form = []
    if d.best is not None or d.verdict == "unexplained":
        form = [*curves(d), *(laws(d) or [NONE] * (d.best is None))]
    first, *more = experiment_steps(d.next_experiment if experiment is None else experiment)
    paragraphs = [
        *health_words(d),
        *(
            failure_text(f, several, errors_of_fit(d.fit))
            for f in failing_joints(d)[:MOST_DESCRIBED]
        ),
        *claim_words(d),
        *form,
        *_invisible(d),
        # beside what is missing the effects of the model have wrong values
        *(unsupported_words(d) if d.verdict == "nothing" else []),
        *([f"Next: {first}", *more] if first else []),
    ]
    return "\n\n".join(paragraphs)


def health_words(d: Diagnosis) -> list[str]:
    """Return what is wrong with the data, if anything is."""
    if d.health.good:
        return []
    findings = ". ".join(map(str, d.health.findings))
    if all(finding.code == CODE for finding in d.health.findings):
        return [f"Something changed within the log. {findings}."]
    return [
        f"Before anything: the data themselves look wrong. {findings}. Put this right or rule it "
        "out, then diagnose again: what follows may only be its consequence."
    ]


def claim_words(d: Diagnosis) -> list[str]:
    """Return the verdict, how sure it is, and its evidence."""
    line = verdict_line(d)
    first = f"{line[:1].upper()}{line[1:]}. {certainty(d)}"
    if d.verdict == "nothing":
        most = 100 * max([0.0, *d.selection.first.chance.limits.values()])
        return [
            f"{first} What does less than {100 * d.decision.material:g} % of a joint's torque, or "
            f"explains less than {most:.2g} % of the held-out squared errors, could still hide."
        ]
    if d.best is None:
        return [first, *_rejected(d), *_nearest(d)]
    best, effect = d.candidates[0], d.candidates[0].effect
    if best.known:
        first += f" The model has it, as {known_values(best)}: that must have changed."
    own_signals = ""
    if effect.joints and best.joint not in effect.joints:
        own_signals = f" against the signals of {', '.join(effect.joints)}"
    return [
        first,
        f"The torque of {named([effect])}: {effect.equation}. What to look for in the plots of "
        f"{best.joint}{own_signals}: {effect.signature}.",
        *([_apart(d, effect, best.rivals)] if best.rivals else []),
        *([f"Its mass and moments are {IN_PROPORTION}."] if effect.loaded_link else []),
        *aside(d),
    ]


def _apart(d: Diagnosis, effect: Effect, rivals: tuple[Effect, ...]) -> str:
    text = (
        f"The held-out errors of {named([effect, *rivals])} differ by less than "
        f"{d.decision.rival_se:g} standard errors."
    )
    if all({*rival.joints} == {*effect.joints} for rival in rivals):
        return f"{text} They differ at other speeds, positions or loads than those of this motion."
    if not d.fit.mechanism.closures:
        return f"{text} In this motion they have almost equal torques."
    return (
        f"{text} In a closed loop the torques of all joints end up in the same equation; only "
        "their leverage, how far a joint goes when the drive does, tells one joint from another, "
        "and over this range of motion it changes too little. That the error falls is no proof of "
        "the cause here."
    )


def aside(d: Diagnosis) -> list[str]:
    """Return what is missing beside the effect that is named."""
    if d.best is None:
        return []
    laws = [formula_noun(relative.formula) for relative in d.relatives[:MOST_DESCRIBED]]
    result = [f"Over the travelled range {listed(laws, 'or')} would do as well."] if laws else []
    more = [named(group) for group in by_kind(m.effect for m in d.also if not m.curve)]
    more += [f"{named([m.effect])} (or a {curve_name(m.curve)})" for m in d.also if m.curve]
    for law in d.laws[:1]:
        errors = (percent(e[law.felt].relative) for e in (law.before, law.after))
        result.append(
            f"In {law.felt} a formula lowers the error, {' → '.join(errors)}: torque of "
            f"{law.joint} = {law.formula}."
        )
    if more:
        result.append(
            f"That is not all: {shortlist(more)} would lower the error further, and change the "
            "values."
        )
    elif d.loud:
        result.append(
            f"That may not be all: even with it more than noise is left in {listed(d.loud)}."
        )
    return result


def _rejected(d: Diagnosis) -> list[str]:
    result = []
    for m in d.selection.members:
        name = named([m.effect])
        if m.curve is not None:
            result.append(f"{name} explains a part, but a {curve_name(m.curve)} more")
        elif m.impossible is not None:
            other = f"{named([m.impossible])}, with an impossible value"
            result.append(f"{name} explains a part, but more {other}")
        elif m.law is not None:
            result.append(f"{name} explains a part, but a formula with no more numbers more")
    return [f"{listed(result)}: their form is not that of the cause."] if result else []


def _nearest(d: Diagnosis) -> list[str]:
    """Return the effects and the curve that come nearest to an explanation."""
    first = d.selection.first
    gains = {named([e.effect]): odds_ratio(e.gain, e.limit) for e in first.evidence if e.sensible}
    for curve, gain in (first.curves or d.selection.last.curves)[:1]:
        gains[f"a {curve_name(curve)}"] = odds_ratio(gain, first.limit_at(curve.joints[0]))
    best = sorted(gains.items(), key=lambda pair: -pair[1])[:MOST_DESCRIBED]
    if not best:
        return []
    return [
        "What lowers the held-out error most, in multiples of what chance does: "
        f"{listed(f'{name} {two_digits(gain)} ×' for name, gain in best)}."
    ]


def _invisible(d: Diagnosis) -> list[str]:
    names = named(item.effect for item in d.invisible)
    return [f"Not identifiable from this log, whatever their size: {names}."] if d.invisible else []


def unsupported_words(d: Diagnosis) -> list[str]:
    """Return which effects of the model the data do not support, and how to leave them out."""
    names = [item.effect.label for item in d.unsupported]
    result = [
        f"In the model, {named([x.effect])} {'cannot be as it is' if x.absurd else 'is idle'}: "
        f"{x.why}."
        for x in d.unsupported
    ]
    if names:
        result.append(
            f"To leave out {listed(names)}: name the others by `--with`, or take [[effect]] out of "
            f"mechanism.toml; in Python, `mechanism.without('{names[0]}')`."
        )
    return result
