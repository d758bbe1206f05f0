"""What a diagnosis claims and how sure that is: an effect, nothing, or that none explains it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ident.diagnose.evidence import BEYOND, CLOSES, REST, SURE
from ident.diagnose.missing import missing
from ident.diagnose.phrases import closure, error_text, listed, remaining, signal, some
from ident.residual.periods import CHANCE

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis

TRIED = 3  # candidates that are told of though none explains it


def claim(d: Diagnosis) -> list[str]:
    """Paragraphs on the verdict."""
    return {"missing": missing, "nothing": _nothing, "unexplained": _unexplained}[d.verdict](d)


def _nothing(d: Diagnosis) -> list[str]:
    errors = d.fit.held_out or d.fit.train
    beside = [
        f"{name} {e.rms:.2g} beside {d.floor[name]:.2g} {e.unit}" for name, e in errors.items()
    ]
    least = [
        f"{REST * e.rms / e.relative:.2g} {e.unit} in {name}"
        for name, e in errors.items()
        if e.relative
    ]
    near = remaining(d)
    left = "what is left is small, but not all of it is noise" if near else "what is left is noise"
    said = (
        f"Nothing is missing that this data could show: {left}. The residual's rms beside that of "
        f"noise alone: {some(beside, 8)}."
    )
    if near:
        said += (
            f" In {some(near)} more is left, or it comes back with every period: below what is "
            "reported, or around velocity reversals, where stick phases, friction at low speed and "
            "filters are not to be told apart; slow strokes at constant speed would show which. An "
            "effect already in the model may stand in for another one."
        )
    if d.periods is not None and max(d.periods.rho.values()) < CHANCE:
        said += " The motion repeats, and the residual does not repeat with it."
    more = [
        f"{each.joint}, against {listed(signal(s.signal) for s in each.depends_on)}"
        if each.depends_on
        else each.joint
        for each in d.where
        if not each.white
    ]
    if more:
        said += (
            f" What the plots still show in {'; '.join(more)} is too small to matter, or no more "
            "than logs without any effect show."
        )
    slight = [
        f"{e.candidate.effect.label} ({100 * e.size:.2g} % of the torque)"
        for e in d.choice.evidence
        if e.z > SURE and e.beyond > BEYOND and e.sensible and e.closure >= CLOSES
    ]
    if slight:
        said += f" Seen, but too small to matter: {', '.join(slight[:3])}."
    return [
        said,
        "How small an effect could still hide: below "
        f"{100 * REST:g} % of a joint's torque nothing is reported ({some(least, 8)}), nor "
        f"what noise covers. {len(d.choice.evidence)} effects were tried at their places.",
    ]


def _unexplained(d: Diagnosis) -> list[str]:
    tried = [
        f"{each.effect.label} closes {closure(each.evidence)} of the gap between residual and "
        f"noise ({each.joint}: {error_text(each.before[each.joint])} → "
        f"{error_text(each.after[each.joint])})"
        for each in [c for c in d.candidates if c.evidence.sensible][:TRIED]
    ]
    said = [
        "Something is missing, and nothing in the library explains it, so no name is given. "
        f"{len(d.choice.evidence)} effects were tried at their places, each with everything "
        f"refitted; a name takes {100 * CLOSES:.0f} % of the gap (less for usual friction)."
        + (f" The best: {'; '.join(tried)}." if tried else "")
    ]
    if (s := d.suggestion) is not None:
        joints = listed(f"s.q[{i}] is the position of {name}" for i, name in enumerate(s.joints))
        said.append(
            f"An expression of the signals describes it: {s}. Here {joints}, s.v and s.a are their "
            f"rates. It closes {100 * s.closure:.0f} % of the gap. It is a description, not "
            "yet a cause: see what it could be. `--out` writes it as suggestion.py, to be used "
            f"with `--with {s.effect} --allow-code`."
        )
    else:
        said.append(
            "No short expression of positions, speeds, accelerations and time explains it either; "
            "look at the maps of the residual, and at what the log does not hold: temperature, "
            "contact, play, cables, another load."
        )
    return said
