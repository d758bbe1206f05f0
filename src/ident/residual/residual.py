"""What a model leaves unexplained, at the rows of the regression.

residual = measured − predicted        predicted = Σ parts
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ident.motion import Motion
from ident.residual.error import Error, Squares
from ident.residual.model import Model
from ident.show.html import Shown

if TYPE_CHECKING:
    from ident.residual.failure import Failure

FAR = 1e4  # s, beyond which no experiment begins by its own clock
RIGID, WRENCHES = "rigid bodies", "external wrenches"
DRIVES, CLOSURES = "other drives", "closure forces"


@dataclass(frozen=True, eq=False)
class Trace:
    """Of one experiment: n rows, filtered and decimated alike, as the regression had them.

    With d independent coordinates and J named joints:

    Attributes:
        name: the experiment's.
        t: (n,) [s]; segment: (n,), rows of one number follow each other without a gap.
        measured: (n, d) torques [N m | N].
        parts: (n, d) by name: `rigid bodies`, each effect, less the `external wrenches`; they add
            up to `predicted`.
        gravity: (n, d), what of the rigid bodies' part is there without motion.
        own: (n, d) by name, in each joint's own row of the generalised forces: rigid bodies and
            effects of that row, `other drives`, and `closure forces` (Jᵀλ); they add up to the
            joint's own torque. Empty for a tree; NaN for a closure's own joint, which has no row.
        q, v, a: (n, J) [rad | m], [.../s], [.../s²] of all named joints.
        direction: (n, J), sign(v), v/still at standstill.
        informed: (n, d), false where dry friction at standstill leaves the torque open.
    """

    name: str
    t: np.ndarray
    segment: np.ndarray
    measured: np.ndarray
    parts: Mapping[str, np.ndarray]
    gravity: np.ndarray
    own: Mapping[str, np.ndarray]
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    direction: np.ndarray
    informed: np.ndarray
    still: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.t)

    @cached_property
    def predicted(self) -> np.ndarray:
        """Σ parts (n, d)."""
        return sum(self.parts.values(), self._zero)

    @cached_property
    def load(self) -> np.ndarray:
        """Torque (n, d) that the links ask of each joint: the prediction without the effects."""
        return sum((self.parts[k] for k in (RIGID, WRENCHES) if k in self.parts), self._zero)

    @property
    def _zero(self) -> np.ndarray:
        return np.zeros_like(self.measured)

    @cached_property
    def residual(self) -> np.ndarray:
        """measured − predicted (n, d)."""
        return self.measured - self.predicted

    def runs(self) -> list[slice]:
        """Rows without a gap between them."""
        edges = [0, *(np.flatnonzero(np.diff(self.segment)) + 1), len(self)]
        return [slice(int(i), int(j)) for i, j in pairwise(edges) if j > i]


@dataclass(frozen=True, eq=False)
class Residual(Shown):
    """A model's residual on a motion. Made by `residual_of`.

    Attributes:
        name: the model's; model: the fit, or the fit.json read back.
        motion: on which.
        joints: independent coordinates (d,), in which torques are compared; units: of their
            torques; coordinate_units: of their positions.
        signals: names of all joints (J,), the order of q, v and a.
        traces: one an experiment.
    """

    name: str
    model: Model
    motion: Motion
    joints: tuple[str, ...]
    units: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    signals: tuple[str, ...]
    traces: tuple[Trace, ...]

    @cached_property
    def errors(self) -> dict[str, Error]:
        """rms and relative error by joint, over all rows, as `Fit.train` has them."""
        d = len(self.joints)
        total = Squares(np.zeros(d), np.zeros(d), np.zeros(d))
        for trace in self.traces:
            error, torque = (trace.residual**2).sum(axis=0), (trace.measured**2).sum(axis=0)
            total = total + Squares(error, torque, np.full(d, float(len(trace))))
        return total.errors(self.joints, self.units)

    @cached_property
    def parts(self) -> dict[str, np.ndarray]:
        """rms (d,) of `measured`, each part, `gravity` and `residual` over all rows."""
        first = self.traces[0]
        found = {"measured": _rms([trace.measured for trace in self.traces])}
        for name in first.parts:
            found[name] = _rms([trace.parts[name] for trace in self.traces])
        found["gravity"] = _rms([trace.gravity for trace in self.traces])
        found["residual"] = _rms([trace.residual for trace in self.traces])
        return found

    @cached_property
    def own(self) -> dict[str, np.ndarray]:
        """rms (d,) of the parts of each joint's own row; empty for a tree."""
        names = self.traces[0].own
        return {name: _rms([trace.own[name] for trace in self.traces]) for name in names}

    def zero(self, trace: Trace) -> float:
        """Where pictures count a trace's time from [s]: its log's start, if that is far from 0."""
        return next(zero_of(e.t) for e in self.motion.experiments if e.name == trace.name)

    @property
    def rows(self) -> int:
        """Over all experiments."""
        return sum(len(trace) for trace in self.traces)

    @property
    def rate(self) -> float:
        """Rows a second [Hz]."""
        longest = max(self.traces, key=len)
        run = max(longest.runs(), key=lambda each: each.stop - each.start)
        t = longest.t[run]
        return (len(t) - 1) / float(t[-1] - t[0]) if len(t) > 1 else 1.0

    def signal(self, name: str) -> tuple[list[np.ndarray], str]:
        """The signal `name` (as `depends_on` has it), (n,) of each trace, and its unit."""
        kind, _, joint = name.partition(".")
        if kind == "t":
            return [trace.t for trace in self.traces], "s"
        if kind == "load":
            u = self.joints.index(joint)
            return [trace.load[:, u] for trace in self.traces], self.units[u]
        i = self.signals.index(joint)
        per = {"q": "", "v": "/s", "a": "/s²"}
        unit = self.coordinate_units[i] + per[kind] if kind in per else ""
        array = kind if kind in per else "direction"
        return [getattr(trace, array)[:, i] for trace in self.traces], unit

    @cached_property
    def where(self) -> tuple[Failure, ...]:
        """Where the model fails, joint by joint, the largest share first."""
        from ident.residual.where import where

        return where(self)

    def __str__(self) -> str:
        from ident.residual.tables import headline, parts_table, where_text

        return "\n".join([headline(self), *parts_table(self), "", *where_text(self)])

    __repr__ = __str__


def zero_of(t: np.ndarray) -> float:
    """The first of some stamps (n,) [s] if they are far from 0, as seconds since 1970 are."""
    return float(t[0]) if abs(float(t[0])) > FAR else 0.0


def _rms(pieces: list[np.ndarray]) -> np.ndarray:
    total = sum(((x**2).sum(axis=0) for x in pieces), np.zeros(pieces[0].shape[1]))
    return np.asarray(np.sqrt(total / max(sum(len(x) for x in pieces), 1)))
