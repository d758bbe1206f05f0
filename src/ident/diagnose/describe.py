"""A trial motion in words: which joint, which range, which speed."""

from __future__ import annotations

from collections.abc import Sequence

from ident.diagnose.trials import Move, Trial

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
