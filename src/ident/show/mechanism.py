"""A mechanism as text, as tables for Jupyter, and in 3-D: standing, or moving along experiments.

M a + … + Jᵀ λ = τ,  J = ∂Φ/∂q,  so a closure's reaction does the virtual work −λᵀ δΦ
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ident.display import renders
from ident.errors import MechanismError
from ident.mechanism.closures import FrameClosure
from ident.mechanism.description import align_z
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.tree import Placement, joint_axis
from ident.show.bodies import simple_body, sites, urdf_shapes
from ident.show.html import definitions, folded, in_frame, items, strong, table
from ident.show.view3d import (
    Body,
    Film,
    Loads,
    Pivot,
    Shape,
    Stage,
    Tie,
    frames,
    running_rms,
    wxyz,
)
from ident.show.view3d.page import View

RATE, MOST, LEAST = 120.0, 6000, 2000  # pictures of a film
ORIGIN = np.zeros(3)
WIDTH = 0.1  # [s] over which a residual is averaged, so that colours do not flicker


@renders(Mechanism, "text")
def text(mechanism: Mechanism) -> str:
    """Return the parts of a mechanism, one a line."""
    m = mechanism
    lines = [
        f"mechanism {m.name}: {m.model.nv} coordinates, "
        f"{len(m.kinematics.multipliers)} closure equations {_freedom(m)}",
        f"  driven:   {', '.join(m.driven) or 'none'}",
        f"  passive:  {', '.join(m.passive) or 'none'}",
    ]
    lines += [f"  closure:  {closure.name} ({closure.kind})" for closure in m.closures]
    lines += [f"  effect:   {effect.label}" for effect in m.effects]
    lines += [f"  unknown:  {len(m.unknown)} of {len(m.bodies.names)} dynamic parameters"]
    return "\n".join([*lines, *(f"  note:     {note}" for note in m.notes)])


def _freedom(mechanism: Mechanism) -> str:
    try:
        return f"of rank {mechanism.rank}, {mechanism.degrees_of_freedom} degrees of freedom"
    except MechanismError as error:  # what cannot be assembled can still be printed
        return f"that do not close: {error}"


@renders(Mechanism, "html")
def html(mechanism: Mechanism) -> str:
    """Return the parts and the joints of a mechanism as tables."""
    m = mechanism
    parts = {
        "Coordinates": str(m.model.nv),
        "Closures": f"{len(m.kinematics.multipliers)} equations {_freedom(m)}"
        if m.closures else "",
        "Closed by": ", ".join(f"{each.name} ({each.kind})" for each in m.closures),
        "Effects": ", ".join(each.label for each in m.effects) or "none",
        "Unknown": f"{len(m.unknown)} of {len(m.bodies.names)} dynamic parameters",
    }  # fmt: skip
    rows = [["joint", "", "lower", "upper", "unit"]]
    for joint in m.joints:
        state = "driven" if joint.name in m.driven else "passive"
        rows.append([joint.name, state, f"{joint.lower:.4g}", f"{joint.upper:.4g}", joint.unit])
    notes = [folded("Notes", items(m.notes))] if m.notes else []
    return in_frame(
        [strong(f"Mechanism {m.name}"), definitions(parts), table(rows, "Joints"), *notes]
    )


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """The motion of a mechanism in one experiment, n samples, and the predictions of a model.

    Attributes:
        name: the experiment's.
        t: (n,) [s]; q: (n, nq) of the mechanism's model.
        multipliers: (n, m) λ, or None.
        residual: (n,) measured − predicted torque by joint [N m | N].
        torque: (n,) measured torque by joint, to whose rms the residual is compared; without it
            the residual is compared to its own rms.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    multipliers: np.ndarray | None = None
    residual: Mapping[str, np.ndarray] | None = None
    torque: Mapping[str, np.ndarray] | None = None

    @staticmethod
    def of(experiment: Any, prediction: Any = None) -> ShownMotion:
        """Return an experiment and a prediction on the same clock."""
        e, p = experiment, prediction
        if p is None:
            return ShownMotion(e.name, e.t, e.q)
        residual = np.where(p.usable[:, None], p.residual, np.nan)
        by_joint = (dict(zip(p.joints, x.T, strict=True)) for x in (residual, p.measured))
        return ShownMotion(e.name, e.t, e.q, p.multipliers, *by_joint)


@renders(Mechanism, "view")
def view(
    mechanism: Mechanism, experiments: Sequence[Any] = (), predictions: Sequence[Any] = ()
) -> View:
    """Return the mechanism moving along experiments; without any, standing as assembled.

    Args:
        mechanism: the mechanism.
        experiments: of a motion.
        predictions: for each, whose reactions are arrows and whose residuals are colours.
    """
    every = predictions or [None] * len(experiments)
    return view_of(mechanism, [ShownMotion.of(*e) for e in zip(experiments, every, strict=True)])


