"""Which logs disagree with the others, in what, and how sure that is.

Were a log like all others but for one unknown j, that unknown would differ by δ_j:

    δ_j = w_jᵀ g / h_j,   h_j = w_jᵀ H w_j,   H = Σ AᵀA / σ²,   g = Aᵀ(b − A β) / σ²
    Var δ_j = s² D_j / h_j + w_jᵀ H C H w_j / h_j²,             z_j = δ_j / √Var δ_j

β, C: base parameters of all other logs and their covariance; w_j: what j changes of them, made
orthogonal (under H) to what the other logs do not tell. s² is the noise of this log, what its own
fit leaves; D_j, how much more residuals that are correlated in time tell wrong of j than white ones
would, from the blocks of all logs in their own fits, and so is C (`fit.covariance`): a difference
between logs is in none of them. It shows in some δ_j; of m numbers, the largest |z_j| is no wonder:

    p = 1 − (1 − min_j p_j)^m,   m = (Σ √λ)² / Σ λ

with λ the eigenvalues of the z's correlation (N. W. Galwey, Genetic Epidemiology 33(7), 2009). A
log that disagrees makes the others look odd: the one that does so most is set aside, and the rest
judged again without it, until none is left or the majority would be lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate
from ident.gather.contrast import Contrast, Logs

RATE = 0.01  # of folders of logs that are alike, in which one is said to disagree
ROUNDING = 1e-6  # of the largest fall, within which two are the same
NEARLY = 0.05  # of what a log's difference explains: parts as near as that are not told apart


@dataclass(frozen=True)
class Disagreement:
    """Of one log with the majority of the others.

    Attributes:
        p_value: chance that a log like the others looks as odd as this one.
        clear: whether that is less than `RATE` over the number of logs.
        unknown: which one alone explains it best; change: by how much it differs, ± stderr, unit.
        parts: bodies and effects of which each alone explains it nearly as well as the best, that
            first; share: what the best explains of the excess of squared error.
    """

    p_value: float
    clear: bool
    unknown: str
    change: float
    stderr: float
    unit: str
    parts: tuple[str, ...]
    share: float


def disagreements(
    cells: Sequence[Cell], estimate: Estimate, columns: Columns
) -> Mapping[int, Disagreement]:
    """By number of the log (`Cell.experiment`); empty if there are not two logs that tell.

    Args:
        cells: of all logs.
        estimate: of all of them together; its weights and base are kept.
        columns: names of its unknowns.
    """
    numbers = sorted({cell.experiment for cell in cells if cell.factor.rows})
    if len(numbers) < 2 or not estimate.base.rank:
        return {}
    logs, least = Logs.of(cells, estimate, columns), RATE / len(numbers)
    agreeing = numbers
    while True:
        odd = [i for i in agreeing if logs.against(agreeing, i).p_value < least]
        if not odd or 2 * (len(agreeing) - 1) <= len(numbers):
            break
        worst = max(odd, key=lambda i: logs.fall(agreeing, i))
        agreeing = [i for i in agreeing if i != worst]
    return {i: _told(logs.against(agreeing, i), columns, least) for i in numbers}


def _told(found: Contrast, columns: Columns, least: float) -> Disagreement:
    falls = np.nan_to_num(found.falls, nan=-1.0)
    # of columns that are multiples of each other the first
    alike = falls >= (1 - ROUNDING) * falls.max(initial=0.0)
    at = int(alike.argmax()) if alike.any() else -1
    best = max(found.parts.values(), default=0.0)
    near = [name for name, share in found.parts.items() if share >= best - NEARLY]
    parts = sorted(near, key=lambda name: -found.parts[name])
    return Disagreement(
        found.p_value,
        found.p_value < least,
        columns.names[at] if at >= 0 else "",
        float(found.delta[at]) if at >= 0 else 0.0,
        float(found.stderr[at]) if at >= 0 else np.nan,
        columns.units[at] if at >= 0 else "",
        tuple(parts),
        best,
    )
