"""Candidates judged: every effect at every place, shapes searched, everything else refitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from ident.diagnose.screen import Judgement, Screen
from ident.effects import Correcting, Effect
from ident.errors import IdentError
from ident.fit.table import Table
from ident.progress import Progress

PRECISE = 1e-3  # of the distance between two starts, to which a shape is refined
SLOPE = 1e-3  # of a shape's range, for its sensitivity


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect at its best shape.

    Attributes:
        effect, shape: which, and its shape parameters.
        judged: what it would do.
        columns: (M, k) in the screen's rows: its unknowns', then its shapes' sensitivities.
        coordinate: whose error it lowers most.
    """

    effect: Effect
    shape: Mapping[str, float]
    judged: Judgement
    columns: np.ndarray
    coordinate: int

    @property
    def parameters(self) -> int:
        """How many numbers it takes."""
        return len(self.effect.parameters)


@dataclass(frozen=True, eq=False)
class Search:
    """All candidates, and what the best of all starts makes of residuals without anything in them.

    Attributes:
        candidates: in the library's order.
        null: (d, residuals) largest in-sample fall over all candidates and starts, by the
            coordinate that a candidate mends.
        failed: candidates that could not be judged, with the reason.
    """

    candidates: tuple[Candidate, ...]
    null: np.ndarray
    failed: tuple[tuple[Effect, str], ...]


def search(
    table: Table,
    screen: Screen,
    effects: Sequence[Effect],
    nulls: np.ndarray,
    progress: Progress | None = None,
) -> Search:
    """Judges all effects.

    Args:
        table, screen: the model's rows.
        effects: what could be missing.
        nulls: (M, residuals) projected residuals of logs in which nothing is missing.
        progress: called with (what is being done, share done).
    """
    found, failed = [], []
    null = np.zeros((screen.d, nulls.shape[1]))
    for i, effect in enumerate(effects):
        if progress:
            progress(f"judging {effect.label}", i / len(effects))
        try:
            candidate, falls = _judged(table, screen, effect, nulls)
        except (IdentError, np.linalg.LinAlgError) as error:
            failed.append((effect, str(error)))
            continue
        found.append(candidate)
        at = candidate.coordinate
        null[at] = np.maximum(null[at], falls)
    return Search(tuple(found), null, tuple(failed))


def _judged(
    table: Table, screen: Screen, effect: Effect, nulls: np.ndarray
) -> tuple[Candidate, np.ndarray]:
    if isinstance(effect, Correcting):
        return _correcting(table, screen, effect, nulls)
    felt, u = table.felt(effect), len(effect.unknowns)
    order = np.argsort(felt)
    felt = felt[order]
    starts = table.starts(effect)
    R = np.column_stack([screen.r, nulls])
    falls = screen.falls(table.with_effect(effect, starts)[:, order], felt, u, R)
    best = int(falls[:, 0].argmax())
    shape = dict(starts[best])
    if effect.searched:
        shape = _refined(table, screen, effect, starts, best)
    C = screen.taken(table.with_effect(effect, [shape])[:, order], felt)
    slopes = _slopes(table, screen, effect, shape, C)
    columns = np.column_stack([C, *slopes]) if slopes else C
    judged = screen.judge(columns)
    return _candidate(effect, shape, judged, columns), falls[:, 1:].max(axis=0, initial=0.0)


def _candidate(
    effect: Effect, shape: Mapping[str, float], judged: Judgement, columns: np.ndarray
) -> Candidate:
    return Candidate(effect, shape, judged, columns, int(judged.by.argmax()))


def _refined(
    table: Table,
    screen: Screen,
    effect: Effect,
    starts: Sequence[Mapping[str, float]],
    best: int,
) -> dict[str, float]:
    """The one continuous shape parameter between the best start's neighbours."""
    shape = dict(starts[best])
    (free,) = [each.name for each in effect.searched if not each.discrete]
    alike = [
        each[free] for each in starts
        if all(each[k] == v for k, v in shape.items() if k != free)
    ]  # fmt: skip
    low, high = table.bounds(effect)[free]
    below = max([x for x in alike if x < shape[free]], default=low)
    above = min([x for x in alike if x > shape[free]], default=high)
    felt = np.sort(table.felt(effect))
    order = np.argsort(table.felt(effect))

    def loss(x: float) -> float:
        C = table.with_effect(effect, [{**shape, free: x}])[:, order]
        return -float(screen.falls(C, felt, len(effect.unknowns), screen.r[:, None])[0, 0])

    found = minimize_scalar(
        loss, bounds=(below, above), method="bounded",
        options={"xatol": PRECISE * (above - below), "maxiter": 14},
    )  # fmt: skip
    return {**shape, free: float(found.x)} if found.fun < loss(shape[free]) else shape


def _slopes(
    table: Table, screen: Screen, effect: Effect, shape: Mapping[str, float], C: np.ndarray
) -> list[np.ndarray]:
    """∂(E c)/∂s (M,) at the coefficients c that fit best."""
    free = [each.name for each in effect.searched if not each.discrete]
    if not free:
        return []
    theta = screen.judge(C).theta
    bounds, felt = table.bounds(effect), table.felt(effect)
    order = np.argsort(felt)
    found = []
    for name in free:
        low, high = bounds[name]
        h = max(min(SLOPE * (high - low), 1e-2 * abs(shape[name]) or np.inf), 1e-9)
        beside = [{**shape, name: shape[name] + sign * h} for sign in (1, -1)]
        up, down = (
            screen.taken(table.with_effect(effect, [each])[:, order], felt[order]) @ theta
            for each in beside
        )
        found.append((up - down) / (2 * h))
    return found


def _correcting(
    table: Table, screen: Screen, effect: Effect, nulls: np.ndarray
) -> tuple[Candidate, np.ndarray]:
    """Sensitivities at no correction: θ are the shapes themselves, to first order."""
    zero = {each.name: effect.values.get(each.name, 0.0) for each in effect.shapes}
    free = [each.name for each in effect.searched]
    x = np.stack([table.sensitivity(effect, zero, name) for name in free], axis=-1)
    columns = screen.taken(x)
    judged = screen.judge(columns)
    bounds = table.bounds(effect)
    shape = dict(zero)
    for name, value in zip(free, judged.theta, strict=True):
        low, high = bounds[name]
        shape[name] = float(np.clip(value, low, high))
    falls = screen.falls(x, np.arange(screen.d), len(free), nulls)[0]
    return _candidate(effect, shape, judged, columns), falls
