"""The noun that an alarm is: since when, what, how much, how sure, and what it may also be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from markupsafe import Markup

from ident.show.html import Shown, definitions, items, strong
from ident.tables import rounded

BLIND = 10.0  # times a change: a standard error beyond which it is not told


@dataclass(frozen=True)
class Step:
    """How much one parameter has changed; the standard error is None where it is not told alone."""

    name: str
    change: float
    stderr: float | None
    unit: str

    def __str__(self) -> str:
        said = rounded(self.change, self.stderr)
        return f"{self.name} {'' if said.startswith('-') else '+'}{said} {self.unit}".rstrip()


@dataclass(frozen=True)
class Change:
    """One cause, and what it would have done.

    Attributes:
        label: `coulomb:elbow`.
        steps: of its parameters.
        explains: share of the squares beyond noise that it explains.
        reactions: by multiplier, rms of the change of its force in normal running [N | N m].
    """

    label: str
    steps: tuple[Step, ...]
    explains: float
    reactions: Mapping[str, float]

    def __str__(self) -> str:
        known = [step for step in self.steps if step.stderr is not None]
        # what the motion does not tell by itself has an error without bound
        told = [step for step in known if (step.stderr or 0.0) < BLIND * abs(step.change)] or known
        told = told or list(self.steps)
        return f"{self.label}: {', '.join(map(str, told))}"


@dataclass(frozen=True)
class Alarm(Shown):
    """Something has changed.

    Attributes:
        onset, detected, named: since when, when it was sure, when it was named [s].
        verdict: `named`, `one of` (what this motion does not tell apart) or `cannot tell` (nothing
            in the library explains it).
        best: the likeliest cause; rivals: others that it may be.
        seen_by: what the leading chart is about.
        evidence: logarithm of the charts' sum when it was sure; threshold: at which that was.
        errors: by joint and multiplier, rms of the error over its normal size, until it was named.
    """

    onset: float
    detected: float
    named: float
    verdict: str
    best: Change | None
    rivals: tuple[Change, ...]
    seen_by: str
    evidence: float
    threshold: float
    errors: Mapping[str, float]

    @property
    def suspects(self) -> tuple[str, ...]:
        """Labels of all that it may be, the likeliest first; none where that cannot be told."""
        if self.verdict == "cannot tell" or self.best is None:
            return ()
        return (self.best.label, *(each.label for each in self.rivals))

    @property
    def headline(self) -> str:
        """In one line."""
        since = f"{self.onset:.2f} s"
        if not self.suspects or self.best is None:
            near = f"; nearest, but no explanation: {self.best.label}" if self.best else ""
            return f"since {since} something has changed, cannot tell what{near}"
        if self.verdict == "named":
            return f"since {since} changed: {self.best}"
        return f"since {since} changed: one of {', '.join(self.suspects)}"

    @property
    def lines(self) -> list[str]:
        """What the headline does not say."""
        found = [
            f"sure at {self.detected:.2f} s by {self.seen_by}, evidence {self.evidence:.1f} of "
            f"{self.threshold:.1f}; named at {self.named:.2f} s"
        ]
        for change in (self.best, *self.rivals) if self.best else ():
            found.append(f"{change}, explains {100 * change.explains:.0f} %")
            felt = {name: x for name, x in change.reactions.items() if x > 0}
            if felt:
                said = ", ".join(f"{name} by {x:.2g}" for name, x in felt.items())
                found.append(f"  it would change the reaction {said} rms")
        ratios = ", ".join(f"{name} {x:.3g}" for name, x in self.errors.items())
        return [*found, f"errors over their normal size: {ratios}"]

    def __str__(self) -> str:
        return "\n".join([self.headline, *(f"  {line}" for line in self.lines)])

    __repr__ = __str__

    def json(self) -> dict[str, Any]:
        """For a file of alarms."""
        return asdict(self)

    def _blocks(self) -> tuple[Markup, ...]:
        said = {
            "Sure at": f"{self.detected:.2f} s, by {self.seen_by}",
            "Named at": f"{self.named:.2f} s",
            "Verdict": self.verdict,
        }
        return strong(self.headline), definitions(said), items(self.lines)
