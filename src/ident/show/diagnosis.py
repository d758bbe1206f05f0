"""A diagnosis as text: first lines for a terminal, tables, and all of it in plain words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.diagnosis.law_search import FittedFormula
from ident.diagnosis.result import Diagnosis, Explanation, errors_of
from ident.diagnosis.selection import Evidence
from ident.display import folder, renders
from ident.effects import KINDS, Effect
from ident.fit import Fit
from ident.fit.findings import Finding
from ident.fit.residual import Failure
from ident.information.blocks import Error
from ident.information.chance import odds_ratio
from ident.show.html import (
    NOISY,
    Bar,
    Card,
    add_command,
    by_kind,
    good_enough,
    named,
    next_command,
    wrong_unit,
)
from ident.show.laws import curve_name, curves, expression, labels, laws, numbers
from ident.show.residual import failure_text, judged_of
from ident.show.sheet import Sheet
from ident.text import listed, percent, places, some, two_digits

SENTENCE_END = re.compile(r"(?<=\.) (?=[A-Z])")
LINES = 20  # of a diagnosis in a terminal, if one joint and the words leave place
MOST = 3  # joints and candidates that are described
CANDIDATES = "what adding an effect would do: held-out error of the joint that it mends most"
PART = 0.5  # share that stays beyond noise, from which a name may be that of another cause
RAREST = 0.01  # chance below which a hundred draws say no more than that it is rarer
Rows = list[list[str]]


# --- pieces ---------------------------------------------------------------------------------------


def by_chance(e: Evidence) -> str:
    """Return how many logs in which nothing is missing would show as much, in words."""
    count = f"fewer than 1 in {1 / RAREST:,.0f}" if e.p < RAREST else f"1 in {1 / e.p:.0f}"
    return f"{count} logs in which nothing is missing would show as much"


def noise_errors(fit: Fit) -> dict[str, Error]:
    """Return what noise alone would leave in each joint, beside the errors of its fit."""
    return {
        n: replace(e, rms=x, relative=e.relative and e.relative * x / max(e.rms, 1e-300))
        for n, e in errors_of(fit).items()
        for x in [fit.noise[n]]
    }


def failing(d: Diagnosis) -> list[Failure]:
    """Return the joints in which more than noise is left, the worst first; none if clean."""
    if d.verdict == "nothing":
        return []
    errors = errors_of(d.fit)
    return [f for f in d.where if errors[f.joint].rms > NOISY * d.floor[f.joint]] or [*d.where[:1]]


def spoilt(d: Diagnosis) -> list[Finding]:
    """Return the faults of the data that explain the log, and another unit of several torques,
    where no effect is named beside them.
    """
    return [] if d.best else [*d.health.faults, *wrong_unit(d.health.findings)]


def verdict_line(d: Diagnosis) -> str:
    """Return the verdict in one sentence; what is wrong with the data comes before effects."""
    if wrong := spoilt(d):
        return f"the data look wrong: {wrong[0].meaning}"
    if d.best is not None:
        first = f"{d.best.label if d.rivals else named(d.group)} ({type(d.best).summary()})"
        names = ["other values of " * bool(d.candidates[0].known) + first, *_alike(d)]
        apart = ", which this data cannot tell apart" if names[1:] else ""
        return f"missing: {listed(names, 'or')}{apart}"
    formulas = listed([f"torque of {law.joint} = {law.formula}" for law in d.laws])
    last = d.laws[-1].after if d.laws else {}  # its fit has all laws
    if open_ := [name for name in d.loud if d.laws and last[name].rms > NOISY * d.floor[name]]:
        formulas += f"; even with it more than noise is left in {listed(open_)}"
    if d.reversing:
        return (
            f"undecided: more is left in {listed(d.loud)} than the sensors' noise, but only around "
            "reversals, where dry friction may have any value; slow motion would show what it is"
        )
    return {
        "nothing": "nothing is missing that this data could show",
        "unexplained": "unexplained: something is missing, and no effect of the library explains "
        + (f"it, but a formula does: {formulas}" if d.laws else "it"),
        "undecided": f"undecided: more is left in {listed(d.loud)} than the sensors' noise, and "
        "this log cannot tell coloured noise from physics",
    }[d.verdict]


def _known(best: Explanation) -> str:
    """Return the values that the model has of an effect that it has."""
    own = [(v.name.rpartition(".")[2], v) for v in best.parameters if v.name in best.known]
    return some([f"{n} = {best.known[v.name]:.4g} {v.unit}".removesuffix(" 1") for n, v in own])


def _stays(d: Diagnosis, after: Mapping[str, Error]) -> float:
    """Return the share of the squares beyond noise that the group leaves where the first name acts;
    0 where no more than noise is left with the whole set.
    """
    joint = d.candidates[0].joint
    if joint not in d.loud:
        return 0.0
    floor = d.floor[joint] ** 2
    before, left = (max(e.rms**2 - floor, 0.0) for e in (errors_of(d.fit)[joint], after[joint]))
    return left / max(before, floor)


def _alike(d: Diagnosis) -> list[str]:
    """Return what this data cannot tell from the best effect."""
    clock = ["another scale of time"] if any(x.code == "time" for x in d.health.findings) else []
    return [*(each.label for each in d.rivals), *clock]


def _separable(d: Diagnosis) -> tuple[str, ...]:
    """Return the best effect and a rival, at another place if there is one, where a motion tells
    them apart that `ident excite` can plan. Of bodies it cannot: only some of the ten parameters of
    one differ from those of another.
    """
    single = [x for x in d.advice.apart if not (x.signal or x.loaded_link) and x.kind in KINDS]
    best, apart = d.best, {each.label for each in single}
    rivals = [each for each in d.rivals if each.label in apart]
    if best is None or not rivals or best.label not in apart:
        return ()
    rival = next((each for each in rivals if each.kind == best.kind), rivals[0])
    return best.label, rival.label


def certainty(d: Diagnosis) -> str:
    """Return how sure the verdict is, in a sentence."""
    if d.best is None:
        more = [each for each in d.every if each.evidence.p < d.decision.alpha]
        none = "none explains it" if d.selection.members or d.laws else "none does more than chance"
        if more and not d.selection.members and not d.laws:
            none = f"none is named: what {labels(e.effect for e in more[:MOST])} would explain is "
            none += "too small to matter away from reversals, or needs values that no machine has"
        return f"{_tried(d)} effects were tried, and {none}.{_turning(d)}"
    best = d.candidates[0]
    certain = "Sure" if best.evidence.p < RAREST else "Not sure"
    if (stays := _stays(d, d.after)) > PART:
        certain = (
            f"Not sure that it is this (with it {100 * stays:.0f} % of the squared error beyond "
            f"noise stays in {best.joint})"
        )
    elif _alike(d):
        certain = f"Which of these is open; that something is missing: {certain.lower()}"
    value = f"{d.best.label}: " if len(d.group) > 1 or _alike(d) else ""
    had = f", in the model {_known(best)}" * bool(best.known)
    return f"{certain}: {by_chance(best.evidence)}; {value}{numbers(best.parameters)}{had}."


def _turning(d: Diagnosis) -> str:
    """Return what is left where nothing is named and rows at reversals fit worse."""
    worse = {j for each in d.fit.all_findings if each.code == "reversals" for j in each.where}
    errors = errors_of(d.fit)
    left = [j for j in errors if j in worse and errors[j].rms > NOISY * d.floor[j]]
    if d.verdict != "nothing" or not left:
        return ""
    return (
        f" What is left in {places(left)} goes with reversals, where dry friction is no exact "
        "step; slow motion would show what it is."
    )


def errors_with(d: Diagnosis) -> Mapping[str, Error]:
    """Return the errors with what is named, or else with the laws; nothing without either."""
    if d.best is not None:
        return d.after
    return d.laws[-1].after if d.laws else {}  # its fit has all laws


def card(d: Diagnosis, added: Sequence[Effect] = ()) -> Card:
    """Return the verdict, how sure it is, the error by joint, and the command to copy."""
    logs = ", ".join(e.name for e in d.fit.motion.experiments)
    errors, after, planned = errors_of(d.fit), errors_with(d), ""
    if d.verdict == "nothing":
        command = next_command("identify", added)
    elif d.best is not None:
        command = add_command(d.fit.mechanism, [*added, *d.group])
        planned = planning(d, added) if _separable(d) else ""
    elif d.laws:
        files = [f"{folder.get() or 'DIR'}/{law.option}" for law in d.laws]
        command = add_command(d.fit.mechanism, added, files)
    else:
        command = planned = planning(d, added)
        command = command or next_command("explore", added)
    bars = tuple(Bar(j, e, after.get(j), d.floor[j]) for j, e in errors.items())
    searched, doubts = d.verdict == "nothing", d.health.findings
    good = good_enough(errors, d.floor, d.fit.residual.away, searched, doubts=doubts)
    told = [*_health(d), good, certainty(d), *beside(d)]
    if spoilt(d):
        remedies = "; ".join(each.remedy for each in d.health.findings if each.remedy)
        told = [f"Put this right, then diagnose again: {remedies}.", good]
    sentences = " ".join(told).strip()
    line, command = f"{d.fit.mechanism.name} on {logs}: {verdict_line(d)}", planned or command
    then = first_motion(d, bool(planned))
    command *= d.health.good
    return Card(line, sentences, bars, command, then, first=felt_in(d))


def felt_in(d: Diagnosis) -> str:
    """Return the joint whose error what is named, or else the first law, lowers most."""
    if d.best is not None:
        return d.candidates[0].joint
    return d.laws[0].felt if d.laws else ""


def planning(d: Diagnosis, added: Sequence[Effect] = ()) -> str:
    """Return the command that plans a motion that tells the best effect and a rival apart; nothing
    where there are none that a motion tells apart.
    """
    pair = _separable(d)
    return next_command("excite", added, pair) if d.health.good and pair else ""


def first_motion(d: Diagnosis, planned: bool) -> str:
    """Return the first sentence of the next experiment, `planned` by the card's command or not;
    nothing where the data look wrong.
    """
    if not d.health.good:
        return ""
    way = ", planned for all drives by this command; by hand" if planned else ""
    first, *_ = experiment_steps(d.next_experiment)
    return _next(first, way)


def _next(step: str, way: str = "") -> str:
    """Return the first step under its title: adding an effect is no experiment."""
    title = "Next" if step.startswith("Add ") else f"Next experiment{way}"
    return f"{title}: {step}" if step else ""


def without_reason(step: str) -> str:
    """Return a step under its title without what follows its second colon, the reason for it."""
    title, *parts = step.split(": ")
    return f"{title}: {parts[0]}." if parts[1:] else step


def experiment_steps(advice: str) -> list[str]:
    """Return the sentences of a next experiment, the most urgent first."""
    return SENTENCE_END.split(advice)


# --- text -----------------------------------------------------------------------------------------


@renders(Diagnosis, "short")
def short(d: Diagnosis, top: Card | None = None) -> str:
    """Return what a person needs first, in twenty lines: verdict, errors, what to do.

    Where there are more, `--verbose` has what is left out: first the formulas, then the reason for
    the next experiment, then the experiment itself, and at last bars of joints.
    """
    shown: Card = top or card(d)
    words, formula = laws(d), f"the formula{', which --out DIR writes' * (not folder.get())}, "
    if d.verdict in ("unexplained", "undecided") and not d.laws and not spoilt(d):
        words, formula = [*_nearest(d), *curves(d)], "what comes nearest, "
    count, steps = len(d.invisible), experiment_steps(d.next_experiment)
    hidden = f", {count} effect{'s' * (count > 1)} this log hides" if count else ""
    formula *= bool(words)
    more = "more about the next experiment, " * (len(steps) > 1 and d.health.good)
    step = without_reason(shown.then)
    reason = "more about the next experiment, " if step != shown.then else more
    experiment = "the next experiment, " if shown.then else more

    def text(top: Card, words: list[str], left_out: str) -> str:
        rest = f"--verbose: {left_out}all candidates{hidden}; {d.decision}"
        return Sheet(top, paragraphs=[*words, rest], indent="  ").text()

    found, over = "", 0
    for then, own, left_out in (
        (shown.then, words, more),
        (shown.then, [], formula + more),
        (step, [], formula + reason),
        ("", [], formula + experiment),
    ):
        found = text(replace(shown, then=then), own, left_out)
        if (over := found.count("\n") + 1 - LINES) <= 0:
            return found
    most = max(1, min(shown.most, len(shown.bars)) - over - 1)
    return text(replace(shown, then="", most=most), [], formula + experiment)


@renders(Diagnosis, "sheet")
def sheet(d: Diagnosis) -> Sheet:
    """Return the verdict, two tables, and all of it in words."""
    tables = {"where it fails": where_rows(d)}
    if d.candidates:
        tables[CANDIDATES] = [row[:-1] for row in candidate_rows(d)]
    paragraphs = [*d.text.split("\n\n"), f"decided with {d.decision}"]
    return Sheet(card(d), tables=tables, paragraphs=paragraphs)


def where_rows(d: Diagnosis) -> Rows:
    """Return joint by joint the held-out error, the noise, and on what the residual depends."""
    repeats = ["repeats"] if d.periods is not None else []
    rows = [["joint", "held out", "", "noise", "of misfit", *repeats, "depends on"]]
    for f in d.where:
        error = errors_of(d.fit)[f.joint]
        signals = ", ".join(each.signal for each in f.depends_on[:2])
        quiet = error.rms <= NOISY * d.floor[f.joint]
        rows.append(
            [
                f.joint,
                f"{error.rms:.3g} {f.unit}",
                percent(error.relative),
                f"{d.floor[f.joint]:.2g} {f.unit}",
                f"{100 * f.share:.0f} %",
                *(["" if f.repeats is None else f"{f.repeats:.2f}"] if repeats else []),
                signals or ("noise" if f.white and quiet else "no single signal"),
            ]
        )
    return rows


def candidate_rows(d: Diagnosis) -> Rows:
    """Return a row a kind, best first, and below it one a candidate.

    `*` marks what is named, `=` what this data cannot tell from it.
    """
    rows = [["effect", "joint", "error", "by chance", "visible", "values"]]
    shown = [each for each in d.every if each in d.candidates or mark(d, each) == "*"]
    for group in alike(d, shown):
        sign = mark(d, group[0])
        if len(group) > 1:
            name = named(each.effect for each in group)
            best = max(group, key=lambda each: each.evidence.gain)
            best = replace(best, after=d.after) if sign == "*" else best
            rows.append([f"{sign} {name}", *_cells(d, best)[:-1], ""])
        indent = "  " * (len(group) > 1)
        rows += [[f"{indent}{sign} {each.effect.label}", *_cells(d, each)] for each in group]
    return rows


def alike(d: Diagnosis, shown: Iterable[Explanation]) -> list[list[Explanation]]:
    """Return candidates of one kind and mark together, in the order of the first of each."""
    groups: dict[tuple[str, str], list[Explanation]] = {}
    for each in shown:
        groups.setdefault((mark(d, each), each.effect.kind), []).append(each)
    return list(groups.values())


def _cells(d: Diagnosis, each: Explanation) -> list[str]:
    joint, e = each.joint, each.evidence
    change = Bar(joint, each.before[joint], each.after[joint], d.floor[joint]).words
    visible = f"{100 * e.refit.visible:.0f} %"
    chance = f"< {100 * RAREST:g} %" if e.p < RAREST else f"{two_digits(100 * e.p)} %"
    return [joint, change, "–" if np.isnan(e.p) else chance, visible, numbers(each.parameters)]


def mark(d: Diagnosis, each: Explanation) -> str:
    """Return `*` for what is named, `=` for its rivals."""
    label = each.effect.label
    if any(effect.label == label for effect in d.group):
        return "*"
    return "=" if any(effect.label == label for effect in d.rivals) else " "


# --- in words -------------------------------------------------------------------------------------

CLAIMS = {  # title of what each verdict says
    "missing": "What is missing",
    "nothing": "What adding an effect would do",
    "unexplained": "What comes nearest",
    "undecided": "What comes nearest",
}


def story(d: Diagnosis, experiment: str | None = None) -> dict[str, list[str]]:
    """Return all of a diagnosis in words: paragraphs by title, as the report has them."""
    form = [*curves(d), *laws(d)] if d.best is not None else []
    if d.verdict == "unexplained":
        form = [*curves(d), *expression(d)]
    first, *more = experiment_steps(d.next_experiment if experiment is None else experiment)
    several = len(d.fit.motion.experiments) > 1
    return {
        "Health of the data": _health(d),
        "Where it fails": [failure_text(f, several, judged_of(d.fit)) for f in failing(d)[:MOST]],
        CLAIMS[d.verdict]: _claim(d),
        "Curve and formula": form,
        "Invisible in this data": _invisible(d),
        # beside what is missing the effects of the model have wrong values
        "In the model, but not supported": _unsupported(d) if d.verdict == "nothing" else [],
        "What to log next": [_next(first), *more] if first else [],
    }


@renders(Diagnosis, "words")
def words(d: Diagnosis, experiment: str | None = None) -> str:
    """Return all of a diagnosis in short paragraphs, parted by empty lines."""
    return "\n\n".join(each for own in story(d, experiment).values() for each in own)


def _health(d: Diagnosis) -> list[str]:
    if d.health.good:
        return []
    findings = ". ".join(map(str, d.health.findings))
    return [
        f"Before anything: the data themselves look wrong. {findings}. Put this right or rule it "
        "out, then diagnose again: what follows may only be its consequence."
    ]


def _claim(d: Diagnosis) -> list[str]:
    """Return the verdict, how sure it is, and what speaks for it."""
    line = verdict_line(d)
    first = f"{line[:1].upper()}{line[1:]}. {certainty(d)}"
    if d.verdict == "nothing":
        most = 100 * max(d.selection.first.chance.limits.values(), default=0.0)
        return [
            f"{first} What does less than {100 * d.decision.material:g} % of a joint's torque, or "
            f"explains less than {most:.2g} % of the held-out squared errors, could still hide."
        ]
    if d.best is None:
        return [first, *_rejected(d), *_nearest(d)]
    best, effect = d.candidates[0], d.candidates[0].effect
    if best.known:
        first += f" The model has it, as {_known(best)}: that must have changed."
    own = ""
    if effect.joints and best.joint not in effect.joints:
        own = f" against the signals of {', '.join(effect.joints)}"
    return [
        first,
        f"The torque of {effect.label}: {effect.equation}. What to look for in the plots of "
        f"{best.joint}{own}: {effect.signature}.",
        *([_apart(d, effect, best.rivals)] if best.rivals else []),
        *beside(d),
    ]


def _relative(found: FittedFormula) -> str:
    """Return the name of a law of the literature in words."""
    name = found.formula.terms[0].known_as.replace("_", " ")
    return f"an {name}" if name[0] in "aeiou" else f"a {name}"


def _apart(d: Diagnosis, effect: Effect, rivals: tuple[Effect, ...]) -> str:
    """Return why this data cannot tell rivals apart."""
    text = (
        f"The held-out errors of {labels([effect, *rivals])} differ by less than "
        f"{d.decision.rival_se:g} standard errors."
    )
    if all(set(each.joints) == set(effect.joints) for each in rivals):
        return text + " They differ at other speeds, positions or loads than those of this motion."
    if not d.fit.mechanism.closures:
        return f"{text} In this motion they have almost equal torques."
    return (
        f"{text} In a closed loop the torques of all joints end up in the same equation; only "
        "their leverage, how far a joint goes when the drive does, tells one joint from another, "
        "and over this range of motion it changes too little. That the error falls is no proof of "
        "the cause here."
    )


def beside(d: Diagnosis) -> list[str]:
    """Return what is missing beside the effect that is named."""
    if d.best is None:
        return []
    laws = [_relative(each) for each in d.relatives[:MOST]]
    found = [f"Over the travelled range {listed(laws, 'or')} would do as well."] if laws else []
    more = [named(group) for group in by_kind(m.effect for m in d.also if not m.curve)]
    more += [f"{m.label}, or a {curve_name(m.curve)}" for m in d.also if m.curve]
    if more:
        found.append(
            f"That is not all: beside it, the data ask for {some(more)}. Add it and diagnose "
            "again; `ident grow` goes on until nothing more can be named."
        )
    elif d.loud:
        found.append(
            f"That may not be all: even with it more than noise is left in {listed(d.loud)}."
        )
    return found


def _tried(d: Diagnosis) -> int:
    return sum(not each.curve for each in d.selection.first.contest.candidates)


def _rejected(d: Diagnosis) -> list[str]:
    """Return why effects that explain a part are not named."""
    found = []
    for m in d.selection.members:
        if m.curve is not None:
            found.append(f"{m.label} explains a part, but a {curve_name(m.curve)} more")
        elif m.impossible is not None:
            other = f"{m.impossible.label}, with a value that no machine has"
            found.append(f"{m.label} explains a part, but more {other}")
        elif m.law is not None:
            found.append(f"{m.label} explains a part, but a formula with no more numbers more")
    return [f"{listed(found)}: these have not the form of the cause."] if found else []


def _nearest(d: Diagnosis) -> list[str]:
    """Return the effects and the curve that come nearest to an explanation."""
    first = d.selection.first
    gains = {e.effect.label: odds_ratio(e.gain, e.limit) for e in first.evidence if e.sensible}
    for curve, gain in (first.curves or d.selection.last.curves)[:1]:
        gains[f"a {curve_name(curve)}"] = odds_ratio(gain, first.limit_at(curve.joints[0]))
    best = sorted(gains.items(), key=lambda pair: -pair[1])[:MOST]
    if not best:
        return []
    return [
        "What lowers the held-out error most, in multiples of what chance does: "
        f"{listed(f'{name} {two_digits(gain)} ×' for name, gain in best)}."
    ]


def _invisible(d: Diagnosis) -> list[str]:
    names = named(each.effect for each in d.invisible)
    return [f"This data cannot show, whatever their size: {names}."] if d.invisible else []


def _unsupported(d: Diagnosis) -> list[str]:
    names = [each.effect.label for each in d.unsupported]
    found = [
        f"In the model, {each.effect.label} {'cannot be as it is' if each.absurd else 'is idle'}: "
        f"{each.why}."
        for each in d.unsupported
    ]
    if names:
        found.append(
            f"To leave out {listed(names)}: name the others by `--with`, or take [[effect]] out of "
            f"mechanism.toml; in Python, `mechanism.without('{names[0]}')`."
        )
    return found
