"""A log as CSV text."""

from __future__ import annotations

import polars as pl

from ident.log import Log


def csv_text(log: Log) -> str:
    """The log as `Log.write` puts it into a .csv."""
    return pl.DataFrame({"t": log.t, **log.columns}).fill_nan(None).write_csv()
