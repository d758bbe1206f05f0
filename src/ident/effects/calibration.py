"""Errors of a calibration that no library entry of its own names: a clock, a late encoder.

They are in no diagnosis: every fit carries them as unknowns with priors (`fit.calibration`).
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ident.effects.drive import LATEST
from ident.effects.effect import Correcting, Correction, Signals, Unknown
from ident.information.cubic import late

FASTEST = 0.5  # range: share by which a clock may be off


class ClockError(Correcting):
    """A clock that is fast or slow, by the same share all the time."""

    kind = "clock"
    arity = 0
    sits = "mechanism"
    shapes: ClassVar = (
        Unknown("s", ("1", "1"), "true over logged time, less 1", range=(-FASTEST, FASTEST)),
    )
    equation = "v → v/(1 + s), a → a/(1 + s)²"
    signature = "inertia and viscous friction are wrong in proportion, gravity is right"
    source = "JCGM 100 (GUM), 2008, sect. 4.3"

    def correction(self, s: Signals) -> Correction:
        return Correction(clock=s.shape["s"])


class LateTorque(Correcting):
    """A torque channel that is read late against the other channels.

    The change is that of the torque which the model predicts: the measured one has noise, which is
    in the residual as well.
    """

    kind = "late_torque"
    sits = "driven"
    shapes: ClassVar = (
        Unknown("d", ("s", "s"), "by which the torque is late", range=(-LATEST, LATEST)),
    )
    equation = "τ + τ̂(t) − τ̂(t − d), with the torque τ̂ that the model predicts"
    signature = "the residual is large where the torque changes fast, with its slope"
    source = "Björklund, Ljung, IEEE CDC 2003"

    def correction(self, s: Signals) -> Correction:
        return Correction(late={self.joints[0]: s.shape["d"]})


class LatePosition(Correcting):
    """An encoder that is read late against the other channels, with its rates."""

    kind = "late_position"
    shapes: ClassVar = (
        Unknown("d", ("s", "s"), "by which the position is late", range=(-LATEST, LATEST)),
    )
    equation = "q(t) logged at t + d"
    signature = "coupling torques are shifted against the joint's own"
    source = "Björklund, Ljung, IEEE CDC 2003"

    def correction(self, s: Signals) -> Correction:
        logged = np.stack([s.q[:, 0], s.v[:, 0], s.a[:, 0]], axis=1)
        return Correction(dq={self.joints[0]: (late(s.t, logged, -s.shape["d"]) - logged).T})
