"""Explorations of small logs, made once."""

from __future__ import annotations

from functools import cache

import ident
from helpers import ROBOTS
from ident.show.explore import Exploration


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
def grown(label: str) -> Exploration:
    """The arm with one effect, whose fall was announced."""
    return screened().with_effect(label)
