"""Excitations as text and charts."""

from __future__ import annotations

import numpy as np

from ident.display import renders
from ident.excite.excitation import Excitation, LimitUse
from ident.show.charts import RESIDUAL, Chart, Level, Line, Mark, Panel
from ident.show.sheet import Sheet
from ident.text import shortened

LIMITING = 0.95  # share of a limit from which it is marked as the one that limits the motion
NEAR = 2.0  # times the largest value: a limit beyond is not drawn
CHANNELS = (("q", "position"), ("v", "speed"), ("a", "acceleration"), ("tau", "torque"))


@renders(Excitation, "sheet")
def sheet(x: Excitation) -> Sheet:
    """Return motion, limits and expected standard errors."""
    start = ", ".join(f"{n} = {c[0] + c[1 + len(c) // 2 :].sum():.4g}" for n, c in x.series.items())
    title = (
        f"excitation of {x.name}: {x.periods} × {x.period:.4g} s, {x.harmonics} harmonics, "
        f"{len(x.log.t)} samples at {x.log.rate:.4g} Hz; seed {x.seed}"
    )
    facts = {"every period begins and ends": f"at rest, at {start}"}
    if x.home:
        size = next(each for each in x.uses if each.kind == "singularity")
        facts["singular positions"] = (
            f"‖K⁺‖ reaches {x.home:.3g} times its value at home, {100 * size.share:.3g} % of its "
            "limit"
        )
    noise = ", ".join(f"{name} {value:.3g}" for name, value in x.noise.items())
    rows = [["base parameter", "prior", "expected ±", "unit"]]
    rows += [[shortened(b.name), f"{b.prior:.4g}", f"{b.stderr:.2g}", b.unit] for b in x.base]
    base = (
        f"identifies {len(x.base)} base parameters of {x.unknowns} unknowns; condition number "
        f"{x.condition_number:.3g}, log det {x.log_det:.4g}; with white torque noise of {noise} "
        "[N m | N] a sample:"
    )
    lines = [] if x.separation is None else [str(x.separation)]
    return Sheet(title, "", facts, {"use of the limits": _limits(x), base: rows}, lines, x.notes)


def _limits(x: Excitation) -> list[list[str]]:
    rows = [["joint", "from", "to", "of range", "speed", "", "acceleration", "", "torque", ""]]
    uses = {(each.joint, each.kind): each for each in x.uses}
    for name in dict.fromkeys(each.joint for each in x.uses if each.joint):
        position = uses[name, "position"]
        row = [name, f"{position.low:.4g}", f"{position.high:.4g}", _share(position)]
        for kind in ("speed", "acceleration", "torque"):
            use = uses.get((name, kind))
            if use is None:
                row += ["", ""]
            else:
                row += [f"{max(-use.low, use.high):.3g} {use.unit}", _share(use)]
        rows.append(row)
    return rows


def _share(use: LimitUse) -> str:
    """Return percent, with a star where the limit is active; a dash without a limit."""
    if not use.share:
        return "–"
    return f"{100 * use.share:.0f} %" + ("*" if use.share >= LIMITING else "")


@renders(Excitation, "plot")
def plot(x: Excitation) -> Chart:
    """Draw position, speed, acceleration and torque of every drive in one period; limits dashed."""
    one = x.log.t <= x.period
    t = x.log.t[one]
    rows: list[tuple[Panel, ...]] = []
    for name in (c.removeprefix("tau.") for c in x.log.columns if c.startswith("tau.")):
        row = []
        for channel, kind in CHANNELS:
            use = x.use(name, kind)
            y = x.log.columns[f"{channel}.{name}"][one]
            near = NEAR * float(np.abs(y).max())
            limits = [b for b in (use.lower, use.upper) if np.isfinite(b) and abs(b) < near]
            marks: list[Mark] = [Line(t, y)]
            marks += [Level(b, dashed=True, colour=RESIDUAL) for b in limits]
            label = f"{name} [{use.unit}]" if channel == "q" else f"[{use.unit}]"
            row.append(Panel(tuple(marks), "t [s]", label, kind if not rows else "", height=1.9))
        rows.append(tuple(row))
    words = "One period of the motion: position, speed, acceleration and torque of every drive"
    return Chart(words, tuple(rows), shared_x=True, width=13, clock=x.log.name)
