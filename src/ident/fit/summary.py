"""`print(fit)`: the table a person wants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ident.fit.values import Value
from ident.residual.error import error_rows
from ident.text import rounded, shortened, table

if TYPE_CHECKING:
    from ident.fit.fit import Fit


def shown(value: Value) -> str:
    """A value as tables have it."""
    return rounded(value.value, value.stderr) + (", at bound" if value.at_bound else "")


def summary(fit: Fit) -> str:
    """Errors, effects, parameters and warnings of a fit."""
    motion = fit.motion
    logs = ", ".join(motion.names)
    cut = motion.band.cutoff
    errors = {"train": fit.train, "held out": fit.held_out, **fit.validation}
    if cut:
        errors["unfiltered"] = fit.unfiltered
    lines = [
        f"fit of {fit.mechanism.name} to {logs}: {fit.rows} rows of {motion.samples} samples"
        + (f", zero-phase filter at {cut:.3g} Hz" if cut else ", unfiltered"),
        "",
        "error of the predicted torque" + (f" below {cut:.3g} Hz" if cut else ""),
        *table(error_rows(errors)),
    ]
    if fit.effects:
        rows = [["effect", "value", "unit"]]
        for effect in fit.effects:
            rows += [[v.name, shown(v), v.unit] for v in effect.parameters]
        lines += ["", *table(rows)]
    own = [value for value in fit.parameters if value.identifiable]
    if own:
        rows = [["parameter", "value", "prior", "unit"]]
        rows += [[v.name, shown(v), f"{v.prior:.5g}", v.unit] for v in own]
        lines += ["", *table(rows)]
    combined = [value for value in fit.base_parameters if " " in value.name]
    if combined:
        rows = [["base parameter", "value", "unit"]]
        rows += [[shortened(v.name), rounded(v.value, v.stderr), v.unit] for v in combined]
        lines += ["", *table(rows)]
    lines += _multipliers(fit)
    left = [value.name for value in fit.parameters if not value.identifiable]
    rest = f"; {len(left)} unknowns are not identifiable by themselves" if left else ""
    condition = f"condition number {fit.condition_number:.3g}"
    if len(fit.columns):
        lines += ["", f"rank {fit.rank} of {len(fit.columns)} unknowns, {condition}{rest}"]
    if fit.likelihood is not None:
        lines.append(str(fit.likelihood))
    if fit.essential is not None:
        lines.append(fit.essential.line)
    lines += fit.correlation.notes()
    if fit.binding is not None:
        lines.append(str(fit.binding))
    return "\n".join(lines)


def _multipliers(fit: Fit) -> list[str]:
    kinematics = fit.mechanism.kinematics
    if not kinematics.multipliers:
        return []
    values = np.concatenate([each for _, each in fit.multipliers])
    rows = [["multiplier", "rms", "largest", "unit"]]
    for i, (name, unit) in enumerate(zip(kinematics.multipliers, kinematics.units, strict=True)):
        x = values[np.isfinite(values[:, i]), i]
        size = [f"{np.sqrt(np.mean(x**2)):.4g}", f"{np.abs(x).max():.4g}"] if len(x) else ["–", "–"]
        rows.append([name, *size, unit])
    return ["", *table(rows)]
