"""From a mechanism and limits to the track on which courses are searched, and its yardsticks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.columns import Columns
from ident.errors import MotionError
from ident.excite.box import Box
from ident.excite.course import Scale, Track
from ident.excite.fourier import Fourier
from ident.excite.home import check_home, home_of, softened
from ident.excite.limits import Kept, Limits, kept
from ident.excite.stage import Stage, moved_joints, resting
from ident.excite.yardstick import noise_of, scaled, some_motions
from ident.fit.settle import initial
from ident.mechanism.mechanism import Mechanism
from ident.motion import Band, Motion
from ident.motion.close import Closer
from ident.solve.rank import Base

SAMPLES = 24  # a period of the highest harmonic
MARGIN = 0.97  # of the limits that follow from the drives' motion, at these samples


@dataclass(frozen=True, eq=False)
class Ready:
    """A track with what is needed to judge its courses.

    Attributes:
        kept: the limits in force; exact: the box of them, not tightened.
        base: what can be identified at all; scale: from rows to numbers.
        sigma: expected noise by drive that is moved [N m | N]; size: ‖K⁺‖ at home, 1 in a tree.
    """

    track: Track
    kept: Kept
    exact: Box
    base: Base
    scale: Scale
    sigma: Mapping[str, float]
    size: float


def prepared(
    mechanism: Mechanism,
    limits: Limits,
    period: float,
    harmonics: int,
    noise: Mapping[str, float],
    seed: int,
) -> Ready:
    """Everything for a search.

    Raises:
        MechanismError, MotionError: where the limits leave no motion at all, with the limit that
            excludes it; where nothing is unknown.
    """
    columns = Columns.of(mechanism)
    if not len(columns):
        raise MotionError(f"{mechanism.name}: nothing is unknown, so no motion is needed")
    names = moved_joints(mechanism)
    start = Closer(mechanism, names).coordinates(mechanism.assembled[None]).value[0]
    held = kept(mechanism, limits, names, dict(zip(names, start, strict=True)))
    known = {joint.name: i for i, joint in enumerate(held.joints)}
    mine = [held.joints[known[name]] for name in names]
    home, said = home_of(mechanism, mine, start)
    held = replace(held, notes=(*held.notes, *said))
    fourier = Fourier(
        period, harmonics, home,
        half=np.array([0.5 * (j.upper - j.lower) for j in mine]),
        speed=np.array([j.velocity for j in mine]),
        acceleration=np.array([held.acceleration[known[name]] for name in names]),
    )  # fmt: skip
    n = SAMPLES * harmonics
    t = period * np.arange(n) / n
    rest = softened(resting(mechanism, names, home, t), fourier)
    still = Motion((rest,), names, Band(0.0, 0.0, None), 0.0)
    stage = Stage(mechanism, columns, initial(mechanism, still))
    size = 1.0 if rest.pinv is None else float(np.linalg.norm(rest.pinv[0]))
    exact = Box.of(mechanism, held, size)
    check_home(mechanism, held, exact, stage, rest)
    box = exact.tightened(names, fourier.between(n), MARGIN)
    track = Track(stage, fourier, box, rest, fourier.basis(t))
    some = some_motions(track, seed)
    sigma = noise_of(mine, some, noise)
    base, scale = scaled(some, sigma)
    return Ready(track, held, exact, base, scale, dict(zip(names, sigma, strict=True)), size)
