"""Two effects that are to be told apart."""

from __future__ import annotations

from ident.effects import KINDS, parse
from ident.equations.columns import Columns
from ident.errors import MechanismError, MotionError
from ident.mechanism.mechanism import Mechanism
from ident.solve.rank import Base


def with_rivals(mechanism: Mechanism, pair: tuple[str, str]) -> Mechanism:
    """The mechanism with both effects, their parameters unknown.

    Raises:
        MechanismError: for what names no one effect, or the same twice.
    """
    if len(set(pair)) != 2:
        raise MechanismError(f"separate {' '.join(pair)}: two different effects are expected")
    for label in pair:
        own = {effect.label: effect for effect in mechanism.effects}
        if label in own and not own[label].known:
            continue
        kind, joints = parse(label)
        if not joints and KINDS[kind].sits != "mechanism":
            raise MechanismError(f"separate {label}: of which joint? write {label}:JOINT")
        mechanism = mechanism.with_effect(label)
    return mechanism


def places_of(columns: Columns, label: str) -> list[int]:
    """Where an effect's unknowns stand in x; of a correction, which has none, its shapes.

    The sensitivity of another effect's shape is zero as long as its unknowns are.
    """
    effect, places = next((e, at) for e, at in columns.effects if e.label == label)
    mine = places[: len(effect.unknowns)] if effect.unknowns else places
    return [int(place) for place in mine if place >= 0]


def columns_of(mechanism: Mechanism, columns: Columns, base: Base, label: str) -> list[int]:
    """Where an effect's unknowns stand among the base parameters.

    Raises:
        MotionError: where one is not there: other columns make it in every motion.
    """
    keep = list(base.independent)
    mine = places_of(columns, label)
    lost = [columns.names[place] for place in mine if place not in keep]
    if lost:
        raise MotionError(
            f"{mechanism.name}: no motion tells {label} from everything else: "
            f"the column of {lost[0]} is made by the others in all motions that were tried; open "
            "the loop, change the load or the base, or measure more torques"
        )
    return [keep.index(place) for place in mine]
