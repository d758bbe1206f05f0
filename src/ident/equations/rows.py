"""The reduced rows of the stack: one an independent coordinate and sample, multipliers eliminated.

    Zᵀ (Γ p + E c) = Zᵀ (τ + f_e) − known        J Z = 0, W_u Z = 1

With one free multiplier a sample, these rows and the stack [Γ E | Jᵀ] have the same solution. Row u
is the error of the predicted torque of the independent joint u, which is what is compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.equations.filter import Decimator
from ident.equations.regressor import supports
from ident.equations.samples import Samples
from ident.equations.scene import Scene
from ident.equations.terms import terms
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment

CHUNK = 1024  # samples whose rows are in memory at once
STICKING = 0.2  # share of a filtered row that may come from samples that do not inform it
LEVER = 0.1  # a joint that barely moves with a coordinate may stand still without harm
ROUNDING = 1e-9  # of a joint's largest leverage: below, it does not move with a coordinate


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of consecutive samples.

    With n samples, d independent coordinates and k unknowns:

    Attributes:
        t: (n,) [s]; sample: (n,) index into the experiment.
        A: (n, d, k); b: (n, d), with all that is known moved to the right.
        tau: (n, d), the measured torques Zᵀτ alone.
        informed: (n, d), false where dry friction at standstill leaves the torque open.
    """

    t: np.ndarray
    sample: np.ndarray
    A: np.ndarray
    b: np.ndarray
    tau: np.ndarray
    informed: np.ndarray


def dof(mechanism: Mechanism, e: Experiment) -> int:
    """Independent coordinates."""
    return mechanism.model.nv if e.leverage is None else e.leverage.shape[2]


def raw_rows(scene: Scene, part: slice, farthest: np.ndarray | None = None) -> Rows:
    """The rows of some samples as they are, unfiltered.

    Args:
        scene: the experiment as the equations see it.
        part: the samples.
        farthest: (J, d), what `reach` says of the experiment, if it is at hand.
    """
    s, e = scene.samples(part), scene.e
    found = terms(scene, part)
    informed = informing(s, found.told, reach(e) if farthest is None else farthest)
    sample = np.arange(part.start, part.stop)
    return Rows(e.t[part], sample, found.A, found.b, found.tau, informed)


def informing(
    s: Samples, told: Sequence[tuple[str, np.ndarray]], farthest: np.ndarray | None
) -> np.ndarray:
    """(n, r), false where a joint with dry friction stands still and its torque is open."""
    informed = np.ones(s.shape, dtype=bool)
    for name, says in told:
        at, lever = s.lever(name)
        most = np.ones(1) if farthest is None else farthest[s.mechanism.joint_index[name]]
        moved = (most > ROUNDING * most.max()) & (np.abs(lever) > LEVER * most)
        informed[:, at] &= says[:, None] | ~moved
    return informed


def reach(e: Experiment) -> np.ndarray | None:
    """Largest leverage (J, d) of every joint over the experiment; None for a tree."""
    if e.leverage is None:
        return None
    return np.abs(e.leverage[e.usable]).max(axis=0, initial=0.0)


def rows(
    scene: Scene,
    cutoff: float | None,
    sticking: float = STICKING,
    farthest: np.ndarray | None = None,
) -> Iterator[Rows]:
    """All rows of an experiment in pieces, filtered at `cutoff` [Hz] and decimated.

    A row informs if less than the share `sticking` of it comes from samples that do not; `farthest`
    is what `reach` says of the whole log, if the experiment is a part of one.
    """
    e = scene.e
    decimator = Decimator.of(cutoff, e.rate)
    farthest = reach(e) if farthest is None else farthest
    for segment in e.segments():
        raw = None
        for inside, part in decimator.pieces(segment, CHUNK):
            raw = _continued(raw, scene, inside, farthest)
            if decimator.taps is None:
                yield raw
                continue
            sample = decimator.centres(part, segment)
            if not len(sample):  # shorter than from one row to the next
                continue
            A, b, tau = (decimator.apply(x, inside, sample) for x in (raw.A, raw.b, raw.tau))
            open_ = decimator.apply((~raw.informed).astype(float), inside, sample, absolute=True)
            yield Rows(e.t[sample], sample, A, b, tau, open_ < sticking)


def _continued(before: Rows | None, scene: Scene, part: slice, farthest: np.ndarray | None) -> Rows:
    """The rows of some samples; those that the piece before has are not made again."""
    if before is None or before.sample[-1] < part.start:
        return raw_rows(scene, part, farthest)
    end = int(before.sample[-1]) + 1
    new, known = raw_rows(scene, slice(end, part.stop), farthest), slice(part.start - end, None)
    names = Rows.__dataclass_fields__
    return Rows(
        *(np.concatenate([getattr(before, name)[known], getattr(new, name)]) for name in names)
    )


def row_supports(mechanism: Mechanism, columns: Columns, e: Experiment) -> list[np.ndarray]:
    """For each independent coordinate the unknowns that can appear in its rows."""
    k = len(columns)
    if e.leverage is not None:
        return [np.arange(k)] * dof(mechanism, e)
    found = []
    for row, bodies in enumerate(supports(mechanism.model)):
        mine = [i for i, column in enumerate(columns.rigid) if column in set(bodies)]
        for effect, places in columns.effects:
            own = {mechanism.joint(n).index for n in effect.joints if n in mechanism.joint_index}
            if not effect.local or row in own:
                mine.extend(int(place) for place in places if place >= 0)
        found.append(np.array(mine, dtype=int))
    return found
