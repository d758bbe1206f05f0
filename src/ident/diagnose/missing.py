"""What a diagnosis says of an effect that is missing: which, how sure, its rivals, what is left."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ident.diagnose.explanation import Explanation
from ident.diagnose.phrases import (
    LOUDER,
    closure,
    error_text,
    failing,
    labels,
    listed,
    numbers,
    some,
    sure,
    what,
)
from ident.effects import Effect
from ident.mechanism import Mechanism

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis

LARGE = 100.0  # times what clean logs show: no more is said
MOST_CLOSED = 0.9  # share of a gap from which no more is missing in it


def missing(d: Diagnosis) -> list[str]:
    """Paragraphs on the effect that is named."""
    best = d.candidates[0]
    effect, joint = best.effect, best.joint
    name = f"{effect.label} ({what(effect)})"
    if best.rivals:
        first = (
            f"Missing is one of {1 + len(best.rivals)} effects that this data cannot tell apart: "
            f"{name} comes first, but it could as well be {labels(best.rivals, 'or')}."
        )
    else:
        first = f"Missing is {name}."
    if best.known:
        first = f"{first} The model has it, as {known(best)}: that must have changed."
    said = [
        f"{first} Its torque: {effect.equation}. With {effect.label} in the model and everything "
        f"refitted, {numbers(best.parameters)}; {_falls(d, best)}.",
        _sureness(d, best),
    ]
    if best.rivals:
        said.append(_apart(d.fit.mechanism, effect, best.rivals))
    own = ""
    if effect.joints and joint not in effect.joints:
        own = f" against the signals of {', '.join(effect.joints)}"
    said.append(
        f"What to look for in the plots of {joint}{own}: {effect.signature}. It is gone once the "
        f"effect is in the model: `ident add MECHANISM {effect.label}` or `--with {effect.label}`, "
        "in Python `mechanism + diagnosis.best`."
    )
    return said + _left(d, best)


def known(best: Explanation) -> str:
    """`Fc = 0.3 N m`, as the model has it so far."""
    return some(
        [
            f"{v.name.rpartition('.')[2]} = {best.known[v.name]:.4g} {v.unit}".removesuffix(" 1")
            for v in best.parameters
        ]
    )


def _falls(d: Diagnosis, best: Explanation) -> str:
    """The held-out error of its joint before and after."""
    before, after = best.before[best.joint], best.after[best.joint]
    return (
        f"the held-out error of {best.joint} falls from {error_text(before)} to "
        f"{error_text(after)}, where noise alone would leave {d.floor[best.joint]:.2g} {after.unit}"
    )


def _sureness(d: Diagnosis, best: Explanation) -> str:
    e = best.evidence
    said = [
        f"That something is missing here: {sure(e.z)}. Stretches of time that were left out of "
        f"the fit are predicted better with it by {e.z:.1f} standard errors"
    ]
    if e.beyond > 1:
        times = f"more than {LARGE:.0f}" if e.beyond > LARGE else f"{e.beyond:.1f}"
        said.append(f"the fall is {times} times the largest that logs without it show by chance")
    said.append(f"it closes {closure(e)} of the gap between residual and noise")
    text = f"{', '.join(said[:-1])}, and {said[-1]}."
    if d.choice.partner is not None:
        other = d.choice.partner.candidate.effect.label
        text += f" By itself that is not all: it takes {other} as well to explain what is seen."
    return text


def _apart(mechanism: Mechanism, effect: Effect, rivals: tuple[Effect, ...]) -> str:
    """Why this data cannot tell rivals apart."""
    said = ["Their held-out errors differ by less than two standard errors."]
    elsewhere = [each for each in rivals if set(each.joints) != set(effect.joints)]
    if elsewhere and len(mechanism.joints) > mechanism.degrees_of_freedom:
        said.append(
            "In a closed loop the torques of all joints end up in the same equation; only their "
            "leverage, how far a joint goes when the drive does, tells one joint from another, and "
            "over this range of motion it changes too little. That the error falls is no proof of "
            "the cause here."
        )
    elif elsewhere:
        said.append(
            f"In this motion {listed([effect.label, *(e.label for e in elsewhere)])} go alike: "
            "what one explains the other explains nearly as well."
        )
    alike = [each for each in rivals if set(each.joints) == set(effect.joints)]
    if alike:
        said.append(
            f"{listed([effect.label, *(e.label for e in alike)])} sit at the same place and differ "
            "only where this motion has little to show, at other speeds, positions or loads."
        )
    return " ".join(said)


def _left(d: Diagnosis, best: Explanation) -> list[str]:
    """What is missing beyond the effect that is named."""
    after, mine = best.after, best.evidence.mends
    done = best.evidence.closure >= MOST_CLOSED
    more = [
        each.joint
        for each in failing(d)
        if after[each.joint].rms > LOUDER * d.floor[each.joint]
        and not (done and d.fit.motion.independent.index(each.joint) in mine)
    ]
    if not more:
        return []
    rest = listed(f"{name} {after[name].rms:.3g} {after[name].unit}" for name in more)
    return [
        f"That may not be all: even with it more than noise is left ({rest}). Add it and diagnose "
        "again; `ident grow` goes on until nothing more can be named."
    ]
