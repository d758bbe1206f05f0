"""Old name of `ident.information.splines`."""

from ident.information.splines import Basis

__all__ = ["Basis"]
