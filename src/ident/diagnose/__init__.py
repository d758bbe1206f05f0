"""Where a model fails, which physical effect is missing, and how the error falls with it."""

from ident.diagnose.diagnose import diagnose
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.grow import History, grow

__all__ = ["Diagnosis", "History", "diagnose", "grow"]
