"""The verb `identify`: mechanism and motion become a fit."""

from __future__ import annotations

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.errors import FitError
from ident.fit.accumulate import accumulate, coordinates
from ident.fit.banded import Band, banded, cells_of
from ident.fit.caveats import basis_bias, share_at_rest, warnings_of
from ident.fit.covariance import covariance
from ident.fit.descend import beyond
from ident.fit.estimate import estimate, totals
from ident.fit.fit import Fit
from ident.fit.plausible import plausible
from ident.fit.sanity import absurdities
from ident.fit.score import held_out, squares
from ident.fit.settle import settled
from ident.fit.values import effect_values
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Told


def identify(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    start: Point | None = None,
    progress: Told | None = None,
) -> Fit:
    """Dynamic parameters, effects and multipliers by one least-squares solve.

    Args:
        mechanism: with what is unknown and which effects it has.
        motion: from `complete`.
        validate: motion of other logs, on which errors are reported and nothing is fitted.
        start: a working point from which shape parameters are searched; default: a coarse search.
        progress: called with (what is being done, share done).

    Returns:
        The fit; `print(fit)` is its summary. Of a mechanism in which nothing is unknown, the errors
        of the model as it is.

    Raises:
        FitError: if it is given no motion, or there are no equations to identify with.
    """
    columns = Columns.of(mechanism)
    if not isinstance(motion, Motion):
        raise FitError(
            f"identify needs a motion, given: {type(motion).__name__}; write "
            "ident.identify(mechanism, ident.complete(mechanism, log))"
        )
    d = coordinates(mechanism, motion)
    units = [mechanism.joint(name).force_unit for name in motion.independent]
    point = settled(mechanism, motion, start, progress)
    prior = columns.prior_at(point.values)
    cells = accumulate(mechanism, columns, motion, progress, point)
    everything = squares(cells, prior, d)
    torque = np.sqrt(everything.torque / np.maximum(everything.rows, 1))
    factors = totals(cells, len(columns), d)
    size = np.sqrt(
        sum((f.column_norms() ** 2 / max(f.rows, 1) for f in factors), np.zeros(len(columns)))
    )
    sensible = plausible(mechanism, columns, torque, size)
    bands = _bands(mechanism, columns, motion, progress, point)
    said: list[str] = []
    if bands:  # the paper's stack: all rows weigh alike, and the basis' misfit is in the parameters
        basic = cells_of(bands, columns, motion)
        found = estimate(totals(basic, len(columns), 1), prior, np.ones(1), sensible)
        cov = covariance(basic, found)
        outside = held_out(basic, cells, found, prior, (1, d))
        free = estimate(factors, prior, torque, sensible)
        said = basis_bias(mechanism, columns, found, free)
    else:
        found = estimate(factors, prior, torque, sensible)
        if (out := beyond(mechanism, columns, motion, point, found)).any():
            found = estimate(
                factors, prior, torque, sensible, sigma=found.sigma, held=found.held | out
            )
        cov = covariance(cells, found)
        if progress:
            progress("held-out errors", 0.9)
        outside = held_out(cells, cells, found, prior, (d, d))
    validation = {}
    if validate is not None:
        other = accumulate(mechanism, columns, validate, progress, point)
        names = validate.independent
        theirs = [mechanism.joint(name).force_unit for name in names]
        for number, experiment in enumerate(validate.experiments):
            mine = [cell for cell in other if cell.experiment == number]
            validation[experiment.name] = squares(mine, found.solution.x, d).errors(names, theirs)
    train = squares(cells, found.solution.x, d)
    errors = train.errors(motion.independent, units)
    point = point.at(mechanism, columns, found.solution.x)
    values = effect_values(columns, found, cov, point)
    said += absurdities(mechanism, errors, values, point.pi)
    return Fit(
        mechanism=mechanism,
        motion=motion,
        columns=columns,
        cells=cells,
        estimate=found,
        covariance=cov,
        train=errors,
        held_out={} if outside is None else outside.errors(motion.independent, units),
        validation=validation,
        warnings=(
            *warnings_of(
                mechanism, motion, columns, found, sensible, share_at_rest(train, cells), point
            ),
            *said,
        ),
        bands=bands,
        point=point,
    )


def _bands(
    mechanism: Mechanism, columns: Columns, motion: Motion, progress: Told | None, point: Point
) -> list[Band]:
    if not mechanism.closures or mechanism.multipliers.basis == "free":
        return []
    return banded(mechanism, columns, motion, progress, point)
