"""Where a model fails: what it leaves unexplained, and on what that depends."""

from ident.residual.failure import Dependence, Failure
from ident.residual.gather import residual_of
from ident.residual.periods import Periods, periods
from ident.residual.residual import Residual, Trace
from ident.residual.where import where

__all__ = [
    "Dependence",
    "Failure",
    "Periods",
    "Residual",
    "Trace",
    "periods",
    "residual_of",
    "where",
]
