"""Which joints can serve as independent coordinates."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations, islice

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.close import Closer, pseudo_inverse


def independent_joints(mechanism: Mechanism, preferred: Iterable[str]) -> tuple[str, ...]:
    """The first of the preferred joints whose rates determine all others through the closures.

    Args:
        preferred: names, most wanted first.

    Returns:
        As many names as there are degrees of freedom, or fewer if these joints do not determine
        the motion, in the mechanism's order.
    """
    names = list(dict.fromkeys(preferred))
    if not mechanism.closures:
        return tuple(joint.name for joint in mechanism.joints if joint.name in names)
    q = mechanism.general[None]
    J = mechanism.kinematics.closure_rows(q).rate[0]
    W = Closer(mechanism, tuple(names)).coordinates(q).rate[0]
    _, sizes, directions = np.linalg.svd(J)
    basis = list(directions[: int((sizes > 1e-8 * max(1.0, sizes.max(initial=0))).sum())])
    chosen: list[str] = []
    for strictness in (1e-3, 1e-7):  # a nearly dependent joint only if nothing better is there
        for name, w in zip(names, W, strict=True):
            if len(basis) == mechanism.model.nv or name in chosen:
                continue
            rest = w.copy()
            for _ in range(2):
                for direction in basis:
                    rest = rest - direction * (direction @ rest)
            if np.linalg.norm(rest) > strictness * np.linalg.norm(w):
                basis.append(rest / np.linalg.norm(rest))
                chosen.append(name)
    return tuple(joint.name for joint in mechanism.joints if joint.name in chosen)


def best_conditioned(mechanism: Mechanism, q: np.ndarray) -> tuple[str, ...]:
    """The independent joints in which this motion is compared with measurements.

    Driven joints before passive ones; among as many driven joints as are to be had, those in which
    the motion stays farthest from a singular position.

    Args:
        q: (n, nq) configurations of the motion.
    """
    d = mechanism.degrees_of_freedom
    q = q[:: max(1, len(q) // 200)]
    fixed = independent_joints(mechanism, mechanism.driven)
    if len(fixed) == d == len(mechanism.driven):
        return fixed
    if len(fixed) == d:
        sets = [*combinations(mechanism.driven, d)]
    else:
        others = [joint.name for joint in mechanism.joints if joint.name not in fixed]
        sets = [(*fixed, *more) for more in combinations(others, d - len(fixed))]
    names = tuple(dict.fromkeys(name for each in sets for name in each))
    J = mechanism.kinematics.closure_rows(q).rate
    W = Closer(mechanism, names).coordinates(q).rate
    best, least = sets[0], np.inf
    for each in islice(sets, 500):
        K = np.concatenate([J, W[:, [names.index(name) for name in each]]], axis=1)
        with np.errstate(all="ignore"):
            size = np.linalg.norm(pseudo_inverse(K), axis=(1, 2)).max()
        if size < 0.99 * least:
            best, least = each, size
    return tuple(joint.name for joint in mechanism.joints if joint.name in best)
