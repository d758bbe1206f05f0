"""The judgement on a result as data, from which terminal, page, notebook and JSON are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ident.assess.errors import NOISY, JointErrors, share_range, times_noise
from ident.assess.good_enough import GoodEnough
from ident.effects import Effect
from ident.finding import Finding
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.request import Step

Range = tuple[float, float]  # the least and the largest


@dataclass(frozen=True)
class NamedCause:
    """What was found: effects of one kind, with their values, and what may be in their place.

    Attributes:
        effects: of one kind, in several joints perhaps.
        values: of their parameters, as far as they were identified.
        rivals: effects that this data cannot tell from them.
        changed: whether the model had them, with other values.
    """

    effects: tuple[Effect, ...]
    values: tuple[Value, ...] = ()
    rivals: tuple[Effect, ...] = ()
    changed: bool = False

    def json(self) -> dict[str, Any]:
        """Return the cause for a file."""
        return {
            "effects": [effect.label for effect in self.effects],
            "values": {value.name: [value.value, value.stderr] for value in self.values},
            "rivals": [effect.label for effect in self.rivals],
            "changed": self.changed,
        }


@dataclass(frozen=True)
class Remainder:
    """What is left beyond the noise of the sensors.

    Attributes:
        joints: the farthest above noise first; none where noise is all that is left.
        share: least and largest share of the torque of these joints.
        times: least and largest multiple of the noise; infinite where noise is not known.
        near_reversals: whether it is left where a speed with dry friction reverses only.
        within_known: whether standard errors of values that are known from another log make as
            much.
    """

    joints: tuple[str, ...] = ()
    share: Range | None = None
    times: Range | None = None
    near_reversals: bool = False
    within_known: bool = False

    @classmethod
    def of(
        cls,
        errors: Mapping[str, Error],
        floor: Mapping[str, float],
        near_reversals: Sequence[str] = (),
        material: float = 0.0,
    ) -> Remainder:
        """Return what errors leave beyond the noise and above a share `material` of the torque."""
        times = {
            joint: times_noise(error, floor.get(joint))
            for joint, error in errors.items()
            if not error.unmeasured
            and (1.0 if error.relative is None else error.relative) > material
        }
        joints = sorted((j for j in times if times[j] > NOISY), key=lambda j: -times[j])
        if not joints:
            return cls()
        ends = times[joints[-1]], times[joints[0]]
        shares = share_range(errors[joint] for joint in joints)
        return cls(tuple(joints), shares, ends, {*joints} <= {*near_reversals})

    def json(self) -> dict[str, Any]:
        """Return what is left for a file."""
        return {
            "joints": list(self.joints), "share": self.share, "times_noise": self.times,
            "near_reversals": self.near_reversals,
        }  # fmt: skip


@dataclass(frozen=True)
class Assessment:
    """The judgement on a result, made once for everyone who reads it.

    Attributes:
        subject: what was judged on which logs, as `arm on run.csv`.
        verdict: of a diagnosis and of a grown model that of the diagnosis; of a fit `identified`;
            of a comparison `changed`, `unchanged`, `falls`, `rises`, `mixed` or `same`; of a
            machine that is watched `alarm`, `normal` or `unwatched`.
        errors: before, now and the floor of noise, joint by joint.
        compared: what errors before and now are of.
        causes: what was found; left: what is not explained; doubts: on the data.
        good_enough: the answer, and what it rests on.
        next: the step that goes on from here.
        worst: joint that is looked at first.
        changed: joints in which an earlier model clearly does worse than on its own log, the most
            first; unmeasured_before: without a measured torque then; other_machine: whether so much
            has changed that the log may be of another machine.
        spoilt: whether the doubts explain the log, so that its numbers say nothing.
        untrusted: whether so much is unexplained that identified values are not to be trusted.
        freely: of a machine that swings freely, with torques of 0 throughout, the largest error as
            a share of gravity's torque; None for others.
    """

    subject: str
    verdict: str
    errors: tuple[JointErrors, ...] = ()
    compared: tuple[str, str] = ("", "")
    causes: tuple[NamedCause, ...] = ()
    left: Remainder = field(default_factory=Remainder)
    doubts: tuple[Finding, ...] = ()
    good_enough: GoodEnough = field(default_factory=GoodEnough)
    next: Step = field(default_factory=Step)
    worst: str = ""
    changed: tuple[str, ...] = ()
    unmeasured_before: tuple[str, ...] = ()
    other_machine: bool = False
    spoilt: bool = False
    untrusted: bool = False
    freely: float | None = None

    @property
    def before(self) -> Range | None:
        """Least and largest share of the torque before; None where there is no error before."""
        return share_range(error.before for error in self.errors if error.after is not None)

    @property
    def now(self) -> Range | None:
        """Least and largest share of the torque now."""
        return share_range(error.now for error in self.errors)

    @property
    def floor(self) -> Range | None:
        """Least and largest share of the torque that noise would leave; None where unknown."""
        shares = [share for error in self.errors if (share := error.sizes[2]) is not None]
        return (min(shares), max(shares)) if shares else None

    @property
    def increased(self) -> tuple[str, ...]:
        """Joints whose error is larger now."""
        return tuple(error.joint for error in self.errors if error.rises)

    def json(self) -> dict[str, Any]:
        """Return the judgement for a file."""
        answer = self.good_enough
        return {
            "verdict": self.verdict, "before": self.before, "now": self.now, "floor": self.floor,
            "found": [cause.json() for cause in self.causes], "left": self.left.json(),
            "doubts": [str(doubt) for doubt in self.doubts],
            "good_enough": {"answer": str(answer.answer), "reason": str(answer.reason)},
            "next": self.next.json(),
        }  # fmt: skip
