"""From an alarm that is raised to its words: when it is time to name it, and what is said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.monitor.alarm import Alarm, Change, Step
from ident.monitor.clean import Clean
from ident.monitor.interval import Interval
from ident.monitor.naming import Naming, Reading
from ident.monitor.reactions import changes
from ident.monitor.watched import Watched
from ident.solve.factor import Factor

ENOUGH = 4  # intervals since the onset before anything is named
STEADY = 3  # intervals in a row for which one suspect must lead alone


@dataclass
class Raised:
    """An alarm that waits for its name.

    Attributes:
        at: when it was sure [s]; height: evidence; by: what the leading chart is about.
        since: intervals since the onset; waited: since it was sure.
        leader: the suspect that leads alone, for `lead` intervals; told: whether it has been named.
    """

    at: float
    height: float
    by: str
    since: int
    waited: int = 0
    leader: str = ""
    lead: int = 0
    told: bool = False

    def ready(self, naming: Naming, length: int) -> bool:
        """Whether one suspect has led alone for long enough, on a window of `length` intervals."""
        alone = naming.best is not None and naming.sound and not naming.rivals
        leader = naming.best.suspect.label if naming.best and alone else ""
        self.lead = self.lead + 1 if leader and leader == self.leader else int(alone)
        self.leader = leader
        return self.lead >= STEADY and length >= ENOUGH


def alarm_of(
    watched: Watched,
    clean: Clean,
    reactions: Sequence[Factor],
    raised: Raised,
    naming: Naming,
    window: Sequence[Interval],
    threshold: float,
) -> Alarm:
    """The alarm in full.

    Args:
        watched, clean: what is watched, and normal running.
        reactions: of the multipliers to all columns.
        raised, naming: what was seen, and what it is called.
        window: intervals since the onset.
        threshold: of the evidence.
    """
    verdict = "cannot tell" if not naming.sound else "one of" if naming.rivals else "named"
    rows = np.maximum(np.sum([each.rows for each in window], axis=0), 1)
    usual = rows * np.where(clean.energy > 0, clean.energy, np.inf)
    rms = np.sqrt(np.sum([each.squares for each in window], axis=0) / usual)
    excess = naming.best.fall / naming.explained if naming.best else 1.0

    def change(reading: Reading) -> Change:
        suspect, dx = reading.suspect, np.zeros(len(watched.columns))
        dx[suspect.places] = reading.theta
        parts = zip(suspect.names, reading.theta, reading.stderr, suspect.units, strict=True)
        steps = tuple(
            Step(name, float(x), None if np.isnan(s) else float(s), u) for name, x, s, u in parts
        )
        explains = float(np.clip(reading.fall / excess, 0.0, 1.0))
        return Change(suspect.label, steps, explains, changes(watched, reactions, dx))

    return Alarm(
        onset=window[0].start,
        detected=raised.at,
        named=window[-1].end,
        verdict=verdict,
        best=change(naming.best) if naming.best else None,
        rivals=tuple(map(change, naming.rivals)),
        seen_by=raised.by,
        evidence=raised.height,
        threshold=threshold,
        errors={
            name: float(x)
            for name, x, energy in zip(watched.errors, rms, clean.energy, strict=True)
            if energy > 0
        },
    )
