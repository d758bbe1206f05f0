"""Identification while samples come: the equations and factors of a batch, step by step."""

from ident.online.online import Online as Online
from ident.online.setting import Setting as Setting
from ident.online.snapshot import Snapshot as Snapshot
from ident.online.stream import Stream as Stream
