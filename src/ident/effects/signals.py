"""What effects see: time series of the joints they act on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ident.errors import MotionError


@dataclass(frozen=True)
class Signals:
    """Time series of some joints, in the order of `joints`, and the present model's say.

    Attributes:
        t: (n,) [s].
        q, v, a: (n, joints) [rad | m], [.../s], [.../s²].
        still: (joints,) speed [rad/s | m/s] below which a joint counts as standing still.
        extra: the log's other columns on the same clock, each (n,).
        shape: values of the effect's shape parameters.
        present: present values of all effects' parameters, by full name.
        predicted: gives (torque, load), both (n, joints) [N m | N]: what the present model predicts
            for each joint, and of it what the links ask for, without effects at that joint. In a
            closure's own joint both are the size of the closure's force.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    still: np.ndarray
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    shape: Mapping[str, float] = field(default_factory=dict)
    present: Mapping[str, float] = field(default_factory=dict)
    predicted: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None

    @property
    def torque(self) -> np.ndarray:
        """(n, joints) [N m | N] that the present model predicts; zero where there is no model."""
        return self.predicted()[0] if self.predicted else np.zeros_like(self.q)

    @property
    def load(self) -> np.ndarray:
        """(n, joints) [N m | N] that the joint passes on; zero where there is no model."""
        return self.predicted()[1] if self.predicted else np.zeros_like(self.q)

    @property
    def travel(self) -> np.ndarray:
        """(joints, 2) lowest and highest coordinate."""
        return np.stack([self.q.min(axis=0), self.q.max(axis=0)], axis=1)

    def column(self, name: str) -> np.ndarray:
        """Another column (n,) of the log.

        Raises:
            MotionError: if the log does not have it.
        """
        if name not in self.extra:
            raise MotionError(f"the log has no column '{name}', which this effect needs; log it")
        return self.extra[name]
