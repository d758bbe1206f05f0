"""Old name of `ident.fit.problem.Problem`, until all callers have moved."""

from ident.fit.problem import Problem
from ident.information.blocks import Information


class Regression(Problem):
    """The equations of a mechanism and a motion at a point."""

    def __new__(cls, mechanism, motion, point, columns, cells=(), bands=(), runs=(), left=()):  # type: ignore[no-untyped-def] # noqa: D102
        k, d = len(columns), 1 + max(cell.coordinate for cell in cells)
        stacked = Information.of(left, k, 1) if left else None
        information = Information.of(cells, k, d)
        return Problem(mechanism, motion, point, columns, information, bands, runs, stacked)
