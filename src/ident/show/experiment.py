"""The next experiment in words: which joint, which range, which speed, and what that shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ident.diagnosis.diagnosis import Diagnosis
from ident.diagnosis.experiment import (
    Attempt,
    Pair,
    Probe,
    Proposal,
    attempts,
    concerned,
    contenders,
    proposal,
    questions,
)
from ident.diagnosis.selection import Evidence
from ident.diagnosis.trials import Move, Trial, present, trials
from ident.diagnosis.unobservable import Invisible
from ident.display import renders
from ident.effects import Effect
from ident.effects.library import separating
from ident.text import some

# --- describe ------------------------------------------------------------------------------------
# A trial motion in words: which joint, which range, which speed.


TOP = {  # what is said once of several joints that do the same
    "turn": "turn {} through a full turn each, there and back, at up to {}",
    "limits": "move {} nearly from limit to limit, at up to {}",
    "wider": "move {}, which is wider than now, at up to {}",
    "same": "move {} as now, in a mixture of several frequencies, at up to {}",
    "faster": "move {} as now, but faster, at up to {}",
    "speeds": "move {} as now, both slowly and fast, at up to a quarter of, then up to {}",
    "strokes": "move {} in strokes of constant speed, at shares {shares} of {}",
    "awake": "move {} too, at up to {}",
}


def described(trial: Trial, now: Sequence[Move]) -> str:
    """What to do, in the mechanism's own terms.

    Args:
        trial: the motion.
        now: what the same joints did in the present log.
    """
    others = any(m.speed and m.joint.name not in trial.about for m in trial.moves)
    rest = ", the other joints as now" if others and trial.kind != "alone" else ""
    before = {m.joint.name: m for m in now}
    moves = [m for m in trial.moves if m.joint.name in trial.about]
    if len(moves) == 1:
        return _one(trial, moves[0], before[moves[0].joint.name]) + rest
    spans = [f"{m.joint.name} {_span(m)}" for m in moves]
    if trial.kind == "turn":
        spans = [m.joint.name for m in moves]
    speeds = [f"{m.speed:.2g}" for m in moves]
    unit = moves[0].joint.unit
    if len({m.joint.unit for m in moves}) > 1:
        speeds, unit = [f"{m.speed:.2g} {m.joint.unit}" for m in moves], ""
    shares = ", ".join(f"{share:g}" for share in trial.shares)
    top = f"{', '.join(speeds)} {unit}".rstrip() + ("/s" if unit else " a second")
    return TOP[trial.kind].format(", ".join(spans), top, shares=shares) + rest


def _one(trial: Trial, m: Move, old: Move) -> str:
    name, unit, span = m.joint.name, m.joint.unit, _span(m)
    was = f"(it moved {_span(old)})"
    speed = f"at up to {m.speed:.2g} {unit}/s"
    if m.speed > old.speed > 0:
        speed += f" (it was {old.speed:.2g})"
    several = [f"{share * m.speed:.2g}" for share in trial.shares]
    slow = f"{', '.join(several[:-1])} and {several[-1]}" if several[1:] else several[0]
    return {
        "turn": f"turn {name} through a full turn, there and back {was}, {speed}",
        "limits": f"move {name} {span}, nearly from limit to limit {was}, {speed}",
        "wider": f"move {name} {span} {was}, {speed}",
        "same": f"move {name} {span} as now, {speed}, in a mixture of several frequencies",
        "faster": f"move {name} faster, {speed}, {span} as now",
        "speeds": f"move {name} {span} as now, both slowly and fast, at up to {slow} {unit}/s",
        "strokes": f"move {name} {span} in strokes of constant speed, at {slow} {unit}/s",
        "alone": f"move {name} alone, {span}, {speed}, and hold the other drives still",
        "awake": f"move {name} too, {span}, {speed}: it stood still",
    }[trial.kind]


def _span(m: Move) -> str:
    return f"from {m.low:.3g} to {m.high:.3g} {m.joint.unit}"


# --- advice --------------------------------------------------------------------------------------
# What to do where no motion helps, or where nothing is to be told apart.
#
# What is the same in all motions needs another condition: a load, a tilt, a sensor.


SHOWS = 0.02  # visible share from which an effect can be seen
LOOKED_AT = 24  # invisible effects that are tried in other motions
LISTED = 4
FOLLOWS = {  # by the first signal on which a residual depends
    "v": "repeat it at half and at twice the speed: what goes with speed then changes in step",
    "sign": "repeat it in slow strokes of constant speed, with reversals at different places",
    "q": "repeat it slowly over the full travel of the joint, up and down",
    "a": "repeat it at half and at twice the speed: what goes with acceleration changes fourfold",
    "load": "repeat it with a known payload: what goes with the load then grows",
    "t": "warm the machine up first, and log temperatures (`temperature.<joint>`)",
}


def without_motion(d: Diagnosis, effects: Sequence[Effect]) -> str:
    """What tells effects apart that no motion does."""
    kinds = {effect.kind for effect in effects}
    found = separating(kinds)
    places = {effect.joints for effect in effects}
    if d.fit.mechanism.closures and len(places) > 1:
        names = ", ".join(closure.name for closure in d.fit.mechanism.closures)
        where = ", ".join(dict.fromkeys(name for effect in effects for name in effect.joints))
        found.append(
            f"open the loop at {names} and move the parts one by one, or measure the torque at "
            f"one of {where} (a sensor or a second drive there), or the closure's force with a "
            "load cell, or load one bearing from outside and see whether the residual grows"
        )
    if not found:
        found = list(dict.fromkeys(effect.remedy for effect in effects if effect.remedy))
    return "; ".join(found) or (
        "measure the torque behind the joint with a sensor of its own, or change one condition "
        "that only one of them feels (load, lubrication, temperature)"
    )


def unexplained(d: Diagnosis) -> str:
    """How to learn what a residual is that no effect explains."""
    worst = d.where[0] if d.where else None
    if d.periods is None:
        first = (
            "Log the same motion at least twice in one log: what then repeats is the mechanism, "
            "what does not is noise or drift."
        )
    else:
        rho = max(d.periods.rho.items(), key=lambda pair: pair[1])
        first = (
            f"The log is periodic already: the residual of {rho[0]} comes again with a "
            f"correlation of {rho[1]:.2f}, "
            + ("so it is physics." if rho[1] > 0.6 else "so much of it is noise or drift.")
        )
    if worst is None:
        return first
    if not worst.depends_on:
        rest = f"repeat the motion of {worst.joint} with reversals at different places, slowly"
        return f"{first} It depends on no single signal: {rest}, to look for memory."
    signal = worst.depends_on[0].signal
    kind = "sign" if signal.startswith("sign") else signal.partition(".")[0]
    then = FOLLOWS.get(kind, FOLLOWS["v"])
    return f"{first} In {worst.joint} it depends on {signal}: {then}."


def unseen(d: Diagnosis) -> str:
    """Which motion would show most of what is invisible now, and what to do about the rest."""
    if not d.invisible:
        return ""
    shown, words = _best_trial(d)
    found = []
    if shown:
        found.append(f"{_capital(words)}: that would show {_list(shown)}, invisible in this log.")
    left = [each for each in d.invisible if each.effect.label not in set(shown)]
    kinds = {each.effect.kind: each.effect.remedy for each in left if each.effect.remedy}
    for kind in list(kinds)[: 2 if found else 3]:
        mine = [each.effect.label for each in left if each.effect.kind == kind]
        start = "No motion tried shows" if not shown else "Nor does that show"
        found.append(f"{start if len(found) < 2 else 'For'} {_list(mine)}: {kinds[kind]}.")
    return " ".join(found)


def _best_trial(d: Diagnosis) -> tuple[list[str], str]:
    """Invisible effects' labels that the most revealing motion shows, and that motion."""
    wanted = [each for each in d.invisible if _cheap(d, each)][:LOOKED_AT]
    now = present(d.fit.mechanism, d.fit.motion)
    best: list[str] = []
    words, seen = "", set()
    for trial in trials(now, concerned(d, [])):
        if trial.kind not in ("awake", "turn", "limits", "wider") or trial.kind in seen:
            continue
        probe = Probe.of(d, trial)
        if probe is None:
            continue
        seen.add(trial.kind)
        found = [each.effect.label for each in wanted if _shows(probe, each.effect)]
        if len(found) > len(best):
            best, words = found, described(trial, now)
    return best, words


