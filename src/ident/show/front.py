"""The right half of a report's first screen: one joint before and now, and what explains it.

The joint is the one whose error changed most, the stretch of time the one in which the squares of
the residual fall most:

    max_t  Σ_{t ≤ s < t + T} r_before(s)² − r_now(s)²
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from markupsafe import Markup

from ident.assess.errors import largest_change
from ident.fit.files import residual_before
from ident.fit.ghost import drift
from ident.fit.identify import Comparison
from ident.fit.prediction import Prediction
from ident.fit.residual import Residual, zero_of
from ident.fit.result import Fit
from ident.fit.values import EffectValues, Value
from ident.mechanism import Mechanism
from ident.show.bodies import Shape, coil_shape, payload_shape
from ident.show.charts import BEFORE, BELOW, MEASURED, NOW, Chart, Line, Panel
from ident.show.html import Block, by_log, piece
from ident.show.residual import compared, plot_map, plot_predictions, time_label, view_of_fit
from ident.show.view import Ghosts, poses_of
from ident.text import rounded

SHARE, SHORTEST, LONGEST = 0.2, 2.0, 6.0  # shown: of a log, and s, that the stretch is long
FOREST = 12  # shown: identified values, the most certain first
SPRINGS = ("spring", "elasticity", "cable")  # kinds that are drawn as a coil
FILM = 400  # shown: pictures of the machine in a report
HEIGHT = 2.6  # shown: inches of each of the two charts, which leave room for the machine
DISCERNIBLE = 0.01  # shown: of the machine's size, by which a ghost is beside it and seen
LOOKED_AT = 60  # work: moments of a ghost that are looked at
PERCENTILE_95 = 1.96  # level: standard errors of an interval of 95 %


@dataclass(frozen=True)
class Stretch:
    """A short part of one log: its number, its samples, and the joint that is looked at."""

    experiment: int
    samples: slice
    joint: str


def stretch_of(before: Residual, now: Residual, joint: str) -> Stretch:
    """Return where the squares of a joint's residual change most; of one model, where they are
    largest.
    """
    u, best = now.joints.index(joint), (-np.inf, Stretch(0, slice(0), joint))
    for number, (old, new) in enumerate(zip(before.predictions, now.predictions, strict=True)):
        n = min(len(old.t), len(new.t))
        rate = (n - 1) / float(new.t[n - 1] - new.t[0])
        seconds = min(max(SHARE * n / rate, SHORTEST), LONGEST)
        width = min(n, max(2, round(seconds * rate)))
        gain = new.residual[:n, u] ** 2
        if before is not now:
            gain = old.residual[:n, u] ** 2 - gain
        gain = np.where(new.usable[:n], gain, 0.0)
        total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(gain))])
        sums = total[width:] - total[:-width]
        start = int(sums.argmax())
        if sums[start] > best[0]:
            best = float(sums[start]), Stretch(number, slice(start, start + width), joint)
    return best[1]


def plot_stretch(before: Residual, now: Residual, stretch: Stretch) -> Chart:
    """Draw the measured torque of a joint, and those predicted before and now, over a stretch."""
    u, part = now.joints.index(stretch.joint), stretch.samples
    old, new = (x.predictions[stretch.experiment] for x in (before, now))
    zero = zero_of(new.t)

    def line(p: Prediction, y: np.ndarray, label: str, colour: str, width: float) -> Line:
        return Line(p.t[part] - zero, np.where(p.usable, y, np.nan)[part], label, colour, width)

    lines = [line(new, new.measured[:, u], "measured", MEASURED, BELOW)]
    if before is not now:
        lines.append(line(old, old.predicted[:, u], f"before: {_name(before)}", BEFORE, 1.5))
    label = "predicted" if before is now else f"now: {_name(now)}"
    lines.append(line(new, new.predicted[:, u], label, NOW, 1.5))
    axis = f"{stretch.joint} [{now.units[u]}]"
    panel = Panel(tuple(lines), time_label(zero), axis, height=HEIGHT)
    first, last = (float(new.t[part][k] - zero) for k in (0, -1))
    words = f"Torque of {stretch.joint}, measured and predicted, {time_span(first, last)}"
    return Chart(f"{words} of {new.name}", ((panel,),), shared_x=True, clock=new.name, stretch=True)


def time_span(first: float, last: float) -> str:
    """Return a stretch of time in words, to a hundredth of its length, far from 0 as well.

    >>> time_span(1237.512, 1242.48), time_span(3.04, 7.03)
    ('from 1237.51 to 1242.48 s', 'from 3.04 to 7.03 s')
    """
    digits = max(0, 2 - math.floor(math.log10(last - first))) if last > first else 2
    return f"from {first:.{digits}f} to {last:.{digits}f} s"


def _name(residual: Residual) -> str:
    """Return the name of a model, short enough for a legend."""
    name = residual.name
    return f"{name[:40]}…" if len(name) > 41 else name


@dataclass(frozen=True)
class FirstScreen:
    """What is seen first: right of the headline the curves, below it the machine."""

    front: Sequence[Block] = ()
    machine: Sequence[Block] = ()


def first_screen(
    before: Residual,
    now: Residual,
    joint: str = "",
    effect: str = "",
    marks: Mapping[str, str] | None = None,
    effects: Sequence[EffectValues] = (),
) -> FirstScreen:
    """Return the stretch of a joint, and its residual before, with the effect's own curve in it,
    and the machine that moves over this stretch.

    Args:
        before, now: residuals on one motion; the same one, where there is no earlier model.
        joint: default: the one whose error changed most.
        effect: label of an effect of `now` whose torque is drawn through the points.
        marks: words beside joints of the machine; effects: with values, drawn where they sit.
    """
    joints = largest_change(before.errors, now.errors) if before is not now else []
    joints = joints or [failure.joint for failure in now.where]
    if not joints or not now.predictions:
        return FirstScreen()
    joint = joint if joint in joints else joints[0]
    stretch = stretch_of(before, now, joint)
    blocks: list[Block] = [plot_stretch(before, now, stretch)]
    drawn = effect in now.traces[0].parts if effect and now.traces else False
    residual = now.without(effect) if drawn else before
    if now.traces and (chart := plot_map(residual, now, joint, effect * drawn, HEIGHT)):
        if before is not now and not drawn:  # which of both models it is
            words = chart.words.replace(
                "the model leaves", f"the model before leaves: {_name(before)}"
            )
            chart = replace(chart, words=words)
        blocks.append(chart)
    machine = machine_of(before, now, stretch, marks or {joint: joint}, effects)
    return FirstScreen(blocks, (machine,))


def machine_of(
    before: Residual,
    now: Residual,
    stretch: Stretch | None,
    marks: Mapping[str, str],
    effects: Sequence[EffectValues] = (),
    most: int = FILM,
) -> Any:
    """Return the measured machine in 3-D with ghosts of the models before and now, over a stretch
    of one log, or over all logs; a machine that cannot be simulated so has none.
    """
    ghosts = dict[int, Ghosts]()
    for number, (old, new) in enumerate(zip(before.predictions, now.predictions, strict=True)):
        if stretch is None or stretch.experiment == number:
            samples = stretch.samples if stretch else slice(0, len(new.t))
            models = {"now": new} if before is now else {"before": old, "now": new}
            with suppress(np.linalg.LinAlgError):
                positions, window = drift([*models.values()], samples)
                known = now.motion.experiments[number].q[samples]
                model = now.model.mechanism.model
                discernible = {
                    name: q
                    for name, q in zip(models, positions, strict=True)
                    if departure(model, known, q) > DISCERNIBLE
                }
                ghosts[number] = Ghosts(
                    samples, [*discernible.values()], window, tuple(discernible)
                )
    view = view_of_fit(now, now.predictions, marks, most, ghosts)
    shapes = [shape for x in effects if (shape := _effect_shape(now.model.mechanism, x, view.size))]
    return replace(view, shapes=[*view.shapes, *shapes])


def departure(model: Any, known: np.ndarray, q: np.ndarray) -> float:
    """Return how far a joint of a ghost with positions q (n, nq) is from that of the machine at
    most, as a share of the room that all joints of the machine take.
    """
    use = np.flatnonzero(np.isfinite(q).all(axis=1))
    use = use[:: max(1, len(use) // LOOKED_AT)]
    if not len(use):
        return 0.0
    (_, machine), (_, ghost) = poses_of(model, known[use]), poses_of(model, q[use])
    size = float(np.ptp(machine.reshape(-1, 3), axis=0).max()) or 1.0
    return float(np.linalg.norm(ghost - machine, axis=-1).max()) / size


def view_page(c: Comparison, before: Residual | None = None) -> Any:
    """Return the mechanism in 3-D beside charts of its torques, which share a cursor, with ghosts
    of the first and the last model, or of one model `before` and now.
    """
    last = list(c.residuals.values())[-1]
    first = before or next(iter(c.residuals.values()))
    worst = last.where[0].joint
    logs = [experiment.name for experiment in last.motion.experiments]
    prior = before.predictions if before else ()
    charts = by_log(logs, lambda i: plot_predictions(c, i, worst, prior))
    machine = machine_of(first, last, None, {worst: worst}, most=2 * FILM)
    return replace(machine, charts=charts, stretch=None)


def view_of_one(fit: Fit) -> Any:
    """Return the page of a fit, with a ghost of the model as it was before."""
    before = residual_before(fit) if len(fit.columns) else None
    return view_page(compared(fit), before)


def _effect_shape(mechanism: Mechanism, x: EffectValues, size: float) -> Shape | None:
    """Return a ball for a payload and a coil for a spring; None for others, which are marked."""
    values = {v.name.rpartition(".")[2]: v.value for v in x.parameters}
    if x.effect.kind == "payload" and values.get("m"):
        centre = np.array([values.get(f"m{axis}", 0.0) for axis in "xyz"]) / values["m"]
        return payload_shape(mechanism, x.effect.joints[0], values["m"], centre, size)
    if x.effect.kind in SPRINGS and x.effect.joints:
        return coil_shape(mechanism, x.effect.joints[0], x.effect.label, size)
    return None


def main_effect(now: Residual, joint: str, effects: Sequence[str]) -> str:
    """Return which of some effects has the largest torque in a joint; "" if none has any there."""
    u = now.joints.index(joint)
    sizes = {
        label: sum(float((trace.parts[label][:, u] ** 2).sum()) for trace in now.traces)
        for label in effects
        if all(label in trace.parts for trace in now.traces)
    }
    best = max(sizes, key=lambda label: sizes[label], default="")
    return best if sizes.get(best) else ""


# --- identified values ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Interval:
    """One row of a forest plot, each in a scale of its own from 0 to 100."""

    name: str
    prior: float
    low: float
    value: float
    high: float
    words: str


def forest_rows(values: Sequence[Value], foremost: Collection[str] = ()) -> list[Interval]:
    """Return intervals of 95 % beside the prior, the `foremost` names first, then those that are
    known best as shares.
    """
    known = [v for v in values if v.stderr and np.isfinite(v.stderr)]
    known.sort(key=lambda v: (v.name not in foremost, -abs(v.value) / (v.stderr or 1.0)))
    rows = []
    for v in known[:FOREST]:
        half = PERCENTILE_95 * (v.stderr or 0.0)
        ends = np.array([v.prior, v.value - half, v.value, v.value + half])
        ends = ends[np.isfinite(ends)]
        low, size = ends.min(), np.ptp(ends) or 1.0
        place = [
            8 + 84 * (x - low) / size for x in (v.prior, v.value - half, v.value, v.value + half)
        ]
        words = f"{rounded(v.value, v.stderr)} {v.unit}".removesuffix(" 1")
        prior, first, value, last = map(float, place)
        rows.append(Interval(v.name, prior, first, value, last, words))
    return rows


def forest(fit: Fit) -> Markup:
    """Return identified values with their intervals beside what was assumed, as a table."""
    values = [value for effect in fit.effects for value in effect.parameters]
    values += [value for value in fit.parameters if value.identifiable]
    rows = forest_rows(values, {v.name for effect in fit.effects for v in effect.parameters})
    more = sum(bool(v.stderr) for v in values) - len(rows)
    return piece("forest", rows, more) if rows else Markup("")
