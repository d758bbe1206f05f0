"""A diagnosis and a grown model as text, tables, charts and files."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ident.diagnosis.data_checks import Health
from ident.diagnosis.diagnosis import Diagnosis, Invisible, name_of
from ident.diagnosis.grow import History, Step
from ident.diagnosis.selection import Evidence
from ident.display import renders
from ident.effects import Effect
from ident.fit.residual import Failure
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.text import percent, rounded, table

WIDTH = 100
MOST = 4  # names or numbers that are listed; the others are counted
TOLD = 3  # joints, windows, regimes and signals that are described
ABSORBED = "absorbed"
SIGNALS = {
    "q": "position",
    "v": "speed",
    "a": "acceleration",
    "load": "load",
    "sign(v)": "direction of motion",
}
SURE = ((8.0, "beyond doubt"), (4.0, "very sure"), (2.5, "sure"), (-1e9, "fairly sure"))
UNITS = re.compile(r"(?<=[\d?]) (%|(N m|N|rad|kg|m|s)\b( s²?/| m²)?)| ± ")
TIE = "\u00a0"
Rows = list[list[str]]


# --- pieces of language ------------------------------------------------------------------------


def listed(names: Iterable[str], word: str = "and") -> str:
    """`a, b and c`.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    *first, last = list(names) or ["none"]
    return f"{', '.join(first)} {word} {last}" if first else last


