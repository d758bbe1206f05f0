"""Where a model fails, which effects are missing, and what is wrong with the data."""

from ident.diagnosis.data_checks import Health, health
from ident.diagnosis.diagnosis import Diagnosis, diagnose
from ident.diagnosis.grow import History, grow

__all__ = ["Diagnosis", "Health", "History", "diagnose", "grow", "health"]
