"""Residuals in words and tables that fit into a terminal of 100 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ident.residual.error import error_rows
from ident.residual.residual import CLOSURES, DRIVES, RIGID, WRENCHES, Residual
from ident.text import percent, table

if TYPE_CHECKING:
    from ident.residual.failure import Failure

WIDTH = 100
TITLE, ABREAST = 32, 2  # characters of a model's name in a table, and models side by side
ROUNDING = 1e-12  # of the measured torque: below, a part is nil
WINDOWS, REGIMES = 3, 3  # that are printed; all are in compare.json


def errors_text(residuals: Mapping[str, Residual]) -> list[str]:
    """Errors of several models on one motion, side by side, and how far they fall."""
    names = list(residuals)
    first, last = residuals[names[0]], residuals[names[-1]]
    cut = first.motion.band.cutoff
    logs = ", ".join(trace.name for trace in first.traces)
    lines = _filled(
        f"error of the predicted torque{f' below {cut:.3g} Hz' if cut else ''} on {logs}"
    )
    short = {name: name if len(name) <= TITLE else f"…{name[-TITLE:]}" for name in names}
    for i in range(0, len(names), ABREAST):
        some = {short[name]: residuals[name].errors for name in names[i : i + ABREAST]}
        lines += table(error_rows(some))
    if first is not last:
        falls = [
            f"{joint} {100 * (1 - last.errors[joint].rms / error.rms):.3g} %"
            for joint, error in first.errors.items()
            if error.rms > 0
        ]
        lines += _filled(f"error falls from {first.name} to {last.name}: {', '.join(falls)}")
    return lines


def _filled(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  ", break_on_hyphens=False)


def headline(residual: Residual) -> str:
    """Of what, on what."""
    logs = ", ".join(trace.name for trace in residual.traces)
    cut = residual.motion.band.cutoff
    below = f" below {cut:.3g} Hz" if cut else ""
    text = f"residual of {residual.name} on {logs}{below}: {residual.rows} rows"
    return "\n".join(_filled(text))


def by_kind(parts: Mapping[str, np.ndarray], residual: Residual) -> dict[str, list[str]]:
    """The parts that one column shows: effects of one kind act on a joint as one."""
    kinds: dict[str, list[str]] = {}
    for name in parts:
        fixed = name in (RIGID, WRENCHES, DRIVES, CLOSURES)
        kinds.setdefault(name if fixed else name.split(":")[0], []).append(name)
    return kinds


def parts_table(residual: Residual, indent: str = "  ") -> list[str]:
    """rms of the measured torque, of each part and of the residual, by joint."""
    kinds = by_kind(residual.traces[0].parts, residual)
    rms = residual.parts
    columns = {"measured": rms["measured"]}
    for kind, names in kinds.items():
        columns[kind] = _together(residual, "parts", names)
        if kind == RIGID:
            columns["(gravity)"] = rms["gravity"]
    columns["residual"] = rms["residual"]
    lines = ["", "the sum taken apart, rms: rigid bodies + effects = predicted"]
    lines += _by_joint(residual, columns, indent)
    if residual.own:
        columns = {
            kind: _together(residual, "own", names)
            for kind, names in by_kind(residual.traces[0].own, residual).items()
        }
        columns = {k: x for k, x in columns.items() if k != DRIVES or np.nanmax(x) > 0}
        lines += [
            "",
            "the joint's own row, rms: rigid bodies + effects + closure forces = its torque",
        ]
        lines += _by_joint(residual, columns, indent)
    return lines


def _together(residual: Residual, which: str, names: Iterable[str]) -> np.ndarray:
    """rms (d,) of the sum of some parts."""
    squares, rows = np.zeros(len(residual.joints)), 0
    for trace in residual.traces:
        parts = getattr(trace, which)
        squares = squares + (sum(parts[name] for name in names) ** 2).sum(axis=0)
        rows += len(trace)
    return np.asarray(np.sqrt(squares / max(rows, 1)))


def _by_joint(residual: Residual, columns: Mapping[str, np.ndarray], indent: str) -> list[str]:
    """One row a joint; more columns than fit go into a second table below."""
    names, lines = list(columns), []
    first = max(len(joint) for joint in residual.joints) + 8
    while names:
        width = first
        some: list[str] = []
        while names and (not some or width + max(len(names[0]), 7) + 2 <= WIDTH):
            width += max(len(names[0]), 7) + 2
            some.append(names.pop(0))
        rows = [["joint", "", *some]]
        for u, joint in enumerate(residual.joints):
            cells = [_number(columns[name][u], residual.parts["measured"][u]) for name in some]
            rows.append([joint, residual.units[u], *cells])
        lines += table(rows, indent)
    return lines


def _number(x: float, beside: float) -> str:
    if np.isnan(x):
        return "–"
    return "0" if x < ROUNDING * beside else f"{x:.3g}"


def where_text(residual: Residual, indent: str = "  ") -> list[str]:
    """Where the model fails, joint by joint."""
    lines = ["where it fails"]
    several = len(residual.traces) > 1
    for failure in residual.where:
        lines += [f"{indent}{line}" for line in failure_text(failure, several)]
    return lines


def failure_text(failure: Failure, several: bool) -> list[str]:
    """Of one joint: how much, on what it depends, in which regimes and when."""
    first, *told = _told(failure, several)
    return [first[1], *(line for head, text in told for line in _wrapped(head, text))]


def failure_lines(failure: Failure, several: bool) -> list[str]:
    """The same, a sentence a line."""
    return [" ".join(each).strip() for each in _told(failure, several)]


def _told(failure: Failure, several: bool) -> list[tuple[str, str]]:
    white = "indistinguishable from noise" if failure.white else "has structure"
    first = (
        f"{failure.joint}: {failure.rms:.3g} {failure.unit} ({percent(failure.relative)}), "
        f"{100 * failure.share:.0f} % of the misfit; {white}"
    )
    told = [("", first)]
    if failure.depends_on:
        told.append(("depends on", "; ".join(str(each) for each in failure.depends_on)))
    elif not failure.white:
        told.append(("depends on", "no single signal that was tried; but it is correlated in time"))
    if regimes := failure.stands_out[:REGIMES]:
        told.append(("larger at", ", ".join(str(each) for each in regimes)))
    if failure.worst and not failure.white:
        windows = [
            f"{each}" + (f" of {each.experiment}" if several else "")
            for each in failure.worst[:WINDOWS]
        ]
        told.append(("worst in", ", ".join(windows)))
    return told


def _wrapped(head: str, text: str) -> list[str]:
    indent = " " * 15
    lines = textwrap.wrap(text, WIDTH - 2 - len(indent), break_on_hyphens=False)
    return [f"   {head:<12}{lines[0]}", *(indent + line for line in lines[1:])]
