"""The paper's stack [Γ E | JᵀB] (eq. 7-8): all rows, multipliers expanded in a time basis.

Γ p + E c + Jᵀ B a = τ + f_e − known          λ(t) = B(t) a
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ident.equations.corrections import Scene
from ident.equations.filter import Decimator, filtered_windows
from ident.errors import FitError
from ident.information.reduction import Chunk
from ident.information.splines import Basis
from ident.mechanism.mechanism import Mechanism
from ident.motion.state import State

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
        if decimator.taps is None:
            chunk = Chunk.of_samples(first, values, J_T, A, b)
        else:
            values = values[:, :, None, None] * J_T[:, None]
            first, L = filtered_windows(
                decimator, basis, e.t[inside], first, values, sample - inside.start
            )
            L = L.transpose(0, 2, 1, 3)
            n, nv = b.shape
            chunk = Chunk(
                np.repeat(first, nv), L.reshape(n * nv, *L.shape[2:]),
                A.reshape(n * nv, A.shape[2]), b.reshape(n * nv),
            )  # fmt: skip
        chosen = informed.reshape(-1)
        yield Chunk(chunk.first[chosen], chunk.L[chosen], chunk.A[chosen], chunk.b[chosen])


def full_rows(scene: Scene, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, nv, k), b (n, nv) of [Γ E] and the known side, and (n, nv) whether a row informs."""
    s, found = scene.generalised(part), scene.terms(part, full=True)
    informed = np.ones(s.shape, dtype=bool)
    for name, moves in found.informative:
        rows, W = s.lever(name)
        informed[:, rows] &= moves[:, None] | (np.abs(W) < ABSENT)
    return found.A, found.b, informed
