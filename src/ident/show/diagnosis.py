"""A diagnosis as text: first lines for a terminal, tables, and all of it in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.diagnosis.law_search import FittedFormula
from ident.diagnosis.result import Diagnosis, Explanation, errors_of
from ident.diagnosis.selection import Evidence
from ident.diagnosis.unobservable import Invisible
from ident.display import folder, renders
from ident.effects import KINDS, Effect
from ident.fit import Fit
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
    sure,
)
from ident.show.laws import curve_name, curves, expression, labels, laws, numbers
from ident.show.residual import details
from ident.show.sheet import Sheet
from ident.text import listed, percent, some

LINES = 20  # of a diagnosis in a terminal, if one joint and the words leave place
BRIEF = 300  # characters of the next experiment in the first lines
MOST = 3  # joints and candidates that are described
ABSORBED = "absorbed"
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


def verdict_line(d: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if d.best is not None:
        first = f"{d.best.label if d.rivals else named(d.group)} ({type(d.best).summary()})"
        names = ["other values of " * bool(d.candidates[0].known) + first, *_alike(d)]
        apart = ", which this data cannot tell apart" if names[1:] else ""
        return f"missing: {listed(names, 'or')}{apart}"
    formulas = listed([f"torque of {law.joint} = {law.formula}" for law in d.laws])
    last = d.laws[-1].after if d.laws else {}  # its fit has all laws
    if open_ := [name for name in d.loud if d.laws and last[name].rms > NOISY * d.floor[name]]:
        formulas += f"; even with it more than noise is left in {listed(open_)}"
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
    them apart.
    """
    best, apart = d.best, {each.label for each in d.advice.apart if not each.signal}
    rivals = [each for each in d.rivals if each.label in apart and each.kind in KINDS]
    if best is None or not rivals or best.label not in apart or best.kind not in KINDS:
        return ()
    rival = next((each for each in rivals if each.kind == best.kind), rivals[0])
    return best.label, rival.label


def card(d: Diagnosis, added: Sequence[Effect] = ()) -> Card:
    """Return the verdict, how sure it is, the error by joint, and the command to copy."""
    logs = ", ".join(e.name for e in d.fit.motion.experiments)
    line = f"{d.fit.mechanism.name} on {logs}: {verdict_line(d)}"
    errors = errors_of(d.fit)
    command = next_command("identify" if d.verdict == "nothing" else "excite", added)
    after: Mapping[str, Error] = {}
    planned = ""
    if d.best is not None:
        best = d.candidates[0]
        after = d.after
        command = add_command(d.fit.mechanism, [*added, *d.group])
        if planned := next_command("excite", added, pair) if (pair := _separable(d)) else "":
            command = planned
        mine = [m.evidence.z for m in d.selection.named if m.evidence and m.effect in d.group]
        certain = sure(min(mine, default=best.evidence.z)).capitalize()  # of the least certain one
        certain = certain if best.evidence.p < RAREST else "Not sure"
        if (stays := _stays(d, after)) > PART:
            certain = (
                f"Not sure that it is this (with it {100 * stays:.0f} % of the squared error "
                f"beyond noise stays in {best.joint})"
            )
        elif _alike(d):
            certain = f"Which of these is open; that something is missing: {certain.lower()}"
        value = f"{d.best.label}: " if len(d.group) > 1 or _alike(d) else ""
        had = f", in the model {_known(best)}" * bool(best.known)
        certain += f": {by_chance(best.evidence)}; {value}{numbers(best.parameters)}{had}."
    else:
        certain = f"{_tried(d)} effects were tried, and none explains more than chance does."
        if d.selection.members or d.laws:
            certain = f"{_tried(d)} effects were tried, and none explains it."
        if d.laws:
            after = d.laws[-1].after  # its fit has all laws
            files = [f"{folder.get() or 'DIR'}/{law.option}" for law in d.laws]
            command = add_command(d.fit.mechanism, added, files)
    bars = [Bar(f.joint, errors[f.joint], after.get(f.joint), d.floor[f.joint]) for f in d.where]
    bars.sort(key=lambda bar: bar.sizes[1] - bar.sizes[0])  # the largest fall first
    good = good_enough(errors, d.floor, d.fit.residual.away, d.verdict == "nothing")
    sentences = " ".join([*_health(d), good, certain, *_rest(d)]).strip()
    return Card(
        line, sentences, tuple(bars), command * d.health.good, first_motion(d, bool(planned))
    )


