"""In which regimes of a joint's own motion its residual is larger than elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ident.fit.residual import Residual, Trace

NEAR = 0.06  # s on either side of a reversal
SLOW = 0.25  # of the top speed: within it a reversal is seen
END = 0.1  # of the range at either end
TOP = 0.75  # quantile above which a speed, an acceleration or a load is high
LARGER = 1.5  # ratio of rms that stands out
SURE = 3.0  # standard errors by which it must
FULL = 2 * np.pi  # rad; a joint that turns further has no ends


@dataclass(frozen=True)
class Regime:
    """The residual of a joint in one regime.

    Attributes:
        name: `reversal`, `standstill`, `high speed`, `lower end`, `upper end`,
            `high acceleration` or `high load`.
        rms: in it [N m | N]; ratio: to the rms of all other rows.
        share: of the rows.
        stands_out: whether the ratio is above 1.5 by more than chance.
    """

    name: str
    rms: float
    ratio: float
    share: float
    stands_out: bool

    def __str__(self) -> str:
        return f"{self.name} ×{self.ratio:.2g}"


def regimes(residual: Residual, joint: str, effective: float) -> tuple[Regime, ...]:
    """The regimes that occur, the most conspicuous first.

    Args:
        residual: of a model.
        joint: an independent one.
        effective: independent rows (n / Σ r²).
    """
    u, i = residual.joints.index(joint), residual.signals.index(joint)
    r = np.concatenate([trace.residual[:, u] for trace in residual.traces])
    rotational = residual.coordinate_units[i] == "rad"
    found = []
    for name, inside in _masks(residual.traces, u, i, rotational):
        n, others = int(inside.sum()), int((~inside).sum())
        if min(n, others) < 5:
            continue
        rms, rest = np.sqrt(np.mean(r[inside] ** 2)), np.sqrt(np.mean(r[~inside] ** 2))
        ratio = float(rms / rest) if rest > 0 else 1.0
        per_row = effective / len(r)
        error = np.sqrt(0.5 / (n * per_row) + 0.5 / (others * per_row))  # of ln(rms / rest)
        out = ratio > LARGER and np.log(ratio) > SURE * error
        found.append(Regime(name, float(rms), ratio, n / len(r), bool(out)))
    return tuple(sorted(found, key=lambda each: -each.ratio))


def _masks(
    traces: tuple[Trace, ...], u: int, i: int, rotational: bool
) -> Iterator[tuple[str, np.ndarray]]:
    q, v, a = (np.concatenate([getattr(trace, x)[:, i] for trace in traces]) for x in "qva")
    load = np.abs(np.concatenate([trace.load[:, u] for trace in traces]))
    still = np.concatenate([np.abs(trace.v[:, i]) < trace.still[i] for trace in traces])
    turning = np.concatenate([reversal(trace, i) for trace in traces])
    yield "reversal", turning
    yield "standstill", still & ~turning
    moving = ~still
    if moving.sum() < 5:
        return
    yield "high speed", moving & (np.abs(v) >= np.quantile(np.abs(v[moving]), TOP))
    low, high = q.min(), q.max()
    if high - low <= FULL or not rotational:
        yield "lower end", q < low + END * (high - low)
        yield "upper end", q > high - END * (high - low)
    yield "high acceleration", np.abs(a) >= np.quantile(np.abs(a), TOP)
    yield "high load", load >= np.quantile(load, TOP)


def reversal(trace: Trace, i: int) -> np.ndarray:
    """(n,) rows within 60 ms of a change of the direction in which joint i moves."""
    found = np.zeros(len(trace), dtype=bool)
    v, still = trace.v[:, i], trace.still[i]
    slow = np.abs(v) < max(SLOW * np.abs(v).max(initial=0.0), still)
    for run in trace.runs():
        moving = np.flatnonzero(np.abs(v[run]) >= still) + run.start
        turned = np.sign(v[moving[1:]]) != np.sign(v[moving[:-1]])
        before, after = trace.t[moving[:-1][turned]], trace.t[moving[1:][turned]]
        quick = after - before < 2 * NEAR + 2 * (trace.t[run][-1] - trace.t[run][0]) / len(v[run])
        middle = (before + after)[quick] / 2
        if len(middle):
            at = np.searchsorted(middle, trace.t[run])
            near = [
                np.abs(trace.t[run] - middle[np.clip(at - k, 0, len(middle) - 1)]) for k in (0, 1)
            ]
            found[run] = np.minimum(*near) <= NEAR
    return found & slow
