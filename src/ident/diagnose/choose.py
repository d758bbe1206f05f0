"""Which effect is missing, which rivals it has, and whether that explains enough.

A candidate that closes half of the gap on its joint by itself is a name. One that does not, but
does with another credible one on the same joint, is the first of two. What closes less is a sign of
something else, and no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.diagnose.evidence import CLOSES, TOGETHER, Evidence, evidence, together, zscore
from ident.diagnose.null import Null
from ident.diagnose.screen import Screen
from ident.diagnose.search import Candidate
from ident.fit.table import Table

APART = 2.0  # standard errors of paired blocks within which two candidates are rivals
SIMPLER = 1.0  # within which the one with fewer numbers is preferred
PARTNERS = 6  # credible candidates of a joint that are tried together


@dataclass(frozen=True, eq=False)
class Choice:
    """Of all candidates.

    Attributes:
        best: the name, if there is one; partner: without which it would not close the gap.
        rivals: that this data cannot tell from the best.
        credible: all that are there at all, best first.
        evidence: of every candidate, in order of held-out gain.
    """

    best: Evidence | None
    partner: Evidence | None
    rivals: tuple[Evidence, ...]
    credible: tuple[Evidence, ...]
    evidence: tuple[Evidence, ...]


def choose(
    table: Table, screen: Screen, null: Null, threshold: float, candidates: Sequence[Candidate]
) -> Choice:
    """The choice among judged candidates; `threshold` is the largest fall of clean logs."""
    weighed = [evidence(table, screen, null, threshold, each) for each in candidates]
    weighed.sort(key=lambda each: -each.gain)
    credible = [each for each in weighed if each.credible]
    for first in credible:
        best = _simplest(first, credible)
        partner = None
        if best.closure < CLOSES:
            partner = _partner(table, screen, null, threshold, best, credible)
            if partner is None:
                continue
        rivals = _rivals(best, credible)
        return Choice(best, partner, tuple(rivals), tuple(credible), tuple(weighed))
    return Choice(None, None, (), tuple(credible), tuple(weighed))


def _behind(a: Evidence, b: Evidence) -> float:
    """By how many standard errors of paired blocks b is better than a."""
    return zscore(b.difference - a.difference)


def _simplest(first: Evidence, credible: Sequence[Evidence]) -> Evidence:
    """The one with fewest numbers among those as good as the first."""
    equal = [
        each for each in credible
        if each is first
        or (_behind(each, first) < SIMPLER and set(each.mends) & set(first.mends))
        or (_nested(each, first) and _behind(each, first) < APART)
    ]  # fmt: skip
    return min(equal, key=lambda each: (each.candidate.parameters, -each.gain))


def _nested(small: Evidence, large: Evidence) -> bool:
    """Whether one is a special case of the other, at the same place."""
    a, b = small.candidate.effect, large.candidate.effect
    return a.joints == b.joints and b.kind in a.nested_in


def _rivals(best: Evidence, credible: Sequence[Evidence]) -> list[Evidence]:
    found = []
    for each in credible:
        if each is best or _behind(each, best) >= APART:
            continue
        if each.closure < 0.8 * min(best.closure, CLOSES) or _nested(best, each):
            continue
        found.append(each)
    return found


def _partner(
    table: Table, screen: Screen, null: Null, threshold: float, best: Evidence,
    credible: Sequence[Evidence],
) -> Evidence | None:  # fmt: skip
    """A second effect on the same joint with which the first closes the gap."""
    others = [
        each for each in credible
        if each is not best and set(each.mends) & set(best.mends)
    ][:PARTNERS]  # fmt: skip
    found = []
    for other in others:
        both = together(
            table, screen, null, threshold, [best.candidate, other.candidate]
        )
        gained = zscore(both.difference - np.maximum(best.difference, other.difference))
        if both.closure >= TOGETHER and gained > APART:
            found.append((both.closure, other))
    return max(found, key=lambda pair: pair[0])[1] if found else None
