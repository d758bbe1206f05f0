"""A mechanism drawn into viser's scene: Pinocchio's visualizer, and colours, gaps and arrows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ident.mechanism import Mechanism
from ident.mechanism.description import align_z
from ident.show.view3d.bodies import (
    BALL,
    ENDS,
    UNKNOWN,
    Colour,
    Parts,
    plain,
    points_of,
    sites,
    tied,
)
from ident.show.view3d.film import Film, Loads, frame_poses

MOMENTS: tuple[Colour, Colour] = ((235, 140, 20), (20, 150, 170))
MAP = "plasma"  # perceptually uniform, legible in grey and to the colour-blind
LONGEST = 0.4  # of the mechanism's size, for the largest reaction
ROUNDING = 1e-9  # a share of the other kind of load below which one is rounding
COLD = 1e-3  # share of the residual below which no joint is to glow
ROBUST = 99.0  # percentile of residuals that gets the last colour
ANGLE = np.radians(35.0)  # vertical angle of view
LOOKED_AT = 40  # moments of a film that decide what the camera sees
FLAT = 0.35  # thickness over width below which a mechanism is looked at face on
THICK = 0.012  # radius of an arrow's head over the size
LEAST = 1e-9  # an arrow of no length would have no inverse
SLIM = 0.2  # share of the longest arrow below which an arrow gets slimmer too


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
    """A mechanism with its shapes and films, and camera and scales that follow from them."""

    mechanism: Mechanism
    parts: Parts
    films: tuple[Film, ...]

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
        extent = np.maximum(np.abs(seen @ right) / 1.25, np.abs(seen @ above)) * 1.25
        distance = float((extent / np.tan(ANGLE / 2) + seen @ direction).max())
        return Camera(target + max(distance, 1e-3) * direction, target, box, up)


def _largest(vectors: np.ndarray) -> float:
    lengths = np.linalg.norm(vectors, axis=-1)
    return float(lengths[np.isfinite(lengths)].max(initial=0.0))


class Drawing:
    """A scene on a page of viser. `show` moves it to a moment of a film."""

    def __init__(self, page: Any, scene: DrawnMechanism, title: Any = None) -> None:
        """Draw a scene; `title` is a label for the name of the film and its time."""
        self.scene, self._title, self._stage = scene, title, page.scene
        self._set_up(page)
        geometry = scene.parts.geometry
        self._robot = _visualizer()(scene.mechanism.model, pin.GeometryModel(), geometry)
        self._robot.initViewer(viewer=page)
        self._robot.loadViewerModel(rootNodeName="mechanism")
        joints = [x.name for x in geometry.geometryObjects if x.name.startswith("joint")]
        self._pivots = {
            pivot: self._robot.frames[f"mechanism/visual/{name}"]
            for pivot, name in zip(scene.parts.pivots, joints, strict=True)
        }
        self._closures = tied(scene.mechanism)
        self._gaps = self._stage.add_line_segments(
            "/gaps", np.zeros((len(self._closures), 2, 3), np.float32), colors=(40, 40, 40),
            thickness=0.3 * BALL * scene.parts.size,
        )  # fmt: skip
        loads = next((film.loads for film in scene.films if film.loads is not None), None)
        self._forces = self._add_arrows("force", loads, ENDS, scene.scales.force)
        self._moments = self._add_arrows("moment", loads, MOMENTS, scene.scales.moment)

    def show(self, film: Film, k: int) -> None:
        """Move everything to moment k of a film."""
        scales = self.scene.scales
        self._robot.display(film.q[k])
        if self._closures:
            ends = [p[0] for _, p in frame_poses(self.scene.mechanism, film.q[k : k + 1])]
            self._gaps.points = np.array(ends, np.float32).reshape(-1, 2, 3)
        for name, pivot in self._pivots.items():
            colour = UNKNOWN
            if scales.misfit > 0 and film.misfit is not None and name in film.misfit:
                r, g, b = mapped(film.misfit[name][k] / scales.misfit)
                colour = int(r), int(g), int(b)
            if tuple(pivot.color) != colour:
                pivot.color = colour
        for arrows, what in ((self._forces, "force"), (self._moments, "moment")):
            for i, arrow in enumerate(arrows):
                _point(arrow, film.loads, what, k, i, scales)
        if self._title is not None:
            self._title.text = f"{film.name}   {film.t[k]:.3f} s"

    def _set_up(self, page: Any) -> None:
        """Set camera, even light, under which colours that mean something stay, and the ground."""
        camera, first, stage = self.scene.camera, page.initial_camera, self._stage
        away = camera.position - camera.target
        distance = float(np.linalg.norm(away))
        first.position, first.look_at, first.up = camera.position, camera.target, camera.up
        first.fov, first.near, first.far = float(ANGLE), 0.01 * distance, 100.0 * distance
        stage.set_up_direction(tuple(float(part) for part in camera.up))
        stage.configure_environment_map(None)
        stage.configure_default_lights(enabled=False)
        stage.add_light_ambient("/light/all round", intensity=1.7)
        right, over = np.cross(camera.up, away), 1.2 * distance * camera.up
        key = camera.target + 0.5 * away + 0.9 * right + over
        stage.add_light_directional("/light/key", intensity=1.9, position=key, cast_shadow=True)
        lowest = min(float(corner @ camera.up) for corner in camera.box)
        below = lowest - camera.target @ camera.up - 0.02 * camera.size
        cell = float(10.0 ** np.floor(np.log10(max(camera.size, 1e-6) / 3.0)))
        width = cell * np.ceil(1.6 * camera.size / cell)
        stage.add_grid(
            "/ground", width=width, height=width, cell_size=cell, section_size=5 * cell,
            cell_color=(215, 218, 224), section_color=(185, 190, 200),
            fade_distance=20 * camera.size, position=camera.target + below * camera.up,
            wxyz=wxyz(align_z(camera.up)),
        )  # fmt: skip

    def _add_arrows(
        self, what: str, loads: Loads | None, colours: Sequence[Colour], largest: float
    ) -> list[Any]:
        import trimesh

        if loads is None or largest == 0:
            return []
        radius = THICK * self.scene.parts.size  # along z, of length 1: scaled by (1, 1, length)
        shaft = trimesh.creation.cylinder(0.4 * radius, segment=np.array([[0, 0, 0], [0, 0, 0.78]]))
        head = trimesh.creation.cone(radius, 0.25)
        head.apply_translation([0, 0, 0.75])
        arrow: Any = trimesh.util.concatenate([shaft, head])
        return [
            self._stage.add_mesh_simple(
                f"/{what}/{i} {plain(name)}", arrow.vertices, arrow.faces, color=colours[i % 2],
                flat_shading=True, cast_shadow=False,
            )
            for i, name in enumerate(loads.names)
        ]  # fmt: skip


def _point(arrow: Any, loads: Loads | None, what: str, k: int, i: int, scales: Scales) -> None:
    """Make an arrow as long as its load is large; slimmer where short, gone where unknown."""
    if loads is None:
        arrow.scale = (LEAST, LEAST, LEAST)
        return
    vector, largest = np.nan_to_num(getattr(loads, what)[k, i]), getattr(scales, what)
    share = float(np.linalg.norm(vector)) / largest
    slim = min(max(share / SLIM, LEAST), 1.0)
    if share > 0:
        arrow.wxyz = wxyz(align_z(vector))
    arrow.position = np.nan_to_num(loads.at[k, i])
    arrow.scale = (slim, slim, max(share * scales.length, LEAST))


def wxyz(R: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (4,), scalar part first, of a rotation matrix (3, 3)."""
    return np.roll(pin.Quaternion(R).coeffs(), 1)


def _visualizer() -> type:
    """Return Pinocchio's visualizer, which draws meshes as Pinocchio has read them."""
    from pinocchio.visualize.viser_visualizer import ViserVisualizer  # loads viser, half a second

    class Visualizer(ViserVisualizer):
        def loadViewerGeometryObject(
            self, geometry_object: Any, prefix: str = "", color: Any = None
        ) -> None:
            mesh = geometry_object.geometry
            if not isinstance(mesh, coal.BVHModelBase):
                super().loadViewerGeometryObject(geometry_object, prefix, color)
                return
            triangles = (mesh.tri_indices(i) for i in range(mesh.num_tris))
            *colour, opacity = geometry_object.meshColor
            node = f"{prefix}/{geometry_object.name}"
            self.frames[node] = self.viewer.scene.add_mesh_simple(
                node, mesh.vertices(), np.array([[t[0], t[1], t[2]] for t in triangles]),
                color=tuple(colour), opacity=opacity, flat_shading=True, side="double",
            )  # fmt: skip

    return Visualizer
