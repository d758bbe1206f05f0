"""Where the whole mechanism is, sample after sample, through its closures.

A position at which the closures cannot follow, or that is singular, is left out and counted; the
next sample sets out from the last position that was good.
"""

from __future__ import annotations

import numpy as np

from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.close import Closer
from ident.motion.place import in_tree, nearness, stated, with_leverage
from ident.online.setting import Setting


class Follower:
    """Completes motions of the logged joints, block by block.

    Args:
        mechanism: that moves.
        setting: of its logs.

    Attributes:
        lost: how many samples could not be completed; why: of the last of them.
    """

    def __init__(self, mechanism: Mechanism, setting: Setting) -> None:
        self._mechanism, self._setting = mechanism, setting
        self._closer = Closer(mechanism, setting.logged, setting.scale)
        self._q: np.ndarray | None = None
        self._y = np.empty(0)
        self._turning = [
            (i, joint)
            for i, joint in enumerate(mechanism.joints)
            if joint.rotational and not joint.in_tree
        ]
        self._own: dict[str, np.ndarray] = {}  # where closures' own joints were last: whole turns
        self.lost, self.why = 0, ""

    def __call__(self, base: Experiment, known: np.ndarray) -> tuple[Experiment, np.ndarray]:
        """The samples of an experiment that can be completed, and their places (kept,) in it.

        Args:
            base: with t, tau and extra.
            known: (3, n, logged) of the logged joints.
        """
        mechanism, names = self._mechanism, self._setting.logged
        if not mechanism.closures:
            return in_tree(mechanism, base, names, known), np.arange(len(base))
        q = self._followed(known[0], base.t)
        closed = np.flatnonzero(np.isfinite(q).all(axis=1))
        if not len(closed):
            return base.at_samples(closed), closed
        if len(closed) < len(q):
            base, known, q = base.at_samples(closed), known[:, closed], q[closed]
        v, a = self._closer.rates(q, *known[1:])
        near = {**self._own, **dict(zip(names, known[0].T, strict=True))}
        e = stated(mechanism, base, q, v, a, near)
        self._own = {joint.name: e.y[-1:, i] for i, joint in self._turning}
        e, _ = with_leverage(mechanism, e, self._setting.independent)
        regular = nearness(e) < self._setting.singular
        if regular.all():
            return e, closed
        at = float(e.t[np.argmin(regular)])
        self._lose(int((~regular).sum()), f"t = {at:.6g} s is near a singular position")
        return e.at_samples(regular), closed[regular]

    def _followed(self, y: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Configurations (n, nq) at the coordinates y (n, logged); NaN where there are none."""
        if self._q is None:
            self._start(y[0])
        assert self._q is not None
        try:
            q = self._closer.onward(self._q, self._y, y, t)
        except MotionError as error:
            if len(y) == 1:
                self._lose(1, str(error))
                self._q = None  # the next sample begins from a place that is known
                return np.full((1, self._mechanism.model.nq), np.nan)
            half = len(y) // 2
            return np.concatenate(
                [self._followed(y[:half], t[:half]), self._followed(y[half:], t[half:])]
            )
        self._q, self._y = q[-1], y[-1]
        return q

    def _start(self, y: np.ndarray) -> None:
        """Sets out from the known place that is nearest to y (logged,)."""
        off = np.abs(self._setting.y - y).max(axis=1)
        nearest = int(off.argmin())
        self._q, self._y = self._setting.q[nearest], self._setting.y[nearest]

    def _lose(self, count: int, why: str) -> None:
        self.lost, self.why = self.lost + count, why
