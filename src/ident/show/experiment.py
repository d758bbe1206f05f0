"""The next experiment in words: which joint, which range, which speed, and what that shows."""

from __future__ import annotations

from collections.abc import Sequence

from ident.assess.experiment import (
    HALF,
    SLOWLY,
    AddFormula,
    AddNamed,
    ApplyRemedy,
    Experiment,
    FollowSignal,
    Inseparable,
    MoveSlowly,
    Nothing,
    RevealEffects,
    SeparateRivals,
    Suggestion,
    next_experiment,
    reached_moves,
    without_motion,
)
from ident.diagnosis.result import Diagnosis
from ident.diagnosis.trials import Move, Trial
from ident.display import renders
from ident.effects import Effect
from ident.effects.formula import Formula
from ident.effects.library import by_kind, named
from ident.information.evidence import TOLD_APART_SE
from ident.mechanism.mechanism import Mechanism
from ident.text import listed, places, two_digits

TWICE = "a motion that is made at least twice in one log"
REPEATS = "what then repeats is the mechanism, what does not is noise or drift"
NOTHING = "This log leaves no question that another motion would answer."
HOW = {
    "turn": "turn {names} through a full turn, there and back{before}, at up to {top}",
    "limits": "move {spans}, nearly from limit to limit{before}, at up to {top}",
    "wider": "move {spans}, wider than now{before}, at up to {top}",
    "same": "move {spans} as now, at up to {top}, in a mixture of several frequencies",
    "faster": "move {spans} as now, but faster, at up to {top}",
    "speeds": "move {spans} as now, both slowly and fast, at up to {shares} of {top}",
    "strokes": "move {spans} in strokes of constant speed, at {shares} of {top}",
    "alone": "move {spans} alone, at up to {top}, and hold the other drives still",
    "awake": "move {spans} too, at up to {top}",
}
FOLLOWS = {  # by the first signal on which a residual depends
    "v": "move {joint}{half}, half as fast as now: what goes with speed then falls in step",
    "sign(v)": "move {joint} slowly{slow} in strokes, turning back at different places",
    "q": "move {joint} slowly{slow} over its full travel, up and down",
    "a": "move {joint}{half}, half as fast as now: what goes with acceleration falls to a quarter",
    "load": "repeat the motion with a known payload: what goes with the load then grows",
    "t": "warm the machine up first, and log temperatures (`temperature.<joint>`)",
    "": "move {joint} slowly{slow}, turning back at five places: this shows what has memory",
}


@renders(Diagnosis, "experiment")
def experiment_text(d: Diagnosis) -> str:
    """Return what to log next, in sentences, the most urgent first."""
    return experiment_words(next_experiment(d), d.fit.mechanism)


def experiment_words(experiment: Experiment, mechanism: Mechanism) -> str:
    """Return the suggestions of an experiment as sentences."""
    return " ".join(
        suggestion_words(suggestion, mechanism) for suggestion in experiment.suggestions
    )


def suggestion_words(suggestion: Suggestion, mechanism: Mechanism) -> str:
    """Return one suggestion as one or several sentences."""
    match suggestion:
        case AddNamed(effects, clock):
            if clock:
                return f"Compare t with another clock, and measure {named(effects)}."
            return f"Add {named(effects)} and diagnose again: no other effect explains it as well."
        case AddFormula(joints):
            return (
                f"Add the formula of {listed(joints)} and diagnose again. A log of another motion, "
                "over the full travel of the joint, shows whether it is a cause: compare both fits "
                "there."
            )
        case MoveSlowly():
            return _slowly(suggestion)
        case FollowSignal():
            return _followed(suggestion)
        case SeparateRivals():
            return _separated(suggestion, mechanism)
        case Inseparable(effects):
            remedy = _capital(remedies_without_motion(mechanism, effects))
            return f"No motion can tell {effect_words(effects)} apart. {remedy}."
        case RevealEffects(trial, now, effects):
            words = _capital(trial_words(trial, now))
            return f"{words}: that would show {named(effects)}, invisible in this log."
        case ApplyRemedy(effects, alone):
            alone_words = ", which no motion tried does" * alone
            return f"{_capital(remedy_of(effects))}: that would show {named(effects)}{alone_words}."
        case Nothing("interrupted"):
            return "Interrupted before one was worked out."
        case Nothing(why):
            return f"No experiment could be worked out ({why})." if why else NOTHING
    raise TypeError(type(suggestion).__name__)


def motion_words(suggestion: Suggestion, mechanism: Mechanism) -> tuple[str, str]:
    """Return what the motion of a suggestion is for, behind `Next:`, and what it is."""
    match suggestion:
        case SeparateRivals(trial, now):
            return (
                f"log a motion that tells {effect_words(suggestion.effects)} apart.",
                f"{trial_words(trial, now)}; they then differ by at least "
                f"{two_digits(suggestion.separation)} standard errors, and "
                f"{_enough(suggestion)}.",
            )
        case RevealEffects(trial, now, effects):
            shows = f"log a motion that shows {named(effects)}, which this log hides."
            return shows, f"{trial_words(trial, now)}."
    words = suggestion_words(suggestion, mechanism)
    return f"{words[:1].lower()}{words[1:]}", ""


def _enough(suggestion: SeparateRivals) -> str:
    """Return how long a log is enough: as long as this one, or longer."""
    seconds = f"about {two_digits(suggestion.seconds)} s"
    if suggestion.separation < TOLD_APART_SE:
        return f"log {seconds} of it to be sure"
    return f"a log of it takes {seconds}"


