"""From a mechanism and what it did to a view of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from ident.description.axes import align_z
from ident.errors import MechanismError
from ident.mechanism.closures import KINDS, Closure
from ident.mechanism.forward import joint_axis
from ident.mechanism.loads import loads_of
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.simple import simple_body, sites
from ident.mechanism.track import Track
from ident.mechanism.visuals import looks
from ident.show.view3d import Body, Film, Pivot, Shape, Stage, Tie, View, frames, running_rms, wxyz

RATE, MOST, LEAST = 120.0, 6000, 2000  # pictures of a film
ORIGIN = np.zeros(3)
WIDTH = 0.1  # s over which a residual is averaged, so that colours do not flicker


def view_of(mechanism: Mechanism, tracks: Sequence[Track] = ()) -> View:
    """The mechanism moving along some tracks; without any, standing where it is assembled."""
    notes: list[str] = []
    if not tracks:
        try:
            q = mechanism.assembled
        except MechanismError as error:  # a picture helps to see why
            q = mechanism.start
            notes.append(str(error))
        tracks = [Track("as assembled", np.zeros(1), q[None])]
    stage, said = stage_of(mechanism, tracks[0].q[0])
    if any(track.multipliers is not None for track in tracks):
        nowhere = [c.name for c in mechanism.closures if not isinstance(c, Closure)]
        if nowhere:
            said.append(
                f"{', '.join(nowhere)}: λ acts along coordinates, at no place: no arrow is drawn"
            )
    films = tuple(film_of(mechanism, stage, track) for track in tracks)
    return View(stage, films, (*notes, *said))


def stage_of(mechanism: Mechanism, q: np.ndarray) -> tuple[Stage, list[str]]:
    """Bodies, joints and closures, sized by the configuration q (nq,); and notes."""
    shapes, notes = _shapes(mechanism, mechanism.urdf)
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


def film_of(mechanism: Mechanism, stage: Stage, track: Track) -> Film:
    """Where the stage's bodies are along a track, at most 6000 moments."""
    kept = frames(track.t, RATE, MOST, LEAST)
    q = np.asarray(track.q, float)[kept]
    R, p = _poses(mechanism.model, q)
    tied = _tied(mechanism)
    ends = np.zeros((len(q), len(tied), 2, 3))
    for i, closure in enumerate(tied):
        for k, frame in enumerate((closure.a, closure.b)):
            ends[:, i, k] = p[:, frame.joint] + R[:, frame.joint] @ frame.placement.translation
    phi = mechanism.kinematics.closure_rows(q).value
    loads = None
    if track.multipliers is not None:
        loads = loads_of(mechanism, (R, p), np.asarray(track.multipliers, float)[kept])
    misfit, unit = _misfit(stage, track)
    return Film(
        track.name, track.t[kept], p, wxyz(R), ends, np.abs(phi).max(axis=1, initial=0.0), loads,
        None if misfit is None else misfit[kept], unit,
    )  # fmt: skip


def pivots(mechanism: Mechanism) -> tuple[Pivot, ...]:
    """A mark for each joint of the tree, and for each closure that leaves a named one free."""
    model, found = mechanism.model, []
    tree = {joint.name for joint in mechanism.joints if joint.in_tree}
    for index in range(1, model.njoints):
        name = model.names[index]
        if name in tree:
            rotational = mechanism.joint(name).rotational
            found.append(Pivot(name, rotational, index, align_z(joint_axis(model, index)), ORIGIN))
    for closure in _tied(mechanism):
        free = KINDS[closure.kind].own if closure.kind in KINDS else ()
        if free:
            several = f".{free[-1]}" if len(free) > 1 else ""
            name = closure.own_name or f"closure.{closure.name}{several}"
            place = closure.a.placement
            found.append(
                Pivot(name, "rz" in free, closure.a.joint, place.rotation, place.translation)
            )
    return tuple(found)


def _tied(mechanism: Mechanism) -> list[Closure]:
    return [closure for closure in mechanism.closures if isinstance(closure, Closure)]


def _shapes(mechanism: Mechanism, urdf: Path) -> tuple[list[list[Shape]], list[str]]:
    """Known shapes of each body in its joint's axes, fixed links with their parent."""
    model = mechanism.model
    found: list[list[Shape]] = [[] for _ in range(model.njoints)]
    by_link, notes = looks(urdf)
    for link, shapes in by_link.items():
        at, place = 0, pin.SE3.Identity()
        if model.existBodyName(link):
            frame = model.frames[model.getBodyId(link)]
            at, place = frame.parentJoint, frame.placement
        elif link in mechanism.bodies.links:
            at = 1 + mechanism.bodies.links.index(link)
        found[at] += [shape.moved(place.rotation, place.translation) for shape in shapes]
    return found, notes


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


def _misfit(stage: Stage, track: Track) -> tuple[np.ndarray | None, str]:
    """(n, pivots) residual over a tenth of a second, as a share, and of what."""
    if not track.residual:
        return None, ""
    share = np.full((len(track.t), len(stage.pivots)), np.nan)
    for i, pivot in enumerate(stage.pivots):
        if pivot.name in track.residual:
            of = track.torque or track.residual
            rms = float(np.sqrt(np.nanmean(np.square(of.get(pivot.name, np.nan)))))
            if rms > 0:
                share[:, i] = track.residual[pivot.name] / rms
    unit = f"rms over {WIDTH:g} s, in % of the rms {'torque' if track.torque else 'residual'}"
    return running_rms(track.t, share, WIDTH), unit
