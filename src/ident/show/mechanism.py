"""A mechanism as text, as tables for Jupyter, and in 3-D: standing, or moving along experiments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.display import renders
from ident.errors import MechanismError
from ident.mechanism.mechanism import Mechanism
from ident.show.motion import joint_rows
from ident.show.sheet import Sheet
from ident.show.view3d.bodies import parts_of
from ident.show.view3d.film import ShownMotion, film_of
from ident.show.view3d.page import View


@renders(Mechanism, "text")
def text(mechanism: Mechanism) -> str:
    """Return the parts of a mechanism, one a line."""
    m = mechanism
    lines = [
        f"mechanism {m.name}: {m.model.nv} coordinates, "
        f"{len(m.kinematics.multipliers)} closure equations {_freedom(m)}",
        f"  driven:   {', '.join(m.driven) or 'none'}",
        f"  passive:  {', '.join(m.passive) or 'none'}",
    ]
    lines += [f"  closure:  {closure.name} ({closure.kind})" for closure in m.closures]
    lines += [f"  effect:   {effect.label}" for effect in m.effects]
    lines += [f"  unknown:  {len(m.unknown)} of {len(m.bodies.names)} dynamic parameters"]
    return "\n".join([*lines, *(f"  note:     {note}" for note in m.notes)])


def _freedom(mechanism: Mechanism) -> str:
    try:
        return f"of rank {mechanism.rank}, {mechanism.degrees_of_freedom} degrees of freedom"
    except MechanismError as error:  # what cannot be assembled can still be printed
        return f"that do not close: {error}"


@renders(Mechanism, "html")
def html(mechanism: Mechanism) -> str:
    """Return the parts and the joints of a mechanism as tables."""
    m = mechanism
    closed = f"{len(m.kinematics.multipliers)} equations {_freedom(m)}"
    parts = {
        "Coordinates": str(m.model.nv),
        "Closures": closed if m.closures else "",
        "Closed by": ", ".join(f"{each.name} ({each.kind})" for each in m.closures),
        "Effects": ", ".join(each.label for each in m.effects) or "none",
        "Unknown": f"{len(m.unknown)} of {len(m.bodies.names)} dynamic parameters",
    }
    tables = {"Joints": joint_rows(m)}
    return Sheet(f"Mechanism {m.name}", facts=parts, tables=tables, notes=m.notes).html()


@renders(Mechanism, "view")
def view(
    mechanism: Mechanism, experiments: Sequence[Any] = (), predictions: Sequence[Any] = ()
) -> View:
    """Return the mechanism moving along experiments; without any, standing as assembled.

    Args:
        mechanism: the mechanism.
        experiments: of a motion.
        predictions: for each, whose reactions are arrows and whose residuals are colours.
    """
    every = predictions or [None] * len(experiments)
    return view_of(mechanism, [ShownMotion.of(*e) for e in zip(experiments, every, strict=True)])


def view_of(mechanism: Mechanism, motions: Sequence[ShownMotion] = ()) -> View:
    """Return the mechanism moving along some motions; without any, standing as assembled."""
    notes: list[str] = []
    if not motions:
        try:
            q = mechanism.assembled
        except MechanismError as error:  # a picture helps to see why
            q = mechanism.start
            notes.append(str(error))
        motions = [ShownMotion("as assembled", np.zeros(1), q[None])]
    parts, more = parts_of(mechanism, motions[0].q[0])
    nowhere = [c.name for c in mechanism.closures if not c.frames]
    if nowhere and any(motion.multipliers is not None for motion in motions):
        more.append(
            f"{', '.join(nowhere)}: λ acts along coordinates, at no place: no arrow is drawn"
        )
    films = tuple(film_of(mechanism, motion) for motion in motions)
    return View(mechanism, parts, films, (*notes, *more))
