"""Old names of `ident.show.residual`, until all callers have moved."""

from ident.show.residual import (
    error_rows,
    errors_text,
    failure_lines,
    failure_text,
    headline,
    parts_table,
    where_text,
)

__all__ = [
    "error_rows",
    "errors_text",
    "failure_lines",
    "failure_text",
    "headline",
    "parts_table",
    "where_text",
]
