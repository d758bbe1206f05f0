"""Old names of `ident.information.covariance`."""

from collections.abc import Iterable

import numpy as np

from ident.information import covariance as _now
from ident.information.blocks import Block, Information
from ident.information.covariance import FEWEST_SQUARES, long_run
from ident.information.estimate import Estimate

__all__ = ["FEWEST_SQUARES", "covariance", "long_run", "scores"]


def _of(cells: Iterable[Block], estimate: Estimate) -> Information:
    return Information.of(cells, len(estimate.solution.x), len(estimate.sigma))


def covariance(cells: Iterable[Block], estimate: Estimate) -> np.ndarray:
    """Return the covariance of the base parameters."""
    return _now.covariance(_of(cells, estimate), estimate)


def scores(
    cells: Iterable[Block], estimate: Estimate, norm: np.ndarray
) -> tuple[list[tuple[int, int]], np.ndarray, np.ndarray, np.ndarray]:
    """Return times, H_b, g_b and the covariance of white residuals."""
    return _now.scores(_of(cells, estimate), estimate, norm)
