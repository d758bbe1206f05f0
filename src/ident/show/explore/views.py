"""Content of the page: tables, lists of effects, charts and texts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

from markupsafe import Markup

from ident.diagnosis import Diagnosis
from ident.fit import Fit
from ident.show.charts import Chart
from ident.show.diagnosis import listed, some
from ident.show.diagnosis_report import plot_rungs
from ident.show.explore.exploration import Exploration, ModelStep, error_text, share
from ident.show.explore.predicted import PredictedGain
from ident.show.fit_pages import plot_maps, plot_predictions
from ident.show.html import code, items, paragraph, table
from ident.text import rounded


def error_rows(first: ModelStep, before: ModelStep, now: ModelStep) -> list[list[str]]:
    """Held-out errors joint by joint: as given, before the last change, now."""
    rows = [["joint", "as given", "before", "now"]]
    for joint in now.fit.motion.independent:
        errors = (rung.errors.get(joint) for rung in (first, before, now))
        rows.append([joint, *map(error_text, errors)])
    return rows


def effect_rows(fit: Fit) -> list[list[str]]:
    """The effects' parameters ± standard error; known ones say so."""
    rows = [["parameter", "value", "unit"]]
    for each in fit.effects:
        rows += [[v.name, rounded(v.value, v.stderr), v.unit] for v in each.parameters]
    shown = {row[0] for row in rows}
    for effect in fit.mechanism.effects:
        for name, parameter in zip(effect.names, effect.parameters, strict=True):
            if name not in shown and parameter.name in effect.values:
                unit = effect.units[effect.names.index(name)]
                rows.append([name, f"{effect.values[parameter.name]:.5g} (known)", unit])
    return rows


def body_rows(fit: Fit) -> list[list[str]]:
    """Identified parameters of bodies, or combinations of them, ± standard error."""
    own = [v for v in fit.parameters if v.identifiable]
    rows = [["parameter", "value", "prior", "unit"]]
    rows += [[v.name, rounded(v.value, v.stderr), f"{v.prior:.5g}", v.unit] for v in own]
    return rows


GROUPS = (
    "In the model",
    "Would lower the error",
    "Would change little, or no more than chance",
    "Cannot be seen in this data",
)
NAMED = 5  # rivals that are listed, the others counted


def effect_list(found: Sequence[PredictedGain], d: Diagnosis | None = None) -> list[dict[str, Any]]:
    """One row an effect, group by group, best first in each.

    Args:
        found: what is announced.
        d: of the same model, whose verdict is shown beside its effects.
    """
    named = {} if d is None or d.best is None else {d.best.label: "judged to be missing"}
    named |= {} if d is None else {each.label: "as likely" for each in d.rivals}
    rows = [_row(each, "" if each.present else named.get(each.label, "")) for each in found]
    return sorted(rows, key=lambda row: GROUPS.index(row["group"]))


def beside_verdict(found: Sequence[PredictedGain], d: Diagnosis | None) -> str:
    """What is to be said where no effect is judged to be missing, but falls are announced."""
    falling = [each for each in found if each.sure and not each.present]
    if d is None or d.verdict == "missing" or not falling:
        return ""
    best = max(falling, key=lambda each: each.fall or 0.0)
    named = "nothing is missing" if d.verdict == "nothing" else "no effect explains what is left"
    return (
        f"Judged: {named} that this data could show. Falls are announced all the same, "
        f"{best.label} {share(best.fall)} ± {100 * (best.error or 0.0):.1f} the largest: a fall is "
        "a share of what is left, however little that is. To be named, an effect must also do "
        "more than effects do by chance in logs without them, matter against the torque, and have "
        "values that it can have."
    )


