"""A mechanism as text, as tables for Jupyter, and in 3-D: standing, or moving along experiments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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


@renders(Mechanism, "sheet")
def sheet(m: Mechanism) -> Sheet:
    """Return the parts of a mechanism."""
    try:
        freedom = f"of rank {m.rank}, {m.degrees_of_freedom} degrees of freedom"
    except MechanismError as error:  # what cannot be assembled can still be printed
        freedom = f"that do not close: {error}"
    closures = f"{len(m.kinematics.multipliers)} closure equations {freedom}"
    facts = {
        "driven": ", ".join(m.driven) or "none",
        "passive": ", ".join(m.passive) or "none",
        "closures": ", ".join(f"{each.name} ({each.kind})" for each in m.closures),
        "effects": ", ".join(each.label for each in m.effects) or "none",
        "unknown": f"{len(m.unknown)} of {len(m.bodies.names)} dynamic parameters",
    }
    title = f"mechanism {m.name}: {m.model.nv} coordinates, {closures}"
    return Sheet(title, facts=facts, notes=m.notes)


@renders(Mechanism, "html")
def html(m: Mechanism) -> str:
    """Return the same with a table of the joints."""
    return replace(sheet(m), tables={"joints": joint_rows(m)}).html()


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
