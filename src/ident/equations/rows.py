"""Filtered rows of the reduced equations: one an independent coordinate and sample, no multipliers.

    Zᵀ (Γ p + E c) = Zᵀ (τ + f_e) − known        J Z = 0, W_u Z = 1

With one free multiplier a sample, these rows and the stack [Γ E | Jᵀ] have the same solution. Row u
is the error of the predicted torque of the independent joint u, which is what is compared.

Or the paper's stack [Γ E | JᵀB] (eq. 7-8): all rows, multipliers expanded in a time basis:

    Γ p + E c + Jᵀ B a = τ + f_e − known          λ(t) = B(t) a
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ident.equations.corrections import Scene
from ident.equations.filter import STICKING, Decimator, filtered_windows
from ident.equations.terms import Samples, with_bodies
from ident.equations.unknowns import Columns
from ident.errors import FitError
from ident.information.band import Chunk
from ident.information.splines import Basis
from ident.mechanism.mechanism import Mechanism
from ident.motion.regressor import supports
from ident.motion.state import State

CHUNK = 1024  # samples of a stream whose raw rows are in memory at once
LEVER = 0.1  # a joint that barely moves with a coordinate may stand still without harm
ROUNDING = 1e-9  # of a joint's largest transmission: below, it does not move with a coordinate


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of consecutive samples.

    With n samples, d independent coordinates and k unknowns:
    """

    t: np.ndarray  # (n,) [s]
    sample: np.ndarray  # (n,) index into the state
    A: np.ndarray  # (n, d, k)
    b: np.ndarray  # (n, d), with all that is known moved to the right
    tau: np.ndarray  # (n, d), the measured torques Zᵀτ alone
    informed: np.ndarray  # (n, d), false where dry friction at standstill leaves the torque open

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, which: slice | np.ndarray) -> Rows:
        """Some of the rows."""
        return Rows(*(getattr(self, each.name)[which] for each in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """Rows one after the other."""
        if len(parts) == 1:
            return parts[0]
        names = [each.name for each in fields(cls)]
        return cls(*(np.concatenate([getattr(x, name) for x in parts]) for name in names))


def informing(
    s: Samples, informative: Sequence[tuple[str, np.ndarray]], farthest: np.ndarray | None
) -> np.ndarray:
    """(n, r), false where a joint with dry friction stands still and its torque is open."""
    informed = np.ones(s.shape, dtype=bool)
    for name, moves in informative:
        at, lever = s.lever(name)
        most = np.ones(1) if farthest is None else farthest[s.mechanism.joint_index[name]]
        moved = (most > ROUNDING * most.max()) & (np.abs(lever) > LEVER * most)
        informed[:, at] &= moves[:, None] | ~moved
    return informed


def largest_transmission(e: State) -> np.ndarray | None:
    """Largest transmission (J, d) of every joint over the state; None for a tree."""
    if e.loop is None:
        return None
    return np.abs(e.leverage[e.usable]).max(axis=0, initial=0.0)


def rows(
    scene: Scene,
    cutoff: float | None,
    sticking: float = STICKING,
    farthest: np.ndarray | None = None,
    keep: bool = True,
) -> Iterator[Rows]:
    """All rows of a state in pieces, filtered at `cutoff` [Hz] and decimated.

    A row informs if less than the share `sticking` of it comes from samples that do not; `farthest`
    is `largest_transmission` of the whole log, if the state is a part of one. Filtered columns of Γ
    are stored with the state, unless it is seen once (`keep`): they hang on no parameter, effect or
    torque.
    """
    e, model = scene.e, scene.mechanism.model
    farthest = largest_transmission(e) if farthest is None else farthest
    key = "Γ", cutoff, e.loop is not None
    stored = e.store.get(key, model)
    spans = _spans(scene.mechanism, e)
    supports = row_supports(scene.mechanism, scene.columns, e)
    before = len(scene.columns.rigid)
    of_effects = [mine[mine >= before] - before for mine in supports]
    fresh: list[list[np.ndarray]] | None = [] if stored is None and keep else None

    def make(part: slice) -> list[np.ndarray]:
        """Γ by row, effects' columns by row, b, τ, informed of some samples."""
        s = scene.samples(part)
        found = scene.effects(s)
        gamma = [] if stored is not None else [s.gamma[:, u, span] for u, span in enumerate(spans)]
        effects = [found.A[:, u, mine] for u, mine in enumerate(of_effects)]
        informed = informing(s, found.informative, farthest)
        return [*gamma, *effects, found.b, found.tau, informed]

    d, done, size = len(spans), 0, 0
    for segment in e.segments():
        for sample, series in Decimator.of(cutoff, e.rate).filtered(segment, make, sticking):
            n = len(sample)
            if stored is not None:
                gamma = [x[:, done : done + n].T for x in stored]
            else:
                gamma, series = series[:d], series[d:]
                size += sum(x.nbytes for x in gamma)
                fresh = fresh if fresh is not None and e.store.fits(size) else None
                if fresh is not None:
                    fresh.append(gamma)
            done += n
            A = np.zeros((d, len(scene.columns) - before, n)).transpose(2, 0, 1)
            for u, mine in enumerate(of_effects):
                A[:, u, mine] = series[u]
            b, tau, informed = series[d:]
            A, b = with_bodies(scene.columns, scene.point, gamma, A, b, spans)
            yield Rows(e.t[sample], sample, A, b, tau, informed)
    if fresh:
        e.store.put(
            key, model, [np.hstack([x.T for x in each]) for each in zip(*fresh, strict=True)]
        )


def _spans(mechanism: Mechanism, e: State) -> list[slice]:
    """For each independent coordinate the stretch of Γ's columns that can differ from zero."""
    if e.loop is not None:
        return [slice(0, len(mechanism.prior))] * e.leverage.shape[2]
    found = supports(mechanism.model)
    return [slice(int(mine[0]), int(mine[-1]) + 1) if len(mine) else slice(0, 0) for mine in found]


def row_supports(mechanism: Mechanism, columns: Columns, e: State) -> list[np.ndarray]:
    """For each independent coordinate the unknowns that can appear in its rows."""
    k = len(columns)
    if e.loop is not None:
        return [np.arange(k)] * e.leverage.shape[2]
    found = []
    for row, bodies in enumerate(supports(mechanism.model)):
        mine = [i for i, column in enumerate(columns.rigid) if column in set(bodies)]
        for effect, places in columns.effects:
            own = {mechanism.joint(n).index for n in effect.joints if n in mechanism.joint_index}
            if not effect.local or row in own:
                mine.extend(int(place) for place in places if place >= 0)
        found.append(np.array(mine, dtype=int))
    return found


ABSENT = 1e-9  # of a unit torque: below, it is not in a row
FINEST = 20.0  # knots a sample; more say nothing, and fill the memory


def basis_of(mechanism: Mechanism, segment: slice, e: State) -> Basis:
    """The time basis of the multipliers over a run of usable samples."""
    settings = mechanism.multipliers
    if settings.spacing * FINEST < 1 / e.rate:
        raise FitError(
            f"{e.name}: knots every {settings.spacing:g} s for samples every {1 / e.rate:.3g} s; "
            "give a spacing of a few samples, or basis free"
        )
    return Basis.spanning(
        float(e.t[segment.start]), float(e.t[segment.stop - 1]), settings.spacing, settings.degree
    )


def stack(scene: Scene, cutoff: float | None, segment: slice, basis: Basis) -> Iterator[Chunk]:
    """The stack of one run of usable samples, in pieces, filtered like all columns."""
    e = scene.e
    decimator = Decimator.of(cutoff, e.rate)
    pieces = decimator.filtered(segment, lambda part: full_rows(scene, part))
    for sample, (A, b, informed) in pieces:
        inside = slice(sample[0] - decimator.half, sample[-1] + decimator.half + 1)
        J_T = scene.mechanism.kinematics.closure_rows(e.q[inside]).rate.transpose(0, 2, 1)
        first, values = basis.window(e.t[inside])
        values = values[:, :, None, None] * J_T[:, None]  # L = Jᵀ B(t) (paper, eq. 7)
        first, L = filtered_windows(
            decimator, basis, e.t[inside], first, values, sample - inside.start
        )
        first = np.broadcast_to(first[:, None], b.shape)
        yield Chunk(first[informed], L.transpose(0, 2, 1, 3)[informed], A[informed], b[informed])


def full_rows(scene: Scene, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, nv, k), b (n, nv) of [Γ E] and the known side, and (n, nv) whether a row informs."""
    s, found = scene.generalised(part), scene.terms(part, full=True)
    informed = np.ones(s.shape, dtype=bool)
    for name, moves in found.informative:
        rows, W = s.lever(name)
        informed[:, rows] &= moves[:, None] | (np.abs(W) < ABSENT)
    return found.A, found.b, informed
