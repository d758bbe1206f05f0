"""Explorations of small logs, made once."""

from __future__ import annotations

from functools import cache

import ident
from helpers import ROBOTS
from ident.assess.exploration import Exploration


@cache
def given(name: str = "arm") -> Exploration:
    """A robot of robots/ on the log that comes with it, nothing announced yet."""
    mechanism = ident.load(ROBOTS / name)
    return Exploration.of(mechanism, ident.complete(mechanism, ROBOTS / name / "run.csv"))


@cache
def screened(name: str = "arm") -> Exploration:
    """With what is announced."""
    return given(name).screened()


@cache
def judged(name: str = "arm") -> Exploration:
    """With its diagnosis."""
    return screened(name).judged()


@cache
def grown(label: str) -> Exploration:
    """The arm with one effect, whose fall was announced."""
    return screened().with_effect(label)


@cache
def odd() -> Exploration:
    """The arm with friction on a log in which the elbow has a law that no library holds, judged."""
    from ident.effects.formula import Formula, Scale, Term

    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")
    motion = ident.complete(mechanism, ROBOTS / "arm" / "run.csv")
    place, width = Scale("q0", "place", "q"), Scale("x0", "width", "q")
    magnet = Formula(("elbow",), terms=(Term(("1/(1 + ((q - q0)/x0)**2)",), (place, width)),))
    first = ident.identify(mechanism, motion)
    at = {"law.elbow.k": 0.8, "law.elbow.q0": 0.9, "law.elbow.x0": 0.35}
    log, _ = ident.simulate(
        mechanism + magnet,
        ident.read_log(ROBOTS / "arm" / "run.csv"),
        values={**first.point.values, **at},
        pi=first.point.pi,
        noise=[ident.Noise("tau", 0.005, True)],
    )
    return Exploration.of(mechanism, ident.complete(mechanism, log)).judged()
