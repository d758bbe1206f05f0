"""The judgement on a machine that is watched, and on many logs of one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ident.assess.assessment import Assessment, Remainder
from ident.assess.errors import JointErrors
from ident.assess.good_enough import good_enough
from ident.motion import Motion
from ident.request import Step

if TYPE_CHECKING:  # they take time to import, and a fit needs none of them
    from ident.faults.disagreements import Disagreement
    from ident.streams.many_logs import LogComparison
    from ident.streams.monitor import Alarm
    from ident.streams.online import Snapshot

# shown: of the torque: a model that leaves more hides differences between logs
POOR = 0.05
# a motion around the logged one, on which a model is tested
TESTING = Step("excite", around=True)
WATCHED = 60.0  # shown: s of normal running, from which on alarms can be offered
MOSTLY = 0.9  # shown: of a log's difference, that a part must explain to be named


def assess_machine(
    name: str,
    snapshot: Snapshot,
    alarms: Sequence[Alarm],
    *,
    watched: bool,
    like: bool = False,
    acceptable: float | None = None,
) -> Assessment:
    """Judge a machine that runs: whether it has changed, and whether its model describes it.

    Args:
        name: of the mechanism; snapshot: the last one; alarms: all so far.
        watched: whether it is compared with normal running; like: whether logs of that were given.
        acceptable: share of the torque that the user accepts.
    """
    errors, noise = snapshot.errors, snapshot.noise
    bars = tuple(JointErrors(joint, error, noise=noise[joint]) for joint, error in errors.items())
    answer = good_enough(errors, noise, acceptable=acceptable)
    step = Step()
    # logs of normal running that were too short for alarms would raise none then either
    if not alarms and (watched or not like or not answer.fits):
        step = Step("monitor" if answer.fits or not answer.joints else "diagnose")
    verdict = "alarm" if alarms else "normal" if watched else "unwatched"
    floor = {joint: x for joint, x in noise.items() if x}
    left = Remainder.of(errors, floor)
    return Assessment(name, verdict, bars, left=left, good_enough=answer, next=step)


def watching_step(motion: Motion) -> Step:
    """Return the step that watches the machine from now on; none where the logs are too short to
    tell what is normal.
    """
    long = motion.duration * len(motion.names) >= WATCHED
    return Step("monitor") if long else Step()


def typical_error(x: LogComparison) -> float | None:
    """Return the typical error of logs' own fits, a share of the torque, where it is so large that
    it hides differences between them; None where it is small, or where some log stands out anyway.
    """
    typical = float(np.median([log.own for log in x.used if log.own is not None] or [0.0]))
    return typical if not x.odd and typical > POOR else None


def explained_alone(odd: Disagreement) -> bool:
    """Return whether one part of the model explains most of a log's difference."""
    return odd.share >= MOSTLY
