"""Effects of the model that the data do not support, or whose values cannot be.

D_B = Σ e²(without) − Σ e²(with) in block B, everything else refitted
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ident.diagnose.evidence import MATERIAL, SURE, sureness, torque_squares
from ident.diagnose.explanation import name_of
from ident.diagnose.screen import Screen
from ident.effects import Effect
from ident.fit import Fit
from ident.fit.table import Table

CERTAIN = 3.0  # standard errors below zero


@dataclass(frozen=True, eq=False)
class Unsupported:
    """An effect in the model that had better be removed, or looked at."""

    effect: Effect
    why: str
    absurd: bool

    def json(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {**name_of(self.effect), "why": self.why, "absurd": self.absurd}


def unsupported(fit: Fit, table: Table, screen: Screen) -> tuple[Unsupported, ...]:
    """Effects without which the held-out error is no larger, and absurd ones."""
    found = []
    values = {each.effect.label: each.parameters for each in fit.effects}
    for effect, places in fit.columns.effects:
        mine = places[places >= 0]
        parameters = values[effect.label]
        absurd = [
            v.name
            for v, parameter in zip(parameters, effect.parameters, strict=True)
            if parameter.nonnegative and v.stderr is not None and v.value < -CERTAIN * v.stderr
        ]
        if absurd:
            found.append(
                Unsupported(
                    effect,
                    f"{', '.join(absurd)} is negative beyond its error, which no such effect can "
                    "be: something else is missing, or a sign is wrong",
                    True,
                )
            )
            continue
        if not len(mine):
            continue
        held = fit.estimate.held.copy()
        held[mine] = True
        without = Screen.same_rows(screen, table, held)
        D = (without.loss - screen.loss).sum(axis=1)
        torque = max(float(torque_squares(table, screen).sum()), 1e-300)
        size = float(max(D.sum(), 0.0) / torque) ** 0.5
        z = sureness(without.loss, screen.loss)
        if z < SURE or D.sum() <= 0:
            why = f"without it the held-out error is no larger (z = {z:.1f})"
            found.append(Unsupported(effect, why, False))
        elif size < MATERIAL / 10:
            why = f"it explains {100 * size:.2g} % of the torque only"
            found.append(Unsupported(effect, why, False))
    return tuple(found)
