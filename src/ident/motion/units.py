"""Columns that contradict each other by a factor or a sign: most often a unit that is not SI."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.errors import MotionError
from ident.mechanism.mechanism import Joint

WINDOW = 0.01  # s; increments over it are compared, in which noise is small
FACTORS = {
    180 / np.pi: "the first in degrees",
    np.pi / 180: "the second in degrees",
    1e3: "the first in millimetres",
    1e-3: "the second in millimetres",
    30 / np.pi: "the first in revolutions a minute",
    np.pi / 30: "the second in revolutions a minute",
    1 / (2 * np.pi): "the first in revolutions",
    2 * np.pi: "the second in revolutions",
}


def check_units(name: str, columns: Mapping[str, np.ndarray], dt: float, joint: Joint) -> None:
    """Refuse q, v and a of a joint whose increments disagree by more than a factor of two.

    Args:
        name: of the log, for the message.
        columns: uniform, step dt [s].
        joint: whose columns are compared, with its limits.

    Raises:
        MotionError: with the factor, what it may be, and the remedy.
    """
    for low, high in (("q", "v"), ("v", "a")):
        first, second = columns.get(f"{low}.{joint.name}"), columns.get(f"{high}.{joint.name}")
        if first is None or second is None or np.std(second) == 0 or np.std(first) == 0:
            continue
        smooth = min(max(1, round(WINDOW / dt)), len(first) - 1)
        rise = first[smooth:] - first[:-smooth]
        area = np.cumsum(np.concatenate([[0.0], 0.5 * dt * (second[1:] + second[:-1])]))
        expected = area[smooth:] - area[:-smooth]
        lengths = float(np.linalg.norm(rise)), float(np.linalg.norm(expected))
        if not all(lengths):
            continue
        ratio = float(rise @ expected) / lengths[1] ** 2
        match = float(rise @ expected) / lengths[0] / lengths[1]
        where = f"{name}: {low}.{joint.name} and {high}.{joint.name} disagree"
        if match < -0.5:
            raise MotionError(f"{where}: one has the wrong sign; give it scale = -1 in [log]")
        if match > 0.8 and not 0.5 < ratio < 2.0:
            near = min(FACTORS, key=lambda factor: abs(np.log(abs(ratio) / factor)))
            guess = f" ({FACTORS[near]}?)" if abs(np.log(abs(ratio) / near)) < 0.1 else ""
            raise MotionError(
                f"{where} by a factor of {ratio:.4g}{guess}; logs are in rad, m and s: give the "
                "wrong one a scale in [log] of mechanism.toml"
            )
    _check_limits(name, columns.get(f"q.{joint.name}"), joint)


def _check_limits(name: str, q: np.ndarray | None, joint: Joint) -> None:
    if q is None or not joint.rotational or not np.isfinite(joint.upper - joint.lower):
        return
    most, reach = float(np.abs(q).max()), max(abs(joint.lower), abs(joint.upper))
    if most > 3.0 * reach and most * np.pi / 180 <= 1.2 * reach:
        raise MotionError(
            f"{name}: q.{joint.name} reaches {most:.4g}, beyond the joint's limit of "
            f"{reach:.4g} rad, and looks like degrees; logs are in rad: give it "
            "scale = 0.017453292519943295 in [log] of mechanism.toml"
        )
