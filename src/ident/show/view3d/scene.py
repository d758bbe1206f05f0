"""A moving mechanism as plain data that `scene.js` draws: shapes, poses, colours and camera.

A film has configurations, reactions of closures and residuals at some moments:

    M a + … + Jᵀ λ = τ,  J = ∂Φ/∂q,  so a closure's reaction does the virtual work −λᵀ δΦ
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ident.fit.residual import zero_of
from ident.mechanism import Mechanism
from ident.mechanism.closures import FrameClosure
from ident.mechanism.tree import Placement
from ident.show.charts import Arrays
from ident.show.view3d.bodies import ENDS, UNKNOWN, Colour, Parts, points_of, sites, tied, triangles

MOST = 1000  # pictures of all films
WIDTH = 0.1  # [s] over which a residual is averaged, so that colours do not flicker
Poses = tuple[np.ndarray, np.ndarray]  # rotations (n, 3, 3) and origins (n, 3) [m] in the world


@dataclass(frozen=True, eq=False)
class Loads:
    """Reactions over time in world axes, K of them, two a closure: (n, K, 3) each.

    Attributes:
        names: as `pin on rocker`; of a closure first that on a, then that on b.
        at: points of action [m]; force [N]; moment [N m].
    """

    names: tuple[str, ...]
    at: np.ndarray
    force: np.ndarray
    moment: np.ndarray


@dataclass(frozen=True, eq=False)
class Film:
    """A mechanism at n moments of one experiment.

    Attributes:
        name: of the experiment.
        t: (n,) [s]; q: (n, nq) of the mechanism's model.
        gap: (n,) largest |Φ| [m | rad].
        loads: reactions, if they are known.
        misfit: (n,) residual of each joint as a share of its rms torque, by name.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    gap: np.ndarray
    loads: Loads | None = None
    misfit: Mapping[str, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self.t)


def film_of(
    mechanism: Mechanism, experiment: Any, prediction: Any = None, most: int = MOST
) -> Film:
    """Return an experiment as a film of at most some moments.

    Args:
        mechanism: what moves.
        experiment: has `name`, `t` (n,) [s] and `q` (n, nq) of the mechanism's model.
        prediction: of a model on the same clock, whose multipliers become reactions, and whose
            residuals become colours, relative to the rms of the measured torque.
        most: moments.
    """
    t, p = experiment.t, prediction
    moments = frames(t, most)
    q = np.asarray(experiment.q, float)[moments]
    gap = np.abs(mechanism.kinematics.closure_rows(q).value).max(axis=1, initial=0.0)
    film = Film(experiment.name, t[moments], q, gap)
    if p is None:
        return film
    residual = np.where(p.usable[:, None], p.residual, np.nan)
    rms = np.sqrt(np.nanmean(p.measured**2, axis=0))
    misfit = {
        joint: running_rms(t, x / size, WIDTH)[moments]
        for joint, x, size in zip(p.joints, residual.T, rms, strict=True)
        if size > 0
    }
    return replace(film, loads=loads_of(mechanism, q, p.multipliers[moments]), misfit=misfit)


def loads_of(mechanism: Mechanism, q: np.ndarray, multipliers: np.ndarray) -> Loads:
    """Return the reactions of all closures that hold two frames together; NaN where λ is NaN.

    Args:
        mechanism: the mechanism.
        q: configurations (n, nq).
        multipliers: (n, m) λ.
    """
    n = len(q)
    names: list[str] = []
    vectors: list[np.ndarray] = []  # (3, n, 3) each: point, force and moment
    poses = iter(frame_poses(mechanism, q))
    for closure in tied(mechanism):
        (Ra, pa), (Rb, pb) = next(poses), next(poses)
        rows = [
            i
            for i, name in enumerate(mechanism.kinematics.multipliers)
            if name.rpartition(".")[0] == closure.name
        ]
        turned = [R.transpose(1, 0, 2).reshape(3, 3 * n) for R in (Ra, Rb)]
        wrenches = _reaction(closure).map(n)(*turned, pa.T, pb.T, multipliers[:, rows].T)
        Fa, Ma, Fb, Mb = (x.full().T for x in wrenches)
        if closure.sliding:  # both act at b
            Ma, pa = Ma - np.cross(pb - pa, Fa), pb
        names += [f"{closure.name} on {frame.link}" for frame in closure.frames]
        vectors += [np.stack([pa, Fa, Ma]), np.stack([pb, Fb, Mb])]
    return Loads(tuple(names), *(np.stack(vectors, axis=2) if vectors else np.zeros((3, n, 0, 3))))


def frame_poses(mechanism: Mechanism, q: np.ndarray) -> list[Poses]:
    """Return the poses of both frames of each closure of two frames at q (n, nq), a first."""
    frames = [frame for closure in tied(mechanism) for frame in closure.frames]
    data = mechanism.model.createData()
    poses = [(np.zeros((len(q), 3, 3)), np.zeros((len(q), 3))) for _ in frames]
    for k, each in enumerate(q):
        pin.forwardKinematics(mechanism.model, data, each)
        for frame, (R, p) in zip(frames, poses, strict=True):
            place = data.oMi[frame.joint] * frame.placement
            R[k], p[k] = place.rotation, place.translation
    return poses


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


