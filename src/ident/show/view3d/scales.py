"""One scale for all films of a view: how long a newton is, and how bright a residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.show.view3d.stage import Film

LONGEST = 0.4  # of the mechanism's size, for the largest reaction
ROUNDING = 1e-9  # a share of the other kind of load below which one is rounding
COLD = 1e-3  # share of the residual below which no joint is to glow
ROBUST = 99.0  # percentile of residuals that gets the last colour


@dataclass(frozen=True)
class Scales:
    """What stands for what; 0 where there is nothing to show.

    Attributes:
        force: largest force [N]; moment: largest moment [N m]; both are drawn `length` [m] long.
        misfit: share of the residual that gets the last colour.
        unit: of the misfit, in words.
        gap: largest |Φ| of all films [m | rad].
    """

    force: float
    moment: float
    length: float
    misfit: float
    unit: str
    gap: float


def scales(films: Sequence[Film], size: float) -> Scales:
    """The scales that make the largest of all films legible, for a mechanism of `size` [m]."""
    loads = [film.loads for film in films if film.loads is not None]
    misfits = [film.misfit[np.isfinite(film.misfit)] for film in films if film.misfit is not None]
    shares = np.concatenate(misfits) if misfits else np.empty(0)
    force = max((_largest(each.force) for each in loads), default=0.0)
    moment = max((_largest(each.moment) for each in loads), default=0.0)
    return Scales(
        force=force if force * size > ROUNDING * moment else 0.0,
        moment=moment if moment > ROUNDING * force * size else 0.0,
        length=LONGEST * size,
        misfit=max(float(np.percentile(shares, ROBUST)), COLD) if len(shares) else 0.0,
        unit=next((film.unit for film in films if film.unit), ""),
        gap=max(float(film.gap.max(initial=0.0)) for film in films),
    )


def _largest(vectors: np.ndarray) -> float:
    lengths = np.linalg.norm(vectors, axis=-1)
    return float(lengths[np.isfinite(lengths)].max(initial=0.0))
