"""Pictures of a diagnosis: candidates side by side, and the winner's added-variable plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ident.diagnose.evidence import Evidence
from ident.diagnose.explanation import Explanation
from ident.diagnose.ladder import changed
from ident.residual import Residual
from ident.residual.error import Error
from ident.residual.plots import time_label
from ident.show.charts import (
    FAINT,
    MEASURED,
    RESIDUAL,
    Bars,
    Chart,
    Colour,
    Level,
    Line,
    Panel,
    Points,
)

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis
    from ident.diagnose.grow import History

BARS = 12
LOGS = 4  # whose residuals are drawn below each other
KINDS: dict[str, Colour] = {
    "named": 0,
    "not to be told from it": MEASURED,
    "seen, but no explanation": 1,
    "does not hold up": FAINT,
}


def plot_candidates(d: Diagnosis) -> Chart:
    """Held-out fall of the best candidates ± standard error; grey: not to be told from the best."""
    first = [] if d.choice.best is None else [d.choice.best, *d.choice.rivals]
    shown = [*first, *(e for e in d.choice.evidence if not any(e is each for each in first))]
    shown = shown[: max(BARS, len(first))]
    kinds = [_kind(d, each, first) for each in shown]
    falls = 100 * np.array([fall_of(each) for each in shown]).reshape(-1, 2)
    bars = []
    for kind, colour in KINDS.items():
        at = np.array([i for i, own in enumerate(kinds) if own == kind], dtype=int)
        if len(at):
            bars.append(Bars(at.astype(float), falls[at, 0], falls[at, 1], kind, colour))
    panel = Panel(
        (*bars, Level(0, upright=True)),
        "fall of the weighted sum of squares, held out, away from reversals [%]",
        y_names=tuple(each.candidate.effect.label for each in shown),
        height=0.5 + 0.32 * max(len(shown), 1),
    )
    return Chart("How far each candidate lowers the held-out error", ((panel,),))


def _kind(d: Diagnosis, each: Evidence, first: list[Evidence]) -> str:
    named, rival, credible, other = KINDS
    if each is d.choice.best:
        return named
    if any(each is one for one in first):
        return rival
    return credible if each.credible else other


def fall_of(e: Evidence) -> tuple[float, float]:
    """Share of the held-out squares, and its standard error over the blocks."""
    total = float(e.difference.sum())
    if total == 0:
        return 0.0, 0.0
    error = float(e.difference.std(ddof=1) * np.sqrt(len(e.difference)))
    return e.gain, abs(e.gain / total) * error


def plot_added(before: Residual, after: Residual, best: Explanation) -> Chart | None:
    """What the model leaves against what the effect explains of it, everything refitted.

    The line has slope 1: an effect that is there lies along it, with no bend and no loops.
    None where the effect changes which rows there are.
    """
    u = before.joints.index(best.joint)
    pairs = list(zip(before.traces, after.traces, strict=False))
    if any(len(a) != len(b) for a, b in pairs):
        return None
    clouds = [
        Points(a.residual[:, u] - b.residual[:, u], a.residual[:, u], colour=i)
        for i, (a, b) in enumerate(pairs)
    ]
    unit, label = before.units[u], best.effect.label
    panel = Panel(
        (*clouds, Level(diagonal=True)),
        f"what {label} explains that nothing else does [{unit}]",
        f"residual of {best.joint} without it [{unit}]",
        height=4.0,
    )
    words = f"Residual of {best.joint} against what {label} explains of it"
    return Chart(words, ((panel,),), width=6.5)


def plot_before_after(before: Residual, after: Residual, best: Explanation) -> Chart:
    """The residual of its joint over time, without it and with it, log below log."""
    u, unit = before.joints.index(best.joint), before.units[before.joints.index(best.joint)]
    rows = []
    for a, b in list(zip(before.traces, after.traces, strict=False))[:LOGS]:
        zero = before.zero(a)
        lines = (
            Line(a.t - zero, a.residual[:, u], "as it is", RESIDUAL, 1.0),
            Line(b.t - zero, b.residual[:, u], f"with {best.effect.label}", 0, 1.0),
        )
        title = a.name if len(before.traces) > 1 else ""
        rows.append((Panel((Level(), *lines), time_label(zero), f"{best.joint} [{unit}]", title),))
    words = f"Residual of {best.joint} over time, as it is and with {best.effect.label}"
    if len(before.traces) > LOGS:
        words += f"; the first {LOGS} of {len(before.traces)} logs"
    clock = before.traces[0].name if len(rows) == 1 else ""
    return Chart(words, tuple(rows), shared_x=True, clock=clock)


def plot_ladder(history: History) -> Chart:
    """Held-out error of every joint against the rungs."""
    names = [changed(step) for step in history.steps]
    return plot_rungs(names, [step.errors for step in history.steps])


def plot_rungs(names: Sequence[str], errors: Sequence[Mapping[str, Error]]) -> Chart:
    """Held-out error of every joint against models one after the other."""
    at = np.arange(len(names), dtype=float)
    lines = []
    for i, joint in enumerate(errors[0]):
        y = [each[joint].relative or 0.0 for each in errors]
        if all(y):  # else there is no torque to be relative to
            lines.append(Line(at, 100 * np.array(y), joint, i, 1.6, dotted=True))
    panel = Panel(
        tuple(lines), "", "held-out error [%]", logarithmic=True, height=4.0,
        x_names=tuple(names),
    )  # fmt: skip
    return Chart("Held-out error of every joint, rung by rung", ((panel,),))
