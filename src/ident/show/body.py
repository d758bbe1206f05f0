"""A rigid body in words: its mass and centre of mass."""

from __future__ import annotations

from collections.abc import Sequence

from ident.fit.values import Value
from ident.text import rounded


def body_words(parameters: Sequence[Value]) -> str:
    """Return mass and centre of mass of a body by its ten parameters, of the centre what the data
    determine. Its errors are the sums of those of the moment and of the mass.
    """
    by_name = {v.name.rpartition(".")[2]: v for v in parameters}
    moments = {axis: by_name[f"m{axis}"] for axis in "xyz" if f"m{axis}" in by_name}
    known = {axis: v for axis, v in moments.items() if v.stderr is not None}
    if len(moments) < 3 or len(known) < 2 or "m" not in by_name or by_name["m"].stderr is None:
        return ""
    m, error = by_name["m"].value, by_name["m"].stderr or 0.0
    if abs(m) <= 2 * error:
        return ""
    centre = []
    for axis, v in known.items():
        c = v.value / m
        size = ((v.stderr or 0.0) + abs(c) * error) / abs(m)
        centre.append(f"{axis} = {rounded(c, size)}")
    return f"mass {rounded(m, error)} kg, its centre at {', '.join(centre)} m in the link's axes"
