"""Laws of the literature that would do as well as a name, over the travelled range."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ident.diagnosis.candidates import Contest
from ident.diagnosis.law_search import MINE, FittedFormula, LawSearch, OnProgress
from ident.diagnosis.laws import LossComparison
from ident.diagnosis.search import Selection
from ident.diagnosis.selection import Decision
from ident.effects import KINDS, Effect, Signals
from ident.information import linear
from ident.information.hypotheses import Array

WIDER = 2.0  # times the travelled range, over which laws that do as well are compared
DIFFERENT = 0.2  # of a torque (rms) there, from which two are two laws


def relatives_of(
    contest: Contest, selection: Selection, decision: Decision, on_progress: OnProgress
) -> tuple[FittedFormula, ...]:
    """Return laws of the literature that do as well as the first name, which is one of position:
    over the travelled range the data cannot tell them from it. One of each kind, the best first;
    effects of the library are the name's rivals instead.
    """
    best = selection.named[0] if selection.named else None
    if best is None or not best.effect.of_position or best.stands_in:
        return ()  # where it stands for another effect, its columns are of that one
    last, joint = selection.last, best.effect.joints[0]
    whole = last.regression.judging([p.Y[:, :1] for p in last.regression.parts])
    bare = whole.without(best.columns)
    mine = replace(last.contest, regression=bare)
    none = np.zeros(len(bare.rows))
    search = LawSearch(
        mine, bare, joint, "", last.limit_at(joint), none, on_progress, of_position=True
    )
    found = sorted(search.extended(None), key=lambda each: float(each.loss.sum()))
    equal: dict[str, FittedFormula] = {}
    for each in found:
        mends = np.flatnonzero(each.refit.by >= MINE * each.refit.by.sum())
        compare = LossComparison([int(u) for u in mends], decision.rival_se)
        name = each.formula.terms[0].known_as
        as_good = compare.better(each.refit.loss, whole.losses) < decision.rival_se
        if name and name not in KINDS and as_good and each.determined(bare):
            equal.setdefault(name, each)
    theta, _ = whole.solved
    place = {int(column): i for i, column in enumerate(whole.model)}
    shape = best.evidence.shape if best.evidence is not None else {}
    own = theta[[place[int(c)] for c in best.columns]][: len(best.effect.unknowns)]
    index = contest.table.mechanism.joint_index[joint]
    q = np.concatenate([scene.e.y[scene.e.usable, index] for scene in contest.table.scenes])
    x = np.mean(q) + WIDER * (np.linspace(q.min(), q.max(), 101) - np.mean(q))
    known = _beyond(best.effect, shape, own, x)
    others = ((e, _beyond(e.formula, e.shape, e.refit.theta, x)) for e in equal.values())
    apart = np.linalg.norm
    return tuple(e for e, f in others if apart(f - known) > DIFFERENT * apart(known))


def _beyond(effect: Effect, shape: Mapping[str, float], theta: Array, x: Array) -> Array:
    """Return the torque (n,) of an effect at positions x (n,), without what gravity could be."""
    one = np.ones((len(x), 1))
    s = Signals(x, x[:, None], one, one, np.full(1, 1e-12), shape=shape)
    f = effect.columns(s)[:, 0] @ theta[: len(effect.unknowns)]
    A = np.stack([one[:, 0], np.sin(x), np.cos(x)], axis=1)
    return np.asarray(f - A @ linear.lstsq(A, f)[0])
