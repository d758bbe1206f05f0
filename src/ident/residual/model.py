"""What has a residual: anything that says every parameter of a mechanism."""

from __future__ import annotations

from typing import Protocol

from ident.equations.point import Point
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion


class Model(Protocol):
    """A mechanism with the values of all its parameters: a fit, or one read from a file."""

    @property
    def mechanism(self) -> Mechanism:
        """With its effects."""

    @property
    def point(self) -> Point:
        """Values of all parameters."""

    @property
    def name(self) -> str:
        """In tables."""

    @property
    def motion(self) -> Motion | None:
        """That it was fitted to; None if it was read from a file."""