def _cheap(d: Diagnosis, each: Invisible) -> bool:
    """A correction in a loop closes it anew at every sample; that is not tried."""
    return not (each.effect.corrects and d.fit.mechanism.closures)


def _shows(probe: Probe, effect: Effect) -> bool:
    try:
        return probe.visible(effect) > SHOWS
    except Exception:  # an effect that cannot be evaluated in this motion is not shown by it
        return False


def _list(labels: Sequence[str]) -> str:
    """The first labels, the others counted."""
    return some(labels, LISTED)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


# --- experiment ----------------------------------------------------------------------------------
# Which motion would tell more: rivals apart, what is invisible, what is unexplained.


NOTHING = "This log leaves no question that another motion would answer."
WAYS = {
    "turn": "a full turn",
    "limits": "wider",
    "wider": "wider",
    "faster": "faster",
    "speeds": "slower",
    "strokes": "slow strokes",
    "alone": "drives one by one",
}


@renders(Diagnosis, "experiment")
def next_experiment(d: Diagnosis) -> str:
    """What to log next, in words: which joint, which range, which speed, and what that shows."""
    try:
        return _words(d) or NOTHING
    except Exception as error:  # an experiment is advice: without it the diagnosis is still one
        return f"No experiment could be worked out ({error})."


def _words(d: Diagnosis) -> str:
    rivals = contenders(d) if d.verdict == "missing" else []
    if len(rivals) > 1:
        return _between(d, rivals, attempts(d, rivals))
    if d.verdict in ("unexplained", "undecided"):
        return unexplained(d)
    advice = unseen(d)
    if d.best is not None:
        return f"Add {d.best.label} and diagnose again: nothing rivals it. {advice}".strip()
    return advice


