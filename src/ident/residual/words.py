"""What a person sees when a residual is drawn against a signal, said from its fitted map."""

from __future__ import annotations

import numpy as np

from ident.residual.maps import Step

ALIKE = 0.9  # share of a map's variation that a shape must explain to give it its name
OUTER = 1 / 3  # of the range: where a kink is at an end
PROMINENT = 0.3  # of a map's range: smaller bends are no wave


def seen(step: Step, unit: str) -> str:
    """A few words on the map of one signal.

    Args:
        step: the signal with its map's values.
        unit: of the torque.
    """
    candidate, f = step.candidate, step.values
    if candidate.kind == "sign(v)":
        return f"a step of {2 * abs(f[0]):.3g} {unit} at v = 0"
    if candidate.kind == "bands":
        return "two bands, one for each direction, that widen with the load"
    x, weight = candidate.knots, candidate.columns.sum(axis=0)
    f = f - np.average(f, weights=weight)
    size = float(np.average(f**2, weights=weight)) or 1e-300
    line = _explained(f, weight, [x]) / size
    if line > ALIKE:
        slope = np.polyfit(x, f, 1, w=np.sqrt(weight))[0]
        rises = "drift" if candidate.kind == "t" else "straight line"
        return f"a {rises} of {slope:.3g} {unit} per {candidate.unit}"
    jump = np.clip(x / (x[1] - x[0]), -1.0, 1.0)
    if candidate.kind == "v" and _explained(f, weight, [jump]) / size > ALIKE:
        return f"a step of about {np.ptp(f):.2g} {unit} at v = 0"
    if candidate.kind == "v" and _explained(f, weight, [jump, x]) / size > ALIKE:
        return "a step at v = 0 and a slope"
    if (kink := _kink(x, f, weight)) is not None:
        share, at, end = kink
        if share / size > ALIKE:
            return f"level, then a kink at the {end} end, from {at:.3g} {candidate.unit}"
    turns = _turns(f)
    if turns >= 3 and candidate.name.startswith("q."):
        return f"a wave of about {np.ptp(x) * 2 / (turns + 1):.2g} {candidate.unit}"
    even = x - x[weight > 0].mean() if candidate.kind == "q" else x
    if _explained(f, weight, [even**2]) / size > ALIKE or turns == 1:
        return "a bow, the same at both ends"
    return "a curve" if turns < 3 else f"a curve with {turns} bends"


def _explained(f: np.ndarray, weight: np.ndarray, shapes: list[np.ndarray]) -> float:
    """Mean square of f (c,) that a combination of shapes explains, beside a constant."""
    A = np.stack([np.ones_like(f), *shapes], axis=1) * np.sqrt(weight)[:, None]
    b = f * np.sqrt(weight)
    left = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    return float((b @ b - left @ left) / weight.sum())


def _kink(x: np.ndarray, f: np.ndarray, weight: np.ndarray) -> tuple[float, float, str] | None:
    """(explained, where, which end) of the best hinge in the outer thirds."""
    inner = x[0] + OUTER * np.ptp(x), x[-1] - OUTER * np.ptp(x)
    found = [
        (_explained(f, weight, [np.maximum(0, side * (x - at))]), float(at), end)
        for side, end, places in (
            (1, "upper", x[(x >= inner[1]) & (x < x[-1])]),
            (-1, "lower", x[(x <= inner[0]) & (x > x[0])]),
        )
        for at in places
    ]
    return max(found) if found else None


def _turns(f: np.ndarray) -> int:
    """Extrema inside a map that stand out by more than 0.3 of its range."""
    count, way, last = 0, 0, f[0]
    least = PROMINENT * max(float(np.ptp(f)), 1e-300)
    for value in f[1:]:
        if (way >= 0 and value > last) or (way <= 0 and value < last):
            if way == 0 and abs(value - last) < least:
                continue
            way = way or int(np.sign(value - last))
            last = value
        elif abs(value - last) > least:
            way, last, count = -way, value, count + 1
    return count
