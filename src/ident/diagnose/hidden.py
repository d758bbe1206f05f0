"""Effects that this data cannot show, whatever their size, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.diagnose.evidence import HIDDEN
from ident.diagnose.explanation import name_of
from ident.diagnose.screen import Screen
from ident.diagnose.search import Candidate
from ident.effects import Correcting, Effect
from ident.fit import Fit
from ident.fit.table import Table
from ident.mechanism.mechanism import Mechanism

SHARE = 0.05  # of a column, from which an unknown is named as one that carries it
NAMED = 4
STILL = 1e-9  # of other effects' columns: below, the motion does not feel this one at all


@dataclass(frozen=True, eq=False)
class Invisible:
    """An effect whose columns the model has already, or the motion does not feel."""

    effect: Effect
    why: str

    def json(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {**name_of(self.effect), "why": self.why}


def invisible(
    fit: Fit, table: Table, screen: Screen, candidates: Sequence[Candidate]
) -> tuple[Invisible, ...]:
    """Candidates of which the model leaves nothing to see."""
    found = []
    for each in candidates:
        if each.judged.visible < HIDDEN:
            found.append(Invisible(each.effect, _why(fit, table, screen, each)))
    return tuple(found)


def outright(mechanism: Mechanism, effect: Effect) -> Invisible | None:
    """A payload on a link whose ten parameters are all unknown needs no looking at."""
    if effect.kind != "payload":
        return None
    link = effect.joints[0]
    own = set(np.array(mechanism.bodies.names)[mechanism.bodies.columns(link)])
    if not own <= set(mechanism.unknown):
        return None
    return Invisible(effect, f"absorbed: same columns as {link}'s own parameters, all unknown")


def _why(fit: Fit, table: Table, screen: Screen, candidate: Candidate) -> str:
    """What absorbs it: C ≈ A_I K, the unknowns that carry most of it named."""
    effect = candidate.effect
    C = candidate.columns
    size = float(np.linalg.norm(C))
    if size <= STILL * float(np.linalg.norm(screen.Q)):
        if isinstance(effect, Correcting):
            return "no torque changes with it: gravity does not feel it in this motion"
        if fit.mechanism.closures:
            return f"the closures hide it: {effect.joints[0]} does not move with any drive"
        return f"{', '.join(effect.joints)} does not move in this motion"
    base = fit.estimate.base
    own = base.independent
    A = screen.taken(table.A[:, :, own])
    norms = np.linalg.norm(A, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    carriers: dict[str, float] = {}
    for c in C.T:
        K = np.linalg.lstsq(A / norms, c, rcond=1e-10)[0] / max(float(np.linalg.norm(c)), 1e-300)
        for i in np.argsort(-np.abs(K)):
            if abs(K[i]) > SHARE:
                name = fit.columns.names[own[i]]
                carriers[name] = max(carriers.get(name, 0.0), abs(float(K[i])))
    names = sorted(carriers, key=lambda name: -carriers[name])
    what = ", ".join(names[:NAMED]) + (
        f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    )
    same = "same columns as" if candidate.judged.visible < 1e-6 else "nearly the same columns as"
    return f"absorbed: {same} {what}" if names else "absorbed by the model's own parameters"