def view_of(mechanism: Mechanism, motions: Sequence[ShownMotion] = ()) -> View:
    """Return the mechanism moving along some motions; without any, standing as assembled."""
    notes: list[str] = []
    if not motions:
        try:
            q = mechanism.assembled
        except MechanismError as error:  # a picture helps to see why
            q = mechanism.start
            notes.append(str(error))
        motions = [ShownMotion("as assembled", np.zeros(1), q[None])]
    stage, more = stage_of(mechanism, motions[0].q[0])
    nowhere = [c.name for c in mechanism.closures if not c.frames]
    if nowhere and any(motion.multipliers is not None for motion in motions):
        more.append(
            f"{', '.join(nowhere)}: λ acts along coordinates, at no place: no arrow is drawn"
        )
    films = tuple(film_of(mechanism, stage, motion) for motion in motions)
    return View(stage, films, (*notes, *more))


def stage_of(mechanism: Mechanism, q: np.ndarray) -> tuple[Stage, list[str]]:
    """Bodies, joints and closures, sized by the configuration q (nq,); and notes."""
    shapes, notes = _shapes(mechanism)
    size = _size(mechanism, q, shapes)
    names = ("ground", *mechanism.bodies.links)
    bodies = [
        Body(name, tuple(shapes[i] or (simple_body(mechanism, i, size) if i else [])))
        for i, name in enumerate(names)
    ]
    ties = [
        Tie(closure.name, closure.kind, closure.a.link, closure.b.link)
        for closure in _tied(mechanism)
    ]
    g = np.array(mechanism.model.gravity.linear)
    strength = float(np.linalg.norm(g))
    up = -g / strength if strength > 0 else np.array([0.0, 0.0, 1.0])
    return Stage(mechanism.name, tuple(bodies), pivots(mechanism), tuple(ties), up, size), notes


def film_of(mechanism: Mechanism, stage: Stage, motion: ShownMotion) -> Film:
    """Where the stage's bodies are along a motion, at most 6000 moments."""
    moments = frames(motion.t, RATE, MOST, LEAST)
    q = np.asarray(motion.q, float)[moments]
    R, p = _poses(mechanism.model, q)
    tied = _tied(mechanism)
    ends = np.zeros((len(q), len(tied), 2, 3))
    for i, closure in enumerate(tied):
        for k, frame in enumerate((closure.a, closure.b)):
            ends[:, i, k] = p[:, frame.joint] + R[:, frame.joint] @ frame.placement.translation
    phi = mechanism.kinematics.closure_rows(q).value
    loads = None
    if motion.multipliers is not None:
        loads = loads_of(mechanism, (R, p), np.asarray(motion.multipliers, float)[moments])
    misfit, unit = _misfit(stage, motion)
    return Film(
        motion.name, motion.t[moments], p, wxyz(R), ends, np.abs(phi).max(axis=1, initial=0.0),
        loads, None if misfit is None else misfit[moments], unit,
    )  # fmt: skip


def pivots(mechanism: Mechanism) -> tuple[Pivot, ...]:
    """A mark for each joint of the tree, and for each closure that leaves a named one free."""
    model, marks = mechanism.model, []
    tree = {joint.name for joint in mechanism.joints if joint.in_tree}
    for index in range(1, model.njoints):
        name = model.names[index]
        if name in tree:
            rotational = mechanism.joint(name).rotational
            marks.append(Pivot(name, rotational, index, align_z(joint_axis(model, index)), ORIGIN))
    for closure in _tied(mechanism):
        if closure.free:
            name, place = closure.own_joint(closure.free[-1]), closure.a.placement
            rotational = "rz" in closure.free
            marks.append(
                Pivot(name, rotational, closure.a.joint, place.rotation, place.translation)
            )
    return tuple(marks)


def _tied(mechanism: Mechanism) -> list[FrameClosure]:
    return [closure for closure in mechanism.closures if isinstance(closure, FrameClosure)]


def _shapes(mechanism: Mechanism) -> tuple[list[list[Shape]], list[str]]:
    """Known shapes of each body in its joint's axes, fixed links with their parent."""
    model = mechanism.model
    shapes_of: list[list[Shape]] = [[] for _ in range(model.njoints)]
    by_link, notes = urdf_shapes(mechanism.urdf)
    for link, shapes in by_link.items():
        at, place = 0, pin.SE3.Identity()
        if model.existBodyName(link):
            frame = model.frames[model.getBodyId(link)]
            at, place = frame.parentJoint, frame.placement
        elif link in mechanism.bodies.links:
            at = 1 + mechanism.bodies.links.index(link)
        shapes_of[at] += [shape.moved(place.rotation, place.translation) for shape in shapes]
    return shapes_of, notes


