"""What each candidate would explain by itself, beside what the largest of them would by chance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ident.diagnosis.candidates import CandidateColumns
from ident.diagnosis.null import SURROGATES
from ident.effects import Effect
from ident.information.chance import Chance
from ident.information.hypotheses import Array, Gains, Index, PartialRegression

STARTS = 4  # of a searched shape, from which it is refined


def null_shares(regression: PartialRegression, found: Gains) -> Array:
    """Return the shares (groups, draws) of random residuals that groups of columns explain: of
    surrogates of the residual, then of draws of noise, as it is.
    """
    before = regression.null_losses.T.copy()  # (draws, d)
    before[SURROGATES:] = np.maximum(before[SURROGATES:], regression.losses.sum(axis=0))
    return regression.explained(found.null.transpose(0, 2, 1), before)


@dataclass(frozen=True, eq=False)
class Screened:
    """Gains of n candidates beside a model, each from the best of its starts.

    Attributes:
        candidates: which.
        starts: of each candidate, the best first; gain, visible, place: (n,) share g of the best
            one, visible share, coordinate.
        null: (groups, draws) shares of random residuals, of all starts; of: (groups,) candidate.
    """

    candidates: Sequence[CandidateColumns]
    starts: Sequence[Sequence[int]]
    gain: Array
    visible: Array
    place: Index
    null: Array
    of: Index

    @classmethod
    def beside(
        cls, regression: PartialRegression, candidates: Sequence[CandidateColumns]
    ) -> Screened:
        """Screen candidates, with the random residuals that the regression has."""
        found = regression.gains([group for each in candidates for group in each.groups])
        ends = np.cumsum([0, *(len(each.groups) for each in candidates)])
        every = regression.explained(found.by)
        order = (np.argsort(-every[a:b], kind="stable") for a, b in pairwise(ends))
        starts = [each[:STARTS].tolist() for each in order]
        best = [a + own[0] for a, own in zip(ends.tolist(), starts, strict=False)]
        visible = np.array([found.visible[a:b].max() for a, b in pairwise(ends)])
        place = np.array([regression.place(each.groups[0]) for each in candidates], dtype=int)
        null = null_shares(regression, found)
        of = np.repeat(np.arange(len(candidates)), np.diff(ends))
        return cls(candidates, starts, every[best], visible, place, null, of)

    def chance(self, some: Sequence[int], alpha: float) -> Chance:
        """The largest shares of some candidates, by place: of surrogates of the residual and of
        draws of the sensors' noise.
        """
        mine = np.isin(self.of, some)
        null, place = self.null[mine], self.place[self.of[mine]]
        largest = {int(u): null[place == u].max(axis=0) for u in np.unique(place)}
        residual, noise = (
            {u: x[draws] for u, x in largest.items()}
            for draws in (slice(SURROGATES), slice(SURROGATES, None))
        )
        return Chance(residual, noise, alpha)

    def hints(self, alpha: float) -> Iterator[tuple[Effect, float, float]]:
        """Yield by joint its best curve, the gain and the limit, where the gain is larger."""
        curves = [i for i, each in enumerate(self.candidates) if each.curve]
        for joint in dict.fromkeys(self.candidates[i].effect.joints[0] for i in curves):
            own = [i for i in curves if self.candidates[i].effect.joints[0] == joint]
            best = max(own, key=lambda i: float(self.gain[i]))
            limit = max(self.chance(own, alpha).limit(int(self.place[best])), 0.0)
            if self.gain[best] > limit:
                yield self.candidates[best].effect, float(self.gain[best]), limit
