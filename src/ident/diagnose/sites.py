"""Every effect of the library at every place where it could sit and is not yet."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from ident.effects import KINDS, Effect, create
from ident.mechanism.closures import Closure
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.places import places
from ident.motion import Motion


def candidates(mechanism: Mechanism, motion: Motion) -> list[Effect]:
    """All effects that could be missing, in the library's order; then known ones, which could have
    changed.
    """
    present = {effect.label for effect in mechanism.effects}
    found = []
    for kind, cls in KINDS.items():
        for joints in _sites(kind, cls, mechanism, motion):
            effect = create(kind, joints)
            if effect.label not in present:
                found.append((mechanism + effect).effects[-1])
    return found + [effect.freed for effect in mechanism.effects if effect.known]


def _sites(
    kind: str, cls: type[Effect], mechanism: Mechanism, motion: Motion
) -> Iterator[tuple[str, ...]]:
    logged = [e.logged for e in motion.experiments]
    extra = set.intersection(*(set(e.extra) for e in motion.experiments))
    if cls.sits == "mechanism":
        yield ()
    elif cls.sits == "link":
        yield from ((link,) for link in mechanism.bodies.links)
    elif cls.sits == "closure":
        frames = [c.name for c in mechanism.closures if isinstance(c, Closure)]
        yield from ((name,) for name in frames)
    elif cls.sits == "place":
        yield from ((place,) for place in _lengths(mechanism))
    elif cls.arity == 2:
        yield from combinations(mechanism.driven, 2)
    elif cls.sits == "driven" or kind == "load_friction":
        own = [j.name for j in mechanism.joints if not j.in_tree] if kind == "load_friction" else []
        yield from ((name,) for name in (*mechanism.driven, *own))
    elif kind == "encoder_offset":
        every = [name for name in logged[0] if all(name in names for names in logged)]
        yield from ((name,) for name in every)
    elif kind == "temperature_friction":
        viscous = {e.joints[0] for e in mechanism.effects if e.kind == "viscous"}
        yield from ((n,) for n in sorted(viscous) if f"temperature.{n}" in extra)
    else:
        yield from ((joint.name,) for joint in mechanism.joints)


def _lengths(mechanism: Mechanism) -> list[str]:
    """Places whose coordinate is a length of the drawing, not zero, past the first joint."""
    found = []
    for place in places(mechanism):
        owner, _, axis = place.rpartition(".")
        if mechanism.model.existJointName(owner):
            index = mechanism.model.getJointId(owner)
            at = mechanism.model.jointPlacements[index].translation
            if mechanism.model.parents[index] and abs(at["xyz".index(axis)]) > 1e-6:
                found.append(place)
        elif axis == "length":
            found.append(place)
        else:
            closure = next(c for c in mechanism.closures if c.name == owner[:-2])
            assert isinstance(closure, Closure)
            at = getattr(closure, owner[-1]).placement.translation
            if abs(at["xyz".index(axis)]) > 1e-6:
                found.append(place)
    return found
