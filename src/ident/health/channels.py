"""The samples of a log's channels: as logged where logs are given, else as the motion has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.fit import Fit
from ident.log import Log
from ident.motion.measure import measure

ON_GRID = 0.95  # share of the gaps between neighbouring values that are whole steps
WHOLE = 0.05  # of a step, by which a gap may differ from a whole number of steps
ROUNDING = 1e-9  # of a channel's largest value: nearer values are one


@dataclass(frozen=True, eq=False)
class Channel:
    """One column of one log.

    Attributes:
        name: `tau.elbow`; log: the log's name.
        t: (n,) [s]; x: (n,) values.
        raw: whether x are the samples as logged, not on another clock or smoothed.
    """

    name: str
    log: str
    t: np.ndarray
    x: np.ndarray
    raw: bool

    @property
    def rms(self) -> float:
        """Root mean square of x."""
        return float(np.sqrt(np.mean(self.x**2)))

    @property
    def step(self) -> float:
        """The step of a quantised channel, 0 if its values lie on no grid."""
        values = np.unique(self.x)
        size = ROUNDING * np.abs(values).max(initial=0.0)
        gaps = np.diff(values)
        gaps = gaps[gaps > size]
        if len(gaps) < 3:
            return float(gaps.min(initial=np.inf)) if len(gaps) else 0.0
        step = float(np.quantile(gaps, 0.02))
        step = float(gaps[gaps < 1.5 * step].mean())
        whole = (
            np.abs(gaps / step - np.round(gaps / step)) < WHOLE * np.maximum(gaps / step, 1) ** 0.5
        )
        return step if whole.mean() > ON_GRID else 0.0


@dataclass(frozen=True, eq=False)
class Channels:
    """All channels of a fit's logs.

    Attributes:
        found: by (log, column); logs: those that were given, under ident's names of columns.
        others: (log, column) of columns that are no channel of this mechanism.
    """

    found: dict[tuple[str, str], Channel]
    others: dict[tuple[str, str], Channel]
    logs: tuple[Log, ...]

    def of(self, kind: str) -> list[Channel]:
        """The channels `q`, `v`, `a` or `tau`."""
        return [c for (_, name), c in self.found.items() if name.split(".", 1)[0] == kind]


def channels(fit: Fit, logs: Sequence[Log] = ()) -> Channels:
    """The channels of a fit, and of the logs it was made from where they are at hand."""
    mechanism = fit.mechanism
    mapped = tuple(measure(mechanism, log).log for log in logs)
    used = {source.column for source in mechanism.columns.values()}
    wanted = {f"{c}.{joint.name}" for joint in mechanism.joints for c in ("q", "v", "a", "tau")}
    found: dict[tuple[str, str], Channel] = {}
    others: dict[tuple[str, str], Channel] = {}
    for log in mapped:
        for name in log.columns:
            t, x = log.series(name)
            if len(x) > 2 and name not in used:
                into = found if name in wanted else others
                into[log.name, name] = Channel(name, log.name, t, x, True)
    if mapped:
        return Channels(found, others, mapped)
    for e in fit.motion.experiments:
        t = e.t[e.usable]
        for j, joint in enumerate(mechanism.driven):
            name = f"tau.{joint}"
            found[e.name, name] = Channel(name, e.name, t, e.tau[e.usable, j], False)
        for name, x in e.extra.items():
            if name not in wanted and name not in used:
                others[e.name, name] = Channel(name, e.name, t, x[e.usable], False)
    return Channels(found, others, ())
