"""Numbers of logged series that many ask for."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar
from weakref import ReferenceType, ref

import numpy as np

T = TypeVar("T")


def once_a_series(function: Callable[[np.ndarray], T]) -> Callable[[np.ndarray], T]:
    """Return a function of a series (n,) that is evaluated once for each that nobody can write to,
    as a log's columns and stretches of them are, while that series exists.
    """
    made = dict[tuple[Any, ...], tuple[ReferenceType[np.ndarray], T]]()

    @wraps(function)
    def remembered(x: np.ndarray) -> T:
        owner = x if x.base is None else x.base
        if not isinstance(owner, np.ndarray) or not owner.flags.owndata:
            return function(x)
        if owner.flags.writeable or x.flags.writeable:
            return function(x)
        key = id(owner), x.__array_interface__["data"][0], x.dtype.str, x.shape, x.strides
        known = made.get(key)
        if known is None or known[0]() is not owner:
            forget = ref(owner, lambda _: made.pop(key, None))
            known = made[key] = forget, function(x)
        return known[1]

    return remembered
