"""The verb `identify`: mechanism and motion become a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.equations.columns import Columns
from ident.errors import FitError
from ident.fit.accumulate import accumulate, coordinates
from ident.fit.banded import Band, banded, cells_of
from ident.fit.covariance import covariance
from ident.fit.estimate import Estimate, estimate, loads, totals
from ident.fit.fit import Fit
from ident.fit.naming import absorbed_by
from ident.fit.plausible import plausible
from ident.fit.predict import identifiable_multipliers
from ident.fit.score import Squares, held_out, squares
from ident.fit.values import rigid_values
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Told

BIASED = 1e-4  # share of a parameter that a time basis may move unmentioned
POOR = 1e3  # condition number above which the motion excites some base parameter poorly


def identify(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    progress: Told | None = None,
) -> Fit:
    """Dynamic parameters, effects and multipliers by one least-squares solve.

    Args:
        mechanism: with what is unknown and which effects it has.
        motion: from `complete`.
        validate: motion of other logs, on which errors are reported and nothing is fitted.
        progress: called with (what is being done, share done).

    Returns:
        The fit; `print(fit)` is its summary.

    Raises:
        FitError: if there is nothing to identify, or no equations to do it with.
    """
    columns = Columns.of(mechanism)
    if not len(columns):
        raise FitError(
            f"{mechanism.name}: nothing is unknown; give [parameters] unknown in mechanism.toml or "
            "add an effect"
        )
    d = coordinates(mechanism, motion)
    joints = [mechanism.joint(name) for name in motion.independent]
    units = [joint.force_unit for joint in joints]
    cells = accumulate(mechanism, columns, motion, progress)
    everything = squares(cells, columns.prior, d)
    torque = np.sqrt(everything.torque / np.maximum(everything.rows, 1))
    factors = totals(cells, len(columns), d)
    scale = loads(factors, columns.prior, torque)
    sensible = plausible(mechanism, columns, torque)
    bands = _bands(mechanism, columns, motion, progress)
    said: list[str] = []
    if bands:  # the paper's stack: all rows weigh alike, and the basis' misfit is in the parameters
        basic = cells_of(bands, columns, motion)
        found = estimate(totals(basic, len(columns), 1), columns.prior, np.ones(1), sensible)
        cov = covariance(basic, found)
        outside = held_out(basic, cells, found, columns.prior, (1, d))
        free = estimate(factors, columns.prior, scale, sensible)
        said = _basis_bias(mechanism, columns, found, free)
    else:
        found = estimate(factors, columns.prior, scale, sensible)
        cov = covariance(cells, found)
        if progress:
            progress("held-out errors", 0.9)
        outside = held_out(cells, cells, found, columns.prior, (d, d))
    validation = {}
    if validate is not None:
        other = accumulate(mechanism, columns, validate, progress)
        for number, experiment in enumerate(validate.experiments):
            mine = [cell for cell in other if cell.experiment == number]
            validation[experiment.name] = squares(mine, found.solution.x, d).errors(
                validate.independent, units
            )
    train = squares(cells, found.solution.x, d)
    return Fit(
        mechanism=mechanism,
        motion=motion,
        columns=columns,
        cells=cells,
        estimate=found,
        covariance=cov,
        train=train.errors(motion.independent, units),
        held_out={} if outside is None else outside.errors(motion.independent, units),
        validation=validation,
        warnings=(
            *_warnings(mechanism, motion, columns, found, cells_at_rest(train, cells)),
            *said,
        ),
        bands=bands,
    )


def _bands(
    mechanism: Mechanism, columns: Columns, motion: Motion, progress: Told | None
) -> list[Band]:
    if not mechanism.closures or mechanism.multipliers.basis == "free":
        return []
    return banded(mechanism, columns, motion, progress)


def _basis_bias(
    mechanism: Mechanism, columns: Columns, found: Estimate, free: Estimate
) -> list[str]:
    """What the time basis does to the parameters: its misfit of λ(t) is no noise and not in ±."""
    if not np.array_equal(found.base.independent, free.base.independent):
        return []
    cov = np.zeros((found.base.rank, found.base.rank))
    pairs = [
        (a.name, a.value, b.value)
        for a, b in zip(
            rigid_values(mechanism, columns, found, cov),
            rigid_values(mechanism, columns, free, cov),
            strict=True,
        )
        if a.identifiable
    ]
    moved = [
        f"{name} {100 * (value / true - 1):+.3g} %"
        for name, value, true in pairs
        if true != 0 and abs(value / true - 1) > BIASED
    ]
    basis = mechanism.multipliers
    return moved and [
        f"the {basis.basis} basis with knots of {1e3 * basis.spacing:.4g} ms moves parameters from "
        f"where free multipliers put them: {', '.join(moved[:6])}"
        + (f" and {len(moved) - 6} more" if len(moved) > 6 else "")
        + "; standard errors do not hold this bias"
    ]


def cells_at_rest(everything: Squares, cells: Sequence) -> float:
    """Share of rows that standstill keeps from informing."""
    rest = sum(cell.rest.rows for cell in cells)
    return rest / max(float(everything.rows.sum()), 1.0)


def _warnings(
    mechanism: Mechanism, motion: Motion, columns: Columns, found: Estimate, rest: float
) -> tuple[str, ...]:
    said = [*mechanism.notes, *motion.notes]
    if rest > 0:
        said.append(
            f"{100 * rest:.3g} % of the equations are at standstill, where dry friction is open; "
            "they count in the errors but not in the fit"
        )
    if found.unexcited:
        names = [columns.names[i] for i in found.unexcited]
        said.append(
            f"this motion does not excite {', '.join(names[:8])}"
            + (f" and {len(names) - 8} more" if len(names) > 8 else "")
            + ": noise alone would decide them, so they stay at their prior; move more joints, "
            "faster or farther"
        )
    absorbed = absorbed_by(columns, found.base)
    for effect, places in columns.effects:
        for name, at in zip(effect.names, places, strict=True):
            if at >= 0 and name in absorbed:
                carrier = absorbed[name]
                said.append(
                    f"{name} cannot be identified: "
                    + (
                        f"same columns as {carrier}"
                        if carrier
                        else "nothing in this motion feels it"
                    )
                )
    if found.base.condition_number > POOR:
        said.append(
            f"condition number {found.base.condition_number:.3g}: this motion excites some base "
            "parameters poorly; see their standard errors, and move more joints, faster or farther"
        )
    determined = identifiable_multipliers(mechanism, motion)
    lost = [
        n for n, good in zip(mechanism.kinematics.multipliers, determined, strict=True) if not good
    ]
    if lost:
        said.append(
            f"multipliers {', '.join(lost)} are not determined: closure equations are redundant "
            f"({len(determined)} of rank {mechanism.rank}), which is normal for planar loops"
        )
    return tuple(dict.fromkeys(said))