def _size(mechanism: Mechanism, q: np.ndarray, shapes: Sequence[Sequence[Shape]]) -> float:
    """Diagonal [m] of the box around joints, closures, masses and shapes at q."""
    R, p = _poses(mechanism.model, q[None])
    cloud = []
    for i, places in enumerate(sites(mechanism)):
        own = [np.array(places).reshape(-1, 3), *(shape.corners for shape in shapes[i])]
        if i and mechanism.model.inertias[i].mass > 0:
            own.append(mechanism.model.inertias[i].lever[None])
        cloud.append(np.concatenate(own) @ R[0, i].T + p[0, i])
    points = np.concatenate(cloud)
    diagonal = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    return diagonal if diagonal > 1e-6 else 1.0


def _poses(model: pin.Model, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (n, bodies, 3, 3) and origins (n, bodies, 3) [m] at q (n, nq), ground first."""
    data, count = model.createData(), model.njoints
    R, p = np.zeros((len(q), count, 3, 3)), np.zeros((len(q), count, 3))
    for k, each in enumerate(q):
        pin.forwardKinematics(model, data, each)
        for i in range(count):
            R[k, i], p[k, i] = data.oMi[i].rotation, data.oMi[i].translation
    return R, p


def _misfit(stage: Stage, motion: ShownMotion) -> tuple[np.ndarray | None, str]:
    """(n, pivots) residual over a tenth of a second, as a share, and of what."""
    if not motion.residual:
        return None, ""
    share = np.full((len(motion.t), len(stage.pivots)), np.nan)
    for i, pivot in enumerate(stage.pivots):
        if pivot.name in motion.residual:
            of = motion.torque or motion.residual
            rms = float(np.sqrt(np.nanmean(np.square(of.get(pivot.name, np.nan)))))
            if rms > 0:
                share[:, i] = motion.residual[pivot.name] / rms
    unit = f"rms over {WIDTH:g} s, in % of the rms {'torque' if motion.torque else 'residual'}"
    return running_rms(motion.t, share, WIDTH), unit


def loads_of(
    mechanism: Mechanism, poses: tuple[np.ndarray, np.ndarray], multipliers: np.ndarray
) -> Loads:
    """Return the reactions of all closures that hold two frames together; NaN where λ is NaN.

    Args:
        mechanism: the mechanism.
        poses: of its bodies in the world, (n, bodies, 3, 3) and (n, bodies, 3) [m], ground first.
        multipliers: (n, m) λ.
    """
    n = len(multipliers)
    names: list[str] = []
    at: list[np.ndarray] = []
    force: list[np.ndarray] = []
    moment: list[np.ndarray] = []
    for closure in _tied(mechanism):
        (Ra, pa), (Rb, pb) = (
            _in_world(frame.placement, frame.joint, poses) for frame in closure.frames
        )
        rows = [
            i for i, name in enumerate(mechanism.kinematics.multipliers)
            if name.rpartition(".")[0] == closure.name
        ]  # fmt: skip
        wrenches = _reaction(closure).map(n)(
            *(R.transpose(1, 0, 2).reshape(3, 3 * n) for R in (Ra, Rb)),
            pa.T, pb.T, multipliers[:, rows].T,
        )  # fmt: skip
        Fa, Ma, Fb, Mb = (x.full().T for x in wrenches)
        if closure.sliding:  # both act at b
            Ma, pa = Ma - np.cross(pb - pa, Fa), pb
        names += [f"{closure.name} on {frame.link}" for frame in closure.frames]
        at += [pa, pb]
        force += [Fa, Fb]
        moment += [Ma, Mb]
    stacked = (np.stack(x, axis=1) if x else np.zeros((n, 0, 3)) for x in (at, force, moment))
    return Loads(tuple(names), np.arange(len(names)) % 2 == 1, *stacked)


def _reaction(closure: FrameClosure) -> ca.Function:
    """(R_a, R_b, p_a, p_b, λ) → force and moment on a at p_a, force and moment on b at p_b.

    Each frame is displaced by δ and turned by θ in world axes: F = −(∂Φ/∂δ)ᵀ λ, M = −(∂Φ/∂θ)ᵀ λ.
    """
    Ra, Rb = ca.SX.sym("Ra", 3, 3), ca.SX.sym("Rb", 3, 3)
    pa, pb = ca.SX.sym("pa", 3), ca.SX.sym("pb", 3)
    small = [ca.SX.sym(name, 3) for name in ("da", "ta", "db", "tb")]
    da, ta, db, tb = small
    phi = closure.between(
        Placement(Ra + ca.skew(ta) @ Ra, pa + da), Placement(Rb + ca.skew(tb) @ Rb, pb + db)
    ).phi
    multipliers = ca.SX.sym("lambda", phi.numel())
    work = ca.dot(phi, multipliers)
    wrenches = [-ca.gradient(work, each) for each in small]
    zeros = [ca.SX.zeros(3)] * 4
    return ca.Function(
        "reaction", [Ra, Rb, pa, pb, multipliers], ca.substitute(wrenches, small, zeros)
    )


def _in_world(
    placement: pin.SE3, joint: int, poses: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    R, p = poses[0][:, joint], poses[1][:, joint]
    return R @ placement.rotation, p + R @ placement.translation
