"""The simplest motion, among some that are tried out, that tells rivals apart.

    worth = Σ min(separation, AMPLE)²  over the pairs of a question        within CLOSE of the best

First question: at which place, of effects of one kind. Second: of which kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from ident.diagnose.describe import described
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.probe import Probe
from ident.diagnose.search import Candidate
from ident.diagnose.trials import Move, Trial, present, trials
from ident.effects import Effect

SURE = 7.0  # standard errors by which rivals are told apart, with chance against it
SOME = 1.0  # from which a longer log tells them apart
AMPLE = 10.0  # beyond which more is worth nothing
CLOSE = 0.8  # share of the best worth with which a simpler motion does
SAME = 2e-3  # share of a rival's torque: what differs by less is the same in this motion
RIVALS = 12  # that are looked at
SLOW = {"stribeck", "hysteresis", "backlash"}  # kinds that show at low speed
PLACES = ("same", "turn", "limits", "wider", "faster", "speeds", "alone", "strokes")
KINDS = ("same", "faster", "speeds", "turn", "limits", "wider", "alone", "strokes")
KINDS_SLOW = ("same", "strokes", "speeds", "faster", "turn", "limits", "wider", "alone")

Pair = tuple[Candidate, Candidate]


@dataclass(frozen=True, eq=False)
class Proposal:
    """A motion to be logged next, and what it would show.

    Attributes:
        trial: the motion; `trial.logs` are its positions, rates and accelerations.
        joints: that move otherwise than now; ranges: of theirs [rad | m]; speeds: top [… / s].
        separation: of the two rivals told apart that stay most alike, in standard errors of a log
            as long as the present one; now: of the same two in a motion like the present one.
        apart: rivals that it tells apart; alike: pairs that it does not.
        seconds: how long a log of it should be to be nearly sure.
        words: what to do.
    """

    trial: Trial
    joints: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...]
    speeds: tuple[float, ...]
    separation: float
    now: float
    apart: tuple[Effect, ...]
    alike: tuple[tuple[Effect, Effect], ...]
    seconds: float
    words: str


@dataclass(frozen=True, eq=False)
class Attempt:
    """What one trial makes of all pairs: (standard errors, share that differs)."""

    trial: Trial
    found: dict[Pair, tuple[float, float]]

    def separation(self, pair: Pair) -> float:
        """Standard errors; none where the two are the same but for rounding."""
        x, share = self.found[pair]
        return x if share > SAME else 0.0

    def worth(self, pairs: Sequence[Pair]) -> float:
        """Of the trial for these pairs."""
        return sum(min(self.separation(pair), AMPLE) ** 2 for pair in pairs)


def contenders(d: Diagnosis) -> list[Candidate]:
    """The best and its rivals, as they were judged, those of the best one's kind first."""
    if d.choice.best is None:
        return []
    best = d.choice.best.candidate
    rest = [each.candidate for each in d.choice.rivals]
    rest.sort(key=lambda each: each.effect.kind != best.effect.kind)
    return [best, *rest][:RIVALS]


def questions(rivals: Sequence[Candidate]) -> list[list[Pair]]:
    """Pairs of one kind at several places, then pairs of several kinds; none empty."""
    pairs = list(combinations(rivals, 2))
    where = [(a, b) for a, b in pairs if a.effect.kind == b.effect.kind]
    what = [(a, b) for a, b in pairs if a.effect.kind != b.effect.kind]
    return [each for each in (where, what) if each]


def attempts(d: Diagnosis, rivals: Sequence[Candidate]) -> list[Attempt]:
    """Tries motions out, one like the present first, until one tells all apart with ease."""
    now = present(d.fit.mechanism, d.fit.motion)
    pairs = list(combinations(rivals, 2))
    tried: list[Attempt] = []
    for trial in ordered(d, rivals, now):
        probe = Probe.of(d, trial)
        if probe is None:
            continue
        tried.append(Attempt(trial, {(a, b): probe.separation(a, b) for a, b in pairs}))
        ample = min(tried[-1].separation(pair) for pair in pairs) >= AMPLE
        if ample and trial.kind != "same":
            break
    return tried


def ordered(d: Diagnosis, rivals: Sequence[Candidate], now: tuple[Move, ...]) -> list[Trial]:
    """Trials in the order in which they are likely to help, as they come where alike."""
    kinds = [rival.effect.kind for rival in rivals]
    order = KINDS_SLOW if set(kinds) & SLOW else KINDS
    if len(set(kinds)) < len(kinds):
        order = PLACES
    about = concerned(d, [rival.effect for rival in rivals])
    mine = [trial for trial in trials(now, about) if trial.kind in order]
    return sorted(mine, key=lambda trial: order.index(trial.kind))


def concerned(d: Diagnosis, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Independent joints whose motion an effect feels: its own in a tree, all of them in a loop."""
    independent = d.fit.motion.independent
    joints = {name for effect in effects for name in effect.joints if effect.site == "joint"}
    if d.fit.mechanism.closures or not joints & set(independent):
        return independent
    return tuple(name for name in independent if name in joints)


def proposal(d: Diagnosis, tried: Sequence[Attempt], pairs: Sequence[Pair]) -> Proposal | None:
    """The simplest trial that answers a question about as well as the best; None if none does."""
    other = [each for each in tried if each.trial.kind != "same"]
    most = max((each.worth(pairs) for each in other), default=0.0)
    best = next((each for each in other if each.worth(pairs) >= CLOSE * most), None)
    if best is None or not (told := [p for p in pairs if best.separation(p) >= SOME]):
        return None
    worst = min(told, key=best.separation)
    like = next((each.separation(worst) for each in tried if each.trial.kind == "same"), 0.0)
    length = sum(float(e.t[-1] - e.t[0]) for e in d.fit.motion.experiments)
    moves = [m for m in best.trial.moves if m.joint.name in best.trial.about]
    effects = {each.effect.label: each.effect for pair in told for each in pair}
    return Proposal(
        trial=best.trial,
        joints=best.trial.about,
        ranges=tuple((m.low, m.high) for m in moves),
        speeds=tuple(m.speed for m in moves),
        separation=best.separation(worst),
        now=like,
        apart=tuple(effects.values()),
        alike=tuple((a.effect, b.effect) for a, b in pairs if best.separation((a, b)) < SOME),
        seconds=max(best.trial.seconds, length * max(1.0, (SURE / best.separation(worst)) ** 2)),
        words=described(best.trial, present(d.fit.mechanism, d.fit.motion)),
    )
