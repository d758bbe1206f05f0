"""Old names of `ident.fit.files`, until all callers have moved."""

from ident.fit.files import Saved, fit_json, read_fit

__all__ = ["Saved", "fit_json", "read_fit"]
