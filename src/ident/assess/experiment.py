"""The next experiment as data: which joint, which range, which speed, and what that shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

from numpy.linalg import LinAlgError

from ident.assess.verdict import joints_at_reversals
from ident.diagnosis.experiment import (
    Attempt,
    Pair,
    Probe,
    attempts,
    concerned,
    contenders,
    proposal,
    questions,
)
from ident.diagnosis.result import Diagnosis
from ident.diagnosis.selection import Evidence
from ident.diagnosis.trials import Move, Trial, present, trials
from ident.effects import KINDS, Effect
from ident.effects.library import by_kind, separating
from ident.errors import IdentError
from ident.information.evidence import PARSIMONY, SAME_SHARE
from ident.information.separation import share_apart
from ident.request import Step

SHOWS = 0.02  # level: visible share from which an effect can be seen
# shown: of the logged top speed: friction that depends on the speed shows between reversals
SLOWLY = 0.1
HALF = 0.5  # shown: of the logged top speed: what goes with speed falls in step
DURATION = 30.0  # shown: s of a planned motion, if nothing asks for more
LOOKED_AT = 24  # work: invisible effects that are tried in other motions


# --- suggestions ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Nothing:
    """No motion would answer a question; `why` none was worked out, if that is the reason."""

    why: str = ""


@dataclass(frozen=True)
class AddNamed:
    """Effects that are named without a rival are added; `clock`: once t was checked."""

    effects: tuple[Effect, ...]
    clock: bool = False


@dataclass(frozen=True)
class AddFormula:
    """Formulas of these joints are added, and compared with a log of another motion."""

    joints: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class MoveSlowly:
    """Joints are moved at a tenth of the logged speed, which occurs at reversals only now."""

    moves: tuple[Move, ...]

    @property
    def speeds(self) -> tuple[tuple[str, float], ...]:
        """The largest speed by joint [rad/s | m/s]."""
        return tuple((move.joint.name, SLOWLY * move.speed) for move in self.moves)


@dataclass(frozen=True, eq=False)
class FollowSignal:
    """A joint is moved otherwise, so that the signal on which the residual depends changes.

    Attributes:
        move: of that joint now; worst: joint whose residual is meant.
        signal: on which that depends, as `v.elbow`; empty where on none.
        again: whether the log should hold the motion twice.
    """

    move: Move
    worst: str
    signal: str
    again: bool


@dataclass(frozen=True, eq=False)
class SeparateRivals:
    """A motion that tells rivals apart.

    Attributes:
        trial: the motion; now: the present one.
        pairs: effects that it tells apart; alike: those that stay alike.
        separation: standard errors by which the rivals that stay most alike then differ.
        seconds: length of a log of it [s].
    """

    trial: Trial
    now: tuple[Move, ...]
    pairs: tuple[tuple[Effect, Effect], ...]
    similar: tuple[tuple[Effect, Effect], ...]
    separation: float
    seconds: float

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that it tells apart."""
        return tuple({effect.label: effect for pair in self.pairs for effect in pair}.values())


@dataclass(frozen=True)
class Inseparable:
    """Effects that no motion of the mechanism tells apart."""

    effects: tuple[Effect, ...]


@dataclass(frozen=True, eq=False)
class RevealEffects:
    """A motion that shows effects which this log hides."""

    trial: Trial
    now: tuple[Move, ...]
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class ApplyRemedy:
    """Something other than a motion shows effects of one kind; `alone`: which no motion does."""

    effects: tuple[Effect, ...]
    alone: bool


