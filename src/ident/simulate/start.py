"""Where an integration begins: coordinates and rates of some joints, closed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.errors import MotionError, one_of
from ident.mechanism.mechanism import Mechanism
from ident.motion.close import Closer
from ident.motion.independent import independent_joints


def started(
    mechanism: Mechanism,
    given: Mapping[str, float],
    q: np.ndarray | None = None,
    v: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """q (nq,) and v (nv,) with some joints where they are told to be; the others follow.

    Args:
        mechanism: the mechanism.
        given: by `q.<joint>` [rad | m] or `v.<joint>` [rad/s | m/s]; `<joint>` alone means q.
        q, v: what is kept where nothing is given; default: assembled, at rest.

    Raises:
        MotionError: for a name that is no joint, or joints that the closures do not let choose.
    """
    wanted = {key if "." in key and key[:2] in ("q.", "v.") else f"q.{key}": x
              for key, x in given.items()}  # fmt: skip
    names = [joint.name for joint in mechanism.joints]
    for key, value in wanted.items():
        if key[2:] not in names:
            raise MotionError(f"start: {key} is of no joint; {one_of(key[2:], names)}")
        if not np.isfinite(value):
            raise MotionError(f"start: {key} = {value}; give a finite number")
    q = mechanism.assembled if q is None else q
    v = np.zeros(mechanism.model.nv) if v is None else v
    if not wanted:
        return q, v
    asked = list(dict.fromkeys(key[2:] for key in wanted))
    chosen = independent_joints(mechanism, [*asked, *mechanism.driven, *names])
    left = [name for name in asked if name not in chosen]
    if left:
        raise MotionError(
            f"start: {mechanism.name} has {mechanism.degrees_of_freedom} degrees of freedom, so "
            f"{', '.join(asked)} cannot all be chosen; leave out {', '.join(left)}"
        )
    closer = Closer(mechanism, chosen)
    now = closer.coordinates(q[None], v[None])
    y, yd = now.value[0], now.rate[0] @ v
    goal = np.array([wanted.get(f"q.{name}", x) for name, x in zip(chosen, y, strict=True)])
    rate = np.array([wanted.get(f"v.{name}", x) for name, x in zip(chosen, yd, strict=True)])
    if not mechanism.closures:
        q = q.copy()
        q[[mechanism.joint(name).index for name in chosen]] = goal
        return q, rate
    q = closer.follow(goal[None], np.zeros(1))[0]
    v, _ = closer.rates(q[None], rate[None], np.zeros((1, len(chosen))))
    return q, v[0]
