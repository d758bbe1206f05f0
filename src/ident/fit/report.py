"""Old names of `ident.show.fit`, until all callers have moved."""

from ident.show.fit import found, misfit, report_html

__all__ = ["found", "misfit", "report_html"]
