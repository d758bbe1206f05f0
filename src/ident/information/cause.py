"""The noun of whatever may explain a residual, and how large it is before any data are seen."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class Cause:
    """One thing that may be wrong, missing or changed: a calibration error, a fault of a channel or
    of the motion, an effect that sets in within a log.

    Attributes:
        name: in words, as `gain of tau.elbow` or `coulomb:elbow`; kind: of the error or the effect;
            places: joints, channels or lengths that have it.
        scale: one standard deviation in `unit`, of what is always there; 0 of what is not there
            unless proven; source: of that number.
    """

    name: str
    kind: str = ""
    places: tuple[str, ...] = ()
    scale: float = 0.0
    unit: str = "1"
    source: str = ""

    @property
    def place(self) -> str:
        """The first of its places; empty of the clock."""
        return self.places[0] if self.places else ""
