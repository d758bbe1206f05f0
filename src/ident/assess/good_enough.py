"""Whether the errors of a model are good enough: yes, no, or not tested on another log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from ident.assess.errors import NOISY, share_range, times_noise, too_large
from ident.faults.data_checks import FAULTS
from ident.finding import Finding
from ident.information.blocks import Error
from ident.information.estimate import MATERIAL
from ident.information.evidence import EXPLAINED_BELOW

# shown: share of a joint's torque below which a model describes its own log, in what is said of it
DESCRIBES = 0.05


class Answer(StrEnum):
    """Whether a model is good enough."""

    YES = "yes"
    NO = "no"
    NOT_TESTED = "not_tested"  # it fits its own log, or nothing can be said


class Reason(StrEnum):
    """What an answer rests on."""

    NOISE = "noise"  # in every joint the error is noise of the sensors
    SMALL = "small"  # it is that, or below what is acceptable
    LARGE = "large"  # it is above noise and above what is acceptable
    HIDDEN = "hidden"  # noise is so large that a cause could hide in it
    DOUBTFUL = "doubtful"  # it is small, but the size of the torques looks wrong
    COMPUTED = "computed"  # the torques are a model's own, and it fits itself
    UNKNOWN = "unknown"  # of a log without noise, or without measured torques


@dataclass(frozen=True)
class GoodEnough:
    """The answer to whether a model's errors are good enough, and what it rests on.

    Attributes:
        answer: yes or no of a log that was held back; of the log that was fitted no, where its own
            error is large, or not tested.
        reason: what decides.
        logs: names of the logs that were held back; none of the log that was fitted.
        joints: whose error is too large, the farthest above noise first; with `HIDDEN` the joint in
            which a cause could hide.
        count: joints with a torque.
        errors: least and largest share of the torque, of `joints`, or of all where there are none.
        noise: least and largest share that noise would leave of these; None where it is unknown.
        acceptable: share of the torque that is acceptable; stated: by the user.
        near_reversals: whether it is too large near reversals of dry friction only.
        times: the largest multiple of the noise, where the errors count as noise.
    """

    answer: Answer = Answer.NOT_TESTED
    reason: Reason = Reason.UNKNOWN
    logs: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    count: int = 0
    errors: tuple[float, float] | None = None
    noise: tuple[float, float] | None = None
    acceptable: float = MATERIAL
    stated: bool = False
    near_reversals: bool = False
    times: float | None = None

    @property
    def fits(self) -> bool:
        """Whether the errors are noise or small, on whichever log they were computed."""
        return self.reason in (Reason.NOISE, Reason.SMALL)


def good_enough(
    errors: Mapping[str, Error],
    floor: Mapping[str, float],
    *,
    acceptable: float | None = None,
    away_from_reversals: Mapping[str, float] | None = None,
    logs: Sequence[str] = (),
    doubts: Iterable[Finding] = (),
) -> GoodEnough:
    """Decide whether the errors of all joints are noise, or too small to matter.

    Args:
        errors, floor: by joint, of the model and what noise of the sensors makes [N m | N].
        acceptable: share of the torque that the user accepts; None: 0.3 %.
        away: rms away from reversals of joints with dry friction [N m | N].
        logs: that were held back; none where the errors are those of the log that was fitted.
        doubts: on the data.
    """
    least, doubts = MATERIAL if acceptable is None else acceptable, [*doubts]
    known = {
        joint: error
        for joint, error in errors.items()
        if not error.unmeasured and (acceptable is not None or floor.get(joint))
    }
    if not known:
        return GoodEnough(logs=tuple(logs), acceptable=least, stated=acceptable is not None)
    noise = {joint: noise_share(error, floor.get(joint)) for joint, error in known.items()}

    def result(answer: Answer, reason: Reason, joints: Sequence[str] = ()) -> GoodEnough:
        of = joints or [*known]
        shares = [share for joint in of if (share := noise[joint]) is not None]
        return GoodEnough(
            answer, reason, tuple(logs), tuple(joints), len(known),
            share_range(known[joint] for joint in of),
            (min(shares), max(shares)) if shares else None, least, acceptable is not None,
        )  # fmt: skip

    if large := too_large(known, floor, least):
        worst = share_range(known[joint] for joint in large)
        spoilt = any(finding.code in FAULTS for finding in doubts)
        describes = acceptable is None and worst is not None and worst[1] < DESCRIBES
        answer = Answer.NOT_TESTED if describes and not (logs or spoilt) else Answer.NO
        beyond = [
            joint
            for joint in large
            if not _only_at_reversals(joint, away_from_reversals or {}, floor)
        ]
        results = result(answer, Reason.LARGE, large)
        return replace(results, near_reversals=not beyond)
    share = {
        joint: max(error.relative or 0.0, noise[joint] or 0.0) for joint, error in known.items()
    }
    hiding = max(share, key=lambda joint: share[joint])  # a cause could hide there
    if share[hiding] > max(EXPLAINED_BELOW, least):
        return result(Answer.NOT_TESTED, Reason.HIDDEN, [hiding])
    if any(finding.code == "computed" for finding in doubts):
        return result(Answer.NO, Reason.COMPUTED)
    if scale_doubts(doubts):
        return result(Answer.NOT_TESTED, Reason.DOUBTFUL)
    most = max(times_noise(error, floor.get(joint)) for joint, error in known.items())
    reason = Reason.SMALL if most > NOISY else Reason.NOISE
    answered = result(Answer.YES if logs else Answer.NOT_TESTED, reason)
    return replace(answered, times=most if reason is Reason.NOISE else None)


def noise_share(error: Error, noise: float | None) -> float | None:
    """Return what noise alone would leave as a share of the torque; None where it is unknown."""
    if not noise or not error.relative or not error.rms:
        return None
    return error.relative * noise / error.rms


def scale_doubts(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings on the size of torques: a fit follows them, whatever their unit is."""
    return [finding for finding in findings if finding.code == "magnitude"]


def _only_at_reversals(
    joint: str, away_from_reversals: Mapping[str, float], floor: Mapping[str, float]
) -> bool:
    return joint in away_from_reversals and away_from_reversals[joint] <= NOISY * floor.get(
        joint, 0.0
    )
