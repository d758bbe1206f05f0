"""Yardsticks from some random motions: what can be identified at all, and usual sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.errors import MechanismError, MotionError, one_of
from ident.excite.course import Scale, Track
from ident.excite.draw import drawn
from ident.excite.stage import Seen
from ident.fit.estimate import TOLERANCE
from ident.mechanism.mechanism import Joint
from ident.solve.factor import Factor
from ident.solve.rank import Base, reveal

NOISE = 0.01  # of the limit of torque: what is expected of a torque signal
LOOKED_AT = 12  # random courses whose rows tell what can be identified at all
HOPELESS = 40  # draws without one that keeps the limits


def some_motions(track: Track, seed: int) -> list[Seen]:
    """Rows of some random courses.

    Raises:
        MotionError: if hardly any keeps the limits.
    """
    random = np.random.default_rng([seed, 1])
    found = [drawn(track, random) for _ in range(LOOKED_AT)]
    seen = [each[1] for each in found if each is not None]
    tried = LOOKED_AT
    while len(seen) < LOOKED_AT and tried < HOPELESS:
        tried += 1
        if (more := drawn(track, random)) is not None:
            seen.append(more[1])
    if not seen:
        raise MotionError(
            f"{track.stage.mechanism.name}: none of {tried} random motions from home keeps the "
            "limits; home is too near a limit or a singular position: give another [joints] "
            "start, or wider limits"
        )
    return seen


def noise_of(
    joints: Sequence[Joint], some: Sequence[Seen], given: Mapping[str, float]
) -> np.ndarray:
    """(d,) expected noise of the torques: as given, else 1 % of the limit, else of their rms."""
    for name, x in given.items():
        if name not in [joint.name for joint in joints]:
            raise MechanismError(
                f"noise: no drive '{name}' is moved; {one_of(name, [j.name for j in joints])}"
            )
        if not 0 < x < np.inf:
            raise MechanismError(f"noise: {name} = {x:g}; a number above 0 is expected")
    found = []
    torque = np.sqrt(np.mean(np.concatenate([s.e.tau for s in some]) ** 2))
    for joint in joints:
        usual = joint.effort if np.isfinite(joint.effort) else max(float(torque), 1e-9)
        found.append(given.get(joint.name, NOISE * usual))
    return np.array(found)


def scaled(some: Sequence[Seen], sigma: np.ndarray) -> tuple[Base, Scale]:
    """The base parameters of all motions together, and the usual size of their columns."""
    rows = np.concatenate([s.A for s in some]) / sigma[:, None]
    flat = rows.reshape(-1, rows.shape[2])
    base = reveal(Factor.of(flat, np.zeros(len(flat))), TOLERANCE)
    keep = base.independent
    size = np.linalg.norm(flat[:, keep], axis=0) / np.sqrt(len(some))
    return base, Scale(keep, size, sigma)
