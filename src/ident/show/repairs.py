"""What is put right in a log or a mechanism's file: in words, and as lines to paste."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ident.request import Repair, Step
from ident.text import listed

FILE = "mechanism.toml"
TURNED = {"rad": (180 / math.pi, "°")}  # shown: units that are said in another one as well


def repair_words(step: Step) -> str:
    """Return what a step puts right, as sentences behind `Next:`."""
    labels = listed([*dict.fromkeys(repair.effect for repair in step.repairs)])
    what = listed([_what(repair) for repair in step.repairs])
    text = f"{what}. Put this right, then identify again without {labels}."
    return f"{text} In {FILE}, beside the URDF:" if repair_lines(step) else text


def repair_lines(step: Step) -> list[str]:
    """Return the lines to paste into mechanism.toml, with those that a new file needs."""
    repairs = step.repairs
    gravity = [f"gravity = {_vector(r.now)}" for r in repairs if r.kind == "gravity"]
    columns = [_column(r) for r in repairs if r.kind in ("offset", "scale")]
    lines = gravity + ["[log]"] * bool(columns) + columns
    file = next((repair.file for repair in repairs if repair.file), "")
    return [f'urdf = "{file}"', *lines] if lines and file else lines


def _what(repair: Repair) -> str:
    """Return what is wrong and what to do, without a number of a line."""
    number, where = repair.number, repair.where
    match repair.kind:
        case "offset":
            times, unit = TURNED.get(repair.unit, (1e3, " mm"))
            high = "little" if number > 0 else "much"
            return f"{where} reads {abs(times * number):.3g}{unit} too {high}"
        case "scale":
            return f"{where} reads {number:.3g} times the torque"
        case "delay":
            late = "late" if number > 0 else "early"
            to = "earlier" if number > 0 else "later"
            size = f"{abs(1e3 * number):.3g} ms"
            return f"{where} is {size} {late}, so shift column {repair.column} {size} {to}"
        case "gravity":
            return (
                f"the base is {math.degrees(number):.3g}° off level, so level it or write gravity"
            )
        case _:
            joint, _, axis = where.rpartition(".")
            if repair.now:
                before, after = repair.now
                return f"{joint}'s origin {axis} {before:.4g} → {after:.3f} m in the URDF"
            return f"{where} is {1e3 * number:+.3g} mm from where the drawing has it, so move it"


def _column(repair: Repair) -> str:
    """Return the entry of [log] of a column."""
    scale, offset = repair.now
    words = [f'column = "{repair.column}"']
    words += [f"scale = {scale:.4g}"] * (repair.kind == "scale")
    words += [f"scale = {scale:.8g}"] * (repair.kind == "offset" and scale != 1.0)
    words += [f"offset = {offset:.4g}"] * bool(offset)
    angle = repair.kind == "offset" and repair.unit in TURNED
    times, unit = TURNED.get(repair.unit, (1.0, ""))
    added = f"  # {times * repair.number:+.3g}{unit}" * angle
    return f'"{repair.where}" = {{ {", ".join(words)} }}{added}'


def _vector(numbers: Sequence[float]) -> str:
    return "[" + ", ".join(f"{x + 0.0:.4g}" for x in numbers) + "]"
