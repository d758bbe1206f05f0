"""From a least-squares estimate to the physically consistent one, with what the limits cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.fit.assemble import outside_of
from ident.fit.binding import Binding, binding_of, impossible_known
from ident.fit.consistent import Program
from ident.fit.descend import shape_bounds
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.regression import Regression
from ident.fit.score import rise
from ident.information.cone import Point
from ident.mechanism.parameters import Consistency
from ident.progress import Progress
from ident.residual.error import Squares

PASSES = 6  # over what the equations are not linear in
SETTLED = 1e-6  # of a plausible size: a smaller change of any unknown is the last


@dataclass(frozen=True, eq=False)
class Constrained:
    """A consistent estimate.

    Attributes:
        regression: at the point where it was found; estimate: with the consistent x.
        free: without limits, at the same point.
        outside: held-out errors, each stretch of time predicted by a consistent fit to the others.
        binding: which limits hold it back, and what they cost.
    """

    regression: Regression
    estimate: Estimate
    free: Estimate
    outside: Squares | None
    binding: Binding

    @property
    def notes(self) -> list[str]:
        """What to say of it."""
        return [*impossible_known(self.regression.mechanism), *self.binding.notes()]


def constrained(
    r: Regression, found: Estimate, asked: Consistency, progress: Progress | None = None
) -> Constrained:
    """The consistent estimate that is nearest to the data; weights are those of `found`.

    Raises:
        FitError: for limits that contradict each other, or a solution that does not hold.
    """
    if progress:
        progress("physical consistency", 0.8)
    unlimited = r.squares(found.solution.x)
    before = outside_of(r, found)
    shapes = shape_bounds(r.mechanism, r.columns, r.motion, r.point)
    program = Program.of(r, asked, shapes, found.solution.x)
    r, found, program, point = _settled(r, found, program)
    outside = outside_of(r, found, lambda other: program.solve(other).x)
    pi = r.columns.dynamic_parameters(r.mechanism, point.x)
    after = r.squares(point.x)
    worse = None if outside is None or before is None else rise(outside, before)
    binding = binding_of(r.mechanism, asked, program, point, pi, rise(after, unlimited), worse)
    return Constrained(r, found.at(point.x), found, outside, binding)


def _settled(
    r: Regression, found: Estimate, program: Program
) -> tuple[Regression, Estimate, Program, Point]:
    """The solution; where columns depend on it, the rows are made anew there until it rests.

    Rows in which the motion has moved stay as they are.
    """
    point = program.solve(found)
    nonlinear = any(not effect.linear for effect in r.mechanism.effects)
    for _ in range(PASSES if nonlinear and not r.runs else 0):
        there = Regression.of(r.mechanism, r.motion, r.point.at(r.mechanism, r.columns, point.x))
        factors = totals(there.fitting, len(r.columns), len(found.sigma))
        again = estimate(factors, there.prior, there.torque, sigma=found.sigma, held=found.held)
        r, found, program, before = there, again, program.at(there.prior), point
        point = program.solve(found)
        if np.abs((point.x - before.x) / r.sensible).max(initial=0.0) < SETTLED:
            break
    return r, found, program, point
