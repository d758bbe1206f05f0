"""Halves of a log, which decide whether what is left belongs to the motion.

Of all candidates that which lowers the left-out errors of one half most is held against the other
half, which had no say in the choice: no chance of a best one among many is to be taken off there.
Noise, of whatever colour, is lowered in neither half by what was chosen in the other.
"""

from __future__ import annotations

import numpy as np

from ident.diagnosis.candidates import Contest
from ident.information.evidence import RIVAL, zscore


def determined_by_motion(contest: Contest) -> bool:
    """Return whether the candidate, curves among them, that is best in either half of the log's
    blocks lowers the left-out squares of the other half too, by RIVAL standard errors in both.
    """
    regression = contest.regression.bare
    groups = [group for candidate in contest.candidates for group in candidate.groups]
    if not groups or regression.blocks < 2 * 2:
        return False
    D = regression.gains(groups).D
    first, second = np.array_split(np.arange(regression.blocks), 2)
    return all(
        zscore(D[int(D[:, chosen].sum(axis=1).argmax()), other]) > RIVAL
        for chosen, other in ((first, second), (second, first))
    )
