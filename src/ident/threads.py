"""Threads of linear algebra: the settings of the libraries that NumPy may be built with.

The matrices of a log are small: threads that wait for each other cost more than they bring (a
diagnosis of six joints took fourteen times the processor time on a busy machine), and two processes
with two threads each are slower on two cores than with one each.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
VARIABLES = tuple(f"{library}_NUM_THREADS" for library in LIBRARIES)
ONE_THREAD = dict.fromkeys(VARIABLES, "1")  # of a process that has not loaded them yet
P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(verb: Callable[P, R]) -> Callable[P, R]:
    """Let linear algebra use one thread while a verb runs, in a process that chose otherwise."""

    @wraps(verb)
    def limited(*args: P.args, **options: P.kwargs) -> R:
        if all(os.environ.get(name) == "1" for name in VARIABLES[:2]):
            return verb(*args, **options)  # as commands and workers have it
        from threadpoolctl import threadpool_limits  # looks which libraries there are by now

        with threadpool_limits(1):
            return verb(*args, **options)

    return limited
