"""The equations of motion without multipliers, the only place where they are put together.

    Γ p + E c = τ + f_e − known        A = [Γ E] of what is unknown, b = τ + f_e − known

In generalised coordinates Jᵀλ is missing, and `stack` expands it in time; in the independent ones
all terms are projected by Zᵀ, and there is none. The samples know which coordinates they are in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.effects import Effect
from ident.equations.columns import Columns, known_values
from ident.equations.samples import Samples


@dataclass(frozen=True, eq=False)
class Terms:
    """The equations of n samples, r rows each: r = nv, or d if the samples are reduced.

    Attributes:
        A: (n, r, k), the columns of the unknowns x.
        b: (n, r) [N m | N], the known side.
        tau: (n, r) [N m | N], the measured torques alone.
        told: by effect and joint, where some sample does not inform: the joint's name and (n,),
            false where dry friction at standstill leaves the torque of that joint open.
    """

    A: np.ndarray
    b: np.ndarray
    tau: np.ndarray
    told: list[tuple[str, np.ndarray]]


def terms(s: Samples, columns: Columns) -> Terms:
    """A x = b of some samples, in their coordinates."""
    tau = s.measured(s.mechanism.driven)
    b = tau.copy() if s.wrench is None else tau + s.wrench
    A = np.zeros((*s.shape, len(columns)))
    np.take(s.gamma, columns.rigid, axis=2, out=A[:, :, : len(columns.rigid)], mode="clip")
    if len(columns.known):
        b -= s.gamma[:, :, columns.known] @ columns.known_values
    told = []
    for effect, places in columns.effects:
        unknown = places >= 0
        if unknown.any():
            mine = places[unknown]  # neighbours in x, so that a view of A can be added to
            add_effect(A[:, :, mine[0] : mine[-1] + 1], s, effect, np.eye(len(places))[:, unknown])
        if not unknown.all():
            add_effect(b, s, effect, -known_values(effect))
        informed = effect.informed(s.signals(effect.joints))
        told += [
            (name, informed[:, i])
            for i, name in enumerate(effect.joints)
            if not informed[:, i].all()
        ]
    return Terms(A, b, tau, told)


def add_effect(out: np.ndarray, s: Samples, effect: Effect, c: np.ndarray) -> None:
    """Adds the forces E c of one effect to `out`, in the coordinates of the samples.

    The only place where an effect becomes forces: here torques E (n, joints, unknowns) of its
    joints, each spread by its W. An effect that is no torque of single joints (a payload, a tilt of
    gravity, an error of geometry, an encoder's offset) would instead give generalised columns
    F (n, nv, unknowns), made of q, v, a and the mechanism in `s`, and add `s.reduce(F) @ c`.

    Args:
        out: (n, r), or (n, r, c) for c combinations of the effect's unknowns.
        s: the samples.
        effect: the effect.
        c: values (unknowns,), or combinations (unknowns, c).
    """
    E = effect.columns(s.signals(effect.joints))
    for i, name in enumerate(effect.joints):
        s.add_torque(out, name, E[:, i] @ c)