def first_motion(d: Diagnosis, planned: bool) -> str:
    """Return the next experiment in some lines, `planned` by the card's command, unless the data
    look wrong.
    """
    if not d.health.good:
        return ""
    text = d.next_experiment  # whole sentences of some three lines, the first one in any case
    end = text.find(". ") if len(text) > BRIEF else -1
    end = max(end, text.rfind(". ", 0, BRIEF)) if end > 0 else len(text)
    way = ", planned by this command or by hand" if planned else ""
    return f"Next experiment{way}: {text[: end + 1]}" if text else ""


# --- text -----------------------------------------------------------------------------------------


@renders(Diagnosis, "short")
def short(d: Diagnosis, top: Card | None = None) -> str:
    """Return what a person needs first, in twenty lines: verdict, errors, what to do."""
    paragraphs = laws(d)
    if d.verdict in ("unexplained", "undecided") and not d.laws:
        paragraphs += [*_nearest(d), *curves(d)]
    hidden = f", {len(d.invisible)} effects this log hides" if d.invisible else ""
    paragraphs.append(f"--verbose: all candidates{hidden}; {d.decision}")
    top = top or card(d)
    text = Sheet(top, paragraphs=paragraphs, indent="  ").text()
    if (over := text.count("\n") + 1 - LINES) > 0:
        top = replace(top, most=max(1, min(top.most, len(top.bars)) - over - 1))
        text = Sheet(top, paragraphs=paragraphs, indent="  ").text()
    return text


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
    groups: dict[tuple[str, str], list[Explanation]] = {}
    for each in d.candidates:
        groups.setdefault((mark(d, each), each.effect.kind), []).append(each)
    for (sign, _), group in groups.items():
        if len(group) > 1:
            name = named(each.effect for each in group)
            best = max(group, key=lambda each: each.evidence.gain)
            rows.append([f"{sign} {name}", *_cells(d, best)[:-1], ""])
        indent = "  " * (len(group) > 1)
        rows += [[f"{indent}{sign} {each.effect.label}", *_cells(d, each)] for each in group]
    return rows


def _cells(d: Diagnosis, each: Explanation) -> list[str]:
    joint, e = each.joint, each.evidence
    change = Bar(joint, each.before[joint], each.after[joint], d.floor[joint]).words
    visible = f"{100 * e.refit.visible:.0f} %"
    chance = f"< {100 * RAREST:g} %" if e.p < RAREST else f"{float(f'{100 * e.p:.2g}'):g} %"
    return [joint, change, "–" if np.isnan(e.p) else chance, visible, numbers(each.parameters)]


def mark(d: Diagnosis, each: Explanation) -> str:
    """Return `*` for what is named, `=` for its rivals."""
    label = each.effect.label
    if any(effect.label == label for effect in d.group):
        return "*"
    return "=" if any(effect.label == label for effect in d.rivals) else " "


# --- in words -------------------------------------------------------------------------------------


