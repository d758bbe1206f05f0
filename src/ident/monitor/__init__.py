"""Health monitoring: a change of the machine is seen, and named with the effect library."""

from ident.monitor.alarm import Alarm, Change, Step
from ident.monitor.monitor import Monitor

__all__ = ["Alarm", "Change", "Monitor", "Step"]
