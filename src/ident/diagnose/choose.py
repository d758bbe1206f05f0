"""Which effect is missing, which rivals it has, and whether that explains enough.

A candidate that closes two thirds of the gap on its joint by itself is a name. One that does not,
but does with one or two other credible ones on the same joint, is the first of them. Friction,
rotor inertia and offsets, which every machine has, may close less: others beside them are no
surprise. What else closes little is a sign of something else, and no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.diagnose.evidence import (
    CLOSES,
    COMMON,
    SURER,
    SUREST,
    TOGETHER,
    TRACE,
    Evidence,
    evidence,
    together,
    zscore,
)
from ident.diagnose.null import Null
from ident.diagnose.screen import Screen
from ident.diagnose.search import Candidate
from ident.fit.table import Table

APART = 2.0  # standard errors of paired blocks within which two candidates are rivals
SIMPLER = 1.0  # within which the one with fewer numbers is preferred
ALIKE = 0.7  # cosine of what two candidates explain, from which it is the same part
USUAL = ("viscous", "coulomb")
USUAL_LEAVES = 2.0  # times what a curve that resembles their sum leaves of the gap, at most
LITTLE = 0.02  # of the gap, which is no reason to prefer a curve
SEEN = 0.1  # share of a richer effect's columns that must be its own for the data to judge them
TOGETHER_MOST = 3  # effects of one joint that may be needed together
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
    table: Table, screen: Screen, null: Null, threshold: np.ndarray, candidates: Sequence[Candidate]
) -> Choice:
    """The choice among judged candidates; `threshold` (d,) is the largest fall of clean logs."""
    weighed = [evidence(table, screen, null, threshold, each) for each in candidates]
    weighed.sort(key=lambda each: -each.gain)
    credible = [each for each in weighed if each.credible]
    same = _Same(screen)
    for first in credible:
        best = _simplest(first, credible, same)
        partner = None
        if not best.candidate.effect.common:
            pair = _usual(table, screen, null, threshold, best, weighed)
            best, partner = pair or (best, None)
        if partner is None and not _enough(best):
            partner = _partner(table, screen, null, threshold, best, credible)
            if partner is None:
                continue
        rivals = _rivals(best, credible, same)
        return Choice(best, partner, tuple(rivals), tuple(credible), tuple(weighed))
    return Choice(None, None, (), tuple(credible), tuple(weighed))


def without_name(choice: Choice) -> Choice:
    """The same evidence, and no name for it."""
    return Choice(None, None, (), choice.credible, choice.evidence)


def _enough(found: Evidence) -> bool:
    """Whether it explains enough of the gap to be a name by itself."""
    if found.candidate.effect.common:
        least = TRACE if found.z > SUREST else COMMON if found.z > SURER else CLOSES
        return found.closure >= least
    return found.closure >= CLOSES


def _behind(a: Evidence, b: Evidence) -> float:
    """By how many standard errors of paired blocks b is better than a."""
    return zscore(b.difference - a.difference)


class _Same:
    """Whether two candidates explain the same part: cosine of X̃_a θ_a and X̃_b θ_b."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self.known: dict[int, np.ndarray] = {}

    def part(self, each: Evidence) -> np.ndarray:
        """X̃ θ (M,), of unit length."""
        if id(each) not in self.known:
            candidate = each.candidate
            x = self.screen.projected(candidate.columns @ candidate.judged.theta[:, None])[:, 0]
            self.known[id(each)] = x / max(float(np.linalg.norm(x)), 1e-300)
        return self.known[id(each)]

    def shows(self, large: Evidence, small: Evidence) -> bool:
        """Whether the data could see what one has beyond the other: ‖(I − P) C̃‖ > SEEN ‖C‖."""
        C, own = large.candidate.columns, self.screen.projected(small.candidate.columns)
        X = self.screen.projected(C / np.linalg.norm(C, axis=0))
        Q = np.linalg.qr(own)[0]
        return bool(np.linalg.norm(X - Q @ (Q.T @ X)) > SEEN * np.sqrt(X.shape[1]))

    def __call__(self, a: Evidence, b: Evidence) -> bool:
        return bool(set(a.mends) & set(b.mends)) and float(self.part(a) @ self.part(b)) > ALIKE


