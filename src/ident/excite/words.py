"""`print(excitation)`: what a person wants to know before the machine is switched on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ident.tables import shortened, table

if TYPE_CHECKING:
    from ident.excite.excitation import Excitation, Use

FULL = 0.95  # share of a limit from which it is what holds the motion back


def said(x: Excitation) -> str:
    """Motion, limits, and what it identifies."""
    start = ", ".join(f"{name} = {c[0] + _cosines(c):.4g}" for name, c in x.series.items())
    lines = [
        f"excitation of {x.name}: {x.periods} × {x.period:.4g} s, {x.harmonics} harmonics, "
        f"{len(x.log.t)} samples at {x.log.rate:.4g} Hz; seed {x.seed}",
        f"  every period begins and ends at rest, at {start}",
        "",
        *table(_limits(x)),
    ]
    if x.home:
        size = next(each for each in x.uses if each.kind == "singularity")
        lines.append(
            f"  singular positions: ‖K⁺‖ reaches {x.home:.3g} times its value at home, "
            f"{100 * size.share:.3g} % of its limit"
        )
    if x.separation is not None:
        lines += ["", str(x.separation)]
    noise = ", ".join(f"{name} {value:.3g}" for name, value in x.noise.items())
    rows = [["base parameter", "prior", "expected ±", "unit"]]
    rows += [[shortened(b.name), f"{b.prior:.4g}", f"{b.stderr:.2g}", b.unit] for b in x.base]
    lines += [
        "",
        f"identifies {len(x.base)} base parameters of {x.unknowns} unknowns; condition number "
        f"{x.condition_number:.3g}, log det {x.log_det:.4g}",
        f"with white torque noise of {noise} [N m | N] a sample:",
        *table(rows),
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in x.notes)])


def _cosines(c: np.ndarray) -> float:
    """Σ b_k, what the series is at t = 0 beside its centre."""
    return float(c[1 + len(c) // 2 :].sum())


def _limits(x: Excitation) -> list[list[str]]:
    rows = [["joint", "from", "to", "of range", "speed", "", "acceleration", "", "torque", ""]]
    by = {(each.joint, each.kind): each for each in x.uses}
    for name in dict.fromkeys(each.joint for each in x.uses if each.joint):
        place = by[name, "position"]
        row = [name, f"{place.low:.4g}", f"{place.high:.4g}", _share(place)]
        for kind in ("speed", "acceleration", "torque"):
            use = by.get((name, kind))
            if use is None:
                row += ["", ""]
            else:
                row += [f"{max(-use.low, use.high):.3g} {use.unit}", _share(use)]
        rows.append(row)
    return rows


def _share(use: Use) -> str:
    """In percent, with a star where the limit holds the motion back; a dash without a limit."""
    if not use.share:
        return "–"
    return f"{100 * use.share:.0f} %" + ("*" if use.share >= FULL else "")
