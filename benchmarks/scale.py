"""The tables of scale in README.md, all by one command: ratios to peers, memory, growth, faults.

    python benchmarks/scale.py [--only NAME …] [--print]

Every table is made by its own module in this run: `figaroh_core`, `banded`, `whole_way`, `online`,
`growth`, `stream`, `faults`. It replaces the table between its marks in README.md; `--print`
changes no file. All of them take about half an hour.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import argparse
import importlib
import json
import platform
import re
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path

README = Path(__file__).with_name("README.md")
MODULES = {
    "figaroh_core": "Regressor, base parameters and least squares, against figaroh",
    "banded": "The solve at the paper's size, against banded normal equations",
    "whole_way": "From CSV to fit, and what is not arithmetic",
    "online": "Online, a sample at a time",
    "hours": "A long run of monitor, beside a batch",
    "growth": "Growth with joints, closures and candidates",
    "stream": "Growth from a thousand to ten million samples",
    "faults": "Faults that begin while a machine runs",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=MODULES, default=[*MODULES])
    parser.add_argument("--print", action="store_true", dest="printed")
    parser.add_argument("--rows", choices=MODULES, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.rows:
        sys.stdout.write(json.dumps(importlib.import_module(arguments.rows).table()))
        return
    for name in arguments.only:
        start = time.perf_counter()
        # a process of its own: what a child has at most is counted from its parent's memory on
        command = [sys.executable, __file__, "--rows", name]
        rows = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        took = time.perf_counter() - start
        text = (
            f"{markdown(rows)}\n\n`python benchmarks/{name}.py`, {took / 60:.1f} min. {machine()}\n"
        )
        sys.stdout.write(f"## {MODULES[name]}\n\n{text}\n")
        if not arguments.printed:
            put(name, text)


def put(name: str, text: str) -> None:
    """The table between its marks in README.md."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    old = README.read_text(encoding="utf-8")
    found = re.subn(
        f"{re.escape(begin)}.*?{re.escape(end)}", lambda _: f"{begin}\n{text}{end}", old, flags=re.S
    )
    if found[1] != 1:
        raise SystemExit(f"{README.name}: the marks {begin} … {end} are not there once")
    README.write_text(found[0], encoding="utf-8")


def markdown(rows: list[dict[str, object]]) -> str:
    """Rows as a table; a number in three digits."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    lines += ["| " + " | ".join(cell(row.get(name)) for name in names) + " |" for row in rows]
    return "\n".join(lines)


def cell(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(cell, value))
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) else "" if value is None else str(value)


def machine() -> str:
    """On what it was measured."""
    names = ("numpy", "scipy", "pin", "casadi", "polars")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in names)
    cores = len(os.sched_getaffinity(0))
    python = f"Python {platform.python_version()}"
    return f"{processor()}, {cores} cores, one BLAS thread, {python}, {versions}."


def processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        return re.findall(r"model name\s*: (.*)", text)[0]
    except (OSError, IndexError):
        return platform.machine()


if __name__ == "__main__":
    main()