def some(names: Sequence[str], most: int = MOST) -> str:
    """The first few, the others counted.

    >>> some(["a", "b", "c"], 2)
    'a, b and 1 more'
    """
    if len(names) <= most:
        return listed(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def signal(name: str) -> str:
    """A signal as a person says it.

    >>> signal("v.elbow")
    'the speed of elbow'
    """
    kind, dot, joint = name.partition(".")
    return f"the {SIGNALS.get(kind, kind)} of {joint}" if dot else "time"


def sure(z: float) -> str:
    """How sure so many standard errors make."""
    return next(words for least, words in SURE if z >= least)


def numbers(parameters: Sequence[Value], most: int = MOST) -> str:
    """`Fc = 0.312 ± 0.004 N m`, several of them; what the data do not determine says so."""
    said = []
    for v in parameters:
        unit = "" if v.unit == "1" else f" {v.unit}"
        said.append(f"{v.name.rpartition('.')[2]} = {rounded(v.value, v.stderr)}{unit}")
    return some(said, most)


def labels(effects: Iterable[Effect], word: str = "and") -> str:
    """Effects as commands take them."""
    return listed([effect.label for effect in effects], word)


def error_text(error: Error) -> str:
    """`0.065 N m (2.1 %)`."""
    relative = "" if error.relative is None else f" ({percent(error.relative)})"
    return f"{error.rms:.3g} {error.unit}{relative}"


def gained(e: Evidence) -> str:
    """`32.8 % (chance: at most 5.2 %)`."""
    return f"{100 * e.gain:.1f} % (chance: at most {100 * e.limit:.1f} %)"


def wrapped(text: str, indent: str = "") -> list[str]:
    """Lines of at most 100 characters, numbers and their units together."""
    lines = textwrap.wrap(
        tied(text), WIDTH, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    )
    return [line.replace(TIE, " ") for line in lines]


def tied(text: str) -> str:
    """With unbreakable spaces between numbers and their units."""
    return UNITS.sub(lambda found: found[0].replace(" ", TIE), text)


# --- tables ------------------------------------------------------------------------------------


def verdict_line(d: Diagnosis) -> str:
    """The verdict in one sentence."""
    if d.verdict == "missing":
        best = d.candidates[0].effect
        if not d.rivals:
            return f"missing: {best.label}"
        return f"missing: {labels([best, *d.rivals], 'or')}, which this data cannot tell apart"
    return {
        "nothing": "nothing is missing that this data could show",
        "unexplained": "unexplained: something is missing, and no effect of the library explains "
        "it",
        "undecided": f"undecided: more is left in {listed(d.loud)} than the sensors' noise, and "
        "this log cannot tell coloured noise from physics",
    }[d.verdict]


@renders(Diagnosis, "text")
def summary(d: Diagnosis) -> str:
    """What `print` and the command show: the verdict, two tables, and all of it in words."""
    logs = ", ".join(e.name for e in d.fit.motion.experiments)
    lines = wrapped(f"{d.fit.mechanism.name} on {logs}: {verdict_line(d)}", "  ")
    lines += ["", "where it fails", *table(where_rows(d))]
    if d.candidates:
        head, *body = table(candidate_rows(d))
        lines += ["", "what adding an effect would do, held out", head]
        for line, each in zip(body, d.candidates, strict=True):
            lines.append(line)
            if d.verdict != "nothing":
                lines += wrapped(f"      {numbers(each.parameters)}", "      ")
    for paragraph in d.text.split("\n\n"):
        lines += ["", *wrapped(paragraph)]
    return "\n".join(lines)


def where_rows(d: Diagnosis) -> Rows:
    """Joint by joint: held-out error, noise floor, what repeats, on what the residual depends."""
    rows = [["joint", "held out", "", "noise", "of misfit", "repeats", "depends on"]]
    errors = d.fit.held_out or d.fit.train
    for f in d.where:
        signals = [each.signal for each in f.depends_on[:2]]
        rows.append(
            [
                f.joint,
                f"{errors[f.joint].rms:.3g} {f.unit}",
                percent(errors[f.joint].relative),
                f"{d.floor[f.joint]:.2g} {f.unit}",
                f"{100 * f.share:.0f} %",
                "" if f.repeats is None else f"{f.repeats:.2f}",
                ", ".join(signals) or ("noise" if f.white else "no single signal"),
            ]
        )
    return rows if d.periods is not None else [[*row[:5], row[6]] for row in rows]


def candidate_rows(d: Diagnosis) -> Rows:
    """One a candidate, best first; `=` marks what this data cannot tell apart."""
    rows = [["effect", "of joint", "error", "fall", "gain", "chance", "visible"]]
    for i, each in enumerate(d.candidates):
        e = each.evidence
        rows.append(
            [
                f"{mark(d, i)} {each.effect.label}",
                each.joint,
                f"{percent(each.error_before)} → {percent(each.error_after)}",
                f"{100 * each.fall:.1f} %",
                f"{100 * e.gain:.1f} %",
                f"{100 * e.limit:.1f} %",
                f"{100 * e.refit.visible:.0f} %",
            ]
        )
    return rows


def mark(d: Diagnosis, i: int) -> str:
    """`*` for the best, `=` for its rivals."""
    if d.verdict != "missing":
        return " "
    rivals = {effect.label for effect in d.rivals}
    return "*" if i == 0 else "=" if d.candidates[i].effect.label in rivals else " "


def error_matrix(d: Diagnosis) -> Rows:
    """Held-out error of every joint as it is, with each candidate, and what noise would leave."""
    errors = d.fit.held_out or d.fit.train
    rows = [["", *errors], ["as it is", *(f"{e.rms:.3g} {e.unit}" for e in errors.values())]]
    for i, each in enumerate(d.candidates):
        cells = [f"{each.after[joint].rms:.3g}" for joint in errors]
        rows.append([f"{mark(d, i)} {each.effect.label}".strip(), *cells])
    return [*rows, ["noise alone", *(f"{d.floor[joint]:.3g}" for joint in errors)]]


# --- in words ----------------------------------------------------------------------------------


@renders(Diagnosis, "words")
def words(d: Diagnosis, experiment: str | None = None) -> str:
    """All of a diagnosis in short paragraphs, parted by empty lines."""
    claim = {"missing": _missing, "nothing": _nothing, "unexplained": _unexplained,
             "undecided": _undecided}[d.verdict]  # fmt: skip
    said = [*_health(d), *_where(d), *claim(d), *_invisible(d), *_unsupported(d)]
    next_ = d.next_experiment if experiment is None else experiment
    return "\n\n".join([*said, *([f"Next experiment: {next_}"] if next_ else [])])


def _health(d: Diagnosis) -> list[str]:
    if d.health.good:
        return []
    findings = ". ".join(f"{check}" for check in d.health.findings)
    return [
        f"Before anything: the data themselves look wrong. {findings}. Put this right or rule it "
        "out, then diagnose again: what follows may only be its consequence."
    ]


def failing(d: Diagnosis) -> list[Failure]:
    """Joints in which more than noise is left, the worst first; of a clean model none."""
    if d.verdict == "nothing":
        return []
    mended = {d.candidates[0].joint} if d.verdict == "missing" else set()
    loud = mended | set(d.loud)
    return [each for each in d.where if each.joint in loud] or list(d.where[:1])


def _where(d: Diagnosis) -> list[str]:
    bad = failing(d)
    said = [_failure(d, each) for each in bad[:TOLD]]
    if len(bad) > TOLD:
        said.append(f"More than noise is left in {listed(e.joint for e in bad[TOLD:])} as well.")
    quiet = [each.joint for each in d.where if each not in bad]
    if bad and quiet:
        said[-1] += f" In {listed(quiet)} nothing but noise is left."
    return said


def _failure(d: Diagnosis, f: Failure) -> str:
    """How much, when, on what that depends, and whether it comes again with the motion."""
    held = (d.fit.held_out or d.fit.train)[f.joint]
    relative = "" if held.relative is None else f", {percent(held.relative)} of the torque"
    said = [
        f"The model fails in {f.joint}: held out, its torque is off by {held.rms:.3g} {f.unit} "
        f"rms{relative}, where noise alone would leave {d.floor[f.joint]:.2g} {f.unit}; that is "
        f"{100 * f.share:.0f} % of the misfit of all joints."
    ]
    if when := [f"{regime}" for regime in f.stands_out[:TOLD]]:
        said.append(f"It is larger at {listed(when)} than elsewhere.")
    if f.worst and not f.white:
        several = len(d.fit.motion.experiments) > 1
        windows = [f"{w}" + f" of {w.experiment}" * several for w in f.worst[:TOLD]]
        said.append(f"It is worst at {listed(windows)}.")
    if f.depends_on:
        shown = [
            f"{each.seen} against {signal(each.signal)} ({100 * each.r2:.0f} % of it)"
            for each in f.depends_on[:TOLD]
        ]
        said.append(f"Plotted, the residual shows {listed(shown)}.")
    elif not f.white:
        said.append(
            "It depends on no single signal, but is no noise either: a product of signals, or "
            "something that remembers, such as play or presliding."
        )
    if d.periods is not None:
        rho, chance = d.periods.rho[f.joint], d.periods.chance
        what = "it does not come back: noise, or something like warming up"
        if rho > chance:
            what = "a part of it comes back" if rho < 0.8 else "it comes back: physics, not noise"
        said.append(f"The motion repeats; of the residual, {what} (correlation {rho:.2f}).")
    return " ".join(said)


def _missing(d: Diagnosis) -> list[str]:
    """Paragraphs on the effect that is named."""
    best = d.candidates[0]
    effect, e = best.effect, best.evidence
    name = f"{effect.label} ({type(effect).summary()})"
    if best.rivals:
        first = (
            f"Missing is one of {1 + len(best.rivals)} effects that this data cannot tell apart: "
            f"{name} comes first, but it could as well be {labels(best.rivals, 'or')}."
        )
    else:
        first = f"Missing is {name}."
    if best.known:
        known = [
            f"{v.name.rpartition('.')[2]} = {best.known[v.name]:.4g} {v.unit}".removesuffix(" 1")
            for v in best.parameters
        ]
        first = f"{first} The model has it, as {some(known)}: that must have changed."
    before, after = best.before[best.joint], best.after[best.joint]
    said = [
        f"{first} Its torque: {effect.equation}. With {effect.label} in the model and everything "
        f"refitted, {numbers(best.parameters)}; the held-out error of {best.joint} falls from "
        f"{error_text(before)} to {error_text(after)}, where noise alone would leave "
        f"{d.floor[best.joint]:.2g} {after.unit}.",
        f"That something is missing here: {sure(e.z)}. In stretches of time that were left out of "
        f"the fit, the squared error of all joints falls by {100 * e.gain:.1f} %; where nothing is "
        f"missing, the best of all candidates makes it fall by more than {100 * e.limit:.1f} % in "
        f"{100 * d.decision.alpha:g} of 100 logs.",
    ]
    if best.rivals:
        said.append(_apart(d, effect, best.rivals))
    own = ""
    if effect.joints and best.joint not in effect.joints:
        own = f" against the signals of {', '.join(effect.joints)}"
    said.append(
        f"What to look for in the plots of {best.joint}{own}: {effect.signature}. It is gone once "
        f"the effect is in the model: `ident add MECHANISM {effect.label}` or `--with "
        f"{effect.label}`, in Python `mechanism + diagnosis.best`."
    )
    more = [
        f"{m.label}" + (f", or a curve ({m.curve.label})" if m.curve else "") for m in d.together
    ]
    if more:
        said.append(
            f"That is not all: beside it, the data ask for {some(more)}. Add it and diagnose "
            "again; `ident grow` goes on until nothing more can be named."
        )
    elif d.loud:
        rest = listed(f"{name} {best.after[name].rms:.3g} {after.unit}" for name in d.loud)
        said.append(f"That may not be all: even with it more than noise is left ({rest}).")
    return said


def _apart(d: Diagnosis, effect: Effect, rivals: tuple[Effect, ...]) -> str:
    """Why this data cannot tell rivals apart."""
    mechanism = d.fit.mechanism
    said = [f"Their held-out errors differ by less than {d.decision.rival_se:g} standard errors."]
    elsewhere = [each for each in rivals if set(each.joints) != set(effect.joints)]
    if elsewhere and len(mechanism.joints) > mechanism.degrees_of_freedom:
        said.append(
            "In a closed loop the torques of all joints end up in the same equation; only their "
            "leverage, how far a joint goes when the drive does, tells one joint from another, and "
            "over this range of motion it changes too little. That the error falls is no proof of "
            "the cause here."
        )
    elif elsewhere:
        said.append(
            f"In this motion {labels([effect, *elsewhere])} go alike: what one explains the other "
            "explains nearly as well."
        )
    alike = [each for each in rivals if set(each.joints) == set(effect.joints)]
    if alike:
        said.append(
            f"{labels([effect, *alike])} sit at the same place and differ only where this motion "
            "has little to show, at other speeds, positions or loads."
        )
    return " ".join(said)


def _beside(d: Diagnosis) -> str:
    errors = d.fit.held_out or d.fit.train
    return some([f"{n} {e.rms:.2g} beside {d.floor[n]:.2g} {e.unit}" for n, e in errors.items()], 8)


def _nothing(d: Diagnosis) -> list[str]:
    errors = d.fit.held_out or d.fit.train
    material = d.decision.material
    least = [
        f"{material * e.rms / e.relative:.2g} {e.unit} in {name}"
        for name, e in errors.items() if e.relative
    ]  # fmt: skip
    said = (
        "Nothing is missing that this data could show: what is left is the sensors' noise, or too "
        f"small to matter. The residual's rms beside that of noise alone: {_beside(d)}."
    )
    if d.periods is not None and max(d.periods.rho.values()) < d.periods.chance:
        said += " The motion repeats, and the residual does not repeat with it."
    return [
        said,
        f"How small an effect could still hide: below {100 * material:g} % of a joint's torque "
        f"nothing is reported ({some(least, 8)}), nor what lowers the held-out squared error by "
        f"less than {100 * d.selection.first.limit:.1f} %, as chance does. "
        f"{_tried(d)} effects were tried at their places.",
    ]


def _tried(d: Diagnosis) -> int:
    return sum(not each.curve for each in d.selection.first.contest.candidates)


def _nearest(d: Diagnosis) -> list[str]:
    """The curve that explains most, with the law that comes nearest."""
    curves = d.selection.first.curves or d.selection.last.curves
    if not curves:
        return []
    curve, gain = curves[0]
    near = next((e for e in d.selection.first.evidence
                 if e.sensible and set(e.effect.joints) & set(curve.joints)), None)  # fmt: skip
    law = f"; nearest known: {near.effect.label}, {100 * near.gain:.1f} %" if near else ""
    return [
        f"A {curve.label.replace(':', ' at ')} explains {100 * gain:.1f} % of the held-out squared "
        f"error (chance: at most {100 * d.selection.first.limit:.1f} %){law}."
    ]


def _unexplained(d: Diagnosis) -> list[str]:
    rejected = [
        f"{m.label} explains a part, but beside it a {m.curve.label.replace(':', ' at ')} explains "
        "much more, so its form is wrong here"
        for m in d.selection.members if m.curve is not None
    ]  # fmt: skip
    tried = [f"{e.effect.label} {gained(e)}" for e in d.selection.first.evidence if e.sensible]
    said = [
        "Something is missing, and nothing in the library explains it, so no name is given. "
        f"{_tried(d)} effects were tried at their places, each with everything refitted."
        + (f" {listed(rejected)}." if rejected else "")
        + (f" The best lower the held-out squared error by: {some(tried, TOLD)}." if tried else "")
    ]
    said += _nearest(d)
    if (s := d.suggestion) is not None:
        joints = listed(f"s.q[{i}] is the position of {name}" for i, name in enumerate(s.joints))
        said.append(
            f"An expression of the signals describes it: {s}. Here {joints}, s.v and s.a are their "
            f"rates. It explains {100 * s.explained:.0f} % of what exceeds the noise. It is a "
            "description, not yet a cause: see what it could be. `--out` writes it as "
            f"suggestion.py, to be used with `--with {s.effect} --allow-code`."
        )
    else:
        said.append(
            "No short expression of positions, speeds, accelerations and time explains it either; "
            "look at the maps of the residual, and at what the log does not hold: temperature, "
            "contact, play, cables, another load."
        )
    return said


def _undecided(d: Diagnosis) -> list[str]:
    tried = [f"{e.effect.label} {gained(e)}" for e in d.selection.first.evidence if e.sensible]
    return [
        f"In {listed(d.loud)} more is left than the sensors' noise makes (rms beside that of noise "
        f"alone: {_beside(d)}), but neither an effect of the library nor a curve of any signal "
        "predicts stretches of time that were left out better than chance does. It may be noise "
        "that remembers, a disturbance, or physics that shows in too little of this log. "
        + (f"The best: {some(tried, TOLD)}." if tried else "")
    ]


def _invisible(d: Diagnosis) -> list[str]:
    """Grouped by reason, a kind's places in one."""
    if not d.invisible:
        return []
    groups: dict[str, dict[str, list[Invisible]]] = {}
    for each in d.invisible:
        reason = ABSORBED if each.why.startswith(ABSORBED) else each.why
        groups.setdefault(reason, {}).setdefault(each.effect.kind, []).append(each)
    said = ["This data cannot show some effects, whatever their size, and says nothing about them."]
    for reason, kinds in groups.items():
        names = "; ".join(_kind(kind, found) for kind, found in kinds.items())
        if reason == ABSORBED:
            said.append(f"Other parameters of the model do the same as {names}.")
        else:
            said.append(f"Of {names}: {reason}.")
    return [" ".join(said)]


def _kind(kind: str, found: list[Invisible]) -> str:
    """`rotor_inertia of yaw (turret.Lzz)`, or several places without what absorbs each."""
    places = [",".join(each.effect.joints) for each in found]
    if found[0].why.startswith(ABSORBED) and len(found) <= 2:
        places = [
            f"{place} ({_carriers(each.why)})".strip()
            for place, each in zip(places, found, strict=True)
        ]
    return f"{kind} of {some(places)}" if places[0] else " ".join([kind, *places]).strip()


def _carriers(why: str) -> str:
    """The first of the parameters that absorb an effect."""
    first, comma, _ = why.rpartition(" columns as ")[2].partition(", ")
    return f"{first} and others" if comma else first


def _unsupported(d: Diagnosis) -> list[str]:
    absurd = [each for each in d.unsupported if each.absurd]
    idle = [each for each in d.unsupported if not each.absurd]
    said = [f"In the model, {each.effect.label} cannot be as it is: {each.why}." for each in absurd]
    if idle:
        names = "; ".join(f"{each.effect.label}: {each.why}" for each in idle)
        how = f"`mechanism.without('{idle[0].effect.label}')`"
        if d.verdict == "nothing":
            advice = f"Leave it out ({how}) unless you know better."
        else:
            advice = f"That may change with what is missing; what stays idle then can go ({how})."
        said.append(f"In the model, and not supported by this data: {names}. {advice}")
    return said


@renders(Diagnosis, "html")
def blocks(d: Diagnosis) -> str:
    """The verdict, two tables, and the words folded."""
    from ident.show.html import folded, in_frame, paragraph, strong
    from ident.show.html import table as html_table

    parts = [strong(verdict_line(d)), html_table(where_rows(d), "Where the model fails")]
    if d.candidates:
        parts.append(html_table(candidate_rows(d), "What adding an effect would do, held out"))
    said = folded("In words", *(paragraph(each) for each in d.text.split("\n\n")))
    return in_frame([*parts, said])


@renders(Health, "text")
def health_text(h: Health) -> str:
    """A table of all checks, and the findings and notes in words."""
    rows = [["check", "channel", "number", "threshold", ""]]
    for c in h.checks:
        if c.number == c.number:
            number = f"{c.number:.3g} {c.unit}".strip()
            limit = f"{c.threshold:.3g}" if c.threshold == c.threshold else "–"
            rows.append([c.name, c.where, number, limit, "bad" if c.bad else ""])
    title = "health of the data: " + (
        "nothing is wrong" if h.good else f"{len(h.findings)} finding(s)"
    )
    said = [f"{'! ' if c.bad else 'note: '}{c}" for c in h.checks if c.bad or c.number != c.number]
    return "\n".join([title, *table(rows), *said])


# --- the ladder --------------------------------------------------------------------------------

NAME, CELL, FALL = 30, 7, 7  # characters of the columns


def head(joints: Sequence[str]) -> str:
    """The ladder's head; joints whose names do not fit beside each other are numbered."""
    names = list(joints)
    lines = ["held-out error"]
    if len(_row("", names, "")) > WIDTH:
        names = [f"[{i + 1}]" for i in range(len(names))]
        legend = ", ".join(f"[{i + 1}] {joint}" for i, joint in enumerate(joints))
        lines = wrapped(f"held-out error of {legend}", "  ")
    return "\n".join([*lines, _row("effect", names, "fall")])


def rung(step: Step, joints: Sequence[str]) -> str:
    """One rung: what was added, errors, the fall of the held-out weighted sum of squares."""
    numbered = len(_row("", joints, "")) > WIDTH
    width = [0 if numbered else len(joint) for joint in joints]
    lines = [_row(changed(step), _cells(step.errors, joints), _fall(step), width)]
    for log, errors in step.fit.validation.items() if step.fit else ():
        name = log if len(log) <= NAME - 4 else f"…{log[-(NAME - 5) :]}"
        lines.append(_row(f"  on {name}", _cells(errors, joints), "", width))
    if step.rivals:
        lines += wrapped(f"    or {labels(step.rivals, 'or')}: not to be told apart", "      ")
    if step.removed and (step.added is not None or len(step.removed) > 1):
        lines += wrapped(f"    without {labels(step.removed)}: superfluous now", "      ")
    return "\n".join(lines)


@renders(Step, "text")
def step_text(step: Step) -> str:
    """One rung with its joints."""
    return rung(step, list(step.errors))


def _row(first: str, cells: Sequence[str], last: str, least: Sequence[int] = ()) -> str:
    width = least or [0] * len(cells)
    middle = [cell.rjust(max(CELL, w)) for cell, w in zip(cells, width, strict=True)]
    return "  ".join([first.ljust(NAME), *middle, last.rjust(FALL)]).rstrip()


def changed(step: Step) -> str:
    """What this rung has that the one before had not, or the reverse."""
    if step.added is not None:
        return f"+ {step.added.label}"
    if len(step.removed) == 1:
        return f"− {step.removed[0].label}"
    return f"− {len(step.removed)} effects" if step.removed else "as given"


def _fall(step: Step) -> str:
    about = "" if step.fit else "≈ "  # announced by the search, not fitted
    return "" if step.added is None else f"{about}{100 * step.fall:.1f} %"


def _cells(errors: Mapping[str, Error], joints: Sequence[str]) -> list[str]:
    """Relative errors; of a joint without torque its rms."""
    found = []
    for joint in joints:
        error = errors.get(joint)
        if error is None:
            found.append("–")
        else:
            found.append(f"{error.rms:.2g}" if error.relative is None else percent(error.relative))
    return found


@renders(History, "text")
def ladder_text(history: History) -> str:
    """The whole ladder."""
    joints = history.fit.motion.independent
    return "\n".join([head(joints), *(rung(step, joints) for step in history.steps)])


@renders(History, "ladder")
def ladder_rows(history: History) -> Rows:
    """As a table: effect, a column a joint, fall, rivals."""
    joints = history.fit.motion.independent
    rows = [["effect", *joints, "fall", "rivals"]]
    for step in history.steps:
        rivals = labels(step.rivals, "or") if step.rivals else ""
        removed = ""
        if step.added is not None or len(step.removed) > 1:
            removed = "".join(f" − {effect.label}" for effect in step.removed)
        cells = _cells(step.errors, joints)
        rows.append([f"{changed(step)}{removed}", *cells, _fall(step), rivals])
    return rows


@renders(History, "html")
def ladder_html(history: History) -> str:
    """The verdict and the ladder."""
    from ident.show.html import in_frame, strong
    from ident.show.html import table as html_table

    rows = html_table(history.table(), "Held-out error, rung by rung", tied=False)
    return in_frame([strong(verdict_line(history.diagnosis)), rows])


# --- diagnosis.json ----------------------------------------------------------------------------

SCHEMA = "ident.diagnosis/1"


@renders(Diagnosis, "json")
def diagnosis_json(d: Diagnosis) -> dict[str, Any]:
    """The content of diagnosis.json; what is not finite is None."""
    first, last = d.selection.first, d.selection.last
    found: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "mechanism": d.fit.mechanism.name,
            "logs": [e.name for e in d.fit.motion.experiments],
            "effects": [name_of(effect) for effect in d.fit.mechanism.effects],
            "verdict": d.verdict,
            "decision": {
                "alpha": d.decision.alpha,
                "material": d.decision.material,
                "rival_se": d.decision.rival_se,
                "quantile": first.limit,
                "candidates": [
                    {"effect": label, "gain": gain, "quantile": first.limit, "visible": visible}
                    for label, (gain, visible) in sorted(
                        first.gains.items(), key=lambda item: -item[1][0]
                    )
                ],
            },
            "where": [{**each.json, "floor": d.floor[each.joint]} for each in d.where],
            "candidates": [each.json() for each in d.candidates],
            "best": None if d.best is None else name_of(d.best),
            "together": [
                {**name_of(m.evidence.effect), "gain": m.gain, "quantile": last.limit,
                 "curve": m.curve.label if m.curve else None}
                for m in d.selection.members
            ],
            "left": [{"curve": curve.label, "gain": gain} for curve, gain in last.curves],
            "invisible": [each.json() for each in d.invisible],
            "unsupported": [each.json() for each in d.unsupported],
            "suggestion": None if d.suggestion is None else d.suggestion.json(),
            "health": d.health.json(),
            "judged": _tried(d),
            "next_experiment": d.next_experiment,
            "text": d.text,
        }
    )  # fmt: skip
    return found


def plain(value: Any) -> Any:
    """As JSON can hold it: numbers of Python, None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
