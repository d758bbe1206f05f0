"""What speaks for a candidate: held-out gain, more than clean logs show, share of the gap closed.

z = mean(D) / (std(D)/√B),  D_B = Σ e₀² − Σ e₁² in block B, or the logarithm of their ratio
gain = Σ D / Σ e₀²
closure = (rms₀ − rms₁) / (rms₀ − floor)        on the joint where it closes most
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from ident.diagnose.null import Null
from ident.diagnose.screen import Judgement, Screen
from ident.diagnose.search import Candidate
from ident.fit.table import Table

SURE = 2.0  # standard errors of the blocks' gain
BEYOND = 1.2  # times the largest fall that clean logs show
LIKELY, FAR = 1.2, 4.0  # fewer errors, if it is so far beyond clean logs and closes the gap
RARE = 3.0  # both, for effects that noise in positions is taken for and few machines have
CLOSES = 0.65  # share of the gap that one effect must close by itself
COMMON = 0.15  # or an effect that every machine has, if it is surer
SURER = 2.5
TRACE = 0.05  # or even less, if it is surer still
SUREST = 4.0
TOGETHER = 0.75  # or two or three effects together, of which none does alone
REST = 0.005  # share of the torque below which what is left over does not matter
MATERIAL = 0.003  # share of a joint's torque below which an effect does not matter
LEAST = 0.03  # share of a residual by which it must exceed noise for a gap to be spoken of
HIDDEN = 0.02  # visible share below which the data cannot speak of an effect
MINE = 0.1  # share of a candidate's fall that makes a coordinate one that it mends


@dataclass(frozen=True, eq=False)
class Evidence:
    """For one candidate, or several together.

    Attributes:
        candidate: the effect, or the first of them.
        difference: (blocks,) D_B.
        gain, z, p: of the held-out squares.
        closure: of the gap, the largest over the coordinates `mends`.
        size: rms of what it explains, as a share of a joint's torque, the largest.
        beyond: its in-sample fall over the largest that clean logs show.
        sensible: whether no value is one that such an effect cannot have.
    """

    candidate: Candidate
    difference: np.ndarray
    gain: float
    z: float
    p: float
    closure: float
    size: float
    beyond: float
    sensible: bool
    mends: tuple[int, ...]

    @property
    def credible(self) -> bool:
        """Whether it is there at all: sure, beyond clean logs, material, visible, sensible."""
        rare = self.candidate.effect.rare
        sure = LIKELY if self.beyond > FAR and self.closure >= CLOSES else SURE
        return (
            self.z > (RARE if rare else sure)
            and self.gain > 0
            and self.beyond > (RARE if rare else BEYOND)
            and self.size > MATERIAL
            and self.candidate.judged.visible > HIDDEN
            and self.sensible
        )


def evidence(
    table: Table, screen: Screen, null: Null, threshold: np.ndarray, candidate: Candidate,
    judged: Judgement | None = None,
) -> Evidence:  # fmt: skip
    """Weighs a candidate, or with `judged` a group of which it is the first.

    Args:
        table, screen, null: the model's rows, and clean logs'.
        threshold: (d,) the largest in-sample fall that clean logs show, by coordinate.
        candidate: to be weighed.
        judged: what the group would do.
    """
    judged = judged or candidate.judged
    before = screen.loss
    D = (before - judged.loss).sum(axis=1)
    z = sureness(before, judged.loss)
    by = np.maximum(judged.by, 0.0)
    mends = np.flatnonzero(by >= MINE * max(by.sum(), 1e-300))
    rows = np.maximum(screen.rows, 1)
    rms0, rms1 = (np.sqrt(loss.sum(axis=0) / rows) for loss in (before, judged.loss))
    gap = np.maximum(rms0 - null.floor, LEAST * rms0 + 1e-300)
    torque = torque_squares(table, screen)
    share = np.sqrt(by / np.where(torque > 0, torque, np.inf))[mends]
    return Evidence(
        candidate=candidate,
        difference=D,
        gain=float(D.sum() / max(before.sum(), 1e-300)),
        z=z,
        p=float(stats.t.sf(z, len(D) - 1)),
        closure=float(np.clip((rms0 - rms1) / gap, 0.0, 1.0)[mends].max(initial=0.0)),
        size=float(share.max(initial=0.0)),
        beyond=float(judged.fall / max(threshold[candidate.coordinate], 1e-300)),
        sensible=bool(share.any()) and _sensible(table, candidate),
        mends=tuple(int(u) for u in mends),
    )


def zscore(D: np.ndarray) -> float:
    """Mean over standard error of differences (blocks,); 0 where nothing differs."""
    spread = D.std(ddof=1) / np.sqrt(len(D)) if len(D) > 1 else 0.0
    return float(D.mean() / spread) if spread > 0 else 0.0


def sureness(before: np.ndarray, after: np.ndarray) -> float:
    """z of the losses' difference (blocks, d), or of their log ratio, the larger."""
    return max(zscore((before - after).sum(axis=1)), zscore(_ratio(before, after)))


def _ratio(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(blocks,) log ratio of squares: where errors are large in few blocks, D alone says little."""
    tiny = 1e-12 * before.sum() + 1e-300
    return np.log((before.sum(axis=1) + tiny) / (after.sum(axis=1) + tiny))


def torque_squares(table: Table, screen: Screen) -> np.ndarray:
    """(d,) weighted squares of the measured torque in the screen's rows."""
    tau = table.tau[screen.row, screen.coordinate] * screen.weight[screen.coordinate]
    return np.bincount(screen.coordinate, tau**2, screen.d)


def _sensible(table: Table, candidate: Candidate) -> bool:
    """Whether no parameter is negative or large that cannot be; what is known already is added."""
    effect, theta = candidate.effect, candidate.judged.theta
    names = effect.unknowns or effect.searched
    own = next((e.values for e in table.mechanism.effects if e.label == effect.label), {})
    values = theta[: len(names)] + [own.get(each.name, 0.0) for each in names]
    if any(abs(v) > each.largest for each, v in zip(names, values, strict=False)):
        return False
    for unknown, value in zip(names, values, strict=False):
        if unknown.nonnegative and value < 0:
            return len(names) > 1 and _minor(effect.arity, values, value)
    return True


def _minor(arity: int, values: np.ndarray, value: float) -> bool:
    """Of several unknowns one may come out a little negative by noise."""
    return arity > 1 and abs(value) < 0.1 * float(np.abs(values).max())


def together(
    table: Table, screen: Screen, null: Null, threshold: np.ndarray, group: Sequence[Candidate]
) -> Evidence:
    """Several candidates at once."""
    judged = screen.judge(np.column_stack([each.columns for each in group]))
    return evidence(table, screen, null, threshold, group[0], judged)
