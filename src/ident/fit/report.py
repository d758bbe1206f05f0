"""report.html of a fit, and its sections for other reports."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from markupsafe import Markup

from ident.fit.plots import plot_parameters
from ident.fit.summary import shown
from ident.motion.report import made_of, understood
from ident.residual import report
from ident.show.html import (
    Block,
    Page,
    Section,
    code,
    folded,
    headed,
    items,
    paragraph,
    strong,
    table,
)
from ident.text import percent, rounded, shortened

if TYPE_CHECKING:
    from ident.fit.fit import Fit
    from ident.fit.reactions import Reactions

STRUCTURE = (
    "What is left in {} has structure: the model may lack something, and ± is what noise alone "
    "would do to a complete model. `ident diagnose` says what could be missing."
)
LAMBDA = "The reaction forces that the closures need for this motion; they rest on the model."


def report_html(
    fit: Fit, reactions: Reactions | None = None, more: Sequence[Section] = ()
) -> bytes:
    """The report of a fit, with further sections before its parameters."""
    sections = (
        *misfit(fit),
        *more,
        *found(fit, reactions),
        understood(fit.mechanism, fit.motion),
        made_of(fit.mechanism, fit.motion),
    )
    return Page(f"{fit.mechanism.name}: identification", headline(fit), sections).html()


def headline(fit: Fit) -> str:
    """How well it predicts, in one line."""
    errors = fit.held_out or fit.train
    known = {name: e.relative for name, e in errors.items() if e.relative is not None}
    if not known:
        return "No torque was measured that could be compared."
    best, worst = min(known, key=lambda n: known[n]), max(known, key=lambda n: known[n])
    what = "held out" if fit.held_out else "in the data that were fitted"
    if best == worst:
        return f"The predicted torque of {best} is off by {percent(known[best])}, {what}."
    return (
        f"The predicted torque is off by {percent(known[best])} ({best}) to "
        f"{percent(known[worst])} ({worst}), {what}."
    )


def shown_blocks(fit: Fit) -> tuple[Markup, ...]:
    """What Jupyter shows of a fit: errors, effects, parameters, warnings."""
    said = [strong(headline(fit)), *_errors(fit).blocks, *_parameters(fit)]
    if fit.warnings:
        said.append(folded(f"Notes: {len(fit.warnings)}", items(fit.warnings)))
    return tuple(block for block in said if isinstance(block, Markup))


def _errors(fit: Fit) -> Section:
    errors = {"train": fit.train, "held out": fit.held_out, **fit.validation}
    cut = fit.motion.band.cutoff
    if not cut:
        return report.errors(errors)
    errors["unfiltered"] = fit.unfiltered
    words = f"Below {cut:.3g} Hz, where the fit was made; unfiltered: with all noise in it."
    return report.errors(errors, words)


def misfit(fit: Fit) -> tuple[Section, ...]:
    """Warnings, errors, measured against predicted, where it fails, the sum taken apart."""
    units = [fit.mechanism.joint(name).force_unit for name in fit.motion.independent]
    residuals = {fit.name: fit.residual}
    said = [each for each in fit.warnings if each not in fit.motion.notes]  # those stand elsewhere
    rough = [failure.joint for failure in fit.residual.where if not failure.white]
    if rough:
        said.append(STRUCTURE.format(", ".join(rough)))
    return (
        Section("Warnings", (items(said),) if said else ()),
        _errors(fit),
        report.torques({fit.name: fit.predict()}, units),
        report.maps(residuals),
        report.parts(residuals),
    )


def found(fit: Fit, reactions: Reactions | None = None) -> tuple[Section, ...]:
    """Parameters and multipliers."""
    return (
        Section("Parameters", _parameters(fit)),
        Section("Multipliers", _lambda(fit, reactions)),
    )


def _parameters(fit: Fit) -> tuple[Block, ...]:
    blocks: list[Block] = []
    effects = [value for effect in fit.effects for value in effect.parameters]
    own = [value for value in fit.parameters if value.identifiable]
    if (chart := plot_parameters([*effects, *own])) is not None:
        blocks.append(chart)
    if effects:
        rows = [["effect", "value", "unit"], *([v.name, shown(v), v.unit] for v in effects)]
        blocks.append(table(rows, "Effects"))
    if own:
        rows = [["parameter", "value", "prior", "unit"]]
        rows += [[v.name, shown(v), f"{v.prior:.5g}", v.unit] for v in own]
        blocks.append(table(rows, "Identified parameters"))
    combined = [value for value in fit.base_parameters if " " in value.name]
    if combined:
        rows = [["base parameter", "value", "unit"]]
        rows += [[shortened(v.name, 120), rounded(v.value, v.stderr), v.unit] for v in combined]
        blocks.append(table(rows, "Combinations that only together can be identified"))
    if fit.binding is not None:
        blocks.append(paragraph(str(fit.binding)))
    return tuple(blocks)


def _lambda(fit: Fit, reactions: Reactions | None) -> tuple[Block, ...]:
    if not fit.mechanism.kinematics.multipliers:
        return ()
    blocks: list[Block] = [paragraph(LAMBDA)]
    said = [each for each in fit.warnings if each.startswith("multipliers ")]
    blocks += [paragraph(each, "warning") for each in said]
    if reactions is not None:
        blocks += [headed("Against known reactions"), code(str(reactions)), reactions.plot()]
    names = [e.name for e in fit.motion.experiments]
    if reactions is None or len(names) > 1:
        blocks += report.by_log(names, fit.plot_multipliers)
    return tuple(blocks)
