"""What the page shows as tables: the ladder, errors joint by joint, effects with their errors."""

from __future__ import annotations

from collections.abc import Sequence

from ident.explore.rung import Rung
from ident.fit import Fit
from ident.residual.error import Error
from ident.tables import percent, rounded


def share(value: float | None) -> str:
    """A fall of error as a percentage; what rises has a minus.

    >>> share(0.1234)
    '12.3 %'
    """
    if value is None:
        return "–"
    if value < -1:  # a rise by so many times
        return f"×{1 - value:.3g}"
    digits = 2 if abs(value) >= 0.9995 else 1  # 99.97 % is not 100 %
    return f"{100 * value:.{digits}f} %".replace("-", "−")


def error_text(error: Error | None) -> str:
    """Relative to the torque, or the rms where there is none."""
    if error is None:
        return "–"
    return f"{error.rms:.3g} {error.unit}" if error.relative is None else percent(error.relative)


def ladder_rows(rungs: Sequence[Rung]) -> list[list[str]]:
    """What was changed, the fall announced and delivered, every joint's held-out error."""
    joints = rungs[0].fit.motion.independent
    rows = [["model", "announced", "delivered", *joints]]
    for i, rung in enumerate(rungs):
        falls = ["", ""] if i == 0 else [share(rung.announced), share(rung.delivered)]
        rows.append([rung.name, *falls, *(error_text(rung.errors.get(j)) for j in joints)])
    return rows


def error_rows(first: Rung, before: Rung, now: Rung) -> list[list[str]]:
    """Held-out errors joint by joint: as given, before the last change, now."""
    rows = [["joint", "as given", "before", "now"]]
    for joint in now.fit.motion.independent:
        errors = (rung.errors.get(joint) for rung in (first, before, now))
        rows.append([joint, *map(error_text, errors)])
    return rows


def effect_rows(fit: Fit) -> list[list[str]]:
    """The effects' parameters ± standard error; known ones say so."""
    rows = [["parameter", "value", "unit"]]
    for each in fit.effects:
        rows += [[v.name, rounded(v.value, v.stderr), v.unit] for v in each.parameters]
    shown = {row[0] for row in rows}
    for effect in fit.mechanism.effects:
        for name, parameter in zip(effect.names, effect.parameters, strict=True):
            if name not in shown and parameter.name in effect.values:
                unit = effect.units[effect.names.index(name)]
                rows.append([name, f"{effect.values[parameter.name]:.5g} (known)", unit])
    return rows


def body_rows(fit: Fit) -> list[list[str]]:
    """Identified parameters of bodies, or combinations of them, ± standard error."""
    own = [v for v in fit.parameters if v.identifiable]
    rows = [["parameter", "value", "prior", "unit"]]
    rows += [[v.name, rounded(v.value, v.stderr), f"{v.prior:.5g}", v.unit] for v in own]
    return rows
