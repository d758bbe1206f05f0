"""Announcements as the page lists them: words in groups, with the numbers to draw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ident.diagnose import Diagnosis
from ident.diagnose.phrases import listed, some
from ident.explore.announce import Announced
from ident.explore.tables import share

GROUPS = (
    "In the model",
    "Would lower the error",
    "Would change little, or no more than chance",
    "Cannot be seen in this data",
)
NAMED = 5  # rivals that are listed, the others counted


def rows_of(found: Sequence[Announced], d: Diagnosis | None = None) -> list[dict[str, Any]]:
    """One row an effect, group by group, best first in each.

    Args:
        found: what is announced.
        d: of the same model, whose verdict is shown beside its effects.
    """
    named = {} if d is None or d.best is None else {d.best.label: "judged to be missing"}
    named |= {} if d is None else {each.label: "as likely" for each in d.rivals}
    rows = [_row(each, "" if each.present else named.get(each.label, "")) for each in found]
    return sorted(rows, key=lambda row: GROUPS.index(row["group"]))


def beside_verdict(found: Sequence[Announced], d: Diagnosis | None) -> str:
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


def group_of(each: Announced) -> str:
    """Where it is listed."""
    if each.present:
        return GROUPS[0]
    if each.fall is None:
        return GROUPS[3]
    return GROUPS[1] if each.sure else GROUPS[2]


def _row(each: Announced, verdict: str) -> dict[str, Any]:
    said = ""
    if each.fall is not None and each.error is not None:
        about = "" if each.effect.linear else "≈ "  # exact for what is linear in its unknowns
        said = f"{about}{share(each.fall)} ± {100 * each.error:.1f}"
    elif each.present:
        said = "not linear"
    told = (("not told apart from", each.rivals), ("explained better by", each.better))
    rivals = "; ".join(f"{words} {some(others, NAMED)}" for words, others in told if others)
    words = each.words
    if each.joints and not each.present and (each.fall or 0.0) > 0:
        words += f"; lowers the error of {listed(each.joints)}"
    return {
        "key": each.label,
        "label": each.label,
        "present": each.present,
        "mark": "in the model" if each.present else verdict,
        "sure": each.sure,
        "fall": said,
        "share": min(max(each.fall or 0.0, 0.0), 1.0),
        "words": words,
        "rivals": rivals,
        "why": each.why,
        "group": group_of(each),
        "find": " ".join([each.label, each.words, *each.joints]),
    }
