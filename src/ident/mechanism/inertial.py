"""The `<inertial>` of a URDF's link given other numbers: as few changes of its text as will do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from lxml import etree

from ident.description.spans import Change, Span, first_child, set_attributes
from ident.description.urdf import numbers
from ident.mechanism.parameters import about_origin, split

TERMS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def inertial_changes(
    text: bytes,
    spans: Mapping[etree._Element, Span],
    link: etree._Element,
    pi: np.ndarray,
) -> list[Change]:
    """What of the text must change for a link to have these ten dynamic parameters.

    Args:
        text: of the URDF.
        spans: where its elements stand.
        link: whose `<inertial>` gets other numbers; one that has none gets one.
        pi: (10,) in the link's frame, in Pinocchio's order.
    """
    m, moments, L = split(pi)
    centre = moments / m if m else np.zeros(3)
    inertia = L - about_origin(m, moments)
    values = dict(zip(TERMS, (float(inertia[place]) for place in PLACES), strict=True))
    inertial = link.find("inertial")
    if inertial is None:
        return [first_child(text, spans[link], _written(m, centre, values))] if np.any(pi) else []
    changes = []
    origin = inertial.find("origin")
    if origin is None:
        if np.any(centre):
            changes.append(
                first_child(
                    text, spans[inertial], [f'<origin xyz="{_words(centre)}" rpy="0 0 0"/>']
                )
            )
    else:
        new = _other(origin, "xyz", centre, "0 0 0") | _other(origin, "rpy", np.zeros(3), "0 0 0")
        changes += set_attributes(text, spans[origin], new)
    mass, tensor = inertial.find("mass"), inertial.find("inertia")
    changes += set_attributes(text, spans[mass], _other(mass, "value", [m], ""))
    terms: dict[str, str] = {}
    for key, value in values.items():
        terms |= _other(tensor, key, [value], "0" if key in ("ixy", "ixz", "iyz") else "")
    return changes + set_attributes(text, spans[tensor], terms)


def _other(
    element: etree._Element, key: str, values: Sequence[float] | np.ndarray, default: str
) -> dict[str, str]:
    """The attribute with these values, if it says others; equal ones stay as they are written."""
    if numbers(element, key, default, len(values), "") == [float(x) for x in values]:
        return {}
    return {key: _words(values)}


def _words(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in values)


def _written(m: float, centre: np.ndarray, inertia: Mapping[str, float]) -> list[str]:
    return [
        "<inertial>",
        f'  <origin xyz="{_words(centre)}" rpy="0 0 0"/>',
        f'  <mass value="{m!r}"/>',
        "  <inertia " + " ".join(f'{key}="{value!r}"' for key, value in inertia.items()) + "/>",
        "</inertial>",
    ]
