"""What a mechanism did, and what a model says of it: all that a view needs to know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Moved(Protocol):
    """What of an experiment is shown."""

    @property
    def name(self) -> str:
        """The log's."""

    @property
    def t(self) -> np.ndarray:
        """(n,) [s]."""

    @property
    def q(self) -> np.ndarray:
        """(n, nq)."""


class Predicted(Protocol):
    """What of a prediction is shown, n samples, d joints, m multipliers."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names (d,)."""

    @property
    def measured(self) -> np.ndarray:
        """(n, d) [N m | N]."""

    @property
    def residual(self) -> np.ndarray:
        """(n, d) [N m | N]."""

    @property
    def multipliers(self) -> np.ndarray:
        """(n, m) λ."""

    @property
    def usable(self) -> np.ndarray:
        """(n,) samples that take part."""


@dataclass(frozen=True, eq=False)
class Track:
    """What a mechanism did in one experiment, n samples, and what a model says of it.

    Attributes:
        name: the experiment's.
        t: (n,) [s]; q: (n, nq) of the mechanism's model.
        multipliers: (n, m) λ, or None.
        residual: (n,) measured − predicted torque by joint [N m | N].
        torque: (n,) measured torque by joint, to whose rms the residual is compared; without it
            the residual is compared to its own rms.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    multipliers: np.ndarray | None = None
    residual: Mapping[str, np.ndarray] | None = None
    torque: Mapping[str, np.ndarray] | None = None

    @staticmethod
    def of(experiment: Moved, prediction: Predicted) -> Track:
        """Of an experiment and what a model says of it, on the same clock."""
        out = ~prediction.usable
        residual = {
            name: np.where(out, np.nan, prediction.residual[:, i])
            for i, name in enumerate(prediction.joints)
        }
        torque = {name: prediction.measured[:, i] for i, name in enumerate(prediction.joints)}
        return Track(
            experiment.name, experiment.t, experiment.q, prediction.multipliers, residual, torque
        )
