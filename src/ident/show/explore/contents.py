"""Content of the page of `explore`: lists of effects, tables, charts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

from markupsafe import Markup

from ident.diagnosis import Diagnosis
from ident.diagnosis.diagnosis import Law
from ident.diagnosis.found_curves import FoundCurve
from ident.effects.formula import Formula
from ident.fit import Fit
from ident.show.card import Bar
from ident.show.charts import Chart
from ident.show.diagnosis import law_words, noise_errors
from ident.show.explore.exploration import Exploration, error_text
from ident.show.explore.predicted import PredictedGain
from ident.show.fit import value_tables
from ident.show.html import code, items, paragraph, table
from ident.show.ladder import plot_rungs
from ident.show.residual import plot_maps, plot_predictions
from ident.text import listed, some

POINTS = 1500  # of a line on the page
NAMED = 5  # rivals that are listed, the others counted
VIEWS = ("Joint", "All joints", "Ladder", "Numbers", "Verdict")
GROUPS = (
    "In the model",
    "Found in these data, of no effect's form: accept or refuse",
    "Would lower the error",
    "Would change little, or no more than chance",
    "Cannot be seen in this data",
)
UNJUDGED = (
    "Not judged yet. What is announced is a fall of error, and a falling error is no proof of a "
    "cause. `Judge it` weighs every effect against what logs without it show by chance, says what "
    "this data cannot tell apart, and offers a curve or a formula where no effect has the "
    "right form."
)


def error_rows(e: Exploration) -> list[list[str]]:
    """Return held-out errors joint by joint: as given, before the last change, now."""
    three = e.rungs[0], e.rungs[max(len(e.rungs) - 2, 0)], e.now
    joints = e.fit.motion.independent
    rows = [[j, *(error_text(rung.errors.get(j)) for rung in three)] for j in joints]
    return [["joint", "as given", "before", "now"], *rows]


def effect_rows(e: Exploration) -> list[dict[str, Any]]:
    """Return one row an effect that is announced or offered, group by group, best first in each."""
    d = e.now.diagnosis
    marks = {} if d is None else {each.label: "as likely" for each in d.rivals}
    if d is not None and d.best is not None:
        marks[d.best.label] = "judged to be missing"
    rows = [_offer(each) for each in e.offered]
    rows += [
        _effect_row(x, "in the model" if x.present else marks.get(x.label, ""))
        for x in e.candidates
    ]
    return sorted(rows, key=lambda row: GROUPS.index(row["group"]))


def _offer(x: Law | FoundCurve) -> dict[str, Any]:
    """Return the row of a law or a curve, which can be accepted or refused."""
    rivals, fall, share = "", "", 1 - math.sqrt(x.ratio) if isinstance(x, FoundCurve) else 0.0
    if isinstance(x, Law):
        bar = Bar(x.joint, x.before[x.joint], x.after[x.joint])
        fall, share = bar.words, 1 - bar.sizes[1] / (bar.sizes[0] or 1.0)
        rivals = "; ".join(each.formula.text for each in x.found.rivals[:NAMED])
        rivals = f"not told apart from {rivals}" if rivals else ""
    else:
        fall = f"{100 * share:.0f} % less"
    return {
        "label": x.effect.label, "kind": x.effect.kind, "present": False, "offered": True,
        "mark": "law" if isinstance(x, Law) else "curve", "sure": True, "fall": fall,
        "share": min(max(share, 0.0), 1.0), "about": law_words(x), "why": "", "rivals": rivals,
        "group": GROUPS[1],
    }  # fmt: skip


def _effect_row(x: PredictedGain, mark: str) -> dict[str, Any]:
    change, fall = "not linear" if x.present else "", 0.0
    if x.before is not None and x.after is not None:
        about = "" if x.effect.linear else "≈ "  # exact for what is linear in its unknowns
        change = f"{about}{Bar('', x.before, x.after).words}"
        fall = 1 - x.after.rms / max(x.before.rms, 1e-300)
    about = x.effect.equation if isinstance(x.effect, Formula) else type(x.effect).summary()
    if x.joints and (x.fall or 0.0) > 0:
        about += f"; lowers the error of {listed(x.joints)}"
    behind = (("not told apart from", x.rivals), ("explained better by", x.better))
    return {
        "label": x.label, "kind": x.effect.kind, "present": x.present, "mark": mark,
        "sure": x.sure, "fall": change, "share": min(max(fall, 0.0), 1.0), "about": about,
        "why": x.why,
        "rivals": "; ".join(f"{head} {some(names, NAMED)}" for head, names in behind if names),
        "group": GROUPS[0 if x.present else 4 if x.fall is None else 2 if x.sure else 3],
    }  # fmt: skip


def beside_verdict(found: Sequence[PredictedGain], d: Diagnosis | None) -> str:
    """Return what is to be said where no effect is judged missing, but falls are announced."""
    falling = [each for each in found if each.sure and not each.present]
    if d is None or d.verdict == "missing" or not falling:
        return ""
    best = falling[0]
    named = "nothing is missing" if d.verdict == "nothing" else "no effect explains what is left"
    change = "" if best.before is None else Bar("", best.before, best.after).words
    return (
        f"Judged: {named} that this data could show. Changes are announced all the same, first "
        f"{best.label} ({change}, of {listed(best.joints[:1])}): to be named, an "
        "effect must also do more than effects do by chance in logs without them, matter "
        "against the torque, and have values that it can have."
    )


def contents(e: Exploration, view: str, joint: str) -> list[Chart | Markup]:
    """Return the charts and HTML of one view, from above.

    Args:
        e: what has been tried.
        view: one of `VIEWS`.
        joint: an independent one, for the view of it.
    """
    if view == "Joint":
        return _joint(e, joint)
    if view == "All joints":
        return [e.fit.plot().thinned(POINTS)]
    if view == "Ladder":
        remarks = [text for a, b in pairwise(e.rungs) for text in b.risen(a)]
        noise = noise_errors(e.now.diagnosis) if e.now.diagnosis else {}
        names = [rung.name for rung in e.rungs]
        ladder = plot_rungs(names, [rung.errors for rung in e.rungs], noise)
        return [items(remarks), ladder]
    if view == "Numbers":
        return _numbers(e.fit)
    if (d := e.now.diagnosis) is None:
        return [paragraph(UNJUDGED)]
    return [paragraph(beside_verdict(e.candidates, d)), code(str(d))]


def _joint(e: Exploration, joint: str) -> list[Chart | Markup]:
    """Return torque of one joint with the last two models, and its residual against signals."""
    last = e.rungs[-2:]
    names = ("before", "now")[-len(last) :]
    predicted = {name: rung.fit.predict() for name, rung in zip(names, last, strict=True)}
    u = e.fit.motion.independent.index(joint)
    residuals = {name: rung.fit.residual for name, rung in zip(names, last, strict=True)}
    whole = plot_predictions(predicted, residuals)
    words = f"Measured and predicted torque of {joint} over time"
    torque = replace(whole, words=words, rows=whole.rows[2 * u : 2 * u + 2])
    failure = next(each for each in e.fit.residual.where if each.joint == joint)
    depends = [f"the residual of {joint} depends on {each}" for each in failure.depends_on]
    if failure.white:
        depends = [f"what is left of {joint} alone cannot be told from noise in a log this long"]
    depends = depends or [f"the residual of {joint} depends on no single signal, and is no noise"]
    remarks = items([*e.now.risen(last[0]), *depends])
    return [remarks, torque.thinned(POINTS), plot_maps({"now": e.fit.residual}, joint)]


def _numbers(fit: Fit) -> list[Chart | Markup]:
    """Return parameters ± standard error, and the notes of the fit."""
    tables = [table(rows, title) for title, rows in value_tables(fit).items()]
    notes = [paragraph("Notes:"), items(fit.warnings)] if fit.warnings else []
    return [*tables, *notes] or [paragraph("Nothing is identified by itself.")]
