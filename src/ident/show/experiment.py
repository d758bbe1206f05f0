"""The next experiment in words: which joint, which range, which speed, and what that shows."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from numpy.linalg import LinAlgError

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
from ident.diagnosis.result import Advice, Diagnosis
from ident.diagnosis.selection import Evidence
from ident.diagnosis.trials import Move, Trial, present, trials
from ident.display import renders
from ident.effects import Effect
from ident.effects.library import by_kind, named, separating
from ident.errors import IdentError
from ident.show.verdict import at_reversals
from ident.text import listed, places, two_digits

SHOWS = 0.02  # visible share from which an effect can be seen
SLOWLY = 0.1  # of the logged top speed: friction that depends on the speed shows between reversals
LOOKED_AT = 24  # invisible effects that are tried in other motions
EXPLAINED = 0.9  # of what exceeds the noise, from which a formula leaves no question in its joint
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
    "sign(v)": "move {joint}{slow} in strokes, with reversals at different places",
    "q": "move {joint}{slow} over its full travel, up and down",
    "a": "move {joint}{half}, half as fast as now: what goes with acceleration falls to a quarter",
    "load": "repeat the motion with a known payload: what goes with the load then grows",
    "t": "warm the machine up first, and log temperatures (`temperature.<joint>`)",
    "": "move {joint}{slow} with reversals at different places, to look for memory",
}


def described(trial: Trial, now: Sequence[Move]) -> str:
    """Return what to do in a trial, where the same joints did `now` in the present log."""
    moves = trial.changed
    others = any(m.speed and m.joint.name not in trial.about for m in trial.moves)
    rest = ", the other joints as now" if others and trial.kind != "alone" else ""
    was = {m.joint.name: m for m in now}
    reached = [m if _span(m) == _span(was[m.joint.name]) else trial.reached(m) for m in moves]
    text = HOW[trial.kind].format(
        names=", ".join(m.joint.name for m in moves),
        spans=", ".join(f"{m.joint.name} {_span(m)}" for m in reached),
        top=", ".join(f"{m.speed:.2g} {m.joint.unit}/s" for m in moves),
        shares=listed(f"{share:g}" for share in trial.shares),
        before="" if moves[1:] else f" (it moved {_span(was[moves[0].joint.name])})",
    )
    return text + rest


def _span(m: Move) -> str:
    return f"from {m.low:.3g} to {m.high:.3g} {m.joint.unit}"


@renders(Diagnosis, "experiment")
def next_experiment(d: Diagnosis) -> Advice:
    """Return what to log next: which joint, which range, which speed, and what that shows."""
    try:
        return _advice(d)
    except KeyboardInterrupt:  # all else of the diagnosis is kept
        return Advice("Interrupted before one was worked out.", interrupted=True)
    except (IdentError, LinAlgError) as error:  # without advice the diagnosis is still one
        return Advice(f"No experiment could be worked out ({error}).")


def _advice(d: Diagnosis) -> Advice:
    rivals = contenders(d)
    if len(rivals) > 1:
        advice = _between(d, rivals, attempts(d, rivals))
        if d.best is not None or advice.apart:
            return advice
    slowly = _slowly(d, at_reversals(d))
    if d.reversing:
        return Advice(slowly)
    if d.verdict in ("unexplained", "undecided"):
        if d.laws and all(_explained(d, name) for name in d.loud):
            return Advice(
                f"Add the formula of {listed([law.joint for law in d.laws])} and diagnose again. A "
                "log of another motion, over the full travel of the joint, shows whether it is a "
                "cause: compare both fits there."
            )
        return unexplained(d)
    first = ""
    if d.best and d.health.faults:  # of the clock, the only one beside a name
        first = f"Compare t with another clock, and measure {named(d.group)}."
    elif d.best:
        first = f"Add {named(d.group)} and diagnose again: no other effect explains it as well."
    return Advice(" ".join(filter(None, (first, slowly, unseen(d)))) or NOTHING)


def _slowly(d: Diagnosis, joints: Sequence[str]) -> str:
    """Return the motion that shows what is left at the reversals of joints; nothing of none."""
    if not joints:
        return ""
    moves = [m for m in present(d.fit.mechanism, d.fit.motion) if m.joint.name in joints]
    tops = dict.fromkeys(f"{SLOWLY * m.speed:.2g} {m.joint.unit}/s" for m in moves)
    speeds = f"up to {next(iter(tops))}, " if len(tops) == 1 else ""
    return (
        f"Move {places(m.joint.name for m in moves)} at {speeds}a tenth of what is logged, to and "
        "fro for as long as this log: such speeds are there at reversals only."
    )


def _explained(d: Diagnosis, joint: str) -> bool:
    """Return whether the laws explain a joint but for the noise."""
    law, noise = d.laws[-1], d.floor[joint] ** 2  # its fit has all laws
    before, after = (errors[joint].rms ** 2 - noise for errors in (law.before, law.after))
    return after < (1 - EXPLAINED) * before


# --- rivals ---------------------------------------------------------------------------------------


def _between(d: Diagnosis, rivals: Sequence[Evidence], tried: Sequence[Attempt]) -> Advice:
    """Return the first question that a motion answers, and what to do about one that none does."""
    parts: list[str] = []
    for pairs in questions(rivals):
        if found := proposal(d, tried, pairs):
            words = " ".join([*parts, _proposed(d, found)])
            return Advice(words, found.apart)
        parts = parts or [_no_motion(d, tried, pairs)]
    return Advice(" ".join(parts) or NOTHING)


def _proposed(d: Diagnosis, p: Proposal) -> str:
    text = (
        f"{_capital(described(p.trial, present(d.fit.mechanism, d.fit.motion)))}: "
        f"{named(p.apart)} then differ by at least "
        f"{two_digits(p.separation)} standard errors in a log as long as this one; log about "
        f"{two_digits(p.seconds)} s of it to be sure"
    )
    if p.alike:
        effects, names = _effects(p.alike)
        text += f". Not all of {names} differ in it; for those, {without_motion(d, effects)}"
    return f"{text}."


def _no_motion(d: Diagnosis, tried: Sequence[Attempt], pairs: Sequence[Pair]) -> str:
    effects, names = _effects([tuple(each.effect for each in pair) for pair in pairs])
    most = max((each.separation(pair) for pair in pairs for each in tried), default=0.0)
    why = "they need the same torques in all that were tried"
    if most:
        size = f"{two_digits(most)} standard errors"
        why = f"at best they differ by {size} in a log as long as this one"
    return (
        f"{_capital(without_motion(d, effects))}: no motion of this mechanism tells {names} apart, "
        f"{why}."
    )


def _effects(pairs: Sequence[Sequence[Effect]]) -> tuple[list[Effect], str]:
    effects = [effect for pair in pairs for effect in pair]
    return effects, named({effect.label: effect for effect in effects}.values())


def without_motion(d: Diagnosis, effects: Sequence[Effect]) -> str:
    """Return what tells effects apart that no motion does: a load, a tilt, a sensor."""
    found = separating({effect.kind for effect in effects})
    if d.fit.mechanism.closures and len({effect.joints for effect in effects}) > 1:
        names = ", ".join(closure.name for closure in d.fit.mechanism.closures)
        where = ", ".join(dict.fromkeys(name for effect in effects for name in effect.joints))
        found.append(
            f"open the loop at {names} and move the parts one by one, or measure the torque at "
            f"one of {where} (a sensor or a second drive there), or the closure's force with a "
            "load cell, or load one bearing from outside and see whether the residual grows"
        )
    found = found or [remedy_of(same) for same in by_kind(e for e in effects if e.remedy)]
    return "; ".join(found) or (
        "measure the torque behind the joint with a sensor of its own, or change one condition "
        "that affects only one of them (load, lubrication, temperature)"
    )


# --- no rivals to distinguish ---------------------------------------------------------------------


def unexplained(d: Diagnosis) -> Advice:
    """Return how to learn what a residual is that no effect explains."""
    again, worst = d.periods is None, d.where[0]
    signal = worst.depends_on[0].signal if worst.depends_on else ""
    kind, _, name = signal.partition(".")
    moves = {m.joint.name: m for m in present(d.fit.mechanism, d.fit.motion)}
    m = moves.get(name, moves[worst.joint])  # of a loop: a joint that can be moved
    half, slow = (f"{share * m.speed:.2g}" for share in (0.5, SLOWLY))
    text = FOLLOWS[kind].format(
        joint=m.joint.name,
        half=f" at up to {half} {m.joint.unit}/s" if m.speed else " slowly",
        slow=f" at up to {slow} {m.joint.unit}/s" if m.speed else " slowly",
    )
    step, _, effect = text.partition(": ")
    why = f"the residual of {worst.joint} depends on {signal or 'no single signal'}"
    why += f", and {effect}" * bool(effect)
    if "{half}" in FOLLOWS[kind] and m.speed:
        both = f"{step}{f', in {TWICE}' * again}: {why}{f'; {REPEATS}' * again}."
        return Advice(_capital(both))
    first = f"Log {TWICE}: {REPEATS}. " * again
    return Advice(f"{first}{_capital(step)}: {why}.")


def unseen(d: Diagnosis) -> str:
    """Return which motion shows most of what is invisible now, and what to do about the rest."""
    shown, words = _best_trial(d) if d.invisible else ([], "")
    found = []
    if shown:
        found.append(f"{_capital(words)}: that would show {named(shown)}, invisible in this log.")
    hidden = (each.effect for each in d.invisible if each.effect not in shown)
    rest = by_kind(effect for effect in hidden if effect.remedy)
    for effects in rest[: 2 if shown else 3]:
        names = named(effects)
        alone = ", which no motion tried does" * (len(found) < 2)
        found.append(f"{_capital(remedy_of(effects))}: that would show {names}{alone}.")
    return " ".join(found)


def remedy_of(effects: Sequence[Effect]) -> str:
    """Return what shows effects of one kind that no motion shows, with their joints."""
    joints = dict.fromkeys(joint for effect in effects for joint in effect.joints)
    return effects[0].remedy.replace("{joint}", places(joints))


def _best_trial(d: Diagnosis) -> tuple[list[Effect], str]:
    """Return what the most revealing motion shows, and that motion."""
    loops = d.fit.mechanism.closures  # a correction closes them anew at every sample: not tried
    wanted = [e.effect for e in d.invisible if not (e.effect.corrects and loops)][:LOOKED_AT]
    now = present(d.fit.mechanism, d.fit.motion)
    best: tuple[list[Effect], str] = [], ""
    kinds = {"awake", "turn", "limits", "wider"}
    for trial in trials(now, concerned(d, [])):
        probe = Probe.of(d, trial) if trial.kind in kinds else None
        if probe is None:
            continue
        kinds.remove(trial.kind)
        found = list[Effect]()
        for effect in wanted:
            with suppress(
                IdentError, LinAlgError
            ):  # what cannot be evaluated in this motion is not shown by it
                found += [effect] if probe.visible(effect) > SHOWS else []
        if len(found) > len(best[0]):
            best = found, described(trial, now)
    return best


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
