"""Home: where motions grow from, and whether the limits leave any motion at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.errors import MotionError
from ident.excite.box import Box, Side
from ident.excite.fourier import Fourier
from ident.excite.limits import Kept
from ident.excite.stage import Stage
from ident.mechanism.mechanism import Joint, Mechanism
from ident.motion import Experiment

AWAY = 0.05  # of its range, by which home keeps off a joint's limits
SOFT = 0.02  # share of the possible speed within which the search sees no jump of dry friction


def home_of(
    mechanism: Mechanism, joints: list[Joint], start: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    """Where motions grow from (d,) [rad | m]: the start, moved into the ranges of a tree's joints.

    Raises:
        MotionError: for a mechanism with closures that starts outside a range.
    """
    home, notes = start.copy(), []
    for i, joint in enumerate(joints):
        inside = joint.lower <= start[i] <= joint.upper
        if mechanism.closures and not inside:
            raise MotionError(
                f"{mechanism.name}: [joints] start has {joint.name} at {start[i]:.4g} "
                f"{joint.unit}, outside its range {joint.lower:.4g} to {joint.upper:.4g}; widen "
                "the range, or give a start inside it"
            )
        if not mechanism.closures:
            margin = AWAY * (joint.upper - joint.lower)
            home[i] = np.clip(start[i], joint.lower + margin, joint.upper - margin)
        if not inside:
            notes.append(
                f"{joint.name} starts outside its range: {home[i]:.4g} {joint.unit} is home instead"
            )
    return home, notes


def softened(e: Experiment, fourier: Fourier) -> Experiment:
    """With one wide band of standstill for all courses, in which dry friction rises gradually.

    The search then climbs a slope where otherwise there were steps, one a sample and reversal.
    """
    top = np.minimum(fourier.speed, fourier.half * fourier.omega[-1])
    reached = top if e.leverage is None else np.abs(e.leverage[0]) @ top
    return replace(e, still=np.maximum(SOFT * reached, 1e-9))


def check_home(
    mechanism: Mechanism, held: Kept, exact: Box, stage: Stage, rest: Experiment
) -> None:
    """Refuse limits that exclude even standing still.

    Raises:
        MotionError: naming the limit.
    """
    z = exact.quantities(stage.seen(rest.thinned(len(rest))).e)
    side = exact.broken(z)
    if side is None:
        return
    at = exact.sides.index(side)
    raise MotionError(
        f"{mechanism.name}: the limits leave no motion: {_said(side, exact, at, z[0, at], held)}"
    )


def _said(side: Side, exact: Box, at: int, value: float, held: Kept) -> str:
    here = f"{value:.4g} {side.unit}"
    allowed = f"{exact.low[at]:.4g} to {exact.high[at]:.4g}"
    if side.kind == "position":
        return (
            f"at home {side.joint} is at {here}, its range is {allowed}; widen it, or give another "
            "[joints] start"
        )
    return (
        f"to stand still at home asks {here} of {side.joint}, and its limit is "
        f"{exact.high[at]:.4g} {side.unit} (the reserve of {100 * held.reserve:.3g} % taken off); "
        "raise its limit of torque, lower the reserve, or give another [joints] start"
    )
