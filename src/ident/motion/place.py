"""Former names of `State.at` and `State.transmitted`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.motion import left_out
from ident.motion.state import HOPELESS, SINGULAR, State, nearness  # noqa: F401


def in_tree(mechanism: Mechanism, base: State, names: tuple[str, ...], known: np.ndarray) -> State:
    """`State.at`."""
    return base.at(mechanism, known, names)


def through_closures(
    mechanism: Mechanism, base: State, names: tuple[str, ...], known: np.ndarray
) -> State:
    """`State.at(start="follow")`."""
    return base.at(mechanism, known, names, start="follow")


def again(
    mechanism: Mechanism,
    e: State,
    moved: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> State:
    """`State.at` of the logged joints, displaced."""
    return e.at(mechanism, displaced_joints(mechanism, e, moved))


def displaced_joints(
    mechanism: Mechanism,
    e: State,
    moved: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Coordinates (3, n, d) of the logged joints, some of them displaced."""
    known = e.known(mechanism)
    for name, rates in moved.items():
        if name in e.logged:
            known[:, :, e.logged.index(name)] += np.stack(rates)
    return known


def stated(
    mechanism: Mechanism,
    base: State,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    logged: Mapping[str, np.ndarray],
) -> State:
    """`State.at(motion=…)`."""
    return base.at(mechanism, motion=(q, v, a), turns=logged)


def reduced(
    mechanism: Mechanism, experiment: State, independent: tuple[str, ...]
) -> tuple[State, float, list[str]]:
    """`State.transmitted`, with the largest |Φ| and a note on samples left out."""
    found = experiment.transmitted(mechanism, independent)
    value = mechanism.kinematics.closure_rows(experiment.q).value
    return found, float(np.abs(value).max()), left_out(experiment, found)


def with_leverage(
    mechanism: Mechanism, e: State, independent: tuple[str, ...]
) -> tuple[State, float]:
    """`State.transmitted` with all samples."""
    value = mechanism.kinematics.closure_rows(e.q).value
    return e.transmitted(mechanism, independent, np.inf), float(np.abs(value).max())
