"""Identification: from equations to parameters, errors and multipliers."""

from ident.fit.fit import Fit
from ident.fit.identify import identify

__all__ = ["Fit", "identify"]
