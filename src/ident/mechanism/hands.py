"""Hands and fingers of which nothing is logged: they are held where they start.

Robots ship with a gripper or a hand in their URDF, whose joints no log of the arm has.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from ident.mechanism.mechanism import Mechanism

WORDS = re.compile(
    r"hand|finger|thumb|gripper|knuckle|jaw|claw|(?<![a-z])(index|middle|pinky)(?![a-z])", re.I
)
CHANNELS = ("q", "v", "a", "tau")


def unlogged_hands(mechanism: Mechanism, columns: Iterable[str]) -> tuple[str, ...]:
    """Return driven joints of hands and fingers of which a log has no column.

    A joint is one of a hand if its own name, that of its link or of an unlogged joint before it is
    a word for one. No joint beyond it may be logged.

    Args:
        mechanism: as it is loaded.
        columns: names in a log.
    """
    given = {*columns}
    given |= {name for name, own in mechanism.columns.items() if own.column in given}
    logged = {
        joint for prefix, _, joint in (name.partition(".") for name in given) if prefix in CHANNELS
    }
    model = mechanism.model
    free = {i: model.names[i] not in logged for i in range(1, model.njoints)}
    for i in reversed(free):
        if not free[i] and model.parents[i]:
            free[model.parents[i]] = False
    hands: set[int] = set()
    for i, link in enumerate(mechanism.bodies.links, 1):
        own = any(map(WORDS.search, (model.names[i], link)))
        if free[i] and (own or model.parents[i] in hands):
            hands.add(i)
    return tuple(model.names[i] for i in sorted(hands) if model.names[i] in mechanism.driven)
