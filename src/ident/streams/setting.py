"""What a stream must know before its first sample, taken from logs of the same machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.equations.rows import largest_transmission
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.recipe import Recipe
from ident.motion.signals import Clock, is_signal, usual_range
from ident.motion.smoothing import AS_LOGGED
from ident.motion.state import largest_nearness, nearness

ORDERS = "qva"
PLACES = 64  # configurations from which a stream may set out
LAG = 10.0  # knots after a sample, of splines that smooth
EXACT = 16  # samples after it, of splines that interpolate: each moves them by 0.43 of the last


@dataclass(frozen=True, eq=False, kw_only=True)
class Setting(Recipe):
    """The recipe of logs of the same machine, and what else a stream must know beforehand."""

    channels: tuple[str, ...]  # what is logged of each of `logged`, of "qva"
    wrenches: tuple[str, ...]  # columns of external wrenches
    taken: tuple[str, ...]  # joints of `logged` whose q, v and a are taken as they are
    scale: np.ndarray  # (logged,) of coordinates, where more are logged than needed
    y: np.ndarray  # (places, logged) configurations on the way of this machine
    q: np.ndarray  # (places, nq)
    # by column, median and distance from it beyond which a sample is absurd
    usual: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, mechanism: Mechanism, motion: Motion) -> Setting:
        """Take what `complete` chose from logs of the same machine."""
        if not motion.logs:
            raise MotionError(
                "this motion has no log, so nothing says what is logged; one of "
                "ident.complete(mechanism, log) has"
            )
        e, log = motion.experiments[0], motion.logs[0]
        at = [mechanism.joint_index[name] for name in e.logged]
        some = np.flatnonzero(e.usable)
        some = some[:: max(1, len(some) // PLACES)]
        far = [x for x in map(largest_transmission, motion.experiments) if x is not None]
        channels = tuple(
            "".join(o for o in ORDERS if f"{o}.{name}" in log.columns) for name in e.logged
        )
        clean = {channel.column for channel in e.channels if channel.how == AS_LOGGED}
        taken = tuple(
            name
            for name, orders in zip(e.logged, channels, strict=True)
            if orders == ORDERS and f"q.{name}" in clean
        )
        return cls(
            clock=Clock(float(e.t[0]), 1 / e.rate, len(e), even=True),
            knots=max((channel.spacing for channel in e.channels), default=0.0),
            noise={channel.column: channel.noise for channel in e.channels} | dict(e.noise),
            logged=e.logged,
            independent=motion.independent,
            band=motion.band,
            still=np.max([each.still for each in motion.experiments], axis=0),
            farthest=np.max(far, axis=0) if far else None,
            singular=np.inf if e.loop is None else largest_nearness(nearness(e)),
            channels=channels,
            wrenches=tuple(name for name in log.columns if name.startswith("wrench.")),
            taken=taken,
            scale=np.maximum(e.y[:, at].std(axis=0), 1e-9),
            y=e.y[some][:, at],
            q=e.q[some],
            usual={name: usual_range(x) for name, x in log.columns.items() if is_signal(name)},
        )

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return 1 / self.clock.step

    @property
    def cutoff(self) -> float | None:
        """Cut-off of the rows' zero-phase filter [Hz]; None: no filter."""
        return self.band.cutoff

    @property
    def spacing(self) -> float:
        """Distance of the knots of the joints that are not taken as logged [s]."""
        return self.knots or 1 / self.rate

    @property
    def together(self) -> int:
        """Samples that are smoothed at once: those from one knot to the next."""
        return max(1, round(self.knots * self.rate))

    @property
    def smoothing_lag(self) -> int:
        """Samples after one that its splines may wait for; 0: all is taken as logged."""
        if self.taken == self.logged:
            return 0
        return max(EXACT, int(np.ceil(LAG * self.spacing * self.rate))) + self.together - 1

    @property
    def motion_columns(self) -> tuple[str, ...]:
        """Columns of the log from which the motion is made."""
        pairs = zip(self.logged, self.channels, strict=True)
        return tuple(f"{order}.{name}" for name, orders in pairs for order in orders)
