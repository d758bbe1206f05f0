"""Laws that no library holds: formulas for what is left, where no effect has the right form.

Of formulas that left-out errors cannot tell apart the one of least complexity is the law.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.diagnosis.candidates import Contest
from ident.diagnosis.effect_set import Member, past_responses
from ident.diagnosis.grammar import PLAIN_WAVE, PROBE
from ident.diagnosis.law_search import FittedFormula, LawSearch, OnProgress, at_most
from ident.diagnosis.search import Selection
from ident.diagnosis.selection import Ranking
from ident.display import part
from ident.effects.curve import Curve
from ident.effects.formula import Formula, Term
from ident.equations.rows import IMMOBILE, largest_transmission
from ident.information.evidence import EXCESS, MAIN_CAUSE, PARSIMONY, paired
from ident.information.hypotheses import Array, Index, PartialRegression
from ident.information.projection import EXACT

JOINTS = 2  # work: whose laws are searched
# level: standard errors within which the simplest formula is preferred to the best one (Breiman,
# Friedman, Olshen, Stone, Classification and Regression Trees, 1984, 3.4.3)
ONE_SE = 1.0
RIVALS_SHOWN = 12  # shown: formulas that are listed beside the law
REPEATS = 1.5  # range: waves in the travel, from which a torque is seen to repeat
CUBIC = Term(("1", "q", "q**2", "q**3"))


@dataclass(frozen=True, eq=False)
class FoundLaw:
    """A formula that explains what is left in a joint."""

    fitted: FittedFormula
    joint: str  # of its torque
    gain: float  # share of the left-out squares
    explained: float  # share of what exceeds the noise
    limit: float  # what the gain was held against
    nearest: str  # name of the closest law of the literature
    distance: float  # share of the torque (rms) that is different from that over the motion
    rivals: tuple[FittedFormula, ...]  # that the left-out error cannot tell from it
    # (complexity, share of the squared error left, formula), the best of each complexity
    front: tuple[tuple[int, float, str], ...]
    replaced: tuple[str, ...]  # labels of effects of the library in whose place it stands
    regression: PartialRegression  # the model's rows without those effects
    bounds: Mapping[str, tuple[float, float]]  # of its constants, and of its rivals'

    @property
    def formula(self) -> Formula:
        """Its formula."""
        return self.fitted.formula

    def instead(self, other: FittedFormula) -> FoundLaw:
        """Return the law with one of its rivals in its place."""
        if other is self.fitted:
            return self
        name = other.formula.terms[0].known_as if len(other.formula.terms) == 1 else ""
        return replace(
            self,
            fitted=other,
            rivals=(self.fitted, *(rival for rival in self.rivals if rival is not other)),
            gain=self.gain * other.refit.G / self.fitted.refit.G,
            nearest=name or self.nearest,
            distance=0.0 if name else self.distance,
        )


@dataclass(frozen=True, eq=False)
class LossComparison:
    """Left-out squares of models in the coordinates that a law affected_coordinates."""

    affected_coordinates: list[int]  # these coordinates
    rival_se: float  # standard errors of paired blocks within which two are equal

    def loss(self, losses: Array) -> Array:
        """(blocks,) of losses (blocks, d)."""
        return np.asarray(losses[:, self.affected_coordinates].sum(axis=1))

    def ratio(self, worse: Array, best: Array) -> float:
        """Return how many times larger the left-out squares of the first are."""
        return float(self.loss(worse).sum() / max(float(self.loss(best).sum()), 1e-300))

    def better(self, worse: Array, best: Array) -> float:
        """Return standard errors of paired blocks by which the second is better."""
        return paired(self.loss(worse), self.loss(best))

    def clear(self, worse: Array, best: Array, ratio: float) -> bool:
        """Return whether the second is better by `rival_se` and by a ratio."""
        better = self.better(worse, best) >= self.rival_se
        return better and self.ratio(worse, best) > ratio

    def equal(self, formulas: Sequence[FittedFormula], within: float) -> list[FittedFormula]:
        """Return the formulas within so many standard errors of the best one, simplest first."""
        best = min(
            formulas, key=lambda fitted: float(self.loss(fitted.refit.loss).sum())
        ).refit.loss

        def as_good(loss: Array) -> bool:
            ratio = self.ratio(loss, best)
            return ratio < 1 + PARSIMONY and self.better(loss, best) <= within

        equal = [fitted for fitted in formulas if as_good(fitted.refit.loss)]
        return sorted(equal, key=lambda e: (e.formula.cost, float(self.loss(e.refit.loss).sum())))


def laws_of(
    selection: Selection, loud: Collection[str], on_progress: OnProgress
) -> tuple[Selection, tuple[FoundLaw, ...], tuple[str, ...]]:
    """Search laws where no effect of the library has the right form, in `loud` joints first.

    Returns:
        The selection, in which a law rejects the effects that it replaces, the laws, and the joints
        that Ctrl-C left out.
    """
    laws, last = list[FoundLaw](), selection.last
    joints, unsearched = _joints(selection, loud)[:JOINTS], list[str]()
    for i, joint in enumerate(joints):
        if any(m.law is not None for m in _doubtful(selection, joint)):
            continue  # in a loop, a law of another joint is in their place
        try:
            law_progress = part(on_progress, i / len(joints), (i + 1) / len(joints))
            law = _law(selection, last, joint, law_progress)
        except KeyboardInterrupt:
            unsearched = joints[i:]
            break
        if law is None:
            continue
        laws.append(law)
        replaced = [m for m in selection.members if m.label in law.replaced]
        rest = last.contest.with_model(last.regression.without(_columns(replaced)))
        last = replace(last, contest=rest.extended(law.fitted.C)[0])
        members = (replace(m, law=law.formula) if m in replaced else m for m in selection.members)
        selection = replace(selection, members=tuple(members))
    return selection, tuple(sorted(laws, key=lambda law: -law.gain)), tuple(unsearched)


def _joints(selection: Selection, loud: Collection[str]) -> list[str]:
    """Joints where a law may be missing, the loud ones first: those of curves, of effects whose
    form is in doubt, and all in which more is left than noise; else one of a name beside which the
    joint's curves have more than chance gives them.
    """
    known = selection.contest.table.mechanism.joint_index
    joints = [curve.joints[0] for curve, _ in selection.last.curves[:1] if loud]
    hinted = {curve.joints[0] for curve, _, _ in selection.last.hints}
    secondary = []
    for m in selection.members:
        joint = m.effect.joints[0] if m.effect.joints else ""
        if joint not in known:
            continue
        several = len(_doubtful(selection, joint)) > 1
        doubt = m.rejected or m.effect.descriptive or _occurs_once(selection.contest, m)
        if not m.effect.common and (doubt or several):
            joints.append(joint)
        elif joint in loud or (m.effect.arity == 1 and joint in hinted and not m.effect.common):
            secondary.append(joint)
    loud_joints = [name for name in (*joints, *secondary) if name in loud]
    return list(dict.fromkeys([*loud_joints, *(joints or secondary[:1]), *loud]))


def _hint(last: Ranking, joint: str, signals: frozenset[str]) -> float | None:
    """Return what chance gives the curves of a joint, where one of these signals has more."""
    for curve, _, limit in last.hints:
        assert isinstance(curve, Curve)
        needed = {"q_o"} if curve.arity > 1 else curve.depends_on
        if curve.joints[0] == joint and signals.issuperset(needed):
            return limit
    return None


def _doubtful(selection: Selection, joint: str) -> list[Member]:
    """Members that a law of a joint could replace: what acts on it, but not on all drives in
    common; in a loop, also what acts on another joint alone and the same
    coordinates.
    """
    table, felt = selection.contest.table, set[int]()
    at = table.mechanism.joint_index[joint]
    for scene in table.scenes:
        most = largest_transmission(scene.e)
        felt_here = [at] if most is None else np.flatnonzero(most[at] > IMMOBILE * most[at].max())
        felt |= {int(u) for u in felt_here}
    doubtful = []
    for m in (m for m in selection.members if not (m.effect.common or m.effect.joined)):
        evidence = m.evidence if m.effect.local else None
        if joint in m.effect.joints[:1] or (
            evidence and felt.issuperset(evidence.refit.affected_coordinates)
        ):
            doubtful.append(m)
    return doubtful


def _occurs_once(contest: Contest, m: Member) -> bool:
    """Whether an effect is a wave of which the travel holds too little to show that it repeats."""
    if not m.effect.waves or m.evidence is None:
        return False
    at = contest.table.mechanism.joint_index[m.effect.joints[0]]
    travel = max(float(np.ptp(scene.e.y[scene.e.usable, at])) for scene in contest.table.scenes)
    return m.evidence.shape[m.effect.waves] * travel < 2 * np.pi * REPEATS


def _law(
    selection: Selection, last: Ranking, joint: str, on_progress: OnProgress
) -> FoundLaw | None:
    contest, doubtful = last.contest, _doubtful(selection, joint)
    named = [m for m in doubtful if not m.rejected]
    drawn = last.regression.without(_columns(m for m in doubtful if m.rejected))
    with_names = drawn.bare
    drawn, regression = (x.without(_columns(named)) for x in (drawn, with_names))
    limit, one, decision = last.limit_at(joint), contest.with_model(regression), contest.decision
    assert contest.draws is not None
    noise = regression.rows * (contest.draws.floor * regression.weight) ** 2
    search = LawSearch(
        one, joint, "", limit, EXCESS**2 * noise, part(on_progress, 0.0, 0.5), drawn=drawn,
        alpha=decision.alpha / regression.d,
    )  # fmt: skip
    formulas = _formulas(search, part(on_progress, 0.5, 1.0))
    if not formulas:
        return None
    best = min(formulas, key=lambda fitted: float(fitted.loss.sum()))
    compare = LossComparison(best.refit.affected_coordinates, decision.rival_se)
    law = compare.equal(formulas, ONE_SE)[0]
    equal = compare.equal(formulas, decision.rival_se)
    # where a cubic does as well as a law, the names stay, and the law stands beside them
    names_stay = False
    if any(m.effect.descriptive for m in named):
        cubic = search.fitted(replace(law.formula, joints=(joint,), terms=(CUBIC,)), {})
        names_stay = not compare.clear(cubic.refit.loss, law.refit.loss, 1 + PARSIMONY)
    if named and not names_stay:
        once = any(_occurs_once(contest, m) for m in named)
        chance = _hint(last, joint, law.formula.depends_on)
        if not _takes_place(law, named, with_names, compare, chance, once):
            return None
    before, after = (float(compare.loss(x).sum()) for x in (regression.losses, law.refit.loss))
    explained = (before - after) / max(before - noise[compare.affected_coordinates].sum(), 1e-300)
    if explained < MAIN_CAUSE:
        return None
    extended, gain = one.extended(law.C)[0], regression.gain(law.refit)
    richer = extended.regression
    _, lags = past_responses(replace(last, contest=extended))
    ratio = gain / max(1 - gain, EXACT)
    if any(e.joints == (joint,) and more > PARSIMONY * (ratio + more) for e, _, more in lags):
        return None  # what follows the past of the speed is no function of the present
    for m in selection.members:
        if not names_stay and joint in m.effect.joints[:1] and m.effect.common:
            bare = richer.without(m.columns)
            if not compare.clear(bare.losses, richer.losses, 1.0):
                doubtful.append(m)
    nearest, distance = _nearest(law, formulas)
    return FoundLaw(
        fitted=law,
        joint=joint,
        gain=gain,
        explained=float(np.clip(explained, 0.0, 1.0)),
        limit=limit,
        nearest=nearest,
        distance=distance,
        rivals=tuple(fitted for fitted in equal if fitted is not law)[:RIVALS_SHOWN],
        front=tuple(_front(formulas, compare, before)),
        replaced=tuple(m.label for m in doubtful if not names_stay),
        regression=regression,
        bounds={k: v for e in (*equal, law) for k, v in contest.table.bounds(e.formula).items()},
    )


def _columns(members: Iterable[Member]) -> Index:
    """Return the columns of members."""
    return np.concatenate([np.zeros(0, dtype=np.intp), *(m.columns for m in members)])


def _formulas(search: LawSearch, on_progress: OnProgress) -> list[FittedFormula]:
    """Return all formulas of a joint's signals and, where these leave much, of another joint's."""
    formulas = search.run()
    best = min(
        formulas, key=lambda search_of_other: float(search_of_other.loss.sum()), default=None
    )
    if best is not None and search.explained(best):
        return formulas
    curves = [e.effect.joints for e in search.contest.candidates if e.curve]
    moving = [
        search_of_other[1]
        for search_of_other in curves
        if len(search_of_other) > 1 and search_of_other[0] == search.joint
    ]
    others = [replace(search, other=name, on_progress=on_progress) for name in moving]
    falls = [search_of_other.probed(PROBE) for search_of_other in others]
    if others and at_most(search.regression, [max(falls)])[0] > search.limit:
        formulas += others[int(np.argmax(falls))].run(best)
    return formulas


def _takes_place(
    law: FittedFormula, named: Collection[Member], with_names: PartialRegression,
    compare: LossComparison, chance: float | None, once: bool,
) -> bool:  # fmt: skip
    """Return whether a law takes the place of names: it is clearly better, or as good and shorter.

    `chance`: gain of a curve of the law's signals by chance, where one has more beside the names;
    `once`: whether one of them is a wave that the travel does not repeat.
    """
    if once and law.formula.terms == (PLAIN_WAVE,):
        return False
    ratio = EXCESS**2 if chance is None else 1 + chance
    if compare.clear(with_names.losses, law.refit.loss, ratio):
        return True
    numbers = sum(len(m.effect.parameters) for m in named)
    numbers_of_law = len(law.formula.parameters)
    described = once or any(m.effect.descriptive for m in named)
    shorter = (1 if described else 2) * numbers_of_law <= numbers
    if len(named) > 1 and numbers_of_law < numbers:  # one law in the place of several
        shorter |= compare.ratio(with_names.losses, law.refit.loss) > 1
    return shorter and not compare.clear(law.refit.loss, with_names.losses, 1.0)


def _nearest(law: FittedFormula, formulas: Sequence[FittedFormula]) -> tuple[str, float]:
    """Return the closest law of the literature, and the share of the torque that differs."""
    named = [e for e in formulas if len(e.formula.terms) == 1 and e.formula.terms[0].known_as]
    if not named:
        return "", 1.0
    cosines = [float(e.refit.direction @ law.refit.direction) for e in named]
    if law in named:
        return law.formula.terms[0].known_as, 0.0
    best = int(np.argmax(cosines))
    distance = float(np.sqrt(max(1 - cosines[best] ** 2, 0.0)))
    return named[best].formula.terms[0].known_as, distance


def _front(
    formulas: Sequence[FittedFormula], compare: LossComparison, before: float
) -> list[tuple[int, float, str]]:
    """Return complexity, share left and text of formulas that no simpler one is better than."""
    front: list[tuple[int, float, str]] = []
    for fitted in sorted(formulas, key=lambda e: (e.formula.cost, float(e.loss.sum()))):
        share = float(compare.loss(fitted.refit.loss).sum()) / before
        if not front or share < front[-1][1]:
            front = [e for e in front if e[0] < fitted.formula.cost]
            front.append((fitted.formula.cost, share, fitted.formula.text))
    return front
