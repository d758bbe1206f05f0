"""Laws as words, charts and JSON: curves and formulas of a diagnosis, the library of effects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.assess.verdict import formulas_explain
from ident.diagnosis.found_curves import FoundCurve
from ident.diagnosis.result import Diagnosis, Law
from ident.effects import KINDS, Effect, Unknown
from ident.fit.values import Value
from ident.request import PYTHON, Request
from ident.show.body import body_words
from ident.show.charts import FAINT, Chart, Level, Line, Panel
from ident.show.html import Block, code, headed, paragraph, table
from ident.text import listed, percent, rounded, shortlist, wrapped

FRONT = (
    "Formulas for which no simpler one leaves as little error: complexity (operators and "
    "constants) against the share of the squared error that is left."
)
DIFFERENT = 0.005  # share of a law's torque from which a relative is called different
NONE = (
    "No short formula of positions, speeds, accelerations, load and time explains it either; look "
    "at the maps of the residual, and at what the log does not hold: temperature, contact, play, "
    "cables, another load."
)
MOST_RIVALS = 3  # rivals that are named
CLEARLY = 0.8  # times the error with a formula: a curve that leaves less shows that it is not all


# --- words ----------------------------------------------------------------------------------------


def numbers(parameters: Sequence[Value]) -> str:
    """Return `Fc = 0.312 ± 0.004 N m`, of several values the first ones, of a body its mass and
    centre; a value that is smaller than its error is one that the data do not determine.
    """
    if body := body_words(parameters):
        return body
    texts = []
    for v in parameters:
        name, number = v.name.rpartition(".")[2], rounded(v.value, v.stderr)
        unknown = v.stderr is not None and abs(v.value) < v.stderr
        value = f"{name} = {number} {v.unit}".removesuffix(" 1")
        texts.append(value + " (not determined)" * unknown)
    return shortlist(texts)


def curve_name(curve: Effect) -> str:
    """Return `curve of v at elbow`."""
    return f"curve of {curve.signal} at {listed(curve.joints)}"


def law_words(form: Law | FoundCurve) -> str:
    """Return what a law or a curve is: constants and relative, or how much it explains."""
    if isinstance(form, FoundCurve):
        signals = {*form.effect.depends_on, *(f"q.{name}" for name in form.effect.joints[1:])}
        more = [n for n in form.depends if n not in signals]
        also = f"It depends on {listed(sorted(signals))}"
        also += f", and beside the curve on {listed(more)}" if more else ""
        also += f"; not on {listed(form.independent)}" if form.independent else ""
        return (
            f"a {curve_name(form.effect)} explains {100 * (1 - form.ratio):.0f} % of the squared "
            f"error there; {100 * form.absorbable:.0f} % of its torque is such as the model's own "
            f"parameters can make. {also}"
        )
    law = form.found
    close = f"closest known law: {law.nearest.replace('_', ' ')}" if law.nearest else ""
    close += f" ({100 * law.distance:.0f} % different)" if law.distance > DIFFERENT else ""
    kind = KINDS.get(law.nearest)
    if kind and kind.unknowns[0].nonnegative and form.parameters[0].value < 0:
        close += ", which cannot have this sign"
    return (
        f"torque of {form.joint} = {form.formula}, with {numbers(form.parameters)} "
        f"({close or 'no known relative'})"
    )


def curves(d: Diagnosis) -> list[str]:
    """Return the curves that explain what no effect does, and on which signals they depend."""
    return [
        f"A{law_words(curve)[1:]}. In the model: `--with "
        f"{curve.effect.label}:pieces={curve.effect.pieces}`."
        for curve in d.curves
    ]


def laws(d: Diagnosis, request: Request = PYTHON) -> list[str]:
    """Return the formulas for what no effect explains, with constants, relatives and rivals."""
    paragraphs, does = [], "explains it" if formulas_explain(d) else "lowers the error"
    for law in d.laws:
        formula = law.found
        before, after = (errors[law.felt].relative for errors in (law.before, law.after))
        given = f" with {listed(e.label for e in law.beside)} beside it" if law.beside else ""
        falls = (after or 0.0) < (before or 0.0)
        way = f"{'falls' if falls else 'rises'} from {percent(before)} to {percent(after)}"
        share = f"; {100 * formula.explained:.0f} % of what exceeds the noise away from reversals"
        share *= falls
        error = f"{given} the error of {law.felt} {way}{share}"
        rivals = [f"`{one.formula.text}`" for one in formula.rivals]
        or_ = (
            f" This motion cannot tell it from {listed(rivals[:MOST_RIVALS], 'or')}."
            if rivals
            else ""
        )
        instead = f" It takes the place of {listed(formula.replaced)}." if formula.replaced else ""
        head = f"A formula {does}:" if d.best is None else "A formula explains more:"
        head = head if law.beside or d.best is None else "A formula could stand in its place:"
        curve, not_all = next((x for x in d.curves if x.joint == law.joint), None), ""
        rest = (before or 0.0) * math.sqrt(curve.ratio) if curve and d.best is None else math.inf
        if curve and rest < CLEARLY * (after or 0.0):
            not_all = (
                f" The {curve_name(curve.effect)} leaves {percent(rest)}, so the formula is not "
                f"all of it: `--with {curve.effect.label}:pieces={curve.effect.pieces}`."
            )
        same = [other.joint for other in d.of_same_form(law)]
        one = f" {listed(same)} has the same form, with constants of its own." if same else ""
        paragraphs.append(
            f"{head} {law_words(law)};{error}.{not_all}{or_}{one}{instead} "
            f"It is a description, not yet a cause. `--out DIR` writes it as {law.file}: `--with "
            f"{request.folder or 'DIR'}/{law.option} --allow-code`."
        )
    return paragraphs


# --- charts, report, JSON ----------------------------------------------------------------------


def law_blocks(d: Diagnosis, request: Request = PYTHON) -> list[Block]:
    """Return the curve with its band, the formula over it, the front, and the effect file."""
    blocks: list[Block] = [paragraph(item) for item in curves(d)]
    of_joint = {item.joint: item for item in d.laws}
    for curve in d.curves:
        blocks.append(plot_curve(curve, of_joint.get(curve.joint)))
    blocks += [paragraph(item) for item in laws(d, request)]
    for law in d.laws:
        blocks += [headed(f"Formulas for {law.joint}"), paragraph(FRONT), plot_front(law)]
        rows = [["complexity", "squared error left", "formula"]]
        rows += [[str(c), f"{100 * share:.2f} %", text] for c, share, text in law.found.front]
        blocks += [table(rows, "The front"), code(law.code)]
    return blocks


def plot_curve(curve: FoundCurve, law: Law | None) -> Chart:
    """Draw a curve with its 95 % band, and the part of the formula that the data determine."""
    effect = curve.effect
    marks = [
        Line(curve.x, curve.lower, "95 % band", FAINT, 1.0),
        Line(curve.x, curve.upper, "", FAINT, 1.0),
        Line(curve.x, curve.torque, "curve", 1, 3.0),
    ]
    if law is not None and (y := curve.torque_of_formula(law.effect, law.parameters)) is not None:
        marks.append(Line(curve.x, y, law.formula, 0, 1.5))
    label = f"{effect.first} of {effect.joints[-1]} [{effect.units[len(effect.unknowns)]}]"
    units = {"v": "speed", "q": "position", "load": "load"}
    of = f" per unit of {units[effect.second]}" if effect.second in units else ""
    of = " for positive speed" if effect.second == "sign" else of
    title = f"What is left in {curve.joint}, as a curve of {effect.signal}"
    axis = f"torque of {curve.joint}{of} [{effect.units[0]}]"
    return Chart(title, ((Panel((Level(), *marks), label, axis, height=3.6),),))


def plot_front(law: Law) -> Chart:
    """Draw complexity against the squared error that is left."""
    cost, share, _ = zip(*law.found.front, strict=True)
    front = Line(np.array(cost, float), 100 * np.array(share), "formulas", 0, 1.4, dotted=True)
    chosen = Level(float(law.effect.cost), upright=True, label="chosen", dashed=True)
    axes = "complexity: operators and constants", "squared error left [%]"
    panel = Panel((front, chosen), *axes, logarithmic=True, height=3.6)
    return Chart(f"Formulas for {law.joint}: complexity against error", ((panel,),), width=6.5)


def curve_json(d: Diagnosis, curve: FoundCurve) -> dict[str, Any]:
    """Return the entry of diagnosis.json; errors are relative, of its joint."""
    error = (d.fit.held_out or d.fit.train).get(curve.joint)
    before = None if error is None else error.relative
    effect, other = curve.effect, curve.effect.joints[-1]
    signals = [
        f"{name}.{curve.joint}" if name != "t" else name for name in sorted(effect.depends_on)
    ]
    signals += [f"q.{other}"] if effect.arity > 1 else []
    floor = 0.0 if error is None else (d.floor.get(curve.joint, 0.0) / max(error.rms, 1e-300)) ** 2
    return {
        "joint": curve.joint, "signals": signals, "error_before": before,
        "error_after": None if before is None else before * float(np.sqrt(curve.ratio)),
        "explained": float(np.clip((1 - curve.ratio) / max(1 - floor, 1e-9), 0.0, 1.0)),
        "absorbable": curve.absorbable, "effect": effect.label, "depends": list(curve.depends),
        "independent": list(curve.independent), "file": curve.file,
    }  # fmt: skip


SITS = {
    "joint": "any joint, a closure's own as well",
    "driven": "a driven joint",
    "mechanism": "the whole mechanism",
    "link": "a moving link",
    "closure": "a closure",
    "frame": "a link that moves, fixed to another one or not",
    "place": "<joint>.<x|y|z>, <closure>.<a|b>.<x|y|z> or <closure>.length",
}
INDENT = 17


def facts(kind: type[Effect]) -> dict[str, list[str]]:
    """Return the description of a kind, lines by heading, without headings that have none."""
    effect = kind.example()
    how = {True: "a few values are tried", False: "from several starting values"}
    shapes = [f"{_parameter(x)}; searched: {how[x.discrete]}" for x in effect.shapes]
    lines = {
        "what": [kind.summary()],
        "torque": [kind.equation],
        "unknowns": [_parameter(unknown) for unknown in effect.unknowns],
        "shapes": shapes,
        "settings": [f"{name} = {value:g} by default" for name, value in kind.settings.items()],
        "sits on": [SITS[kind.sits] if effect.arity < 2 else f"{effect.arity} driven joints"],
        "signals": [", ".join(kind.signals)] if kind.signals else [],
        "needs": [f"{signal} at the same joint" for signal in kind.needs]
        + [f"the log's column {name.replace('joint1', '<joint>')}" for name in effect.reads()],
        "when missing": [kind.signature],
        "confused with": [", ".join(kind.confused_with) or "nothing"],
        "contained in": [", ".join(kind.nested_in)] if kind.nested_in else [],
        "source": [kind.source],
    }
    return {heading: signal for heading, signal in lines.items() if signal}


def described(kind: type[Effect]) -> str:
    """Return the text of a kind for a terminal."""
    lines = [kind.example().call]
    for heading, texts in facts(kind).items():
        first = f"  {heading:<{INDENT - 2}}"
        lines += [part for x in texts for part in wrapped(first + x, " " * INDENT)]
    return "\n".join(lines)


def _parameter(parameter: Unknown) -> str:
    rotational, linear = parameter.units
    unit = rotational if rotational == linear else f"{rotational} | {linear}"
    sign = ", not negative" if parameter.nonnegative else ""
    return f"{parameter.name} [{unit}] {parameter.meaning}{sign}"
