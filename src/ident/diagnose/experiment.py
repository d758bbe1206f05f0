"""Which motion would tell more: rivals apart, what is invisible, what is unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ident.diagnose.advice import unexplained, unseen, without_motion
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.propose import (
    Attempt,
    Pair,
    Proposal,
    attempts,
    contenders,
    proposal,
    questions,
)
from ident.diagnose.search import Candidate

NOTHING = "This log leaves no question that another motion would answer."
LISTED = 5
WAYS = {
    "turn": "a full turn",
    "limits": "wider",
    "wider": "wider",
    "faster": "faster",
    "speeds": "slower",
    "strokes": "slow strokes",
    "alone": "drives one by one",
}


def next_experiment(d: Diagnosis) -> str:
    """What to log next, in words: which joint, which range, which speed, and what that shows."""
    try:
        return _words(d) or NOTHING
    except Exception as error:  # an experiment is advice: without it the diagnosis is still one
        return f"No experiment could be worked out ({error})."


def propose(d: Diagnosis) -> Proposal | None:
    """The motion that tells the rivals apart best; None where there are none, or none helps."""
    rivals = contenders(d)
    tried = attempts(d, rivals) if len(rivals) > 1 else []
    found = (proposal(d, tried, pairs) for pairs in questions(rivals))
    return next((each for each in found if each), None)


def _words(d: Diagnosis) -> str:
    rivals = contenders(d) if d.verdict == "missing" else []
    if len(rivals) > 1:
        return _between(d, rivals, attempts(d, rivals))
    if d.verdict == "unexplained":
        return unexplained(d)
    advice = unseen(d)
    if d.best is not None:
        return f"Add {d.best.label} and diagnose again: nothing rivals it. {advice}".strip()
    return advice


def _between(d: Diagnosis, rivals: Sequence[Candidate], tried: Sequence[Attempt]) -> str:
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
    text = (
        f"{p.words}: {rivals} then differ by at least {p.separation:.2g} standard errors in a log "
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


def _list(labels: Sequence[str]) -> str:
    more = len(labels) - LISTED
    if more > 0:
        return f"{', '.join(labels[:LISTED])} and {more} more"
    return " and ".join([", ".join(labels[:-1]), labels[-1]]) if len(labels) > 1 else labels[0]
