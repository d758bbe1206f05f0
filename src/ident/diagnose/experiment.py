"""Which motion would tell more (first version)."""

from __future__ import annotations

from ident.diagnose.diagnosis import Diagnosis


def next_experiment(d: Diagnosis) -> str:
    """TODO"""
    return ""
