"""Curves and formulas of a diagnosis: charts, a section of the report, and JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.diagnosis.diagnosis import Diagnosis, Law
from ident.diagnosis.found_curves import FoundCurve
from ident.show.charts import FAINT, Chart, Level, Line, Panel
from ident.show.diagnosis import curves, laws
from ident.show.html import Block, code, headed, paragraph, table

FRONT = (
    "Formulas for which no simpler one leaves as little error: complexity (operators and "
    "constants) against the share of the squared error that is left."
)


def law_blocks(d: Diagnosis) -> tuple[Block, ...]:
    """Return the curve with its band, the formula over it, the front, and the effect file."""
    blocks: list[Block] = [paragraph(each) for each in curves(d)]
    of_joint = {each.joint: each for each in d.laws}
    for curve in d.curves:
        blocks.append(plot_curve(curve, of_joint.get(curve.joint)))
    blocks += [paragraph(each) for each in laws(d)]
    for law in d.laws:
        blocks += [headed(f"Formulas for {law.joint}"), paragraph(FRONT), plot_front(law)]
        rows = [["complexity", "squared error left", "formula"]]
        rows += [[str(c), f"{100 * left:.2f} %", text] for c, left, text in law.found.front]
        blocks += [table(rows, "The front"), code(law.code)]
    return tuple(blocks)


def plot_curve(curve: FoundCurve, law: Law | None) -> Chart:
    """Draw a curve with its 95 % band, and the part of the formula that the data determine."""
    effect = curve.effect
    unit = effect.units[0]
    marks = [
        Line(curve.x, curve.lower, "95 % band", FAINT, 1.0),
        Line(curve.x, curve.upper, "", FAINT, 1.0),
        Line(curve.x, curve.torque, "curve", 1, 3.0),
    ]
    if law is not None and (y := _on_curve(curve, law)) is not None:
        marks.append(Line(curve.x, y, law.formula, 0, 1.5))
    label = f"{effect.first} of {effect.joints[-1]} [{effect.units[len(effect.unknowns)]}]"
    times = {
        "": "",
        "sign": " for positive speed",
        "v": " per unit of speed",
        "q": " per unit of position",
    }
    title = f"What is left in {curve.joint}, as a curve of {effect.signal}"
    axis = f"torque of {curve.joint}{times[effect.second]} [{unit}]"
    return Chart(title, ((Panel((Level(), *marks), label, axis, height=3.6),),))


def _on_curve(curve: FoundCurve, law: Law) -> np.ndarray | None:
    """Return the formula on a curve's signal, up to what a spline of the model can absorb.

    None where it depends on more than the curve's signals. Offset and slope, which the model's own
    parameters often make, are taken from the curve.
    """
    formula, effect = law.effect, curve.effect
    if len(formula.joints) > 1 or effect.second or formula.signals_used != {effect.first}:
        return None
    values = {v.name.rpartition(".")[2]: v.value for v in law.parameters}
    y = formula.of_signal(effect.first, curve.x, values)
    weight = 1 / np.maximum(curve.upper - curve.lower, 1e-12)
    A = np.stack([np.ones_like(curve.x), curve.x], axis=1)
    rest = np.linalg.lstsq(A * weight[:, None], (curve.torque - y) * weight, rcond=None)[0]
    return np.asarray(y + A @ rest)


def plot_front(law: Law) -> Chart:
    """Draw complexity against the squared error that is left."""
    cost, left, _ = zip(*law.found.front, strict=True)
    x, y = np.array(cost, float), 100 * np.array(left)
    chosen = Level(float(law.effect.cost), upright=True, label="chosen", dashed=True)
    panel = Panel(
        (Line(x, y, "formulas", 0, 1.4, dotted=True), chosen),
        "complexity: operators and constants",
        "squared error left [%]",
        logarithmic=True,
        height=3.6,
    )
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
        "joint": curve.joint,
        "signals": signals,
        "error_before": before,
        "error_after": None if before is None else before * float(np.sqrt(curve.ratio)),
        "explained": float(np.clip((1 - curve.ratio) / max(1 - floor, 1e-9), 0.0, 1.0)),
        "absorbable": curve.absorbable,
        "effect": effect.label,
        "depends": list(curve.depends),
        "independent": list(curve.independent),
        "file": curve.file,
    }
