"""The health of the logged data: checks, each with number, threshold, meaning and remedy."""

from ident.health.check import Check
from ident.health.health import Health
from ident.health.judge import health

__all__ = ["Check", "Health", "health"]