Suggestion = (
    Nothing | AddNamed | AddFormula | MoveSlowly | FollowSignal | SeparateRivals | Inseparable
    | RevealEffects | ApplyRemedy
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Experiment:
    """What to log next, the most urgent first.

    Attributes:
        suggestions: in order; step: the command that writes the first motion of them, if any does;
            motion: that motion.
        interrupted: whether Ctrl-C came before a motion was worked out.
    """

    suggestions: tuple[Suggestion, ...]
    step: Step = field(default_factory=Step)
    motion: Suggestion | None = None
    interrupted: bool = False


_EXPERIMENTS: WeakKeyDictionary[Diagnosis, Experiment] = WeakKeyDictionary()


def next_experiment(d: Diagnosis) -> Experiment:
    """Return what to log next: which joint, which range, which speed. It is worked out once."""
    if d not in _EXPERIMENTS:
        try:
            suggestions = tuple(_suggestions(d))
            steps = {i: step_of_suggestion(d, one) for i, one in enumerate(suggestions)}
            first = next((i for i, step in steps.items() if step), None)
            motion = None if first is None else suggestions[first]
            step = Step() if first is None else steps[first]
            _EXPERIMENTS[d] = Experiment(suggestions, step, motion)
        except KeyboardInterrupt:  # all else of the diagnosis is kept
            _EXPERIMENTS[d] = Experiment((Nothing("interrupted"),), interrupted=True)
        except (IdentError, LinAlgError) as error:  # without advice the diagnosis is still one
            _EXPERIMENTS[d] = Experiment((Nothing(str(error)),))
    return _EXPERIMENTS[d]


def _suggestions(d: Diagnosis) -> list[Suggestion]:
    rivals = contenders(d)
    if len(rivals) > 1:
        result = _between(d, rivals, attempts(d, rivals))
        if d.best is not None or any(isinstance(one, SeparateRivals) for one in result):
            return result
    slow_moves = _slow_moves(d, joints_at_reversals(d))
    slowly: list[Suggestion] = [MoveSlowly(slow_moves)] if slow_moves else []
    if d.reversing:
        return slowly
    if d.verdict in ("unexplained", "undecided"):
        if d.laws and all(_explained(d, name) for name in d.loud):
            return [AddFormula(tuple(law.joint for law in d.laws))]
        return [follow_signal(d)]
    first: list[Suggestion] = []
    if d.best:
        # faults of the clock are the only ones beside a name
        first = [AddNamed(d.group, clock=bool(d.health.faults))]
    return [*first, *slowly, *hidden_effects(d)] or [Nothing()]


def _slow_moves(d: Diagnosis, joints: Sequence[str]) -> tuple[Move, ...]:
    """Return the moves of joints whose residual is at their reversals."""
    moves = present(d.fit.mechanism, d.fit.motion)
    return tuple(move for move in moves if move.joint.name in joints)


def _explained(d: Diagnosis, joint: str) -> bool:
    """Return whether the laws explain a joint but for the noise."""
    law, noise = d.laws[-1], d.floor[joint] ** 2  # its fit has all laws
    before, after = (errors[joint].rms ** 2 - noise for errors in (law.before, law.after))
    return after < PARSIMONY * before


def _between(
    d: Diagnosis, rivals: Sequence[Evidence], trials: Sequence[Attempt]
) -> list[Suggestion]:
    """Return the first question that a motion answers, behind one that none does."""
    suggestions: list[Suggestion] = []
    for pairs in questions(rivals):
        if result := proposal(d, trials, pairs):
            similar = {(a.label, b.label) for a, b in result.similar}
            effects = [(a.effect, b.effect) for a, b in pairs]
            apart = tuple((a, b) for a, b in effects if (a.label, b.label) not in similar)
            now = present(d.fit.mechanism, d.fit.motion)
            motion = SeparateRivals(
                result.trial, now, apart, result.similar, result.separation, result.seconds
            )
            return [*suggestions, motion]
        suggestions = suggestions or [Inseparable(_effects_of(pairs))]
    return suggestions or [Nothing()]


def _effects_of(pairs: Sequence[Pair]) -> tuple[Effect, ...]:
    return tuple({item.effect.label: item.effect for pair in pairs for item in pair}.values())


def follow_signal(d: Diagnosis) -> FollowSignal:
    """Return how to learn what a residual is that no effect explains."""
    worst = d.where[0]
    signal = worst.depends_on[0].signal if worst.depends_on else ""
    moves = {m.joint.name: m for m in present(d.fit.mechanism, d.fit.motion)}
    move = moves.get(signal.partition(".")[2], moves[worst.joint])  # of a loop: one that can move
    return FollowSignal(move, worst.joint, signal, d.periods is None)


def hidden_effects(d: Diagnosis) -> list[Suggestion]:
    """Return the motion that shows most of what is invisible now, and what to do for the rest."""
    motion = _most_revealing(d) if d.invisible else None
    shown = motion.effects if motion else ()
    hidden = (invisible.effect for invisible in d.invisible if invisible.effect not in shown)
    rest = by_kind(effect for effect in hidden if effect.remedy)
    result: list[Suggestion] = [motion] if motion else []
    for effects in rest[: 2 if motion else 3]:
        result.append(ApplyRemedy(tuple(effects), alone=len(result) < 2))
    return result


def _most_revealing(d: Diagnosis) -> RevealEffects | None:
    """Return the motion in which most of what is invisible would show; None if nothing would."""
    loops = d.fit.mechanism.closures  # a correction closes them anew at every sample: not tried
    wanted = [e.effect for e in d.invisible if not (e.effect.corrects and loops)][:LOOKED_AT]
    now = present(d.fit.mechanism, d.fit.motion)
    best: RevealEffects | None = None
    kinds = {"awake", "turn", "limits", "wider"}
    for trial in trials(now, concerned(d, [])):
        probe = Probe.of(d, trial) if trial.kind in kinds else None
        if probe is None:
            continue
        kinds.remove(trial.kind)
        visible: list[Effect] = []
        for effect in wanted:
            # what cannot be evaluated in this motion is not shown by it
            with suppress(IdentError, LinAlgError):
                visible += [effect] if probe.visible(effect) > SHOWS else []
        if len(visible) > len(best.effects if best else ()):
            best = RevealEffects(trial, tuple(now), tuple(visible))
    return best


def without_motion(effects: Sequence[Effect]) -> list[str]:
    """Return what tells kinds of effects apart that no motion does: a load, a tilt, a sensor."""
    return separating({effect.kind for effect in effects})


# --- the command ----------------------------------------------------------------------------------


def step_of_suggestion(d: Diagnosis, suggestion: Suggestion) -> Step:
    """Return the step that plans the motion of a suggestion; none where it is no motion."""
    match suggestion:
        case SeparateRivals(trial, now):
            step = _plan(trial, now)
            if suggestion.seconds > DURATION:
                step = replace(step, duration=float(math.ceil(suggestion.seconds)))
            return replace(step, separate=separable_pair(d, suggestion.pairs, trial))
        case RevealEffects(trial, now):
            return _plan(trial, now)
        case MoveSlowly():
            return Step("excite", speed=suggestion.speeds, around=True, as_logged=True)
        case FollowSignal(move, _, signal) if move.speed:
            share = HALF if signal.partition(".")[0] in ("v", "a") else SLOWLY
            speeds = ((move.joint.name, share * move.speed),)
            return Step("excite", speed=speeds, around=True, as_logged=True)
    return Step()


def _plan(trial: Trial, now: Sequence[Move]) -> Step:
    """Return the step that plans a motion in the ranges, and up to the speeds, of a trial."""
    changed = [move for move in reached_moves(trial, now) if move.speed]
    ranges = tuple((move.joint.name, move.low, move.high) for move in changed)
    speeds = tuple((move.joint.name, move.speed) for move in changed)
    others = any(move.speed and move.joint.name not in trial.about for move in trial.moves)
    return Step("excite", range=ranges, speed=speeds, around=True, as_logged=others)


def reached_moves(trial: Trial, now: Sequence[Move]) -> tuple[Move, ...]:
    """Return the moves of a trial that differ from those `now`, with the range that they reach."""
    present_moves = {move.joint.name: move for move in now}
    return tuple(
        move if _same_range(move, present_moves[move.joint.name]) else trial.reached(move)
        for move in trial.changed
    )


def _same_range(a: Move, b: Move) -> bool:
    return math.isclose(a.low, b.low) and math.isclose(a.high, b.high)


def separable_pair(
    d: Diagnosis, pairs: Sequence[tuple[Effect, Effect]], trial: Trial | None = None
) -> tuple[str, str] | tuple[()]:
    """Return the best effect and a rival that `excite` tells apart, the one of the same kind if
    there is one. Of bodies it cannot: only some of their ten parameters differ; nor of effects of
    which one can do in a trial whatever the other does.
    """
    best = d.best
    if best is None:
        return ()
    rivals = []
    for pair in pairs:
        labels = [effect.label for effect in pair]
        without_signals = all(not (x.signal or x.loaded_link) and x.kind in KINDS for x in pair)
        if without_signals and best.label in labels:
            rivals.append(pair[1 - labels.index(best.label)])
    if not rivals:
        return ()
    rivals.sort(key=lambda effect: effect.kind != best.kind)
    probe = Probe.of(d, trial) if trial else None
    apart = (x for x in rivals if probe is None or _apart(probe, best, x))
    rival = next(apart, None)
    return (best.label, rival.label) if rival else ()


def _apart(probe: Probe, a: Effect, b: Effect) -> bool:
    """Return whether a trial shows two effects apart; not where it cannot be computed."""
    with suppress(IdentError, LinAlgError, ValueError):
        one, other = (probe.spans(effect, [])[0] for effect in (a, b))
        return bool(one.size and other.size) and share_apart(one, [other]) > SAME_SHARE
    return False