def trial_words(trial: Trial, now: Sequence[Move]) -> str:
    """Return what to do in a trial, where the same joints did `now` in the present log."""
    moves, reached = trial.changed, reached_moves(trial, now)
    others = any(m.speed and m.joint.name not in trial.about for m in trial.moves)
    rest = ", the other joints as now" if others and trial.kind != "alone" else ""
    present = {m.joint.name: m for m in now}
    tops = [f"{m.speed:.2g} {m.joint.unit}/s" for m in moves]
    text = HOW[trial.kind].format(
        names=", ".join(m.joint.name for m in moves),
        spans=", ".join(f"{m.joint.name} {_span(m)}" for m in reached),
        top=tops[0] if len({*tops}) == 1 else ", ".join(tops),
        shares=listed(f"{share:g}" for share in trial.shares),
        before="" if moves[1:] else f" (it moved {_span(present[moves[0].joint.name])})",
    )
    return text + rest


def _span(m: Move) -> str:
    return f"from {m.low:.3g} to {m.high:.3g} {m.joint.unit}"


def _slowly(suggestion: MoveSlowly) -> str:
    tops = dict.fromkeys(f"{SLOWLY * m.speed:.2g} {m.joint.unit}/s" for m in suggestion.moves)
    speeds = f"up to {next(iter(tops))}, " if len(tops) == 1 else ""
    return (
        f"Move {places(m.joint.name for m in suggestion.moves)} slowly ({speeds}a tenth of the "
        "logged speed), to and fro for as long as this log: now such speeds occur at reversals "
        "only."
    )


def _followed(suggestion: FollowSignal) -> str:
    move, signal = suggestion.move, suggestion.signal
    kind, unit = signal.partition(".")[0], f"{suggestion.move.joint.unit}/s"
    half, slow = (f"{share * move.speed:.2g} {unit}" for share in (HALF, SLOWLY))
    text = FOLLOWS[kind].format(
        joint=move.joint.name,
        half=f" at up to {half}" if move.speed else " slowly",
        slow=f" ({slow})" if move.speed else "",
    )
    step, _, effect = text.partition(": ")
    why = f"the residual of {suggestion.worst} depends on {signal or 'no single signal'}"
    why += f", and {effect}" * bool(effect and signal)
    why += f"; {effect}" * bool(effect and not signal)
    if "{half}" in FOLLOWS[kind] and move.speed:
        twice = f", in {TWICE}" * suggestion.again
        return _capital(f"{step}{twice}: {why}{f'; {REPEATS}' * suggestion.again}.")
    first = f"Log {TWICE}: {REPEATS}. " * suggestion.again
    return f"{first}{_capital(step)}: {why}."


def _separated(suggestion: SeparateRivals, mechanism: Mechanism) -> str:
    text = (
        f"{_capital(trial_words(suggestion.trial, suggestion.now))}: "
        f"{effect_words(suggestion.effects)} then differ by at least "
        f"{two_digits(suggestion.separation)} standard errors; {_enough(suggestion)}"
    )
    if suggestion.similar:
        effects = [effect for pair in suggestion.similar for effect in pair]
        names = effect_words([*{effect.label: effect for effect in effects}.values()])
        remedy = remedies_without_motion(mechanism, effects)
        text += f". Not all of {names} differ in it; for those, {remedy}"
    return f"{text}."


def effect_words(effects: Sequence[Effect]) -> str:
    """Return effects in words, formulas among them by what they are known as."""
    physical = [effect for effect in effects if not isinstance(effect, Formula)]
    formulas = [effect for effect in effects if isinstance(effect, Formula)]
    likes = [f"{formula_noun(x)} in {places(x.joints)}" for x in formulas]
    return listed([*([named(physical)] if physical else []), *dict.fromkeys(likes)])


def formula_noun(formula: Formula) -> str:
    """Return what the force of a formula is known as, with its article."""
    name = formula.terms[0].known_as.replace("_", " ") or "force of a shape without a name"
    return f"an {name}" if name[0] in "aeiou" else f"a {name}"


def remedies_without_motion(mechanism: Mechanism, effects: Sequence[Effect]) -> str:
    """Return what tells effects apart that no motion does: a load, a tilt, a sensor."""
    remedies = without_motion(effects)
    if mechanism.closures and len({effect.joints for effect in effects}) > 1:
        names = ", ".join(closure.name for closure in mechanism.closures)
        where = ", ".join(dict.fromkeys(name for effect in effects for name in effect.joints))
        remedies.append(
            f"open the loop at {names} and move the parts one by one, or measure the torque at "
            f"one of {where} (a sensor or a second drive there), or the closure's force with a "
            "load cell, or load one bearing from outside and see whether the residual grows"
        )
    remedies = remedies or [remedy_of(same) for same in by_kind(e for e in effects if e.remedy)]
    return "; ".join(remedies) or (
        "measure the torque behind the joint with a sensor of its own, or change one condition "
        "that affects only one of them (load, lubrication, temperature)"
    )


def remedy_of(effects: Sequence[Effect]) -> str:
    """Return what shows effects of one kind that no motion shows, with their joints."""
    joints = dict.fromkeys(joint for effect in effects for joint in effect.joints)
    return effects[0].remedy.replace("{joint}", places(joints))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
