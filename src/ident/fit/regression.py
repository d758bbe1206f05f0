"""What is regressed: the rows of a motion at a working point, and what is known beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.errors import FitError
from ident.fit.accumulate import Cell, accumulate, coordinates
from ident.fit.banded import Band, banded, cells_of
from ident.fit.estimate import totals
from ident.fit.plausible import plausible
from ident.fit.score import squares
from ident.likelihood.step import Run
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Progress
from ident.residual.error import Squares
from ident.solve.factor import Factor


@dataclass(frozen=True, eq=False)
class Regression:
    """The equations of a mechanism and a motion at a point, as triangular factors.

    Attributes:
        mechanism, motion, point: what is fitted to what, and where what is not linear is evaluated.
        columns: the k unknowns.
        cells: of the d independent coordinates, in which errors count.
        bands: where the multipliers have a time basis, the paper's stack.
        runs: where the motion's noise counts, rows whitened by it.
        left: what is left of such a stack of all samples, where the motion is an excerpt of them.
    """

    mechanism: Mechanism
    motion: Motion
    point: Point
    columns: Columns
    cells: Sequence[Cell]
    bands: Sequence[Band] = ()
    runs: Sequence[Run] = ()
    left: Sequence[Cell] = ()

    @classmethod
    def of(
        cls, mechanism: Mechanism, motion: Motion, point: Point, progress: Progress | None = None
    ) -> Regression:
        """The rows, seen once and absorbed into factors."""
        columns = Columns.of(mechanism)
        cells = accumulate(mechanism, columns, motion, progress, point)
        basis = mechanism.closures and mechanism.multipliers.basis != "free"
        bands = banded(mechanism, columns, motion, progress, point) if basis else []
        if bands and not any(f.rows for band in bands for f in band.elimination.factors):
            cut = motion.band.cutoff
            raise FitError(
                f"{mechanism.name}: "
                + (f"filtered at {cut:.3g} Hz, " if cut else "")
                + "there are no more rows than coefficients of the multipliers in their time basis;"
                " give --basis free, a larger --spacing or a higher --cutoff"
            )
        return cls(mechanism, motion, point, columns, cells, tuple(bands))

    @property
    def d(self) -> int:
        """Independent coordinates."""
        return coordinates(self.mechanism, self.motion)

    @cached_property
    def prior(self) -> np.ndarray:
        """(k,) the URDF's values; 0 for effects; shapes where they are."""
        return self.columns.prior_at(self.point.values)

    @cached_property
    def factors(self) -> list[Factor]:
        """One a coordinate, of all rows on all k columns."""
        return totals(self.cells, len(self.columns), self.d)

    @cached_property
    def at_rest(self) -> list[Factor]:
        """One a coordinate, of the rows at standstill, which count but do not inform."""
        rest = [replace(cell, triangle=cell.rest) for cell in self.cells]
        return totals(rest, len(self.columns), self.d)

    @cached_property
    def fitting(self) -> Sequence[Cell]:
        """From which parameters are estimated: the cells, or what is left of larger stacks."""
        if self.left:
            return self.left
        stacks: list[Band | Run] = [*self.bands, *self.runs]
        return cells_of(stacks, self.motion) if stacks else self.cells

    @property
    def stacked(self) -> bool:
        """Whether parameters are estimated from rows of all coordinates together."""
        return bool(self.left or self.bands or self.runs)

    @cached_property
    def torque(self) -> np.ndarray:
        """(d,) rms of the measured torque [N m | N]."""
        everything = self.squares(self.prior)
        return np.asarray(np.sqrt(everything.torque / np.maximum(everything.rows, 1)))

    @cached_property
    def sensible(self) -> np.ndarray:
        """(k,) largest plausible distance of each unknown from its prior."""
        size = np.zeros(len(self.columns))
        for factor in self.factors:
            size = size + factor.column_norms() ** 2 / max(factor.rows, 1)
        return plausible(self.mechanism, self.columns, self.torque, np.sqrt(size))

    def squares(self, x: np.ndarray) -> Squares:
        """What x (k,) leaves in all rows."""
        return squares(self.cells, x, self.d)

    @property
    def units(self) -> list[str]:
        """Of the torque of every independent coordinate."""
        return [self.mechanism.joint(name).force_unit for name in self.motion.independent]
