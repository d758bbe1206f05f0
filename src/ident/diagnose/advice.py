"""What to do where no motion helps, or where nothing is to be told apart.

Rules of thumb: what is the same in all motions needs another condition (a load, a tilt, a sensor).
"""

from __future__ import annotations

from collections.abc import Sequence

from ident.diagnose.describe import described
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.hidden import Invisible
from ident.diagnose.probe import Probe
from ident.diagnose.propose import concerned
from ident.diagnose.trials import present, trials
from ident.effects import Correcting, Effect

SHOWS = 0.02  # visible share from which an effect can be seen
LOOKED_AT = 24  # invisible effects that are tried in other motions
LISTED = 4
INSTEAD = {  # how to see what the motion alone does not show
    "rotor_inertia": "give its link's inertia from the drawing, or log once more with a known load",
    "torque_gain": "log once more with a known mass on the last link",
    "payload": "log the same motion with the load and without it",
    "gravity_tilt": "level the base, or turn it about a horizontal axis by a known angle",
    "encoder_offset": "put the joint against a reference, or turn the base about a horizontal axis",
    "geometry": "measure this length, or log passive joints' angles too",
    "closure_compliance": "log passive joints' angles too, under a known load",
    "torque_offset": "read the torque with the drive unloaded, or tilt the base",
    "spring": "tilt the base by a known angle, so that gravity changes and springs do not",
    "cable": "tilt the base by a known angle, so that gravity changes and cables do not",
    "delay": "log a motion of two frequencies, the higher at least three times the lower",
}
PAIRS = (
    ({"load_friction", "coulomb"}, "repeat the motion with a known payload: load friction grows"),
    ({"torque_gain", "rotor_inertia"}, "repeat the motion with a known mass on the last link"),
    ({"torque_gain", "viscous"}, "repeat the motion with a known mass on the last link"),
    ({"gravity_tilt", "encoder_offset"}, "repeat it with the first joint turned by a right angle"),
    ({"spring", "gravity_tilt"}, "repeat the motion with the base tilted by a known angle"),
    ({"spring", "encoder_offset"}, "repeat the motion with the base tilted by a known angle"),
    ({"drift", "temperature_friction"}, "log the motors' temperatures, `temperature.<joint>`"),
    ({"delay", "viscous"}, "log two frequencies, the higher at least three times the lower"),
)
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
    found = [text for pair, text in PAIRS if pair <= kinds]
    places = {effect.joints for effect in effects}
    if d.fit.mechanism.closures and len(places) > 1:
        names = ", ".join(closure.name for closure in d.fit.mechanism.closures)
        where = ", ".join(dict.fromkeys(name for effect in effects for name in effect.joints))
        found.append(
            f"open the loop at {names} and move the parts one by one, or measure the torque at "
            f"one of {where} (a sensor or a second drive there), or the closure's force with a "
            "load cell, or load one bearing from outside and see whether the residual grows"
        )
    for kind in (k for k in INSTEAD if k in kinds and not found):
        found.append(INSTEAD[kind])
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
    kinds = dict.fromkeys(each.effect.kind for each in left if each.effect.kind in INSTEAD)
    for kind in list(kinds)[: 2 if found else 3]:
        mine = [each.effect.label for each in left if each.effect.kind == kind]
        start = "No motion tried shows" if not shown else "Nor does that show"
        found.append(f"{start if len(found) < 2 else 'For'} {_list(mine)}: {INSTEAD[kind]}.")
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
    return not (isinstance(each.effect, Correcting) and d.fit.mechanism.closures)


def _shows(probe: Probe, effect: Effect) -> bool:
    try:
        return probe.visible(effect) > SHOWS
    except Exception:  # an effect that cannot be evaluated in this motion is not shown by it
        return False


def _list(labels: Sequence[str]) -> str:
    more = len(labels) - LISTED
    return ", ".join(labels[:LISTED]) + (f" and {more} more" if more > 0 else "")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
