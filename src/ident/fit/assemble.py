"""Old name of `ident.fit.identify.assembled`, until all callers have moved."""

from ident.fit.consistency import Constrained
from ident.fit.identify import assembled


def assemble(  # type: ignore[no-untyped-def]
    regression, estimate, covariance, *, outside=None, binding=None, likelihood=None, notes=(),
    validate=None, progress=None,
):  # fmt: skip
    """Assemble a fit."""
    possible = None
    if binding is not None:
        possible = Constrained(regression, estimate, estimate, outside, binding, ())
    return assembled(
        regression, estimate, covariance, notes, likelihood, validate, progress, possible
    )
