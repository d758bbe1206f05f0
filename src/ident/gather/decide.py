"""What a long log decides for all of its portions: on some stretches of it, and by their extremes.

Smoothing and noise are decided on stretches; the speed below which a joint stands still depends on
its top speed, and so on every sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.equations.filter import Decimator
from ident.gather.motion import excerpted, experiment
from ident.gather.plan import Part, Plan, Portion
from ident.gather.stretches import stretches
from ident.motion.close import Closer
from ident.motion.decided import Decided
from ident.motion.derive import derive
from ident.motion.measure import measure
from ident.motion.place import HOPELESS, SINGULAR, nearness
from ident.motion.rest import noise_of_speeds, thresholds, top_speeds

THINNED = 8  # samples of which one is followed to know the branch of the closures


@dataclass(frozen=True, eq=False)
class Extremes:
    """Of one portion: top speeds (J,), and largest leverages (J, d) or None."""

    top: np.ndarray
    farthest: np.ndarray | None


def decided(plan: Plan, number: int) -> tuple[Part, np.ndarray]:
    """The part of the plan of a log with several portions, and (J,) the speeds that noise feigns.

    Args:
        plan: without what this log decides.
        number: of the log.

    Raises:
        LogError, MotionError: where `complete` would raise one.
    """
    part, mechanism = plan.parts[number], plan.mechanism
    clock = part.survey.clock
    grid = Decimator.of(plan.band.cutoff, 1 / clock.step).factor
    pieces = [part.survey.log.piece(*each) for each in stretches(part.survey)]
    whole = [measure(mechanism, piece) for piece in pieces]
    made = [excerpted(plan, signals) for signals in whole]
    derived = [derive(s, plan.logged, plan.band, plan.smoothing) for s in whole]
    surplus = len(plan.logged) > mechanism.degrees_of_freedom
    smooth = [e.smooth for e in made if e.smooth is not None]
    common = Decided(replace(clock, grid=grid), ends=max(each.ends for each in derived))
    if smooth:
        noisy = {name for d in derived if d.smooth for name in d.smooth.names}
        spacing = min(each.spacing for each in smooth)  # at rest coarser ones would do
        length = clock.t_end - clock.t0
        columns = [c.column for c in smooth[0].channels]
        noise = {
            name: float(
                np.median([c.sigma for s in smooth for c in s.channels if c.column == name])
            )
            for name in columns
        }
        common = replace(
            common,
            noisy=tuple(n for n in plan.logged if n in noisy or surplus),
            carriers=smooth[0].names,
            knots=length / np.ceil(length / spacing - 1e-9),
            noise=noise,
        )
    largest = np.inf
    if mechanism.closures:
        sizes = np.concatenate([nearness(e) for e in made])
        largest = min(HOPELESS, SINGULAR * float(np.median(sizes)))
    feigned = [
        noise_of_speeds(mechanism, s, e, plan.logged) for s, e in zip(whole, made, strict=True)
    ]
    anchors = _anchors(plan, part) if mechanism.closures else None
    return replace(part, decided=common, largest=largest, anchors=anchors), np.max(feigned, axis=0)


def logged_speeds(plan: Plan, number: int) -> Extremes | None:
    """Extremes of a log that are known without its motion: a tree's, where speeds are as logged."""
    part = plan.parts[number]
    assert part.decided is not None
    top = part.survey.top
    names = [joint.name for joint in plan.mechanism.joints]
    known = part.survey.full and not part.decided.noisy and all(f"v.{n}" in top for n in names)
    if plan.mechanism.closures or not known:
        return None
    return Extremes(np.array([top[f"v.{name}"] for name in names]), None)


def extremes(plan: Plan, portion: Portion) -> Extremes | None:
    """Extremes of one portion, from its motion; None where no sample can be used.

    Args:
        plan: of all portions.
        portion: which one.
    """
    e, _ = experiment(plan, portion)
    if e is None:
        return None
    inside = (e.t >= portion.since) & (e.t < portion.until)
    e = replace(e, usable=e.usable & inside)
    far = None
    if e.leverage is not None:
        far = np.abs(e.leverage[e.usable]).max(axis=0, initial=0.0)
    return Extremes(top_speeds(e), far)


def with_extremes(part: Part, found: list[Extremes], feigned: np.ndarray) -> Part:
    """The part with its speeds of standstill and largest leverages."""
    top = np.max([each.top for each in found], axis=0)
    far = [each.farthest for each in found if each.farthest is not None]
    return replace(
        part,
        still=thresholds(top, feigned),
        farthest=np.max(far, axis=0) if far else None,
    )


def _anchors(plan: Plan, part: Part) -> np.ndarray:
    """(portions, nq) configurations near their beginnings, each followed from the one before.

    A portion alone would be reached straight from [joints] start: on another branch, perhaps.
    """
    mechanism, found = plan.mechanism, []
    closer = Closer(mechanism, plan.logged)
    columns = [f"q.{name}" for name in plan.logged]
    portions = list(plan.portions(plan.parts.index(part)))
    q = y = None
    for portion, after in zip(portions, [*portions[1:], portions[-1]], strict=True):
        log = part.survey.log.piece(portion.begin, portion.end, ["t", *columns])
        known = np.stack([log.columns[name] for name in columns], axis=1)
        told = np.flatnonzero(np.isfinite(known).all(axis=1))[::THINNED]
        if not len(told):
            found.append(mechanism.assembled if q is None else q)
            continue
        t, target = log.t[told], known[told]
        if q is None or y is None:
            path = closer.follow(target, t)
        else:
            path = closer.onward(q, y, target, t)
        found.append(path[0])
        at = max(int(np.searchsorted(told, after.begin - portion.begin)) - 1, 0)
        q, y = path[at], target[at]
    return np.array(found)
