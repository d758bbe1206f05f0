"""What the channels of a stream show: dead, clipped, held, frozen, …, window by window.

The checks are those of a whole log (`fit/channel_checks.py`), on the last seconds. A joint that
rests in a window is not judged: its torque may well be constant or noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.fit.channel_checks import log_findings
from ident.fit.findings import Finding
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.state import State

SECONDS = 10.0  # [s] of a window
FEWEST = 400  # samples of a window
MOVING = 0.2  # share of a window in which a joint must move to be judged
REPORTED = 100  # kinds of findings, after which no other is reported


@dataclass(frozen=True)
class Since:
    """A finding, and the window in which it was first made."""

    finding: Finding
    t: float  # beginning of the window [s]

    def __str__(self) -> str:
        return f"since t = {self.t:.4g} s or later: {self.finding}"


class DataWatch:
    """Looks at windows of a stream; every kind of finding is reported once a channel.

    Args:
        mechanism: of the stream; like: a motion with its filter and independent joints.
        columns: of the samples, `t` first.

    Attributes:
        found: all so far.
    """

    def __init__(self, mechanism: Mechanism, like: Motion, columns: tuple[str, ...]) -> None:
        self._mechanism, self._columns = mechanism, columns
        self._like = Motion((), like.independent, like.band, 0.0)
        self._samples: list[np.ndarray] = []
        self._states: list[State] = []
        self.found: dict[tuple[str, tuple[str, ...]], Since] = {}

    def add(self, X: np.ndarray, states: list[State]) -> list[Since]:
        """Add samples (n, columns) and states that are complete; return what is new."""
        self._samples += [X] if len(X) else []
        self._states += [e for e in states if len(e)]
        count = sum(map(len, self._states))
        if not count or count < FEWEST:
            return []
        start, end = float(self._states[0].t[0]), float(self._states[-1].t[-1])
        if end - start < SECONDS or len(self.found) >= REPORTED:
            return []
        t, yd, ydd = (
            np.concatenate([getattr(e, name) for e in self._states]) for name in ("t", "yd", "ydd")
        )
        still, self._states = self._states[-1].still, []
        X = np.concatenate(self._samples)
        inside, after = (X[:, 0] >= start) & (X[:, 0] <= end), X[:, 0] > end
        self._samples = [X[after]] if after.any() else []
        index = self._mechanism.joint_index
        moving = (np.abs(yd) > still).mean(axis=0) > MOVING
        columns = {
            name: x
            for name, x in zip(self._columns[1:], X[inside].T[1:], strict=True)
            if (joint := name.partition(".")[2]) not in index or moving[index[joint]]
        }
        if not columns:
            return []
        name = self._mechanism.name
        log = Log.from_arrays(name, X[inside, 0], columns)
        state = State(
            name=name, t=t, tau=np.empty((len(t), 0)), usable=np.ones(len(t), dtype=bool),
            yd=yd, ydd=ydd, still=still,
        )  # fmt: skip
        like = self._like
        motion = Motion((state,), like.independent, like.band, 0.0, (), (log,), self._mechanism)
        new = []
        for each in log_findings(self._mechanism, motion):
            key = each.code, each.where
            if key not in self.found:
                self.found[key] = Since(each, start)
                new.append(self.found[key])
        return new
