"""Identification: from equations to parameters, errors and multipliers."""

from ident.fit.identify import identify
from ident.fit.result import Fit

__all__ = ["Fit", "identify"]
