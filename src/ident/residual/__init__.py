"""Where a model fails: what it leaves unexplained, and on what that depends."""

from ident.fit.residual import Residual, Trace, residual_of
from ident.residual.failure import Dependence, Failure
from ident.residual.periods import Periods, periods
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
