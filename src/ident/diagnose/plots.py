"""Pictures of a diagnosis: candidates side by side, and the winner's added-variable plot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ident.diagnose.evidence import Evidence
from ident.diagnose.explanation import Explanation
from ident.residual import Residual

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis

BARS = 12
POINTS = 6000
BEST, RIVAL, CREDIBLE, OTHER = "C0", "0.55", "C1", "0.85"


def plot_candidates(d: Diagnosis) -> Figure:
    """Held-out fall of the best candidates ± standard error; grey: not to be told from the best."""
    first = [] if d.choice.best is None else [d.choice.best, *d.choice.rivals]
    shown = [*first, *(e for e in d.choice.evidence if not any(e is each for each in first))]
    shown = shown[: max(BARS, len(first))]
    figure = Figure(figsize=(9, 1.3 + 0.32 * max(len(shown), 1)), layout="constrained")
    axis = figure.subplots()
    for i, each in enumerate(shown):
        fall, error = fall_of(each)
        color = BEST if each is d.choice.best else RIVAL if each in first else OTHER
        if color == OTHER and each.credible:
            color = CREDIBLE
        axis.barh(i, 100 * fall, xerr=100 * error, color=color, ecolor="0.3", capsize=2)
    axis.set_yticks(range(len(shown)), [each.candidate.effect.label for each in shown])
    axis.invert_yaxis()
    axis.axvline(0, color="k", lw=0.8)
    axis.grid(axis="x", alpha=0.3)
    axis.set_xlabel("fall of the weighted sum of squares, held out, away from reversals [%]")
    kinds = {
        BEST: "named",
        RIVAL: "not to be told from it",
        CREDIBLE: "seen, but no explanation",
        OTHER: "does not hold up",
    }
    used = {patch.get_facecolor() for patch in axis.patches}
    handles = [Patch(color=color, label=word) for color, word in kinds.items()]
    figure.legend(
        handles=[handle for handle in handles if handle.get_facecolor() in used],
        loc="outside upper center",
        ncols=4,
        fontsize="small",
    )
    return figure


def fall_of(e: Evidence) -> tuple[float, float]:
    """Share of the held-out squares, and its standard error over the blocks."""
    total = float(e.difference.sum())
    if total == 0:
        return 0.0, 0.0
    error = float(e.difference.std(ddof=1) * np.sqrt(len(e.difference)))
    return e.gain, abs(e.gain / total) * error


def plot_added(before: Residual, after: Residual, best: Explanation) -> Figure | None:
    """What the model leaves against what the effect explains of it, everything refitted.

    The line has slope 1: an effect that is there lies along it, with no bend and no loops.
    None where the effect changes which rows there are.
    """
    u = before.joints.index(best.joint)
    pairs = list(zip(before.traces, after.traces, strict=False))
    if any(len(a) != len(b) for a, b in pairs):
        return None
    r = [a.residual[:, u] for a, _ in pairs]
    part = [a.residual[:, u] - b.residual[:, u] for a, b in pairs]
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    axis = figure.subplots()
    for i, (x, y) in enumerate(zip(part, r, strict=True)):
        step = max(1, len(x) * len(pairs) // POINTS)
        axis.plot(x[::step], y[::step], ".", ms=3, alpha=0.6, color=f"C{i % 10}", rasterized=True)
    ends = np.array([min(x.min() for x in part), max(x.max() for x in part)])
    axis.plot(ends, ends, color="k", lw=1.2)
    axis.grid(alpha=0.3)
    unit = before.units[u]
    axis.set_xlabel(f"what {best.effect.label} explains that nothing else does [{unit}]")
    axis.set_ylabel(f"residual of {best.joint} without it [{unit}]")
    return figure
