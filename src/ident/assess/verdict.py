"""The judgement on a diagnosis: what it found, how sure that is, and what is left."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from ident.assess.errors import NOISY, too_large
from ident.assess.good_enough import scale_doubts
from ident.faults.data_checks import Health
from ident.faults.fault import UNITS
from ident.finding import Finding
from ident.fit import Fit
from ident.fit.files import Saved
from ident.fit.findings import DRIVING
from ident.fit.residual import Failure
from ident.information.blocks import Error
from ident.information.estimate import MATERIAL
from ident.information.evidence import MAIN_CAUSE

if TYPE_CHECKING:  # a fit is judged without what a diagnosis needs
    from ident.diagnosis.result import Diagnosis

BODIES = 0.3  # range: difference of logarithms that the masses of a URDF make


def errors_with_named(d: Diagnosis) -> Mapping[str, Error]:
    """Return the errors with what is named, or else with the laws; nothing without either."""
    if d.best is not None:
        return d.after
    return d.laws[-1].after if d.laws else {}  # its fit has all laws


def _errors(fit: Fit) -> Mapping[str, Error]:
    """Return errors held out, or of the fitted data where the log is too short for that."""
    return fit.held_out or fit.train


def failing_joints(d: Diagnosis) -> list[Failure]:
    """Return the joints in which more than noise is left, the worst first; none if clean."""
    if d.verdict == "nothing":
        return []
    errors = _errors(d.fit)
    noisy = [f for f in d.where if errors[f.joint].rms > NOISY * d.floor[f.joint]]
    return noisy or [*d.where[:1]]


def spoiling_faults(d: Diagnosis) -> list[Finding]:
    """Return the faults of data that explain the log, where no effect is named beside them."""
    return [] if d.best else faults_that_explain(d.health)


def faults_that_explain(health: Health) -> list[Finding]:
    """Return the faults of data that explain a log, as does another unit of several torques."""
    units = [
        finding
        for finding in scale_doubts(health.findings)
        if finding.number
        and finding.where[1:]
        and any(abs(abs(math.log(finding.number)) - math.log(unit)) < BODIES for unit in UNITS)
    ]
    return [*health.faults, *units]


def doubts_of(health: Health, findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return what looks wrong in the data of a fit: faults, sizes of torques, and their signs."""
    turned = [  # torques: driving friction, the negative of what the URDF's bodies need
        finding
        for finding in (*health.findings, *findings)
        if finding.code == DRIVING or (finding.code == "unlike" and (finding.threshold or 0.0) < 0)
    ]
    return (*health.faults, *scale_doubts(health.findings), *turned)


def share_unexplained(d: Diagnosis) -> float:
    """Return the share of squares beyond noise that the group leaves where the first name acts."""
    joint = d.candidates[0].joint
    if joint not in d.loud:
        return 0.0
    floor = d.floor[joint] ** 2
    squares = (e.rms**2 for e in (_errors(d.fit)[joint], d.after[joint]))
    before, rest = (max(square - floor, 0.0) for square in squares)
    return rest / max(before, floor)


def clock_is_a_rival(d: Diagnosis) -> bool:
    """Return whether another scale of time does as well as the best effect."""
    return any(finding.code == "time" for finding in d.health.findings)


def is_open(d: Diagnosis) -> bool:
    """Return whether this data cannot tell something from what is named."""
    return bool(d.rivals_in_group) or clock_is_a_rival(d)


def incomplete_before(d: Diagnosis) -> dict[str, Error]:
    """Return by joint the errors that an earlier model left beyond noise in its own log, where it
    leaves no more here; none where it does worse in some joint than then.
    """
    earlier = d.fit.earlier
    errors = earlier.errors if isinstance(earlier, Saved) else {}
    then = errors.get("held out") or errors.get("train") or {}
    if d.verdict == "nothing" or d.fit.residual.increased_errors(then):
        return {}
    return {joint: then[joint] for joint in too_large(then, d.floor, MATERIAL)}


def joints_at_reversals(d: Diagnosis) -> list[str]:
    """Return joints where nothing is named, more than noise is left, and reversals fit worse."""
    if d.reversing:
        return [*d.loud]
    worse = {j for note in d.fit.all_findings if note.code == "reversals" for j in note.where}
    errors = _errors(d.fit) if d.verdict == "nothing" else {}
    return [j for j, e in errors.items() if j in worse and e.rms > NOISY * d.floor[j]]


def formulas_explain(d: Diagnosis) -> bool:
    """Return whether the formulas take more than half of the error of each of their joints."""
    before, after = (d.laws[0].before, d.laws[-1].after) if d.laws else ({}, {})
    return all(after[law.felt].rms < MAIN_CAUSE * before[law.felt].rms for law in d.laws)


def noisy_joints(errors: Mapping[str, Error], floor: Mapping[str, float]) -> Sequence[str]:
    """Return the joints whose error is more than noise of the sensors."""
    return [joint for joint, error in errors.items() if error.rms > NOISY * floor[joint]]
