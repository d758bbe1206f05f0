"""Sections of a report on what models predict and leave."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ident.residual.error import Error, error_rows
from ident.residual.plots import plot_maps, plot_own, plot_parts, plot_predictions
from ident.residual.predict import Prediction
from ident.residual.residual import Residual
from ident.residual.tables import failure_lines, parts_table
from ident.show.charts import Chart
from ident.show.html import Block, Choice, Option, Section, code, items, paragraph, table

ROWS = 4  # of panels in one chart: what a window shows
LOGS = 12  # whose curves are in a report
MAPS = (
    "Each dot is a row of the fit; the dark line is the mean. A model that lacks nothing leaves a "
    "flat band. What the residual depends on most is framed."
)


def errors(named: Mapping[str, Mapping[str, Error]], words: str = "") -> Section:
    """The error of the predicted torque, by joint."""
    said = (paragraph(words),) if words else ()
    rows = error_rows(named)
    shown = table(rows, "Error of the predicted torque: rms, and relative to the measured torque")
    return Section("Error of the predicted torque", (*said, shown))


def torques(predictions: Mapping[str, list[Prediction]], units: Sequence[str]) -> Section:
    """Measured against predicted, per joint, log by log."""
    names = [p.name for p in next(iter(predictions.values()))]
    return Section(
        "Measured against predicted",
        by_log(names, lambda i: plot_predictions(predictions, units, i)),
    )


def by_log(names: Sequence[str], draw: Callable[[int], Chart]) -> tuple[Block, ...]:
    """A chart, or of several logs a choice between theirs."""
    if len(names) == 1:
        return draw(0).pieces(ROWS)
    options = tuple(Option(name, draw(i).pieces(ROWS)) for i, name in enumerate(names[:LOGS]))
    choice = Choice("Which log", options)
    if len(names) <= LOGS:
        return (choice,)
    return paragraph(f"The first {LOGS} of {len(names)} logs are drawn."), choice


def maps(residuals: Mapping[str, Residual]) -> Section:
    """Where the last model fails: a choice between joints, the worst first, with their maps."""
    last = list(residuals.values())[-1]
    options = []
    for failure in last.where:
        blocks = (items(failure_lines(failure, len(last.traces) > 1)),)
        options.append(Option(failure.joint, (*blocks, plot_maps(residuals, failure.joint))))
    choice = Choice("Of which joint", tuple(options))
    return Section("Residual maps", (paragraph(MAPS), choice))


def parts(residuals: Mapping[str, Residual]) -> Section:
    """The sum taken apart: rigid bodies, effects, closure forces."""
    first = next(iter(residuals.values()))
    blocks: list[Block] = []
    for name, residual in residuals.items():
        lines = "\n".join(parts_table(residual, "")).strip()
        blocks += [paragraph(name)] if len(residuals) > 1 else []
        blocks.append(code(lines))
    names = [trace.name for trace in first.traces]
    blocks += by_log(names, lambda i: plot_parts(residuals, i))
    if first.own:
        blocks += by_log(names, lambda i: plot_own(residuals, i))
    return Section("The sum taken apart", tuple(blocks))