def _between(d: Diagnosis, rivals: Sequence[Evidence], tried: Sequence[Attempt]) -> str:
    """The first question that a motion answers, and what to do about one that none does."""
    parts: list[str] = []
    for pairs in questions(rivals):
        found = proposal(d, tried, pairs)
        if found:
            if parts:  # the place stays open, and what to do about it is said already
                kinds = _proposed(d, replace(found, alike=()))
                return f"{parts[0]} Of which kind it is, a motion tells in part. {kinds}"
            return _proposed(d, found)
        if not parts:
            parts.append(_no_motion(d, tried, pairs))
    return " ".join(parts)


def _proposed(d: Diagnosis, p: Proposal) -> str:
    now = f" (in a motion like this one: {p.now:.2g})" if p.now < p.separation / 2 else ""
    rivals = _list([each.label for each in p.apart])
    how = described(p.trial, present(d.fit.mechanism, d.fit.motion))
    text = (
        f"{how}: {rivals} then differ by at least {p.separation:.2g} standard errors in a log "
        f"as long as this one{now}"
    )
    text += f"; log about {float(f'{p.seconds:.2g}'):g} s of it to be sure"
    if p.alike:
        effects = [effect for pair in p.alike for effect in pair]
        labels = _list(list(dict.fromkeys(effect.label for effect in effects)))
        text += f". Not all of {labels} differ in it; for those, {without_motion(d, effects)}"
    return f"{text[:1].upper()}{text[1:]}."


def _no_motion(d: Diagnosis, tried: Sequence[Attempt], pairs: Sequence[Pair]) -> str:
    effects = [each.effect for pair in pairs for each in pair]
    labels = _list(list(dict.fromkeys(effect.label for effect in effects)))
    rest = without_motion(d, effects)
    if not tried:
        return f"No other motion could be followed to tell {labels} apart. Instead, {rest}."
    most = max(max(each.separation(pair) for pair in pairs) for each in tried)
    why = (
        f"at best they differ by {most:.2g} standard errors in a log as long as this one"
        if most
        else "they ask for the same torques in all of them"
    )
    ways = ", ".join(dict.fromkeys(WAYS[t.trial.kind] for t in tried if t.trial.kind in WAYS))
    return (
        f"No motion of this mechanism tells {labels} apart: {why} (tried: {ways}). Instead, {rest}."
    )
