"""What effects of a set predict where nothing like it was fitted.

A motion that repeats shows each of its parts many times: what describes one log is then rewarded
by stretches of time that are left out, whose twins are fitted. So whole phases of the period are
left out, and whole regions of a joint's position and direction, beside stretches of time:

    D_k = |e_k without the effect|² − |e_k with it|²        e_k: errors of the left-out part k

An effect is carried by a log if one of its values is CERTAIN standard errors from zero, if D is
RIVAL standard errors above zero over stretches of time, or over phases where the motion repeats, if
regions that were left out are not predicted worse with it, and if what it takes from the error of
some joint is CARRIED_SHARE of that joint's torque, or most of that error: what a diagnosis would
name next is no refinement of what is there.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.diagnosis.effect_set import EffectSet, Member
from ident.fit.residual_maps import period_of
from ident.information.blocks import Part
from ident.information.evidence import CERTAIN, MAIN_CAUSE, PARSIMONY, RIVAL, paired
from ident.information.hypotheses import Array, Index, PartialRegression

CARRIED_SHARE = 0.01  # level: of a joint's torque (rms), that an effect takes from its error
PHASES = 10  # work: of a period, that are left out in turn
REGIONS = 5  # work: of a joint's positions, each in both directions


@dataclass(frozen=True, eq=False)
class Unseen:
    """The rows of a set of effects, with phases and regions of its motion in place of blocks."""

    effect_set: EffectSet

    def carries(self, member: Member) -> bool:
        """Return whether the log carries a member of the set."""
        return self.shortfall(member) <= 0

    def shortfall(self, member: Member) -> float:
        """Return by how much a member falls short of what carries it, as a share of that; at most 0
        of one that is carried.
        """
        without, losses = self._losses(self.effect_set.regression, member)
        fall = (without - losses).sum(axis=0)
        torque = np.maximum(self.effect_set.contest.torque, 1e-300)
        size = float(np.sqrt(np.maximum(fall, 0.0) / torque).max())
        share = float((fall / np.maximum(without.sum(axis=0), 1e-300)).max())
        if self.phases is not None:
            without, losses = self._losses(self.phases, member)
        sure = paired(without.sum(axis=1), losses.sum(axis=1))
        worst = max(
            1 - self.standard_errors[member.label] / CERTAIN,
            1 - sure / RIVAL,
            1 - max(size / CARRIED_SHARE, share / MAIN_CAUSE),
        )
        in_motion = member.effect.joints and not member.effect.corrects
        if worst <= 0 and in_motion and (regions := self._regions(member)) is not None:
            without, losses = self._losses(regions, member)
            unseen, seen = float((losses - without).sum()), max(float(fall.sum()), 1e-300)
            worst = max(worst, unseen / seen - PARSIMONY)
        return worst

    @cached_property
    def standard_errors(self) -> dict[str, float]:
        """The largest value of each member over its standard error, by label."""
        regression = self.effect_set.regression
        theta, inverse = regression.solved
        noise = np.sqrt(float(regression.loss.sum()) / max(float(regression.rows.sum()), 1.0))
        stderr = noise * np.sqrt(np.maximum(np.diag(inverse), 0.0))
        place = {int(column): i for i, column in enumerate(regression.model)}
        sizes = np.abs(theta) / np.where(stderr > 0, stderr, np.inf)
        return {
            m.label: float(max(sizes[place[int(column)]] for column in m.columns))
            for m in self.effect_set.members
        }

    @staticmethod
    def _losses(rows: PartialRegression, member: Member) -> tuple[Array, Array]:
        """Return the left-out squares (parts, d) without a member and with it."""
        return rows.losses_without(member.columns), rows.losses

    @cached_property
    def phases(self) -> PartialRegression | None:
        """The rows by phase of the period; None where no log repeats its motion."""
        table = self.effect_set.contest.table
        joints = table.mechanism.joint_index
        independent = np.array([joints[name] for name in table.motion.independent])
        labels, repeats = table.blocks.copy(), False
        first = int(labels.max(initial=0)) + 1  # of the phases' numbers
        for number, scene in enumerate(table.scenes):
            rows = table.experiment == number
            period = period_of(scene.e, independent, table.motion.band.motion)
            if period is not None and rows.any():
                turn = (table.t[rows] - table.t[rows][0]) / period % 1.0
                labels[rows] = first + number * PHASES + np.floor(PHASES * turn).astype(int)
                repeats = True
        return self._parted(labels) if repeats else None

    def _regions(self, member: Member) -> PartialRegression | None:
        """Return the rows by position and direction of a member's joint; None of one at rest."""
        index = self.effect_set.contest.table.mechanism.joint_index
        if not {*member.effect.joints[:1]} <= {*index}:
            return None
        at = index[member.effect.joints[0]]
        if at not in self._by_region:
            self._by_region[at] = self._regions_of(at)
        return self._by_region[at]

    @cached_property
    def _by_region(self) -> dict[int, PartialRegression | None]:
        """What `_regions` has returned, by joint."""
        return {}

    def _regions_of(self, at: int) -> PartialRegression | None:
        """Return the rows by position and direction of a joint; None of one at rest."""
        table = self.effect_set.contest.table
        q, v = np.empty(len(table.t)), np.empty(len(table.t))
        for number, scene in enumerate(table.scenes):
            rows = table.experiment == number
            q[rows] = scene.e.y[table.sample[rows], at]
            v[rows] = scene.e.yd[table.sample[rows], at]
        edges = np.quantile(q, np.arange(1, REGIONS) / REGIONS)
        if not edges[-1] > edges[0]:
            return None
        return self._parted(2 * np.searchsorted(edges, q) + (v > 0))

    def _parted(self, labels: np.ndarray) -> PartialRegression:
        """Return the rows of the set's model alone, in parts by labels (N,) of the table's rows."""
        contest, regression = self.effect_set.contest, self.effect_set.regression
        numbers, parts, orders, first = np.unique(labels), list[Part](), list[Index](), 0
        for part in regression.parts:
            of_rows = labels[contest.use[:, part.coordinate]]
            order = np.argsort(of_rows, kind="stable")
            edges = np.searchsorted(of_rows[order], [*numbers, numbers[-1] + 1])
            none = np.zeros((len(order), 0))
            parts.append(Part(part.coordinate, numbers[:0], none, part.Y[order, :1], edges))
            orders.append(first + order)
            first += len(order)
        return regression.in_order(parts, np.concatenate(orders))


def carried(effect_set: EffectSet, given: Collection[str]) -> EffectSet:
    """Return a set without the effects, but those `given` by label and what others need, that the
    log does not carry; what falls shortest goes first.
    """
    while True:
        unseen = Unseen(effect_set)
        free = [m for m in effect_set.members if m.label not in {*given, *effect_set.required}]
        shortfalls = {m.label: unseen.shortfall(m) for m in free}
        worst = max(free, key=lambda m: shortfalls[m.label], default=None)
        if worst is None or shortfalls[worst.label] <= 0:
            return effect_set
        effect_set = effect_set.minus(worst)
