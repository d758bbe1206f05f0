"""Two causes of one alarm that began together, as after a service.

A second cause h joins a first one g where, fitted together,

    G_gh − G_g ≥ A′,  G_gh − G_h ≥ A′     A′: gain that a cause must have, in the noise that is left
    z_gh,g, z_gh,h ≥ CERTAIN               so the two beat each of them alone
    |θ| ≥ δ in one parameter of each       a change that is watched for
    rest_gh ≤ rest_g / 2                   beyond noise and the error of the reference

and nothing is left to be explained. For one parameter G_gh − G_g is (θ/s)², so A′ is a few standard
errors. Two causes are asked for only where no single one is sound, after all of the patience: what
the fit of a load leaves while its window is short looks like a further cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from ident.information.evidence import CERTAIN, MAIN_CAUSE, credible
from ident.streams.charts import NormalRunning, WatchedInterval
from ident.streams.suspects import EARLIER, Naming, Reading, Suspect, name_change, onset

LEADERS = 3  # work: likeliest causes with which every other one is tried


def name_together(
    single: Naming,
    suspects: Sequence[Suspect],
    intervals: Sequence[WatchedInterval],
    window: Sequence[WatchedInterval],
    x: np.ndarray,
    normal: NormalRunning,
    least: float,
) -> tuple[Naming, list[WatchedInterval]] | None:
    """Name two causes of what began with `window`, the last of the `intervals`; None where a single
    one is as good, or nothing is explained by two.
    """
    pairs = pairs_of([reading.suspect for reading in single.readings[:LEADERS]], suspects)
    if not pairs:
        return None
    naming = name_change([*suspects, *pairs], window[1:] or window, x, normal, least)
    if naming.best is None or naming.best.suspect.label not in {pair.label for pair in pairs}:
        return None
    first = max(len(intervals) - len(window) - EARLIER, 0)
    since = list(intervals[first + onset(intervals[first:], x, naming.best) :])
    again = name_change([*suspects, *pairs], since[1:] or since, x, normal, least)
    if again.best is None or again.best.suspect.label != naming.best.suspect.label:
        again, since = naming, list(window)
    parts = {effect.label for effect in naming.best.suspect.effects}
    alone = [r for r in again.readings if {e.label for e in r.suspect.effects} < parts]
    both = again.sound and again.surplus <= max(MAIN_CAUSE * single.surplus, 0.0)
    needed = all(needs_both(again, part, normal) for part in alone)
    return (again, since) if both and needed and grows_in_each(again, normal) else None


def pairs_of(leaders: Sequence[Suspect], suspects: Sequence[Suspect]) -> list[Suspect]:
    """Return each leader together with each other suspect that shares no column with it."""
    pairs: dict[frozenset[int], Suspect] = {}
    for one, other in product(leaders, suspects):
        shared = {*one.places.tolist()} & {*other.places.tolist()}
        if not (shared or (one.load and other.load)):
            pairs.setdefault(frozenset([*one.places.tolist(), *other.places.tolist()]), one + other)
    return list(pairs.values())


def needs_both(naming: Naming, part: Reading, normal: NormalRunning) -> bool:
    """Return whether the best of a naming is clearly likelier than a part of it alone."""
    assert naming.best is not None
    gained = naming.best.gain - part.gain
    z, _ = naming.best.apart_from(part, normal.typical)
    return credible(gained, naming.least * max(naming.remains, 1.0), possible=z >= CERTAIN)


def grows_in_each(naming: Naming, normal: NormalRunning) -> bool:
    """Return whether each cause of the best changes by what is watched for, in one parameter."""
    assert naming.best is not None
    suspect, theta = naming.best.suspect, np.abs(naming.best.theta)
    enough = theta >= normal.least[suspect.places]
    free = ~suspect.loaded
    return bool(enough[free].any() and (not suspect.load or enough[suspect.loaded].any()))
