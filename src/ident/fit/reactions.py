"""Old names of `ident.fit.multipliers`, until all callers have moved."""

from ident.fit.multipliers import Reactions

__all__ = ["Reactions", "compare_multipliers"]


def compare_multipliers(fit, reactions):  # type: ignore[no-untyped-def]
    """Compare the first experiment's multipliers with known reactions."""
    return fit.compare_multipliers(reactions)
