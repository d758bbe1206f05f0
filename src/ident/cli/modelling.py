"""`add` and `effects`."""

from __future__ import annotations

from typing import Annotated

import typer

from ident.cli.arguments import (
    AllowCode,
    MechanismPath,
    grown,
    kinds_beginning,
    mechanism_of,
)
from ident.cli.console import result
from ident.effects import KINDS, kind_of
from ident.mechanism.write import add_effects
from ident.show.effects import described


def add(
    mechanism: MechanismPath,
    effect: Annotated[
        str,
        typer.Argument(
            metavar="EFFECT",
            autocompletion=kinds_beginning,
            help="As viscous:elbow, viscous for all driven joints, or file.py:function:elbow.",
        ),
    ],
    allow_code: AllowCode = False,
) -> None:
    """Write an effect into mechanism.toml.

    A bare URDF gets a mechanism.toml beside it.
    """
    before = mechanism_of(mechanism, allow_code=allow_code)
    after = grown(before, effect, allow_code=allow_code)
    new = [each for each in after.effects if each not in before.effects]
    path = add_effects(before, new)
    result(f"{path}: added {', '.join(each.label for each in new)}")


def effects(
    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="KIND",
            autocompletion=kinds_beginning,
            help="One of them, as viscous; else all.",
        ),
    ] = None,
) -> None:
    """The library of effects.

    Equation, unknowns and shapes with units, where an effect sits, and what a residual looks like
    when it is missing.
    """
    kinds = KINDS.values() if kind is None else [kind_of(kind)]
    result("\n\n".join(described(each) for each in kinds))
