"""Errors of torques by joint: before and now, and what noise of the sensors alone would leave."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ident.fit import Fit
from ident.information.blocks import Error
from ident.information.evidence import NOISY

# names of errors before, each the only one for its thing
URDF_NUMBERS, EARLIER_NUMBERS = "with the URDF's numbers", "with the earlier numbers"
REFITTED_BODIES, REFITTED_MODEL = "with bodies refitted", "with bodies and effects refitted"
BEFORE_NAMES = (URDF_NUMBERS, EARLIER_NUMBERS, REFITTED_BODIES, REFITTED_MODEL)
SAME = 0.05  # shown: of an error: a change below is what other samples of one log would make


@dataclass(frozen=True)
class JointErrors:
    """The error of one joint's torque before and now, and what noise alone would leave of it.

    Attributes:
        joint: an independent one.
        before: the error before [N m | N], the only one where nothing has changed.
        after: the error now; None where there is one error only.
        noise: rms that noise of the sensors alone would leave [N m | N]; None where unknown.
        larger: whether it is larger now, where that was decided by more than its share of the
            torque; None elsewhere.
    """

    joint: str
    before: Error
    after: Error | None = None
    noise: float | None = None
    larger: bool | None = None

    @property
    def now(self) -> Error:
        """The error now."""
        return self.after or self.before

    @property
    def sizes(self) -> tuple[float, float, float | None]:
        """Before, after and noise as shares of the measured torque; 0 where there is none. After
        and noise are those of one log, which may be another than that of before.
        """
        before, after = self.before, self.now
        if not before.relative or not before.rms:
            return 0.0, 0.0, None
        torque = after.rms / after.relative if after.relative else before.rms / before.relative
        share = after.rms / torque if after.relative is None else after.relative
        return before.relative, share, self.noise / torque if self.noise else None

    @property
    def rises(self) -> bool:
        """Whether the error is larger now."""
        if self.larger is not None:
            return self.larger
        before, after = self.before, self.now
        if before.relative is None or after.relative is None:
            return after.rms > (1 + SAME) * before.rms
        return after.relative > (1 + SAME) * before.relative

    @property
    def falls(self) -> bool:
        """Whether the error is smaller now."""
        return self.now.rms < (1 - SAME) * self.before.rms

    @property
    def times_noise(self) -> float:
        """The error now as a multiple of the noise; infinite where that is not known."""
        return times_noise(self.now, self.noise)


def joint_errors(
    before: Mapping[str, Error], now: Mapping[str, Error], noise: Mapping[str, float | None]
) -> tuple[JointErrors, ...]:
    """Return errors now by joint, with those before where they are known; without joints whose
    torque is not measured.
    """
    return tuple(
        JointErrors(joint, before.get(joint, error), error if joint in before else None, floor)
        for joint, error in now.items()
        if not error.unmeasured
        for floor in [noise.get(joint)]
    )


def times_noise(error: Error, noise: float | None) -> float:
    """Return an error as a multiple of the noise of the sensors; infinite where that is unknown."""
    return error.rms / noise if noise else math.inf


def too_large(
    errors: Mapping[str, Error], floor: Mapping[str, float], acceptable: float
) -> list[str]:
    """Return the joints, the farthest above noise first, whose error is above a share `acceptable`
    of the torque, and above the noise of the sensors. Noise that is not known is no excuse.
    """
    times = {joint: times_noise(error, floor.get(joint)) for joint, error in errors.items()}
    large = [
        joint
        for joint, error in errors.items()
        if times[joint] > NOISY and (1.0 if error.relative is None else error.relative) > acceptable
    ]
    return sorted(large, key=lambda joint: -times[joint])


def share_range(errors: Iterable[Error | None]) -> tuple[float, float] | None:
    """Return the least and the largest relative error; None where no torque was measured."""
    shares = [error.relative for error in errors if error and error.relative is not None]
    return (min(shares), max(shares)) if shares else None


def noise_errors(fit: Fit) -> dict[str, Error]:
    """Return what noise alone would leave in each joint, as the errors of its fit are stated."""
    errors = fit.held_out or fit.train
    return {
        joint: replace(
            error,
            rms=fit.noise[joint],
            relative=error.relative and error.relative * fit.noise[joint] / max(error.rms, 1e-300),
        )
        for joint, error in errors.items()
        if not fit.train[joint].unmeasured
    }


def largest_change(first: Mapping[str, Error], last: Mapping[str, Error]) -> Sequence[str]:
    """Return the joints, the one whose error changes most against its torque first."""
    change = {
        joint: abs(error.rms - last[joint].rms) * ((error.relative or 0) / (error.rms or 1))
        for joint, error in first.items()
        if joint in last and not error.unmeasured
    }
    return sorted(change, key=lambda joint: -change[joint])