def _row(each: PredictedGain, verdict: str) -> dict[str, Any]:
    fall = "not linear" if each.present else ""
    if each.fall is not None and each.error is not None:
        about = "" if each.effect.linear else "≈ "  # exact for what is linear in its unknowns
        fall = f"{about}{share(each.fall)} ± {100 * each.error:.1f}"
    behind = (("not told apart from", each.rivals), ("explained better by", each.better))
    words = what = type(each.effect).summary()
    if each.joints and not each.present and (each.fall or 0.0) > 0:
        words += f"; lowers the error of {listed(each.joints)}"
    seen = 3 if each.fall is None else 1 if each.sure else 2
    return {
        "key": each.label,
        "label": each.label,
        "present": each.present,
        "mark": "in the model" if each.present else verdict,
        "sure": each.sure,
        "fall": fall,
        "share": min(max(each.fall or 0.0, 0.0), 1.0),
        "words": words,
        "rivals": "; ".join(f"{head} {some(names, NAMED)}" for head, names in behind if names),
        "why": each.why,
        "group": GROUPS[0 if each.present else seen],
        "find": " ".join([each.label, what, *each.joints]),
    }


POINTS = 1500  # of a line on the page
VIEWS = ("Joint", "All joints", "Ladder", "Numbers", "Verdict")
UNJUDGED = (
    "Not judged yet. What is announced is a fall of error, and a falling error is no proof of a "
    "cause. `Judge it` weighs every effect against what logs without it show by chance, and says "
    "what this data cannot tell apart."
)


def contents(e: Exploration, view: str, joint: str) -> list[Chart | Markup]:
    """Return the charts and HTML of one view, from above; the work is done here, off the page.

    Args:
        e: what has been tried.
        view: one of `VIEWS`.
        joint: an independent one, for the view of it.
    """
    before = e.rungs[-2] if len(e.rungs) > 1 else e.now
    if view == "Joint":
        return [
            items([*e.now.risen(before), *depends(e.now, joint)]),
            *plot_joint(before, e.now, joint),
        ]
    if view == "All joints":
        return [e.now.fit.plot().thinned(POINTS)]
    if view == "Ladder":
        remarks = [text for a, b in pairwise(e.rungs) for text in b.risen(a)]
        ladder = plot_rungs([rung.name for rung in e.rungs], [rung.errors for rung in e.rungs])
        return [items(remarks), ladder]
    if view == "Numbers":
        return numbers(e.fit)
    if (d := e.now.diagnosis) is None:
        return [paragraph(UNJUDGED)]
    beside = beside_verdict(e.candidates, d)
    return [*([paragraph(beside)] if beside else []), code(str(d))]


def plot_joint(before: ModelStep, now: ModelStep, joint: str) -> list[Chart]:
    """Return torque of one joint with the last two models, and its residual against signals."""
    rungs = {"now": now} if before is now else {"before": before, "now": now}
    predicted = {name: rung.fit.predict() for name, rung in rungs.items()}
    joints = now.fit.motion.independent
    unit = now.fit.mechanism.joint(joint).force_unit
    whole = plot_predictions(predicted, [unit] * len(joints), 0)
    u = joints.index(joint)
    torque = replace(
        whole,
        words=f"Measured and predicted torque of {joint} over time",
        rows=whole.rows[2 * u : 2 * u + 2],
    )
    return [torque.thinned(POINTS), plot_maps({"now": now.fit.residual}, joint)]


def depends(rung: ModelStep, joint: str) -> list[str]:
    """Return on which signals a joint's residual depends, in words."""
    failure = next(each for each in rung.fit.residual.where if each.joint == joint)
    if failure.white:
        return [f"what is left of {joint} alone cannot be told from noise in a log of this length"]
    found = [f"the residual of {joint} depends on {each}" for each in failure.depends_on]
    return found or [f"the residual of {joint} depends on no single signal, and is no noise"]


def numbers(fit: Fit) -> list[Chart | Markup]:
    """Return parameters ± standard error, and the notes of the fit."""
    parts: list[Chart | Markup] = []
    if fit.mechanism.effects:
        parts.append(table(effect_rows(fit), "Effects"))
    rows = body_rows(fit)
    if len(rows) > 1:
        parts.append(table(rows, "Identified parameters of bodies"))
    if fit.warnings:
        parts += [paragraph("Notes:"), items(fit.warnings)]
    return parts or [paragraph("Nothing is identified by itself.")]