def _simplest(first: Evidence, credible: Sequence[Evidence], same: _Same) -> Evidence:
    """The one with fewest numbers among those as good as the first."""
    equal = [
        each for each in credible
        if each is first
        or (_behind(each, first) < _apart(each, first) and same(each, first))
        or (_nested(each, first) and _behind(each, first) < APART)
    ]  # fmt: skip
    return min(equal, key=lambda each: (_rare(each), each.candidate.parameters, -each.gain))


def _rare(each: Evidence) -> bool:
    return each.candidate.effect.rare


def _apart(each: Evidence, first: Evidence) -> float:
    """Standard errors within which one is as good as the first; more if the first is rare."""
    return APART if _rare(first) and not _rare(each) else SIMPLER


def _nested(small: Evidence, large: Evidence) -> bool:
    """Whether one is a special case of the other, at the same place."""
    a, b = small.candidate.effect, large.candidate.effect
    return a.joints == b.joints and b.kind in a.nested_in


def _rivals(best: Evidence, credible: Sequence[Evidence], same: _Same) -> list[Evidence]:
    """Those that explain the same part, as well within the error of the comparison."""
    found = []
    for each in credible:
        if each is best or _behind(each, best) >= APART or not same(each, best):
            continue
        if each.closure < 0.8 * min(best.closure, CLOSES):
            continue
        if _nested(best, each) and _behind(best, each) < SIMPLER and same.shows(each, best):
            continue  # what it has beyond the best would be seen, and is not
        found.append(each)
    return found


def _usual(
    table: Table, screen: Screen, null: Null, threshold: np.ndarray, best: Evidence,
    weighed: Sequence[Evidence],
) -> tuple[Evidence, Evidence | None] | None:  # fmt: skip
    """Viscous or Coulomb friction of the same joint, or both, if they do about as well.

    Real friction is a little curved, and while both are missing, one curve that resembles their sum
    is a better fit than either. What remains beside them can be named afterwards.
    """
    joint = best.candidate.effect.joints[:1]
    usual = [
        each for each in weighed
        if each.candidate.effect.kind in USUAL and each.candidate.effect.joints == joint
    ]  # fmt: skip
    enough = 1 - (USUAL_LEAVES * (1 - best.closure) + LITTLE)
    usual.sort(key=lambda each: (not each.credible, -each.gain))
    if not usual or not usual[0].credible:
        return None
    if usual[0].closure >= enough:
        return usual[0], None
    if len(usual) < len(USUAL):
        return None
    both = together(table, screen, null, threshold, [each.candidate for each in usual])
    return (usual[0], usual[1]) if both.closure >= enough else None


def _partner(
    table: Table, screen: Screen, null: Null, threshold: np.ndarray, best: Evidence,
    credible: Sequence[Evidence],
) -> Evidence | None:  # fmt: skip
    """The next effect on the same joint with which, and one more at most, the gap is closed."""
    others = [
        each for each in credible
        if each is not best and set(each.mends) & set(best.mends)
    ][:PARTNERS]  # fmt: skip
    group, partner = [best], None
    while others and len(group) < TOGETHER_MOST:
        tried = [
            (together(table, screen, null, threshold, [e.candidate for e in (*group, o)]), o)
            for o in others
        ]
        both, other = max(tried, key=lambda pair: pair[0].closure)
        if zscore(both.difference - np.maximum(best.difference, other.difference)) <= APART:
            return None
        partner = partner or other
        if both.closure >= TOGETHER:
            return partner
        group.append(other)
        others = [each for each in others if each is not other]
    return None
