"""Laws that no library holds: formulas for what is left, where no effect has the right form.

Of formulas that left-out errors cannot tell apart the one of least complexity is the law.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.diagnosis.candidates import Contest
from ident.diagnosis.effect_set import Member, Responses
from ident.diagnosis.grammar import PLAIN_WAVE, PROBE
from ident.diagnosis.law_search import FittedFormula, LawSearch, OnProgress, at_most
from ident.diagnosis.search import Selection
from ident.diagnosis.selection import MOST, Decision, Ranking
from ident.display import part
from ident.effects.curve import Curve
from ident.effects.formula import Formula, Term
from ident.equations.rows import ROUNDING, largest_transmission
from ident.information.chance import LOUD, MINE, PARSIMONY, paired
from ident.information.hypotheses import Array, Index, PartialRegression
from ident.information.projection import EXACT

OTHERS = 1  # work: joint whose signals are tried beside the own ones
JOINTS = 2  # work: whose laws are searched
# level: standard errors within which the simplest formula is preferred to the best one (Breiman,
# Friedman, Olshen, Stone, Classification and Regression Trees, 1984, 3.4.3)
ONE_SE = 1.0
RIVALS = 12  # shown: formulas that are listed beside the law
REPEATS = 1.5  # range: waves in the travel, from which a torque is seen to repeat
CUBIC = Term(("1", "q", "q**2", "q**3"))


@dataclass(frozen=True, eq=False)
class FoundLaw:
    """A formula that explains what is left in a joint.

    Attributes:
        found: the formula; joint: of its torque.
        gain: share of the left-out squared error; explained: of what exceeds the noise.
        limit: what the gain was held against.
        nearest: name of the closest law of the literature, with its distance: the share of the
            torque (rms) that is different over the motion.
        rivals: other formulas that the left-out error cannot tell from it.
        front: (complexity, share of the squared error left, formula), of the best of each
            complexity.
        replaced: labels of effects of the library in whose place it stands.
        beside: the model's rows without those effects.
        bounds: of its constants, and of its rivals'.
    """

    found: FittedFormula
    joint: str
    gain: float
    explained: float
    limit: float
    nearest: str
    distance: float
    rivals: tuple[FittedFormula, ...]
    front: tuple[tuple[int, float, str], ...]
    replaced: tuple[str, ...]
    beside: PartialRegression
    bounds: Mapping[str, tuple[float, float]]

    @property
    def formula(self) -> Formula:
        """Its formula."""
        return self.found.formula

    def instead(self, other: FittedFormula) -> FoundLaw:
        """Return the law with one of its rivals in its place."""
        if other is self.found:
            return self
        name = other.formula.terms[0].known_as if len(other.formula.terms) == 1 else ""
        return replace(
            self,
            found=other,
            rivals=(self.found, *(each for each in self.rivals if each is not other)),
            gain=self.gain * other.refit.G / self.found.refit.G,
            nearest=name or self.nearest,
            distance=0.0 if name else self.distance,
        )


@dataclass(frozen=True, eq=False)
class LossComparison:
    """Left-out squares of models in the coordinates that a law mends.

    Attributes:
        mends: coordinates.
        rival_se: standard errors of paired blocks within which two are equal.
    """

    mends: Sequence[int]
    rival_se: float

    def loss(self, losses: Array) -> Array:
        """(blocks,) of losses (blocks, d)."""
        return np.asarray(losses[:, list(self.mends)].sum(axis=1))

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

    def equal(self, found: Sequence[FittedFormula], within: float) -> list[FittedFormula]:
        """Return the formulas within so many standard errors of the best one, simplest first."""
        best = min(found, key=lambda each: float(self.loss(each.refit.loss).sum())).refit.loss

        def as_good(loss: Array) -> bool:
            ratio = self.ratio(loss, best)
            return ratio < 1 + PARSIMONY and self.better(loss, best) <= within

        equal = [each for each in found if as_good(each.refit.loss)]
        return sorted(equal, key=lambda e: (e.formula.cost, float(self.loss(e.refit.loss).sum())))


def laws_of(
    contest: Contest,
    selection: Selection,
    loud: Collection[str],
    floor: Mapping[str, float],
    decision: Decision,
    on_progress: OnProgress,
) -> tuple[Selection, tuple[FoundLaw, ...], tuple[str, ...]]:
    """Search laws where no effect of the library has the right form; Ctrl-C ends the search with
    the laws that are found.

    Args:
        contest, selection: of the diagnosis.
        loud: joints in which more than noise is left; floor: rms of noise by joint [N m | N].
        decision: the rule of evidence.
        on_progress: called with (what is being done, share done).

    Returns:
        The selection, in which a law rejects the effects that it replaces, the laws, and the joints
        that Ctrl-C left out.
    """
    found, last = list[FoundLaw](), selection.last
    joints, unsearched = _joints(contest, selection, loud)[:JOINTS], list[str]()
    for i, joint in enumerate(joints):
        if any(m.law is not None for m in _doubtful(contest, selection, joint)):
            continue  # in a loop, a law of another joint is in their place
        try:
            here = part(on_progress, i / len(joints), (i + 1) / len(joints))
            law = _law(contest, selection, last, joint, floor, decision, here)
        except KeyboardInterrupt:
            unsearched = joints[i:]
            break
        if law is None:
            continue
        found.append(law)
        last = _with(last, law, selection.members)
        members = [
            replace(m, law=law.formula) if m.label in law.replaced else m for m in selection.members
        ]
        selection = replace(selection, members=tuple(members))
    return selection, tuple(sorted(found, key=lambda law: -law.gain)), tuple(unsearched)


def _joints(contest: Contest, selection: Selection, loud: Collection[str]) -> list[str]:
    """Joints where a law may be missing, the loud ones first: those of curves, of effects whose
    form is in doubt, and all in which more is left than noise.

    If there are none, one of a name beside which the joint's curves have more than chance gives
    them.
    """
    known = contest.table.mechanism.joint_index
    found = [curve.joints[0] for curve, _ in selection.last.curves[:1] if loud]
    hinted = {curve.joints[0] for curve, _, _ in selection.last.hints}
    quiet = []
    for m in selection.members:
        joint = m.effect.joints[0] if m.effect.joints else ""
        if joint not in known:
            continue
        several = len(_doubtful(contest, selection, joint)) > 1
        doubt = m.rejected or m.effect.descriptive or _once(contest, m)
        if not m.effect.common and (doubt or several):
            found.append(joint)
        elif joint in loud or (m.effect.arity == 1 and joint in hinted and not m.effect.common):
            quiet.append(joint)
    mine = [name for name in (*found, *quiet) if name in loud]
    return list(dict.fromkeys([*mine, *(found or quiet[:1]), *loud]))


def _with(last: Ranking, law: FoundLaw, members: Collection[Member]) -> Ranking:
    """Return the model with a law in the place of what it replaces."""
    regression = last.regression
    for m in members:
        regression = regression.without(m.columns) if m.label in law.replaced else regression
    whole, new = replace(last.contest, regression=regression).added(law.found.C)
    return replace(last, contest=whole, regression=whole.regression.extended(new))


def _hint(last: Ranking, joint: str, signals: frozenset[str]) -> float | None:
    """Return what chance gives the curves of a joint, where one of these signals has more."""
    for curve, _, own in last.hints:
        assert isinstance(curve, Curve)
        needed = {"q_o"} if curve.arity > 1 else curve.depends_on
        if curve.joints[0] == joint and signals.issuperset(needed):
            return own
    return None


def _doubtful(contest: Contest, selection: Selection, joint: str) -> list[Member]:
    """Members that a law of a joint could replace: what acts on it, but not on all drives in
    common; in a loop, also what acts on another joint alone and mends the same coordinates.
    """
    at = contest.table.mechanism.joint_index[joint]
    felt: set[int] = set()
    for scene in contest.table.scenes:
        most = largest_transmission(scene.e)
        here = [at] if most is None else np.flatnonzero(most[at] > ROUNDING * most[at].max())
        felt |= {int(u) for u in here}
    return [
        m
        for m in selection.members
        if not m.effect.common
        and not m.effect.joined
        and (
            joint in m.effect.joints[:1]
            or (m.effect.local and m.evidence is not None and felt.issuperset(m.evidence.mends))
        )
    ]


def _once(contest: Contest, m: Member) -> bool:
    """Whether an effect is a wave of which the travel holds too little to show that it repeats."""
    if not m.effect.waves or m.evidence is None:
        return False
    at = contest.table.mechanism.joint_index[m.effect.joints[0]]
    travel = max(float(np.ptp(scene.e.y[scene.e.usable, at])) for scene in contest.table.scenes)
    return m.evidence.shape[m.effect.waves] * travel < 2 * np.pi * REPEATS


def _law(
    contest: Contest, selection: Selection, last: Ranking, joint: str, floor: Mapping[str, float],
    decision: Decision, on_progress: OnProgress,
) -> FoundLaw | None:  # fmt: skip
    doubtful = _doubtful(contest, selection, joint)
    named = [m for m in doubtful if not m.rejected]
    drawn = last.regression.without(_columns(m for m in doubtful if m.rejected))
    with_names = drawn.judging([p.Y[:, :1] for p in drawn.parts])
    drawn, regression = (x.without(_columns(named)) for x in (drawn, with_names))
    limit = last.limit_at(joint)
    one = replace(last.contest, regression=regression)
    floors = np.array([floor[name] for name in contest.fit.motion.independent])
    noise = regression.rows * (floors * regression.weight) ** 2
    here = [part(on_progress, i / (1 + OTHERS), (i + 1) / (1 + OTHERS)) for i in range(1 + OTHERS)]
    search = LawSearch(one, regression, joint, "", limit, LOUD**2 * noise, here[0], drawn=drawn,
                       alpha=decision.alpha / regression.d)  # fmt: skip
    found = _formulas(contest, search, here[1:])
    if not found:
        return None
    best = min(found, key=lambda each: float(each.loss.sum()))
    mends = np.flatnonzero(best.refit.by >= MINE * best.refit.by.sum())
    compare = LossComparison([int(u) for u in mends], decision.rival_se)
    law = compare.equal(found, ONE_SE)[0]
    equal = compare.equal(found, decision.rival_se)
    # where a cubic does as well as a law, the names stay, and the law stands beside them
    names_stay = False
    if any(m.effect.descriptive for m in named):
        cubic = search.fitted(replace(law.formula, joints=(joint,), terms=(CUBIC,)), {})
        names_stay = not compare.clear(cubic.refit.loss, law.refit.loss, 1 + PARSIMONY)
    if named and not names_stay:
        once = any(_once(contest, m) for m in named)
        chance = _hint(last, joint, law.formula.depends_on)
        if not _takes_place(law, named, with_names, compare, chance, once):
            return None
    before, after = (float(compare.loss(x).sum()) for x in (regression.losses, law.refit.loss))
    explained = (before - after) / max(before - noise[compare.mends].sum(), 1e-300)
    if explained < MOST:
        return None
    whole, new = replace(last.contest, regression=regression).added(law.C)
    richer = whole.regression.extended(new)
    gain = regression.gain(law.refit)
    lags = Responses.of(replace(last, contest=whole, regression=richer)).credible
    ratio = gain / max(1 - gain, EXACT)
    if any(e.joints == (joint,) and more > PARSIMONY * (ratio + more) for e, _, more in lags):
        return None  # what follows the past of the speed is no function of the present
    for m in selection.members:
        if not names_stay and joint in m.effect.joints[:1] and m.effect.common:
            bare = richer.without(m.columns)
            if not compare.clear(bare.losses, richer.losses, 1.0):
                doubtful.append(m)
    nearest, distance = _nearest(law, found)
    return FoundLaw(
        found=law,
        joint=joint,
        gain=gain,
        explained=float(np.clip(explained, 0.0, 1.0)),
        limit=limit,
        nearest=nearest,
        distance=distance,
        rivals=tuple(each for each in equal if each is not law)[:RIVALS],
        front=tuple(_front(found, compare, before)),
        replaced=tuple(m.label for m in doubtful if not names_stay),
        beside=regression,
        bounds={k: v for e in (*equal, law) for k, v in contest.table.bounds(e.formula).items()},
    )


def _columns(members: Iterable[Member]) -> Index:
    """Return the columns of members."""
    return np.concatenate([np.zeros(0, dtype=np.intp), *(m.columns for m in members)])


def _formulas(
    contest: Contest, search: LawSearch, parts: Sequence[OnProgress]
) -> list[FittedFormula]:
    """Return all formulas of a joint's signals and, where they leave more than noise, of another
    joint's; progress of each of those goes to one of `parts`.
    """
    found = search.run()
    best = min(found, key=lambda each: float(each.loss.sum()), default=None)
    if best is not None and search.explained(best):
        return found
    others = [replace(search, other=name) for name in _moving(contest, search.joint)]
    falls = {each.other: each.probed(PROBE) for each in others}
    likely = sorted(others, key=lambda each: -falls[each.other])
    for each, here in zip(likely, parts, strict=False):
        each.on_progress = here
        if at_most(each.regression, [falls[each.other]])[0] > search.limit:
            found += each.run(best)
    return found


def _takes_place(
    law: FittedFormula, named: Collection[Member], with_names: PartialRegression,
    compare: LossComparison, chance: float | None, once: bool,
) -> bool:  # fmt: skip
    """Return whether a law takes the place of names: it is clearly better, or as good and shorter.

    Args:
        named: the effects; with_names: the model with them.
        chance: gain of a curve of the law's signals by chance, where one has more beside the names.
        once: whether one of them is a wave that the travel does not repeat.
    """
    if once and law.formula.terms == (PLAIN_WAVE,):
        return False
    ratio = LOUD**2 if chance is None else 1 + chance
    if compare.clear(with_names.losses, law.refit.loss, ratio):
        return True
    numbers = sum(len(m.effect.parameters) for m in named)
    mine = len(law.formula.parameters)
    described = once or any(m.effect.descriptive for m in named)
    shorter = (1 if described else 2) * mine <= numbers
    if len(named) > 1 and mine < numbers:  # one law in the place of several
        shorter |= compare.ratio(with_names.losses, law.refit.loss) > 1
    return shorter and not compare.clear(law.refit.loss, with_names.losses, 1.0)


def _moving(contest: Contest, joint: str) -> list[str]:
    """Other joints that move."""
    curves = [e.effect for e in contest.candidates if e.curve and len(e.effect.joints) > 1]
    return [c.joints[1] for c in curves if c.joints[0] == joint]


def _nearest(law: FittedFormula, found: Sequence[FittedFormula]) -> tuple[str, float]:
    """Return the law of the literature that is closest over this motion, and its distance.

    The distance is the share of the law's torque, rms, that is different beside the model.
    """
    named = [e for e in found if len(e.formula.terms) == 1 and e.formula.terms[0].known_as]
    if not named:
        return "", 1.0
    cosines = [float(e.refit.direction @ law.refit.direction) for e in named]
    if law in named:
        return law.formula.terms[0].known_as, 0.0
    best = int(np.argmax(cosines))
    distance = float(np.sqrt(max(1 - cosines[best] ** 2, 0.0)))
    return named[best].formula.terms[0].known_as, distance


def _front(
    found: Sequence[FittedFormula], compare: LossComparison, before: float
) -> list[tuple[int, float, str]]:
    """Return complexity, share left and text of formulas that no simpler one is better than."""
    front: list[tuple[int, float, str]] = []
    for each in sorted(found, key=lambda e: (e.formula.cost, float(e.loss.sum()))):
        left = float(compare.loss(each.refit.loss).sum()) / before
        if not front or left < front[-1][1]:
            front = [e for e in front if e[0] < each.formula.cost]
            front.append((each.formula.cost, left, each.formula.text))
    return front
