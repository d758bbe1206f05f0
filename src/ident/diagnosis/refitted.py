"""Candidates refitted: which of rivals is named, and what each of them does."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np

from ident.diagnosis.effect_set import Member
from ident.diagnosis.result import Diagnosis, Explanation, announced, errors_of, known_of
from ident.diagnosis.search import Selection
from ident.diagnosis.selection import Evidence, simplicity
from ident.effects import Effect
from ident.equations.unknowns import Point
from ident.errors import IdentError
from ident.fit import Fit, identify

SHOWN = 3  # shown: candidates that are listed though they are not credible
LISTED = 8  # shown: candidates that are listed at most


def by_rivals(selection: Selection) -> Iterator[Selection]:
    """Yield a selection as it is, then with each rival of its first name in the place of that, the
    simplest first; nothing where nothing is named.
    """
    if not selection.named:
        return
    yield selection
    first = selection.named[0]
    simple = sorted(first.rivals, key=simplicity)
    for each in simple:
        yield _with_first(selection, each, [e for e in simple if e is not each])


def _with_first(selection: Selection, name: Evidence, rivals: Sequence[Evidence]) -> Selection:
    """Return a selection with another first name, which no other member has, and its rivals."""
    first, label = selection.named[0], name.effect.label
    member = replace(first, effect=name.effect, evidence=name, rivals=tuple(rivals), stands_in=True)
    members = (member if m is first else m for m in selection.members)
    return replace(selection, members=tuple(m for m in members if m is member or m.label != label))


def least_error(selection: Selection, found: Sequence[Explanation]) -> Selection | None:
    """Return a selection with that rival of its first name in the place of that which leaves least
    when all is refitted, where both are one load on several links; None where the first name does.

    Args:
        selection: with a first name.
        found: the first name and its rivals, refitted or not.
    """
    first = selection.named[0]
    left = {
        e.effect.label: float(np.mean([np.log(max(x.rms, 1e-300)) for x in e.after.values()]))
        for e in found
        if e.fit is not None
    }
    own = first.evidence
    if own is None or first.label not in left or not first.effect.loaded_link:
        return None
    alike = [e for e in (own, *first.rivals) if e.effect.kind == first.effect.kind]
    alike = [e for e in alike if e.effect.label in left]
    best = min(alike, key=lambda e: left[e.effect.label])
    if best is own:
        return None
    return _with_first(selection, best, [e for e in (own, *first.rivals) if e is not best])


def explanations(fit: Fit, selection: Selection, best: Member | None) -> list[Explanation]:
    """The best refitted, its rivals and what else is promising, best first."""
    first = [best.evidence, *best.rivals] if best is not None and best.evidence else []
    labels = {each.effect.label for each in first}
    rest = [e for e in selection.first.evidence if e.effect.label not in labels]
    rest.sort(key=lambda each: not each.credible)
    wanted = [*first, *rest][: max(SHOWN, min(LISTED, len(first) + 1))]
    effects = [each.effect for each in first]
    cheap = all(each.linear for each in fit.mechanism.effects)  # no search of shapes
    found = []
    for each in wanted:
        rivals = tuple(e for e in effects if e.label != each.effect.label)
        rivals = rivals if each.effect.label in labels else ()
        if (first and each is first[0]) or (each.effect.linear and cheap):
            with suppress(IdentError):  # a correction too large for the loops to close, say
                found.append(explain(fit, each, rivals))
        else:
            found.append(announced(fit, selection, each, rivals))
    return found


def explain(fit: Fit, found: Evidence, rivals: tuple[Effect, ...] = ()) -> Explanation:
    """The refit with a candidate; searched shapes set out from where they were found. Its standard
    errors hold no bias of wrong data, beside which nothing is named.
    """
    refit = identify(
        fit.mechanism + found.effect, fit.motion, start=started(fit.point, fit, [found]),
        estimator="least-squares",
    )  # fmt: skip
    effects = refit.effects_with(refit.without_faults)
    values = next(e.parameters for e in effects if e.effect.label == found.effect.label)
    return Explanation.of(fit, found, refit, errors_of(refit), values, rivals)


def with_group(d: Diagnosis) -> Diagnosis:
    """Return a diagnosis with the errors that a fit with all effects that it names together has."""
    if len(d.group) < 2:
        return d
    fit, found = d.fit, [m.evidence for m in d.members_of_group if m.evidence]
    model = reduce(add, d.group, fit.mechanism)
    with suppress(IdentError):  # announced errors stay
        start = started(fit.point, fit, found)
        again = identify(model, fit.motion, start=start, estimator="least-squares")
        return replace(d, with_group=errors_of(again))
    return d


def started(point: Point, fit: Fit, found: Collection[Evidence]) -> Point:
    """The working point with the shapes of some candidates where they were found."""
    shapes: dict[str, float] = {}
    for each in found:
        effect = each.effect
        before = known_of(fit, effect) if effect.corrects else {}
        names = effect.names[len(effect.unknowns) :]
        shapes |= {
            full: each.shape[shape.name] + before.get(full, 0.0)
            for full, shape in zip(names, effect.shapes, strict=True)
            if shape.name in each.shape
        }
    return Point(point.pi, {**point.values, **shapes})