def frames(t: np.ndarray, most: int) -> np.ndarray:
    """Return the indices of at most some samples of t (n,) [s], evenly in time, with both ends."""
    if len(t) <= most:
        return np.arange(len(t))
    wanted = np.linspace(t[0], t[-1], most)
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    return np.unique(np.where(wanted - t[after - 1] <= t[after] - wanted, after - 1, after))


def running_rms(t: np.ndarray, x: np.ndarray, width: float) -> np.ndarray:
    """Return the rms of x (n,) over `width` [s] around each t (n,); NaN counts as no sample."""
    known = np.isfinite(x)
    power = np.concatenate([[0.0], np.cumsum(np.where(known, x, 0.0) ** 2)])
    count = np.concatenate([[0], np.cumsum(known)])
    first = np.searchsorted(t, t - width / 2, side="left")
    last = np.searchsorted(t, t + width / 2, side="right")
    number = count[last] - count[first]
    mean = (power[last] - power[first]) / np.where(number > 0, number, np.nan)
    return np.sqrt(np.maximum(mean, 0.0))


MOMENTS: tuple[Colour, Colour] = ((235, 140, 20), (20, 150, 170))
MAP = "plasma"  # perceptually uniform, legible in grey and to the colour-blind
LONGEST = 0.4  # of the mechanism's size, for the largest reaction
ROUNDING = 1e-9  # a share of the other kind of load below which one is rounding
COLD = 1e-3  # share of the residual below which no joint is to glow
ROBUST = 99.0  # percentile of residuals that gets the last colour
ANGLE = np.radians(35.0)  # vertical angle of view
SHADES = 17  # colours of the map
ASPECT, MARGIN = 1.25, 1.05  # width over height of the narrowest window; room around
LOOKED_AT = 40  # moments of a film that decide what the camera sees
FLAT = 0.35  # thickness over width below which a mechanism is looked at face on


def mapped(share: np.ndarray) -> np.ndarray:
    """Return colours (…, 3) of 0 … 255 for shares (…); above 1 as 1, `UNKNOWN` for NaN."""
    from matplotlib import colormaps

    known = np.isfinite(share)
    rgb = np.array(colormaps[MAP](np.clip(np.where(known, share, 0.0), 0.0, 1.0)))[..., :3]
    return np.where(known[..., None], np.round(255 * rgb), UNKNOWN).astype(np.uint8)


@dataclass(frozen=True)
class Scales:
    """Scales of what is drawn; 0 where there is nothing to show.

    Attributes:
        force, moment: the largest [N], [N m], drawn `length` [m] long.
        misfit: share of the torque that gets the last colour.
        gap: largest |Φ| of all films [m | rad].
    """

    force: float
    moment: float
    length: float
    misfit: float
    gap: float


@dataclass(frozen=True, eq=False)
class Camera:
    """Position, target (3,) [m], and the box (2, 3) [m] around everything that moves."""

    position: np.ndarray
    target: np.ndarray
    box: np.ndarray
    up: np.ndarray

    @property
    def size(self) -> float:
        """Diagonal of the box [m]."""
        return float(np.linalg.norm(self.box[1] - self.box[0]))


