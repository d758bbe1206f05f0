"""Recorded experiments: read, checked, repaired and written. Knows no robot."""

from ident.log.columns import Column
from ident.log.log import Log
from ident.log.read import read_log

__all__ = ["Column", "Log", "read_log"]
