"""Recorded experiments: read, checked, repaired and written. Independent of any robot."""

from ident.log.log import Log
from ident.log.read import read_log
from ident.log.table import Column

__all__ = ["Column", "Log", "read_log"]
