"""Logs in portions, on many machines or sample by sample: sums of the same triangles."""

from ident.streams.diagnose_each import Verdicts, diagnose_each
from ident.streams.gather import Gathered, gather
from ident.streams.monitor import Alarm, Monitor
from ident.streams.online import Online, Snapshot
from ident.streams.stream import Setting, Stream

__all__ = [
    "Alarm", "Gathered", "Monitor", "Online", "Setting", "Snapshot", "Stream", "Verdicts",
    "diagnose_each", "gather",
]  # fmt: skip