@dataclass(frozen=True, eq=False)
class DrawnMechanism:
    """A mechanism with its shapes and films, and camera and scales that follow from them.

    Attributes:
        mechanism, parts, films: what is shown: shapes, and their motion, one an experiment.
        marks: words beside joints, by their names.
    """

    mechanism: Mechanism
    parts: Parts
    films: tuple[Film, ...]
    marks: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def up(self) -> np.ndarray:
        """Direction (3,) against gravity; z without gravity."""
        g = np.array(self.mechanism.model.gravity.linear)
        strength = float(np.linalg.norm(g))
        return -g / strength if strength > 0 else np.array([0.0, 0.0, 1.0])

    @cached_property
    def scales(self) -> Scales:
        """Scales of reactions and residuals that make the largest of all films legible."""
        size = self.parts.size
        loads = [film.loads for film in self.films if film.loads is not None]
        misfits = [each for film in self.films for each in (film.misfit or {}).values()]
        shares = np.concatenate(misfits) if misfits else np.empty(0)
        shares = shares[np.isfinite(shares)]
        force = max((_largest(each.force) for each in loads), default=0.0)
        moment = max((_largest(each.moment) for each in loads), default=0.0)
        return Scales(
            force=force if force * size > ROUNDING * moment else 0.0,
            moment=moment if moment > ROUNDING * force * size else 0.0,
            length=LONGEST * size,
            misfit=max(float(np.percentile(shares, ROBUST)), COLD) if len(shares) else 0.0,
            gap=max(float(film.gap.max(initial=0.0)) for film in self.films),
        )

    @cached_property
    def camera(self) -> Camera:
        """Camera that sees all films, a flat mechanism face on."""
        model, up = self.mechanism.model, self.up
        corners = [*points_of(self.parts.geometry), *enumerate(sites(self.mechanism))]
        data, clouds = model.createData(), []
        for film in self.films:
            for k in np.unique(np.linspace(0, len(film) - 1, LOOKED_AT).astype(int)):
                pin.forwardKinematics(model, data, film.q[k])
                poses = [(data.oMi[i], p) for i, p in corners]
                clouds += [p @ M.rotation.T + M.translation for M, p in poses]
        cloud = np.concatenate(clouds)
        box = np.array([cloud.min(axis=0), cloud.max(axis=0)])
        target = box.mean(axis=0)
        spread, axes = np.linalg.eigh(np.cov((cloud - target).T) + 1e-12 * np.eye(3))
        side = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0])
        direction = 0.8 * side - np.cross(side, up) + 0.55 * up
        thin = axes[:, 0] * np.sign(axes[:, 0] @ direction or 1.0)
        if np.sqrt(spread[0] / spread[1]) < FLAT and thin @ up < 0.7:  # "up" stays visible
            direction = thin + 0.35 * up + 0.3 * side
        direction = direction / np.linalg.norm(direction)
        right = np.cross(up, direction)
        right /= np.linalg.norm(right)
        # far enough that every point is within the angle of view, with a margin
        seen, above = cloud - target, np.cross(direction, right)
        extent = np.maximum(np.abs(seen @ right) / ASPECT, np.abs(seen @ above)) * MARGIN
        distance = float((extent / np.tan(ANGLE / 2) + seen @ direction).max())
        return Camera(target + max(distance, 1e-3) * direction, target, box, up)

    def data(self) -> str:
        """Return the scene as JSON, safe inside a <script> element; what `drawScene` takes."""
        arrays, scales, camera = Arrays(), self.scales, self.camera
        ramp = mapped(np.linspace(0.0, 1.0, SHADES)).tolist()
        pivots, shapes = iter(self.parts.pivots), []
        for each in self.parts.geometry.geometryObjects:
            kind = each.name.partition(" ")[0]
            corners, faces = triangles(each.geometry)
            placed = corners @ each.placement.rotation.T + each.placement.translation
            shapes.append({
                "kind": kind, "joint": int(each.parentJoint),
                "pivot": next(pivots) if kind == "joint" else "",
                "colour": np.round(255 * each.meshColor[:3]).tolist(),
                "corners": arrays.place(placed, "<f4"), "faces": arrays.place(faces, "<i4"),
            })  # fmt: skip
        content = {
            "shapes": shapes, "films": [self._film(film, arrays) for film in self.films],
            "marks": dict(self.marks), "ramp": ramp, "unknown": UNKNOWN, "fov": float(ANGLE),
            "misfit": scales.misfit, "up": camera.up.tolist(),
            "position": camera.position.tolist(), "target": camera.target.tolist(),
            "arrays": list(arrays),
        }  # fmt: skip
        return json.dumps(content).replace("<", "\\u003c")

    def _film(self, film: Film, arrays: Arrays) -> dict[str, Any]:
        """Return times, poses, colours, gaps and arrows of a film, times as charts count them."""
        model, scales = self.mechanism.model, self.scales
        data, poses = model.createData(), np.zeros((len(film), model.njoints, 12))
        for k, q in enumerate(film.q):
            pin.forwardKinematics(model, data, q)
            for i, place in enumerate(data.oMi):
                poses[k, i, :9], poses[k, i, 9:] = place.rotation.ravel(), place.translation
        ends = [p for _, p in frame_poses(self.mechanism, film.q)]
        arrows = []
        for what, colours in (("force", ENDS), ("moment", MOMENTS)):
            largest = getattr(scales, what)
            if film.loads is None or largest == 0:
                continue
            for i in range(len(film.loads.names)):
                along = getattr(film.loads, what)[:, i] * (scales.length / largest)
                both = np.stack([film.loads.at[:, i], film.loads.at[:, i] + along], axis=1)
                place = arrays.place(np.nan_to_num(both), "<f4")
                arrows.append({"colour": colours[i % 2], "ends": place})
        gaps = [np.stack(pair, axis=1) for pair in zip(ends[::2], ends[1::2], strict=True)]
        return {
            "name": film.name, "t": arrays.place(film.t - zero_of(film.t), "<f8"),
            "poses": arrays.place(poses, "<f4"), "arrows": arrows,
            "gaps": [arrays.place(gap, "<f4") for gap in gaps],
            "misfit": {j: arrays.place(x, "<f4") for j, x in (film.misfit or {}).items()},
        }  # fmt: skip


def _largest(vectors: np.ndarray) -> float:
    lengths = np.linalg.norm(vectors, axis=-1)
    return float(lengths[np.isfinite(lengths)].max(initial=0.0))