def story(d: Diagnosis, experiment: str | None = None) -> dict[str, list[str]]:
    """Return all of a diagnosis in words: paragraphs by title, as the report has them."""
    form = [*curves(d), *laws(d)] if d.best is not None else []
    if d.verdict == "unexplained":
        form = [*curves(d), *expression(d)]
    next_ = d.next_experiment if experiment is None else experiment
    return {
        "Health of the data": _health(d),
        "Where it fails": _where(d),
        CLAIMS[d.verdict][0]: [*CLAIMS[d.verdict][1](d), *_rest(d)],
        "Curve and formula": form,
        "Invisible in this data": _invisible(d),
        "In the model, but not supported": _unsupported(d),
        "What to log next": [f"Next experiment: {next_}"] if next_ else [],
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


def _where(d: Diagnosis) -> list[str]:
    bad = failing(d)
    found = [_failure(d, each) for each in bad[:MOST]]
    if len(bad) > MOST:
        found.append(f"More than noise is left in {listed(e.joint for e in bad[MOST:])} as well.")
    quiet = [each.joint for each in d.where if each not in bad]
    if bad and quiet:
        found[-1] += f" In {listed(quiet)} nothing but noise is left."
    return found


def _failure(d: Diagnosis, f: Failure) -> str:
    """Return how much a joint fails, when, on what that depends, and whether it repeats."""
    sentences = [
        f"The model fails in {f.joint}: held out, its torque is off by "
        f"{_error(errors_of(d.fit)[f.joint])}, where noise alone would leave "
        f"{d.floor[f.joint]:.2g} {f.unit}; that is {100 * f.share:.0f} % of the misfit of all "
        "joints."
    ]
    if found := details(f, len(d.fit.motion.experiments) > 1):
        sentences.append(f"The residual: {found}.")
    if d.periods is not None:
        rho = d.periods.rho[f.joint]
        what = "comes back" if rho > d.periods.chance else "does not come back"
        sentences.append(f"The motion repeats, and the residual {what} (correlation {rho:.2f}).")
    return " ".join(sentences)


def _error(e: Error) -> str:
    return f"{e.rms:.3g} {e.unit}" + ("" if e.relative is None else f" ({percent(e.relative)})")


def _missing(d: Diagnosis) -> list[str]:
    best = d.candidates[0]
    effect, e = best.effect, best.evidence
    name = f"{effect.label} ({type(effect).summary()})"
    first = f"Missing is {name}."
    if others := _alike(d):
        first = (
            f"Missing is one of {1 + len(others)} that this data cannot tell apart: {name} comes "
            f"first, but it could as well be {listed(others, 'or')}."
        )
    if best.known:
        first += f" The model has it, as {_known(best)}: that must have changed."
    before, after = (_error(x) for x in (best.before[best.joint], best.after[best.joint]))
    own = ""
    if effect.joints and best.joint not in effect.joints:
        own = f" against the signals of {', '.join(effect.joints)}"
    if d.relatives:
        laws = [f"{_relative(each)} (`{each.formula.text}`)" for each in d.relatives[:MOST]]
        first += f" Over the travelled range this data cannot tell it from {listed(laws, 'or')}."
    return [
        f"{first} Its torque: {effect.equation}. With {effect.label} in the model and everything "
        f"refitted, {numbers(best.parameters)}; the held-out error of {best.joint} falls from "
        f"{before} to {after}, where noise alone would leave {d.floor[best.joint]:.2g} "
        f"{best.after[best.joint].unit}.",
        f"That something is missing here: {sure(e.z)}. In stretches of time that were left out of "
        f"the fit it explains so much that {by_chance(e)}.",
        *([_apart(d, effect, best.rivals)] if best.rivals else []),
        f"What to look for in the plots of {best.joint}{own}: {effect.signature}. It is gone once "
        f"the effect is in the model: `{add_command(d.fit.mechanism, [effect])}` or `--with "
        f"{effect.label}`, in Python `mechanism + diagnosis.best`.",
    ]


def _relative(found: FittedFormula) -> str:
    """Return the name of a law of the literature in words."""
    name = found.formula.terms[0].known_as.replace("_", " ")
    return f"an {name}" if name[0] in "aeiou" else f"a {name}"


def _apart(d: Diagnosis, effect: Effect, rivals: tuple[Effect, ...]) -> str:
    """Return why this data cannot tell rivals apart."""
    mechanism = d.fit.mechanism
    text = f"Their held-out errors differ by less than {d.decision.rival_se:g} standard errors."
    if any(set(each.joints) == set(effect.joints) for each in rivals):
        text += (
            " Those at the same place differ only where this motion has little to show, at other "
            "speeds, positions or loads."
        )
    if all(set(each.joints) == set(effect.joints) for each in rivals):
        return text
    if len(mechanism.joints) == mechanism.degrees_of_freedom:
        return f"{text} In this motion {labels([effect, *rivals])} have almost equal torques."
    return (
        f"{text} In a closed loop the torques of all joints end up in the same equation; only "
        "their leverage, how far a joint goes when the drive does, tells one joint from another, "
        "and over this range of motion it changes too little. That the error falls is no proof of "
        "the cause here."
    )


def _rest(d: Diagnosis) -> list[str]:
    """Return what is missing beside the effect that is named."""
    if d.best is None:
        return []
    laws = [_relative(each) for each in d.relatives[:MOST]]
    found = [f"Over the travelled range {listed(laws, 'or')} would do as well."] if laws else []
    mine = {effect.label for effect in d.group}
    rest = [m for m in d.together if m.label not in mine]
    more = [named(group) for group in by_kind(m.effect for m in rest if not m.curve)]
    more += [f"{m.label}, or a {curve_name(m.curve)}" for m in rest if m.curve]
    if more:
        return [
            *found,
            f"That is not all: beside it, the data ask for {some(more)}. Add it and diagnose "
            "again; `ident grow` goes on until nothing more can be named.",
        ]
    if not d.loud:
        return found
    return [
        *found,
        f"That may not be all: even with it more than noise is left in {listed(d.loud)}.",
    ]


def _nothing(d: Diagnosis) -> list[str]:
    most = max(d.selection.first.chance.limits.values(), default=0.0)
    return [
        "Nothing is missing that this data could show: what is left is the sensors' noise, or too "
        f"small to matter. The residual's rms beside that of noise alone: {_beside(d)}.",
        "How small an effect could still hide: nothing is reported below "
        f"{100 * d.decision.material:g} % of a joint's torque, nor what explains, as chance does, "
        f"less than {100 * most:.2g} % of the held-out squared errors. "
        f"{_tried(d)} effects were tried at their places.",
    ]


def _beside(d: Diagnosis) -> str:
    pairs = errors_of(d.fit).items()
    return some([f"{n} {e.rms:.2g} beside {d.floor[n]:.2g} {e.unit}" for n, e in pairs], 8)


def _tried(d: Diagnosis) -> int:
    return sum(not each.curve for each in d.selection.first.contest.candidates)


def _unexplained(d: Diagnosis) -> list[str]:
    rejected = []
    for m in d.selection.members:
        if m.curve is not None:
            other = f"a {curve_name(m.curve)}"
        elif m.impossible is not None:
            other = f"a {m.impossible.label} with a value that no machine has"
        elif m.law is not None:
            other = "a formula with no more numbers"
        else:
            continue
        rejected.append(f"{m.label} explains a part, but {other} explains more")
    first = (
        "Something is missing, and nothing in the library explains it, so no name is given. "
        f"{_tried(d)} effects were tried at their places, each with everything refitted."
    )
    if rejected:
        first += f" {listed(rejected)}: these have not the form of the cause."
    return [first, *_nearest(d)]


def _undecided(d: Diagnosis) -> list[str]:
    return [
        f"In {listed(d.loud)} more is left than the sensors' noise makes (rms beside that of noise "
        f"alone: {_beside(d)}), but neither an effect of the library nor a curve of any signal "
        "predicts stretches of time that were left out better than chance does. It may be "
        "autocorrelated noise, a disturbance, or physics that shows in too little of this log.",
        *_nearest(d),
    ]


CLAIMS = {  # title of what each verdict says, and in which words
    "missing": ("What is missing", _missing),
    "nothing": ("What adding an effect would do", _nothing),
    "unexplained": ("What comes nearest", _unexplained),
    "undecided": ("What comes nearest", _undecided),
}


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
        f"{listed(f'{name} {gain:.2g} ×' for name, gain in best)}."
    ]


