"""The type of a callback that long work reports its progress to."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with the name of the present step and the share of it that is done, 0 to 1."""

Told = Progress
