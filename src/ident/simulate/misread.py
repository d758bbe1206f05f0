"""Logs as they are read by sensors that are a little wrong, by errors of a stated size.

    t → t/(1 + s), v → v (1 + s), a → a (1 + s)²     a clock that is s slow, and rates made by it
    q → q − z,  τ → (1 + g) τ                          a zero, a gain
    x(t) → x(t − d)                                    a channel that is late

As the corrections of `effects.calibration` take them back. Lengths are in no log: another length is
another machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ident.information.cause import Cause
from ident.information.cubic import cubic
from ident.log import Log


def misread(log: Log, causes: Iterable[Cause], errors: Mapping[str, float]) -> Log:
    """Return a log as sensors with errors read it.

    Args:
        log: as it is.
        causes: of the errors; lengths among them change nothing.
        errors: by name of a cause, in its prior scale; 0 where one is not given.
    """
    size = {(c.kind, c.place): c.scale * errors.get(c.name, 0.0) for c in causes}
    clock = 1.0 + size.get(("clock", ""), 0.0)
    columns = dict(log.columns)
    for name, x in log.columns.items():
        kind, _, joint = name.partition(".")
        order = "qva".find(kind) if len(kind) == 1 else -1
        place = f"q.{joint}" if order >= 0 else name
        if d := size.get(("lateness", place), 0.0):
            x = _late(log.t, x, d)
        if order > 0:
            x = x * clock**order
        x = x - (size.get(("q", place), 0.0) if order == 0 else 0.0)
        columns[name] = x * (1.0 + size.get(("tau", place), 0.0))
    return Log(log.name, columns, log.t / clock, log.repairs)


def _late(t: np.ndarray, x: np.ndarray, d: float) -> np.ndarray:
    """Return x(t − d), empty where x is; the ends stand still."""
    known = np.isfinite(x)
    if known.sum() < 2:
        return x
    shifted = cubic(t[known], x[known], np.clip(t - d, t[known][0], t[known][-1]))
    return np.where(known, shifted, np.nan)
