"""A diagnosis in plain words, for somebody who knows the machine and not the statistics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ident.diagnose.claims import claim
from ident.diagnose.hidden import Invisible
from ident.diagnose.phrases import failing, listed, signal, some
from ident.residual import Failure
from ident.residual.periods import CHANCE
from ident.text import percent

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis

TOLD = 3  # joints, windows, regimes and signals that are described
REPEATS = 0.8  # correlation of the residual between periods that is physics
CARRIERS = 2  # sites of a kind whose absorbing parameters are named
ABSORBED = "absorbed"


def text_of(d: Diagnosis, experiment: str) -> str:
    """All of a diagnosis in short paragraphs, parted by empty lines.

    Args:
        d: the diagnosis; its own `text` and `next_experiment` are not looked at.
        experiment: which motion would tell more.
    """
    said = [*_health(d), *_where(d), *claim(d), *_invisible(d), *_unsupported(d)]
    if experiment:
        said.append(f"Next experiment: {experiment}")
    return "\n\n".join(said)


def _health(d: Diagnosis) -> list[str]:
    if d.health.good:
        return []
    findings = ". ".join(f"{check}" for check in d.health.findings)
    return [
        f"Before anything: the data themselves look wrong. {findings}. Put this right or rule it "
        "out, then diagnose again: what follows may only be its consequence."
    ]


def _where(d: Diagnosis) -> list[str]:
    bad = failing(d)
    said = [_failure(d, each) for each in bad[:TOLD]]
    if len(bad) > TOLD:
        said.append(f"More than noise is left in {listed(e.joint for e in bad[TOLD:])} as well.")
    quiet = [each.joint for each in d.where if each not in bad]
    if bad and quiet:
        said[-1] += f" In {listed(quiet)} nothing but noise is left."
    return said


def _failure(d: Diagnosis, f: Failure) -> str:
    """How much, when, on what that depends, and whether it comes again with the motion."""
    held = (d.fit.held_out or d.fit.train)[f.joint]
    relative = "" if held.relative is None else f", {percent(held.relative)} of the torque"
    said = [
        f"The model fails in {f.joint}: held out, its torque is off by {held.rms:.3g} {f.unit} "
        f"rms{relative}, where noise alone would leave {d.floor[f.joint]:.2g} {f.unit}; that is "
        f"{100 * f.share:.0f} % of the misfit of all joints."
    ]
    when = [f"{regime}" for regime in f.stands_out[:TOLD]]
    if when:
        said.append(f"It is larger at {listed(when)} than elsewhere.")
    if f.worst and not f.white:
        several = len(d.fit.motion.experiments) > 1
        windows = [f"{w}" + f" of {w.experiment}" * several for w in f.worst[:TOLD]]
        said.append(f"It is worst at {listed(windows)}.")
    if f.depends_on:
        seen = [
            f"{each.seen} against {signal(each.signal)} ({100 * each.r2:.0f} % of it)"
            for each in f.depends_on[:TOLD]
        ]
        said.append(f"Plotted, the residual shows {listed(seen)}.")
    elif not f.white:
        said.append(
            "It depends on no single signal, but is no noise either: a product of signals, or "
            "something that remembers, such as play or presliding."
        )
    return " ".join([*said, *_repeating(d, f.joint)])


def _repeating(d: Diagnosis, joint: str) -> list[str]:
    if d.periods is None:
        return []
    rho, chance = d.periods.rho[joint], d.periods.chance
    found = f"correlation {rho:.2f} between periods"
    if rho > max(REPEATS, chance):
        return [f"The motion repeats, and so does the residual ({found}): physics, not noise."]
    if rho > chance:
        return [f"The motion repeats, and a part of the residual repeats with it ({found})."]
    if rho > CHANCE:
        return [f"The motion repeats too seldom to say whether the residual does ({found})."]
    return [
        f"The motion repeats, but the residual does not ({found}): it is noise, or something that "
        "does not come back, such as warming up."
    ]


def _invisible(d: Diagnosis) -> list[str]:
    """Grouped by reason, a kind's places in one."""
    if not d.invisible:
        return []
    groups: dict[str, dict[str, list[Invisible]]] = {}
    for each in d.invisible:
        reason = ABSORBED if each.why.startswith(ABSORBED) else each.why
        groups.setdefault(reason, {}).setdefault(each.effect.kind, []).append(each)
    said = ["This data cannot show some effects, whatever their size, and says nothing about them."]
    for reason, kinds in groups.items():
        names = "; ".join(_kind(kind, found) for kind, found in kinds.items())
        if reason == ABSORBED:
            said.append(f"Other parameters of the model do the same as {names}.")
        else:
            said.append(f"Of {names}: {reason}.")
    return [" ".join(said)]


def _kind(kind: str, found: list[Invisible]) -> str:
    """`rotor_inertia of yaw (turret.Lzz)`, or several places without what absorbs each."""
    places = [",".join(each.effect.joints) for each in found]
    if not found[0].why.startswith(ABSORBED) or len(found) > CARRIERS:
        named = places
    else:
        named = [
            f"{place} ({_carriers(each.why)})".strip()
            for place, each in zip(places, found, strict=True)
        ]
    return f"{kind} of {some(named)}" if places[0] else " ".join([kind, *named]).strip()


def _carriers(why: str) -> str:
    """The first of the parameters that absorb an effect."""
    first, comma, _ = why.rpartition(" columns as ")[2].partition(", ")
    return f"{first} and others" if comma else first


def _unsupported(d: Diagnosis) -> list[str]:
    absurd = [each for each in d.unsupported if each.absurd]
    idle = [each for each in d.unsupported if not each.absurd]
    said = [f"In the model, {each.effect.label} cannot be as it is: {each.why}." for each in absurd]
    if idle:
        names = "; ".join(f"{each.effect.label}: {each.why}" for each in idle)
        how = f"`mechanism.without('{idle[0].effect.label}')`"
        if d.verdict == "nothing":
            advice = f"Leave it out ({how}) unless you know better."
        else:
            advice = f"That may change with what is missing; what stays idle then can go ({how})."
        said.append(f"In the model, and not supported by this data: {names}. {advice}")
    return said