def _invisible(d: Diagnosis) -> list[str]:
    """Return what this data cannot show, grouped by reason, the places of a kind together."""
    groups: dict[str, dict[str, list[Invisible]]] = {}
    for each in d.invisible:
        reason = ABSORBED if each.why.startswith(ABSORBED) else each.why
        groups.setdefault(reason, {}).setdefault(each.effect.kind, []).append(each)
    found = []
    for reason, kinds in groups.items():
        names = "; ".join(_places(kind, each) for kind, each in kinds.items())
        same = f"Other parameters of the model do the same as {names}."
        found.append(same if reason == ABSORBED else f"Of {names}: {reason}.")
    first = "This data cannot show some effects, whatever their size, and says nothing about them."
    return [" ".join([first, *found])] if found else []


def _places(kind: str, found: list[Invisible]) -> str:
    """Return `rotor_inertia of yaw (turret.Lzz)`, or several places without what absorbs each."""
    places = []
    for each in found:
        carrier, comma, _ = each.why.rpartition(" columns as ")[2].partition(", ")
        brief = not each.why.startswith(ABSORBED) or len(found) > 2
        by = "" if brief else f" ({carrier}{' and others' if comma else ''})"
        places.append(f"{','.join(each.effect.joints)}{by}".strip())
    return f"{kind} of {some(places)}" if places[0] else kind


def _unsupported(d: Diagnosis) -> list[str]:
    found = [
        f"In the model, {each.effect.label} cannot be as it is: {each.why}."
        for each in d.unsupported if each.absurd
    ]  # fmt: skip
    idle = [each for each in d.unsupported if not each.absurd]
    if idle:
        names = "; ".join(f"{each.effect.label}: {each.why}" for each in idle)
        how = f"`mechanism.without('{idle[0].effect.label}')`"
        advice = f"That may change with what is missing; what stays idle then can go ({how})."
        if d.verdict == "nothing":
            advice = f"Leave it out ({how}) unless you know better."
        found.append(f"In the model, and not supported by this data: {names}. {advice}")
    return found
