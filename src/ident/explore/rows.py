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
    if each.joints and not each.present:
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
