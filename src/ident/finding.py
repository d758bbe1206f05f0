"""The noun of all advice: one thing that a person should know before trusting a result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing that a person should know."""

    code: str  #: of its kind, such as `negative`
    meaning: str  #: a sentence
    remedy: str = ""  #: what to do about it
    where: tuple[str, ...] = ()  #: joints, bodies, parameters or logs that it is about
    number: float | None = None  #: what was measured, if it is that, …
    threshold: float | None = None  #: … and from which value on it is mentioned
    effects: tuple[str, ...] = ()  #: labels of effects with which a model takes it into account

    def __str__(self) -> str:
        return f"{self.meaning}; {self.remedy}" if self.remedy else self.meaning


def note(text: str) -> Finding:
    """Return a finding of words alone."""
    return Finding("note", text)
