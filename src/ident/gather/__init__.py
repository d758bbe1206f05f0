"""Logs in portions: larger than memory, many, on many machines; one fit."""

from ident.gather.diagnose_each import diagnose_each
from ident.gather.gather import gather
from ident.gather.gathered import Gathered
from ident.gather.verdicts import Verdicts

__all__ = ["Gathered", "Verdicts", "diagnose_each", "gather"]
