"""The measured channels of the joints' motion, with the noise that the data show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.motion.measure import Signals
from ident.motion.spectrum import noise_level

ORDERS = "qva"
SHARPEST = 1e-3  # noise of a derivative over that of what it derives, a log's length
GRAINS = 20  # changes of a signal from which its step can be told
MOST = 1000.0  # steps between two samples beyond which multiples are no sign of anything
NIL = 1e-12  # rad, m and their rates: what moves less stands still, but for rounding
ROUNDING = 1e-9  # of its spread, or of 1 rad or m: no channel is trusted better


@dataclass(frozen=True, eq=False)
class Channel:
    """What was logged of one derivative of one joint's coordinate.

    Attributes:
        joint: its name; order: 0 position, 1 velocity, 2 acceleration.
        t, x: (n,) as logged; sigma: its noise; spread: its standard deviation.
    """

    joint: str
    order: int
    t: np.ndarray
    x: np.ndarray
    sigma: float
    spread: float

    @property
    def column(self) -> str:
        """Its name in the log."""
        return f"{ORDERS[self.order]}.{self.joint}"

    @property
    def noise(self) -> float:
        """Its noise as a share of its spread; 0 for a constant."""
        return self.sigma / self.spread if self.spread > 0 else 0.0

    def within(self, t: np.ndarray) -> Channel:
        """Its samples in a run of the clock t (n,)."""
        margin = 0.75 * (t[1] - t[0]) if len(t) > 1 else 0.0
        a, b = np.searchsorted(self.t, (t[0] - margin, t[-1] + margin))
        return Channel(self.joint, self.order, self.t[a:b], self.x[a:b], self.sigma, self.spread)

    def with_noise(self, sigma: float) -> Channel:
        """The channel with another noise."""
        return Channel(self.joint, self.order, self.t, self.x, sigma, self.spread)


@dataclass(frozen=True)
class Smoothed:
    """What smoothing did to a channel.

    Attributes:
        column: of the log; how: in words.
        noise: its estimated white noise; a channel that the others contradict weighs less.
        residual: rms of measured minus smoothed; 0 where it was taken as logged.
        spacing: of the knots [s]; 0 where there are none.
    """

    column: str
    how: str
    noise: float
    residual: float
    spacing: float = 0.0


def channels_of(signals: Signals, names: Sequence[str]) -> list[Channel]:
    """All motion channels that a log has of some joints."""
    found: list[Channel] = []
    for name in names:
        for order, letter in enumerate(ORDERS):
            column = f"{letter}.{name}"
            if column not in signals.columns:
                continue
            t, x = signals.log.series(column)
            spread = _spread(x)
            sigma = max(noise_level(signals.even(column)[0]), float(grain(x) / np.sqrt(12.0)))
            sigma = max(sigma, ROUNDING * (spread or 1.0))
            if found and found[-1].joint == name:  # beside noisy positions no rate is exact
                before = found[-1]
                sigma = max(sigma, SHARPEST * before.sigma / float(np.ptp(t)))
            found.append(Channel(name, order, t, x, sigma, spread))
    return found


def _spread(x: np.ndarray) -> float:
    """Standard deviation of a signal (n,); 0 for a constant, but for rounding."""
    return float(np.std(x)) if float(np.ptp(x)) > NIL else 0.0


def grain(x: np.ndarray) -> float:
    """The step of a signal (n,) that only takes multiples of one; 0 for others."""
    steps = np.abs(np.diff(x))
    steps = steps[steps > 0]
    if len(steps) < GRAINS:
        return 0.0
    least = float(steps.min())
    if least * MOST < float(steps.max()):
        return 0.0
    off = steps / least
    whole = np.round(off)
    multiples = (np.abs(off - whole) < 0.01 * off).all()
    return least if multiples and np.ptp(whole) > 0 else 0.0  # a ramp has one step only


def periods(channels: Sequence[Channel]) -> float:
    """The shortest median step among the channels [s]."""
    return min(float(np.median(np.diff(channel.t))) for channel in channels)
