"""Where a model fails, which effects are missing, and what is wrong with the data."""

from ident.diagnosis.diagnosis import diagnose, health
from ident.diagnosis.grow import History, grow
from ident.diagnosis.result import Diagnosis
from ident.faults.data_checks import Health

__all__ = ["Diagnosis", "Health", "History", "diagnose", "grow", "health"]
