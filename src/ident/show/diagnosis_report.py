"""Charts, report and files of a diagnosis."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.assess.diagnosis import assess_diagnosis, before_words
from ident.assess.verdict import errors_with_named, spoiling_faults
from ident.diagnosis.result import Diagnosis, Explanation, errors_of
from ident.diagnosis.unobservable import name_of
from ident.display import renders
from ident.effects.library import by_kind, named
from ident.files import json_bytes, jsonable, regular, write_all
from ident.fit.files import residual_before
from ident.fit.identify import Comparison
from ident.fit.residual import Failure
from ident.fit.values import EffectValues
from ident.request import PYTHON, Request, Step
from ident.show.card import Bar
from ident.show.charts import BEFORE, MEASURED, NOW, Chart, Dots, Panel
from ident.show.diagnosis import (
    aside,
    bar_of,
    candidate_rows,
    card,
    claim_words,
    experiment_steps,
    health_words,
    mark,
    planning,
    similar,
    unsupported_words,
    where_rows,
)
from ident.show.error_axis import ErrorAxis
from ident.show.fit import fit_sections
from ident.show.front import FirstScreen, first_screen
from ident.show.html import (
    Block,
    Choice,
    Section,
    code,
    headed,
    items,
    paragraph,
    report_page,
    table,
)
from ident.show.laws import curve_json, law_blocks, numbers, plot_curve
from ident.show.residual import plot_joint, plot_maps

SCHEMA = "ident.diagnosis/1"
NOTHING_ADDED = Step()
CLAIMS = {  # title of what each verdict says
    "missing": "What is missing",
    "nothing": "What adding an effect would do",
    "unexplained": "What comes nearest",
    "undecided": "What comes nearest",
}
BARS = 12
OWN_JOINT = re.compile(r"law\d*_[\w.-]*\.py|curve_[\w.-]*\.csv")  # files that a diagnosis writes
LOGS = 4  # whose torques are drawn below each other
MARKS = "* named; = this data cannot tell it from the one named."
FALLS = (
    "Error: held out, of the joint that it mends most, without it → with it. Explains: share of "
    "the left-out squares in all joints; in brackets the limit, which the best candidate exceeds "
    "in no more than alpha of logs in which nothing is missing. By chance: share of these in which "
    "the best explains as much. Visible: how much of its torque no other parameter could take over."
)
EFFECT = (
    "Above, all but the effect is taken off; the line is the effect itself. Below, the effect is "
    "taken off too: a flat band."
)


# --- charts ---------------------------------------------------------------------------------------


@renders(Diagnosis, "plot")
def plot_candidates(d: Diagnosis) -> Chart:
    """Draw the error of its joint without and with each candidate, and what noise would leave."""
    named = [item for item in d.every if mark(d, item) != " "]
    others = [element for element in d.every if element not in named][: max(BARS - len(named), 0)]
    shown = [entry_ for group in similar(d, [*named, *others]) for entry_ in group]
    before, after, noise = (
        100 * np.array([size or 0.0 for size in sizes])
        for sizes in zip(*(bar_of(d, x).sizes for x in shown), strict=True)
    )
    axis = ErrorAxis.of(0.01 * np.concatenate([before, after, noise]))
    before, after, noise = (np.maximum(sizes, axis.percents[0]) for sizes in (before, after, noise))
    at, none = np.arange(len(shown), dtype=float), np.zeros(len(shown))
    alone = len(d.floor) == 1  # joint, whose error is meant
    marks = [Dots(at, before, none, "as it is", BEFORE)]
    labels = "with it: named, or not distinguishable from that", "with it: others"
    for label, part, colour in ((labels[0], named, NOW), (labels[1], others, 0)):
        of = np.array([explanation in part for explanation in shown], dtype=bool)
        if part:
            marks.append(Dots(at[of], after[of], none[of], label, colour))
    marks.append(Dots(at, noise, none, "noise alone", MEASURED, upright=True))
    own_joint = (x.joint in x.effect.joints or alone for x in shown)
    names = [
        x.effect.label + f" in {x.joint}" * (not y) for x, y in zip(shown, own_joint, strict=True)
    ]
    panel = Panel(
        tuple(marks), "held-out error of the joint [%]", y_names=tuple(names), logarithmic_x=True,
        x_range=axis.percents,
        height=0.5 + 0.32 * max(len(shown), 1),
    )  # fmt: skip
    return Chart("The error of its joint, as it is and with each candidate", ((panel,),))


# --- report ---------------------------------------------------------------------------------------


def diagnosis_sections(
    d: Diagnosis, request: Request = PYTHON, added: Step = NOTHING_ADDED
) -> tuple[Section, ...]:
    """Return the words with tables and charts to them, and the fit that was diagnosed; `added`: a
    step with the effects that its model has, but not the mechanism as given.
    """
    claim = [paragraph(claim_word) for claim_word in claim_words(d)]
    if d.verdict != "nothing":  # the card has the first and what is missing beside it
        claim = claim[0 if spoiling_faults(d) else 1 : len(claim) - len(aside(d))]
    what = Section(CLAIMS[d.verdict], [*claim, *_candidates(d)])
    steps = [
        experiment_step.partition(": ")[::2]
        for experiment_step in experiment_steps(d.next_experiment)
    ]
    following: list[Block] = []
    if d.next_experiment:
        following.append(table([["step", "why"], *steps], "The most urgent first", tied=False))
        following += [code(item) for item in [planning(d, added, request)] if item]
    caption = "Joint by joint: held-out error, and what noise would leave"
    by_laws = bool(d.laws) and d.best is None  # what comes nearest matters less
    felt = d.candidates[0].joint if d.best else ""
    idle = unsupported_words(d) if d.verdict == "nothing" else []
    return (
        Section("Health of the data", [paragraph(health_word) for health_word in health_words(d)]),
        Section(
            "Joint by joint" if d.verdict == "nothing" else "Where it fails",
            [table(where_rows(d), caption)],  # the maps have the words
        ),
        *([] if by_laws else [what]),
        Section("Curve and formula", law_blocks(d, request)),
        Section("What to log next", following),
        *([what] if by_laws else []),
        Section("Invisible in this data", _invisible(d)),
        Section("In the model, but not supported", [paragraph(element) for element in idle]),
        *fit_sections(d.fit, first=felt, request=request),
    )


def marks_of(d: Diagnosis) -> dict[str, str]:
    """Return words beside joints in 3-D: what is named, where it sits, or else the laws."""
    m, felt = d.fit.mechanism, d.candidates[0].joint if d.best else ""
    joint_of = dict(zip(m.bodies.links, [*m.model.names][1:], strict=True))
    at = [(joint_of.get(x, x) if e.loaded_link else x, e) for e in d.group for x in e.joints]
    marks = {joint if joint in m.joint_index else felt: e.label for joint, e in at}
    return marks or {law.joint: f"formula: {law.joint}" for law in d.laws}


def screen_of(d: Diagnosis) -> FirstScreen:
    """Return a joint with and without what is named, and the curve of that; without a name, the fit
    beside what it was before.
    """
    marks = marks_of(d)
    fitted = [x for x in d.candidates if x.fit is not None and mark(d, x) == "*"]
    if d.best is not None and fitted:
        best = fitted[0]
        assert best.fit is not None
        label, after = (
            best.effect.label,
            replace(best.fit.residual, name=f"with {best.effect.label}"),
        )
        before = replace(d.fit.residual, name=before_words(d.fit).removeprefix("with "))
        effects = [EffectValues(best.effect, best.parameters)]
        return first_screen(before, after, best.joint, label, marks, effects)
    if d.laws:
        law = d.laws[-1]  # its fit has all of them
        after = replace(law.fit.residual, name=f"with the formula in {law.joint}")
        before = replace(d.fit.residual, name=before_words(d.fit).removeprefix("with "))
        screen = first_screen(before, after, law.felt, marks=marks)
        curves = [x for x in d.curves if x.effect.joints == law.effect.joints]
        front = [*screen.front[:1], *(plot_curve(x, law) for x in curves[:1])]
        return replace(screen, front=front)
    before = residual_before(d.fit) if len(d.fit.columns) else d.fit.residual
    return first_screen(before, d.fit.residual, marks=marks)


def _invisible(d: Diagnosis) -> list[Block]:
    """Return a row a kind of what this data cannot show, and why."""
    rows = [["effect", "why"]]
    for group in by_kind(item.effect for item in d.invisible):
        why = list(dict.fromkeys(element.why for element in d.invisible if element.effect in group))
        more = f"; {len(why) - 1} more alike in diagnosis.json" * (len(why) > 1)
        rows.append([named(group), f"{why[0]}{more}"])
    return [table(rows, "This data cannot show", tied=False)] if rows[1:] else []


def _candidates(d: Diagnosis) -> list[Block]:
    """Return all of them beside each other, and each that is refitted before and after."""
    if not d.candidates:
        return []
    blocks: list[Block] = [paragraph(MARKS)] if d.best else []
    blocks += [plot_candidates(d), paragraph(FALLS), table(candidate_rows(d), "Candidates")]
    refitted = [
        candidate
        for candidate in d.candidates
        if candidate.fit is not None and d.verdict != "nothing"
    ]
    options = {f"{mark(d, x)} {x.effect.label}".strip(): _option(d, x) for x in refitted}
    if options:
        blocks += [headed("Its residual before and after"), Choice("Which candidate", options)]
    return blocks


def _option(d: Diagnosis, explanation: Explanation) -> list[Block]:
    assert explanation.fit is not None
    before, after = d.fit.residual, explanation.fit.residual
    label, joint = explanation.effect.label, explanation.joint
    change = f"held-out error of {joint}: {bar_of(d, explanation).words}"
    lines = [type(explanation.effect).summary(), change, numbers(explanation.parameters)]
    if explanation.rivals:
        lines.append(f"not distinguishable from it in this data: {named(explanation.rivals, 'or')}")
    blocks: list[Block] = [headed(f"With {label}"), items(lines)]
    models = Comparison({"as it is": before, "with it": after}, {})
    count = len(before.traces)
    blocks += [paragraph(f"Drawn are the first {LOGS} of {count} logs.")] * (count > LOGS)
    blocks += [plot_joint(models, joint, i) for i in range(min(LOGS, count))]
    if label not in after.traces[0].parts:  # a correction has no torque, which could be drawn
        return [*blocks, plot_maps(models, joint)]
    models = Comparison({"without it": after.without(label), "with it": after}, {})
    return [*blocks, paragraph(EFFECT), plot_maps(models, joint, label)]


# --- files ----------------------------------------------------------------------------------------


@renders(Diagnosis, "files")
def write_diagnosis(
    d: Diagnosis,
    folder: str | Path,
    more: Mapping[str, bytes] | None = None,
    sections: Sequence[Section] = (),
    request: Request = PYTHON,
) -> list[Path]:
    """Write diagnosis.json, report.html with `sections` first, files of laws, and `more`."""
    title = f"{d.fit.mechanism.name}: diagnosis"
    request = replace(request, folder=str(folder))
    screen, every = screen_of(d), (*sections, *diagnosis_sections(d, request))
    top = card(d, request=request)
    report = report_page(title, top, every, screen.front, machine=screen.machine)
    files = {**diagnosis_files(d), **(more or {}), "report.html": report}
    return write_instead(d, Path(folder), files)


def write_instead(d: Diagnosis, folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write the files of a diagnosis; laws and curves that the folder's last one wrote are removed,
    unless the model uses them.
    """
    names: list[str] = []
    with suppress(OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        last = json.loads(regular(folder / "diagnosis.json").read_text(encoding="utf-8"))
        laws = [str(item["effect"]).partition(":")[0] for item in last.get("laws", ())]
        names = laws + [str(element["file"]) for element in last.get("curves", ())]
    written = write_all(folder, files)
    used = {effect.file.resolve() for effect in d.fit.mechanism.effects if effect.file}
    for path in (
        folder / name for name in names if name not in files and OWN_JOINT.fullmatch(name)
    ):
        if path.resolve() not in used:
            path.unlink(missing_ok=True)
    return written


def diagnosis_files(d: Diagnosis) -> dict[str, bytes]:
    """Return diagnosis.json, and a file for each curve and law."""
    files = {"diagnosis.json": json_bytes(diagnosis_json(d))}
    files |= {law.file: law.code.encode() for law in d.laws}
    return files | {curve.file: curve.csv.encode() for curve in d.curves}


def _noise(d: Diagnosis, joint: str) -> float | None:
    """Return what noise alone would leave of a joint, as a share of its torque."""
    return Bar(joint, errors_of(d.fit)[joint], noise=d.floor[joint]).sizes[2]


def _where(d: Diagnosis, failure: Failure) -> dict[str, Any]:
    """Return the failure of a joint with its held-out error, before and after, as in the text."""
    joint, after = failure.joint, (errors_with_named(d) or d.after)[failure.joint]
    error = errors_of(d.fit)[joint]
    return {
        **failure.json, "rms": error.rms, "relative": error.relative,
        "floor": d.floor[joint], "noise": _noise(d, joint),
        "rms_after": after.rms, "relative_after": after.relative,
    }  # fmt: skip


@renders(Diagnosis, "json")
def diagnosis_json(d: Diagnosis) -> dict[str, Any]:
    """Return the content of diagnosis.json; what is not finite is None."""
    first, last = d.selection.first, d.selection.last
    gains = sorted(first.gains.items(), key=lambda item: -item[1][0])
    limits = {
        candidate.effect.label: first.limit_of(candidate) for candidate in first.contest.candidates
    }
    decision = {
        **asdict(d.decision),
        "quantile": max(first.chance.limits.values(), default=0.0),
        "candidates": [
            {"effect": label, "gain": gain, "quantile": limits[label], "visible": visible}
            for label, (gain, visible, _) in gains
        ],
    }
    together = [
        {
            **name_of(m.effect),
            "rise": m.gain,
            "quantile": last.chance.limit(last.regression.place(m.columns)),
            "curve": m.curve.label if m.curve else None,
            "impossible": m.impossible.label if m.impossible else None,
            "law": m.law.label if m.law else None,
        }
        for m in d.selection.members
    ]
    content: dict[str, Any] = jsonable(
        {
            "schema": SCHEMA,
            "mechanism": d.fit.mechanism.name,
            "logs": list(d.fit.motion.names),
            "effects": [name_of(effect) for effect in d.fit.mechanism.effects],
            "verdict": d.verdict,
            "decision": decision,
            "where": [_where(d, element) for element in d.where],
            "candidates": [
                {**entry_.json(), "noise": _noise(d, entry_.joint)} for entry_ in d.every
            ],
            "best": None if d.best is None else name_of(d.best),
            "group": [name_of(effect) for effect in d.group],
            "relatives": [
                {"nearest": relative.formula.terms[0].known_as, "formula": relative.formula.text}
                for relative in d.relatives
            ],
            "together": together,
            "left": [{"curve": curve.label, "gain": gain} for curve, gain in last.curves],
            "invisible": [explanation.json() for explanation in d.invisible],
            "unsupported": [explanation.json() for explanation in d.unsupported],
            "curves": [curve_json(d, explanation) for explanation in d.curves],
            "laws": [
                {**law.json(), "same_form": [one.joint for one in d.of_same_form(law)]}
                for law in d.laws
            ],
            "health": d.health.json(),
            "judged": sum(not explanation.curve for explanation in first.contest.candidates),
            "next_experiment": d.next_experiment,
            "assessment": assess_diagnosis(d).json(),
            "text": d.text,
        }
    )
    return content
