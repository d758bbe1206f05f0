"""What a batch chooses from a whole log, and a stream must know before its first sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.equations.rows import reach
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment, Motion
from ident.motion.derive import AS_LOGGED
from ident.motion.place import HOPELESS, SINGULAR, nearness

ORDERS = "qva"
PLACES = 64  # configurations from which a stream may set out
DEGREE = 6  # of the local polynomial
REACH = 1.6  # knots of the log's splines on either side of it
CLEAN = 3  # samples on either side, of signals that need no smoothing: they are interpolated


@dataclass(frozen=True, eq=False)
class Setting:
    """Everything about a machine's logs that is chosen once, and kept while samples come.

    Attributes:
        rate: samples a second [Hz].
        logged: joints that determine the motion; independent: those in which errors are compared.
        channels: what is logged of each of `logged`, of "qva".
        wrenches: columns of external wrenches.
        cutoff: of the rows' zero-phase filter [Hz]; None: no filter.
        half: samples on either side from which derivatives are made; 0: taken as logged.
        taken: joints of `logged` whose q, v and a are taken as they are.
        noise: standard deviation of white noise, by column.
        still: (J,) speed below which a joint stands still [rad/s | m/s].
        farthest: (J, d) largest leverage of every joint; None for a tree.
        scale: (logged,) by which coordinates are divided where more are logged than needed.
        singular: ‖K⁺‖ from which on a sample is too near a singular position.
        y, q: (places, logged), (places, nq), configurations on the way of this machine.
    """

    rate: float
    logged: tuple[str, ...]
    independent: tuple[str, ...]
    channels: tuple[str, ...]
    wrenches: tuple[str, ...]
    cutoff: float | None
    half: int
    taken: tuple[str, ...]
    noise: Mapping[str, float]
    still: np.ndarray
    farthest: np.ndarray | None
    scale: np.ndarray
    singular: float
    y: np.ndarray
    q: np.ndarray

    @classmethod
    def of(cls, mechanism: Mechanism, motion: Motion) -> Setting:
        """As `complete` chose them from logs of the same machine.

        Args:
            mechanism: that moves.
            motion: of earlier logs, or of the first seconds.

        Raises:
            MotionError: for a motion that was not completed from logs.
        """
        if not motion.logs:
            raise MotionError(
                "this motion has no log, so nothing says what is logged; one of "
                "ident.complete(mechanism, log) has"
            )
        e, log = motion.experiments[0], motion.logs[0]
        at = [mechanism.joint_index[name] for name in e.logged]
        some = np.flatnonzero(e.usable)
        some = some[:: max(1, len(some) // PLACES)]
        far = [x for x in map(reach, motion.experiments) if x is not None]
        size = np.inf if e.pinv is None else SINGULAR * float(np.median(nearness(e)))
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
            rate=e.rate,
            logged=e.logged,
            independent=motion.independent,
            channels=channels,
            wrenches=tuple(name for name in log.columns if name.startswith("wrench.")),
            cutoff=motion.band.cutoff,
            half=0 if taken == e.logged else _half(e),
            taken=taken,
            noise={channel.column: channel.noise for channel in e.channels} | dict(e.noise),
            still=np.max([each.still for each in motion.experiments], axis=0),
            farthest=np.max(far, axis=0) if far else None,
            scale=np.maximum(e.y[:, at].std(axis=0), 1e-9),
            singular=min(HOPELESS, size),
            y=e.y[some][:, at],
            q=e.q[some],
        )

    @property
    def motion_columns(self) -> tuple[str, ...]:
        """Columns of the log from which the motion is made."""
        pairs = zip(self.logged, self.channels, strict=True)
        return tuple(f"{order}.{name}" for name, orders in pairs for order in orders)


def _half(e: Experiment) -> int:
    """M: samples on either side that a local polynomial needs to smooth as the log's splines do.

    One of degree N over 2 M + 1 samples passes what is below (N + 1)/(3.2 M − 4.6) of half the rate
    (R. Schafer, IEEE Signal Process. Mag. 28(4), 2011, eq. 11): of degree 6 over 1.6 knots to
    either side 1.4 times what splines pass, and leaves as much noise as they do.
    """
    widest = max((channel.spacing for channel in e.channels), default=0.0) * e.rate
    return max(CLEAN, round(REACH * widest))
