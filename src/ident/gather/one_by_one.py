"""From the rows of many logs to the noun `Each`: joint model, own fits, disagreement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.regression import Regression
from ident.fit.score import squares
from ident.gather.disagree import disagreements
from ident.gather.each import Alone, Each

QUIET = 1e-3  # of the joint residual: logs are believed to have no less noise than that


def each_of(
    r: Regression,
    names: Mapping[int, str],
    samples: Mapping[str, int],
    left_out: Mapping[str, str] | None = None,
) -> Each:
    """Logs one by one.

    Args:
        r: rows of all logs.
        names: of the logs by `Cell.experiment`, in the order in which they were given.
        samples: of each log by name.
        left_out: by name of a log, why it is in no fit.
    """
    broken = left_out or {}
    by_log: dict[int, list[Cell]] = {}
    for cell in r.cells:
        by_log.setdefault(cell.experiment, []).append(cell)
    joint = estimate(r.factors, r.prior, r.torque, r.sensible)
    own = {log: _own(r, mine, joint) for log, mine in by_log.items()}
    odd = disagreements(r.cells, _weighed(r, joint, by_log, own), r.columns)
    found = [Alone(name, left_out=broken[name]) for name in broken if name not in names.values()]
    for number, name in names.items():
        mine = by_log.get(number, [])
        if name in broken or not mine:
            why = broken.get(name, "no sample of it can be used")
            found.append(Alone(name, samples.get(name, 0), left_out=why))
            continue
        errors = _errors(r, mine, joint.solution.x, own[number])
        found.append(Alone(name, samples.get(name, 0), *errors, odd.get(number)))
    return Each(tuple(sorted(found, key=lambda each: bool(each.left_out))))


def _own(r: Regression, mine: Sequence[Cell], joint: Estimate) -> np.ndarray:
    """(k,) the own fit of a log; where it does not tell, the joint one."""
    factors, x = totals(mine, len(r.columns), r.d), joint.solution.x
    if not len(x) or not sum(factor.rows for factor in factors):
        return x
    return estimate(factors, x, r.torque, sigma=joint.sigma, held=joint.held).solution.x


def _weighed(
    r: Regression,
    joint: Estimate,
    by_log: Mapping[int, Sequence[Cell]],
    own: Mapping[int, np.ndarray],
) -> Estimate:
    """The joint estimate with weights of what own fits leave, in which logs do not differ."""
    left, rows = np.zeros(r.d), np.zeros(r.d)
    for log, mine in by_log.items():
        for cell in mine:
            left[cell.coordinate] += cell.factor.residual_norm(own[log][cell.support]) ** 2
            rows[cell.coordinate] += cell.factor.rows
    sigma = np.maximum(np.sqrt(left / np.maximum(rows, 1)), QUIET * joint.sigma)
    return estimate(r.factors, r.prior, r.torque, sigma=sigma, held=joint.held)


def _errors(
    r: Regression, mine: Sequence[Cell], joint: np.ndarray, own: np.ndarray
) -> tuple[float | None, float | None, str]:
    """Of the joint model and of the own fit in a log, and the joint where they differ most."""
    torque = np.where(r.torque > 0, r.torque, np.inf) ** 2
    found = [squares(mine, x, r.d) for x in (joint, own)]
    rows = float(found[0].rows[np.isfinite(torque)].sum())
    if not rows:
        return None, None, ""
    left = [each.error / torque for each in found]
    worst = r.motion.independent[int(np.argmax(left[0] - left[1]))]
    return float(np.sqrt(left[0].sum() / rows)), float(np.sqrt(left[1].sum() / rows)), worst
