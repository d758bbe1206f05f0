"""Logs as text and HTML."""

from __future__ import annotations

import numpy as np

from ident.display import renders
from ident.log import Log
from ident.show.sheet import Sheet


def _sheet(log: Log) -> Sheet:
    largest, rms = log.jitter
    gaps = log.gaps()
    known = {name: int(np.isfinite(x).sum()) for name, x in log.columns.items()}
    # below a nanosecond it is the rounding of t
    jitter = f"{1e3 * largest:.3g} ms max, {1e3 * rms:.3g} ms rms" if largest > 1e-9 else "none"
    columns = (name if n == log.t.size else f"{name} ({n} samples)" for name, n in known.items())
    start, end = max(gaps, key=lambda gap: gap[1] - gap[0], default=(0.0, 0.0))
    longest = f"{len(gaps)}, longest {end - start:.3g} s at t = {start:.6g} s"
    facts = {
        "samples": f"{log.t.size} in {log.duration:.6g} s",
        "rate": f"{log.rate:.6g} Hz, jitter {jitter}",
        "columns": ", ".join(columns),
        "gaps": longest if gaps else "",
        "repairs": "; ".join(log.repairs) or "none",
    }
    return Sheet(f"Log {log.name!r}", facts=facts)


@renders(Log, "text")
def text(log: Log) -> str:
    """Return samples, rate, columns, gaps and repairs."""
    return _sheet(log).text()


@renders(Log, "html")
def html(log: Log) -> str:
    """Return the same with a table of the columns' ranges."""
    rows = [["column", "samples", "from", "to", "rms"]]
    for name in log.columns:
        _, x = log.series(name)
        size = (x.min(), x.max(), np.sqrt(np.mean(x**2))) if len(x) else ()
        rows.append([name, str(len(x)), *([f"{each:.4g}" for each in size] or ["–"] * 3)])
    facts = {**_sheet(log).facts, "columns": ""}
    return Sheet(f"Log {log.name}", facts=facts, tables={"Columns": rows}).html()
