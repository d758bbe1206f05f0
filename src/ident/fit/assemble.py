"""From an estimate, whoever made it, to the noun `Fit`: errors in all sets of data, notes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ident.fit.accumulate import accumulate
from ident.fit.binding import Binding
from ident.fit.caveats import share_at_rest, warnings_of
from ident.fit.estimate import Estimate
from ident.fit.fit import Fit
from ident.fit.noisy import Likelihood
from ident.fit.regression import Regression
from ident.fit.sanity import absurdities
from ident.fit.score import held_out, squares
from ident.fit.values import effect_values
from ident.motion import Motion
from ident.progress import Progress
from ident.residual.error import Error, Squares

Refit = Callable[[Estimate], np.ndarray]  # of least squares on a part of the data: x (k,)


def assemble(
    regression: Regression,
    estimate: Estimate,
    covariance: np.ndarray,
    *,
    validate: Motion | None = None,
    refit: Refit | None = None,
    outside: Squares | None = None,
    binding: Binding | None = None,
    likelihood: Likelihood | None = None,
    notes: Sequence[str] = (),
    progress: Progress | None = None,
) -> Fit:
    """A fit with its errors in the data, held out and in other logs.

    Args:
        regression: the rows; effects that are not linear are taken at its point.
        estimate: with the solution x; `Estimate.at` puts another x into it.
        covariance: (n_ind, n_ind) of the base parameters.
        validate: motion of other logs, on which errors are reported.
        refit: how x follows from the least-squares estimate of nine tenths of the data, for
            held-out errors; default: as it is.
        outside: the held-out errors, if they are known already.
        binding: what the limits of a consistent fit did.
        likelihood: how torques and motion were weighed together.
        notes: to be said after all others.
        progress: called with (what is being done, share done).
    """
    r, x = regression, estimate.solution.x
    if progress:
        progress("held-out errors", 0.9)
    if outside is None:
        outside = outside_of(r, estimate, refit)
    train = r.squares(x)
    errors = train.errors(r.motion.independent, r.units)
    point = r.point.at(r.mechanism, r.columns, x)
    values = effect_values(r.columns, estimate, covariance, point)
    caveats = warnings_of(
        r.mechanism, r.motion, r.columns, estimate, r.sensible, share_at_rest(train, r.cells), point
    )
    absurd = absurdities(r.mechanism, errors, values, point.pi)
    return Fit(
        mechanism=r.mechanism,
        motion=r.motion,
        columns=r.columns,
        cells=r.cells,
        estimate=estimate,
        covariance=covariance,
        train=errors,
        held_out={} if outside is None else outside.errors(r.motion.independent, r.units),
        validation=validated(r, x, validate, progress),
        warnings=(*caveats, *notes, *absurd),
        bands=r.bands,
        left=r.left,
        point=point,
        binding=binding,
        likelihood=likelihood,
    )


def outside_of(r: Regression, estimate: Estimate, refit: Refit | None = None) -> Squares | None:
    """Errors in each stretch of time of the model fitted to all the others."""
    return held_out(r.fitting, r.cells, estimate, r.prior, r.d, refit)


def validated(
    r: Regression, x: np.ndarray, validate: Motion | None, progress: Progress | None = None
) -> dict[str, dict[str, Error]]:
    """Errors at x (k,) in other logs, by log, then joint."""
    if validate is None:
        return {}
    other = accumulate(r.mechanism, r.columns, validate, progress, r.point)
    units = [r.mechanism.joint(name).force_unit for name in validate.independent]
    found = {}
    for number, experiment in enumerate(validate.experiments):
        mine = [cell for cell in other if cell.experiment == number]
        found[experiment.name] = squares(mine, x, r.d).errors(validate.independent, units)
    return found
