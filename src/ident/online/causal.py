"""Which effects can be had from one sample after the other, and at which values they are held."""

from __future__ import annotations

from dataclasses import replace

from ident.effects import Effect
from ident.effects.measurement import Backlash
from ident.equations.point import Point
from ident.errors import FitError
from ident.mechanism.mechanism import Mechanism


def check_causal(mechanism: Mechanism) -> None:
    """Refuse effects whose columns at one sample depend on more than its surroundings.

    Raises:
        FitError: naming the effect, and what to do.
    """
    for effect in mechanism.effects:
        if why := _beyond(effect):
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' {why}, which is not there sample by "
                f"sample; leave out {effect.label}, or identify whole logs (ident identify)"
            )


def _beyond(effect: Effect) -> str:
    """What of other samples an effect needs, or nothing."""
    if effect.memory:
        return "depends on all that was before"
    if isinstance(effect, Backlash):
        return "depends on the load of a whole log"
    return ""


def held(mechanism: Mechanism, point: Point) -> Mechanism:
    """The mechanism with all shape parameters known, at their values in `point`.

    Raises:
        FitError: for a shape without a value.
    """
    effects = []
    for effect in mechanism.effects:
        _, shape = point.of(effect)
        lacking = [each.name for each in effect.searched if each.name not in shape]
        if lacking:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' has no value for {', '.join(lacking)}, "
                "which is not linear and is not searched online; give like= a fit, or its value"
            )
        searched = {each.name: shape[each.name] for each in effect.searched}
        effects.append(replace(effect, values={**effect.values, **searched}))
    return replace(mechanism, effects=tuple(effects))
