"""The verb `residual_of`: a model and a motion become a residual.

    f = Γ π + E c − f_e            generalised forces; in the independent coordinates Zᵀ f = τ̂
    Jᵀ λ = W_uᵀ τ̂_u + W_oᵀ τ_o − f    of the drives u that are predicted and the others o

All are filtered and decimated as the rows of the regression are, so that the residual is b − A x.
"""

from __future__ import annotations

import numpy as np

from ident.equations.filter import Decimator
from ident.equations.point import Point
from ident.equations.rows import STICKING, informing, reach
from ident.equations.samples import Samples
from ident.equations.scene import Scene
from ident.equations.terms import told_by
from ident.errors import FitError
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment, Motion
from ident.motion.regressor import rigid_forces
from ident.residual.model import Model
from ident.residual.predict import NOTHING, generalised
from ident.residual.residual import CLOSURES, DRIVES, RIGID, WRENCHES, Residual, Trace

CHUNK = 4096  # samples whose regressor is in memory at once


def residual_of(model: Model, motion: Motion | None = None, *, name: str = "") -> Residual:
    """What a model leaves unexplained, and the parts of what it explains.

    Args:
        model: a fit, or a fit.json read back.
        motion: of which log; default: the one that the fit was made from.
        name: of the model; default: the file's, or the effects in it.

    Raises:
        FitError: if a model read from a file comes without a motion, or no stretch of the motion is
            long enough for its filter.
    """
    if motion is None:
        motion = model.motion
    if motion is None:
        raise FitError("a fit read from a file has no motion; give motion=ident.complete(…)")
    mechanism = model.mechanism
    traces = [trace_of(mechanism, model.point, motion, e) for e in motion.experiments]
    if not any(len(trace) for trace in traces):
        lost = ", ".join(trace.name for trace in traces)
        raise FitError(
            f"{lost}: no stretch is long enough for the filter ({motion.band.cutoff:.3g} Hz); "
            "give a longer log or a higher --cutoff"
        )
    joints = [mechanism.joint(each) for each in motion.independent]
    return Residual(
        name=name or model.name,
        model=model,
        motion=motion,
        joints=motion.independent,
        units=tuple(joint.force_unit for joint in joints),
        coordinate_units=tuple(joint.unit for joint in mechanism.joints),
        signals=tuple(joint.name for joint in mechanism.joints),
        traces=tuple(trace for trace in traces if len(trace)),
    )


def trace_of(mechanism: Mechanism, point: Point, motion: Motion, e: Experiment) -> Trace:
    """The residual of one experiment at a working point."""
    scene = Scene.of(mechanism, NOTHING, e, point, motion.band.cutoff)
    mechanism, e = scene.mechanism, scene.e
    decimator, farthest = Decimator.of(motion.band.cutoff, e.rate), reach(e)
    names = [RIGID, *(effect.label for effect in mechanism.effects if effect.unknowns)]
    names += [WRENCHES] if e.wrench is not None else []
    own = [*names, DRIVES, CLOSURES] if e.leverage is not None else []
    d = len(motion.independent)
    found: list[list[np.ndarray]] = []
    for number, segment in enumerate(e.segments()):
        for inside, part in decimator.pieces(segment, CHUNK):
            block, informed = _block(scene, motion, inside, farthest)
            sample = np.arange(part.start, part.stop)
            if decimator.taps is not None:
                sample = decimator.centres(part, segment)
                block = decimator.apply(block, inside, sample)
                open_ = decimator.apply((~informed).astype(float), inside, sample, absolute=True)
                informed = open_ < STICKING
            found.append([e.t[sample], np.full(len(sample), number), block, informed])
    J = len(mechanism.joints)
    widths = [d] * (2 + len(names) + len(own)) + [J] * 4
    if not found:
        found = [[np.zeros(0), np.zeros(0, int), np.zeros((0, sum(widths))), np.ones((0, d), bool)]]
    t, number_, block, informed = (np.concatenate(each) for each in zip(*found, strict=True))
    pieces = np.split(block, np.cumsum(widths)[:-1], axis=1)
    parts, rows = pieces[2 : 2 + len(names)], pieces[2 + len(names) : -4]
    q, v, a, direction = pieces[-4:]
    return Trace(
        e.name, t, number_, pieces[0], dict(zip(names, parts, strict=True)), pieces[1],
        dict(zip(own, rows, strict=True)), q, v, a, direction, informed, e.still,
    )  # fmt: skip


def _block(
    scene: Scene, motion: Motion, part: slice, farthest: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """All series of some samples side by side (n, …), unfiltered, and `informed` (n, d)."""
    mechanism, e = scene.mechanism, scene.e
    s, u = scene.generalised(part), scene.samples(part)
    forces = generalised(s, scene.point)
    q, zero = e.q[part], np.zeros_like(e.v[part])
    gravity = rigid_forces(mechanism.model, q, zero, zero, scene.point.pi)
    block = [u.measured(mechanism.driven), u.reduce(gravity), *(u.reduce(f) for f in forces)]
    if e.leverage is not None:
        block += _own(s, u, motion, forces)
    direction = np.clip(e.yd[part] / e.still, -1.0, 1.0)
    block += [e.y[part], e.yd[part], e.ydd[part], direction]
    said = [each for effect in mechanism.effects for each in told_by(u, effect)]
    return np.hstack(block), informing(u, said, farthest)


def _own(s: Samples, u: Samples, motion: Motion, forces: list[np.ndarray]) -> list[np.ndarray]:
    """Each part (n, d) in the rows of the independent joints, then other drives, Jᵀλ."""
    mechanism = s.mechanism
    others = tuple(name for name in mechanism.driven if name not in motion.independent)
    drives = s.measured(others)
    f = sum(forces, np.zeros(s.shape))
    tau = u.reduce(f - drives)
    for i, name in enumerate(motion.independent):
        s.add_torque(drives, name, tau[:, i])
    closures = drives - f
    rows = [mechanism.joint(name) for name in motion.independent]
    at = [row.index if row.in_tree else 0 for row in rows]
    missing = np.where([row.in_tree for row in rows], 0.0, np.nan)
    return [x[:, at] + missing for x in forces] + [
        tau - drives[:, at] + missing,
        closures[:, at] + missing,
    ]
