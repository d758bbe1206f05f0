"""What a person should know before trusting a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.equations.columns import Columns
from ident.equations.filter import Decimator
from ident.equations.point import Point
from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate
from ident.fit.naming import absorbed_by
from ident.fit.reach import identifiable_multipliers, resting_on_priors
from ident.fit.values import rigid_values
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, DYNAMIC
from ident.motion import Motion
from ident.residual.error import Squares

BIASED = 1e-4  # share of a parameter that a time basis may move unmentioned
FEW = 3.0  # equations a parameter below which values follow the noise
POOR = 1e3  # condition number above which the motion excites some base parameter poorly


def basis_bias(
    mechanism: Mechanism, columns: Columns, found: Estimate, free: Estimate
) -> list[str]:
    """What the time basis does to the parameters: its misfit of λ(t) is no noise and not in ±."""
    if not np.array_equal(found.base.independent, free.base.independent):
        return []
    cov = np.zeros((found.base.rank, found.base.rank))
    pairs = [
        (a.name, a.value, b.value)
        for a, b in zip(
            rigid_values(mechanism, columns, found, cov),
            rigid_values(mechanism, columns, free, cov),
            strict=True,
        )
        if a.identifiable
    ]
    moved = [
        f"{name} {100 * (value / true - 1):+.3g} %"
        for name, value, true in pairs
        if true != 0 and abs(value / true - 1) > BIASED
    ]
    basis = mechanism.multipliers
    return moved and [
        f"the {basis.basis} basis with knots of {1e3 * basis.spacing:.4g} ms moves parameters from "
        f"where free multipliers put them: {', '.join(moved[:6])}"
        + (f" and {len(moved) - 6} more" if len(moved) > 6 else "")
        + "; standard errors do not hold this bias"
    ]


def share_at_rest(everything: Squares, cells: Sequence[Cell]) -> float:
    """Share of rows that standstill keeps from informing."""
    rest = sum(cell.rest.rows for cell in cells)
    return rest / max(float(everything.rows.sum()), 1.0)


def warnings_of(
    mechanism: Mechanism,
    motion: Motion,
    columns: Columns,
    found: Estimate,
    sensible: np.ndarray,
    rest: float,
    point: Point,
) -> tuple[str, ...]:
    """Notes of mechanism and motion, and what the fit cannot tell; `rest`: share at standstill."""
    said = [*_too_short(found), *mechanism.notes, *motion.notes]
    if rest > 0:
        said.append(
            f"{100 * rest:.3g} % of the equations are at standstill, where dry friction is open; "
            "they count in the errors but not in the fit"
        )
    if not len(columns):
        said.append(
            "nothing is unknown: these are the errors of the model as it is; to identify, give "
            "[parameters] unknown in mechanism.toml or add an effect"
        )
    rigid = np.arange(len(columns)) < len(columns.rigid)
    shapes = np.isin(np.arange(len(columns)), columns.shapes)
    for held, where in (
        (found.held & rigid, "held at the prior"),
        (found.held & shapes, "left where the search ended"),
        (found.held & ~rigid & ~shapes, "held at zero"),
    ):
        names = [columns.names[i] for i in np.flatnonzero(held)]
        if names:
            said.append(
                f"with a residual of this size this motion cannot tell {', '.join(names[:8])}"
                + (f" and {len(names) - 8} more" if len(names) > 8 else "")
                + f": {where}; move more joints, faster or farther, or see what is missing"
            )
    said += _lost_to_the_filter(motion) + _half_known(mechanism)
    absorbed = absorbed_by(columns, found.base)
    for effect, places in columns.effects:
        for name, at in zip(effect.names, places, strict=True):
            if at >= 0 and name in absorbed and not found.held[at]:
                carrier = absorbed[name]
                said.append(
                    f"{name} cannot be identified: "
                    + (
                        f"same columns as {carrier}"
                        if carrier
                        else "nothing in this motion feels it"
                    )
                )
    if found.base.condition_number > POOR:
        said.append(
            f"condition number {found.base.condition_number:.3g}: this motion excites some base "
            "parameters poorly; see their standard errors, and move more joints, faster or farther"
        )
    determined = identifiable_multipliers(mechanism, motion)
    lost = [
        n for n, good in zip(mechanism.kinematics.multipliers, determined, strict=True) if not good
    ]
    if lost:
        said.append(
            f"multipliers {', '.join(lost)} are not determined: closure equations are redundant "
            f"({len(determined)} of rank {mechanism.rank}), which is normal for planar loops"
        )
    resting = resting_on_priors(mechanism, motion, columns, found.base, sensible, point)
    resting = {name: on for name, on in resting.items() if name not in lost}
    if resting:
        on = list(dict.fromkeys(name for names in resting.values() for name in names))
        said.append(
            f"multipliers {', '.join(resting)} rest on the priors of {', '.join(on[:6])}"
            + (f" and {len(on) - 6} more" if len(on) > 6 else "")
            + ", which no torque determines: a wrong prior moves them, however well torques fit"
        )
    return tuple(dict.fromkeys(said))


def _too_short(found: Estimate) -> list[str]:
    """Whether there are hardly more equations than parameters."""
    equations, rank = found.factor.rows, found.base.rank
    return [
        f"only {equations} equations for {rank} parameters: these values and errors mean nothing; "
        f"give a longer log, or make less unknown ([parameters] unknown)"
    ] if rank and equations < FEW * rank else []  # fmt: skip


def _lost_to_the_filter(motion: Motion) -> list[str]:
    """Samples that the filter needs on either side of a row, and runs too short to give one."""
    said = []
    for e in motion.experiments:
        half = Decimator.of(motion.band.cutoff, e.rate).half
        runs = [segment.stop - segment.start for segment in e.segments()]
        short = [length for length in runs if length <= 2 * half]
        if half and short:
            said.append(
                f"{e.name}: {sum(short)} samples in {len(short)} runs between gaps are left out: "
                f"shorter than the filter ({(2 * half + 1) / e.rate:.3g} s); a higher cut-off "
                "keeps them"
            )
        if half and len(runs) > len(short):
            said.append(
                f"{e.name}: the filter takes {1e3 * half / e.rate:.3g} ms at both ends of "
                f"{len(runs) - len(short)} run(s)"
            )
    return said


def _half_known(mechanism: Mechanism) -> list[str]:
    """Bodies of which mass or first moments are unknown, but not all that they enter."""
    said = []
    for link in mechanism.bodies.links:
        mine = {n.rsplit(".", 1)[1] for n in mechanism.unknown if n.rsplit(".", 1)[0] == link}
        if mine & {"m", "mx", "my", "mz"} and len(mine) < COUNT:
            held = [word for word in DYNAMIC if word not in mine]
            said.append(
                f"of {link} {', '.join(w for w in DYNAMIC if w in mine)} is unknown while "
                f"{', '.join(held)} are held: first moments and moments about the joint frame, so "
                "that its centre of mass and inertia about it move"
            )
    return said
