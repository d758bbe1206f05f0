"""A stage drawn into viser's scene: colours, scales, camera, meshes and arrows.

Pinocchio's ViserVisualizer shows one configuration of one open chain of Pinocchio's; it has no
gaps of closures, arrows, joints coloured over time, absolute coordinates or recordings, hence this.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ident.show.view3d import (
    Colour,
    Film,
    Loads,
    Pivot,
    Shape,
    Stage,
    arrow,
    box,
    cylinder,
    rotations,
    sphere,
    turned_to,
    wxyz,
)

BODIES: tuple[Colour, ...] = (
    (98, 132, 168),
    (143, 163, 104),
    (196, 154, 108),
    (126, 111, 156),
    (92, 152, 149),
    (178, 125, 134),
)
GROUND: Colour = (150, 150, 150)
ENDS: tuple[Colour, Colour] = ((200, 30, 60), (30, 80, 200))  # of a closure's a and b
MOMENTS: tuple[Colour, Colour] = ((235, 140, 20), (20, 150, 170))
UNKNOWN: Colour = (90, 90, 96)  # a joint of which no residual is known
MAP = "plasma"  # perceptually uniform, legible in grey and to the colour-blind


def body_colour(index: int) -> Colour:
    """Of the body at an index of the stage; 0 is the ground."""
    return GROUND if index == 0 else BODIES[(index - 1) % len(BODIES)]


def mapped(share: np.ndarray) -> np.ndarray:
    """Colours (…, 3) of 0 … 255 for shares (…); above 1 as 1, `UNKNOWN` for NaN."""
    from matplotlib import colormaps

    known = np.isfinite(share)
    rgb = colormaps[MAP](np.clip(np.where(known, share, 0.0), 0.0, 1.0))[..., :3]
    return np.where(known[..., None], np.round(255 * rgb), UNKNOWN).astype(np.uint8)


def css(colour: Colour) -> str:
    """The colour as style sheets write it."""
    return "#" + "".join(f"{int(part):02x}" for part in colour)


def css_ramp(steps: int = 9) -> str:
    """The residual's map from left to right, as style sheets write it."""
    found = mapped(np.linspace(0.0, 1.0, steps))
    return f"linear-gradient(to right, {', '.join(css(tuple(c)) for c in found)})"


LONGEST = 0.4  # of the mechanism's size, for the largest reaction
ROUNDING = 1e-9  # a share of the other kind of load below which one is rounding
COLD = 1e-3  # share of the residual below which no joint is to glow
ROBUST = 99.0  # percentile of residuals that gets the last colour


@dataclass(frozen=True)
class Scales:
    """Scales of what is drawn; 0 where there is nothing to show."""

    force: float  # largest [N], drawn `length` [m] long
    moment: float  # largest [N m], drawn `length` [m] long
    length: float
    misfit: float  # share of the residual that gets the last colour
    unit: str  # of the misfit, in words
    gap: float  # largest |Φ| of all films [m | rad]


def scales(films: Sequence[Film], size: float) -> Scales:
    """The scales that make the largest of all films legible, for a mechanism of `size` [m]."""
    loads = [film.loads for film in films if film.loads is not None]
    misfits = [film.misfit[np.isfinite(film.misfit)] for film in films if film.misfit is not None]
    shares = np.concatenate(misfits) if misfits else np.empty(0)
    force = max((_largest(each.force) for each in loads), default=0.0)
    moment = max((_largest(each.moment) for each in loads), default=0.0)
    return Scales(
        force=force if force * size > ROUNDING * moment else 0.0,
        moment=moment if moment > ROUNDING * force * size else 0.0,
        length=LONGEST * size,
        misfit=max(float(np.percentile(shares, ROBUST)), COLD) if len(shares) else 0.0,
        unit=next((film.unit for film in films if film.unit), ""),
        gap=max(float(film.gap.max(initial=0.0)) for film in films),
    )


def _largest(vectors: np.ndarray) -> float:
    lengths = np.linalg.norm(vectors, axis=-1)
    return float(lengths[np.isfinite(lengths)].max(initial=0.0))


ANGLE = np.radians(35.0)  # vertical angle of view
LOOKED_AT = 40  # moments of a film that decide
FLAT = 0.35  # thickness over width below which a mechanism is looked at face on


@dataclass(frozen=True, eq=False)
class Camera:
    """Position, target (3,) [m], and the box (2, 3) [m] around everything that moves."""

    position: np.ndarray
    target: np.ndarray
    box: np.ndarray

    @property
    def size(self) -> float:
        """Diagonal of the box [m]."""
        return float(np.linalg.norm(self.box[1] - self.box[0]))


def points(stage: Stage, films: Sequence[Film]) -> np.ndarray:
    """Corners of all shapes, joints and closures (k, 3) at some moments of the films [m]."""
    found = []
    for film in films:
        for k in np.unique(np.linspace(0, len(film) - 1, LOOKED_AT).astype(int)):
            R = rotations(film.wxyz[k])
            for i, body in enumerate(stage.bodies):
                own = [shape.corners for shape in body.shapes]
                own += [pivot.p[None] for pivot in stage.pivots if pivot.body == i]
                if own:
                    found.append(np.concatenate(own) @ R[i].T + film.position[k, i])
            found.append(film.ends[k].reshape(-1, 3))
    return np.concatenate(found)


def framed(stage: Stage, films: Sequence[Film]) -> Camera:
    """The camera that sees all of the motion, a flat mechanism face on."""
    cloud = points(stage, films)
    box = np.array([cloud.min(axis=0), cloud.max(axis=0)])
    target = box.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((cloud - target).T) + 1e-12 * np.eye(3))
    thin = axes[:, 0]
    up = stage.up
    side = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0])
    front = np.cross(side, up)
    if np.sqrt(spread[0] / spread[1]) < FLAT:
        towards = thin * (1.0 if thin @ (up + 0.3 * side - 0.6 * front) >= 0 else -1.0)
        # neither straight down, where "up" means nothing, nor without any depth
        lift = 0.35 * up if abs(thin @ up) < 0.7 else -0.6 * front
        direction = towards + lift + 0.3 * side
    else:
        direction = 0.8 * side - 1.0 * front + 0.55 * up
    direction = direction / np.linalg.norm(direction)
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    above = np.cross(direction, right)
    seen = cloud - target
    # far enough that every point is within the angle of view, with a margin
    reach = np.maximum(np.abs(seen @ right) / 1.25, np.abs(seen @ above)) * 1.25
    distance = float((reach / np.tan(ANGLE / 2) + seen @ direction).max())
    return Camera(target + max(distance, 1e-3) * direction, target, box)


@dataclass(frozen=True, eq=False)
class FilmedStage:
    """A stage with its films, and camera and scales that follow from both."""

    stage: Stage
    films: tuple[Film, ...]

    @cached_property
    def camera(self) -> Camera:
        """Camera that sees all films."""
        return framed(self.stage, self.films)

    @cached_property
    def scales(self) -> Scales:
        """Scales of reactions and residuals, common to all films."""
        return scales(self.films, self.stage.size)

    @property
    def loads(self) -> Loads | None:
        """Reactions of the first film that has any."""
        return next((film.loads for film in self.films if film.loads is not None), None)


DISC = 0.022  # radius of a joint's disc over the mechanism's size
BAR = 0.15  # length of a sliding joint's bar over the size
BALL = 0.012  # radius of a closure's mark over the size
THICK = 0.012  # radius of an arrow's head over the size
LEAST = 1e-9  # an arrow of no length would have no inverse
SLIM = 0.2  # share of the longest arrow below which an arrow gets slimmer too
SEE_THROUGH = 0.5  # opacity of bodies, in which joints and closures would be hidden


@dataclass(eq=False)
class Drawn:
    """Handles of what moves; the one thing here that changes, as viser's scene does."""

    scales: Scales
    bodies: list[Any] = field(default_factory=list)
    meshes: list[Any] = field(default_factory=list)
    pivots: list[Any] = field(default_factory=list)
    names: list[Any] = field(default_factory=list)
    ends: list[tuple[Any, Any]] = field(default_factory=list)
    gaps: Any = None
    forces: list[Any] = field(default_factory=list)
    moments: list[Any] = field(default_factory=list)
    title: Any = None

    def show(self, film: Film, k: int) -> None:
        """Move everything to moment k of a film."""
        for i, body in enumerate(self.bodies):
            body.position, body.wxyz = film.position[k, i], film.wxyz[k, i]
        for (a, b), ends in zip(self.ends, film.ends[k], strict=True):
            a.position, b.position = ends
        if self.gaps is not None:
            self.gaps.points = film.ends[k].astype(np.float32)
        if film.misfit is not None and self.scales.misfit > 0:
            colours = mapped(film.misfit[k] / self.scales.misfit)
            for pivot, colour in zip(self.pivots, colours, strict=True):
                if tuple(pivot.color) != tuple(colour):
                    pivot.color = tuple(int(part) for part in colour)
        elif film.misfit is None:
            for pivot in self.pivots:
                pivot.color = UNKNOWN
        _point(self.forces, film.loads, "force", k, self.scales.force, self.scales.length)
        _point(self.moments, film.loads, "moment", k, self.scales.moment, self.scales.length)
        if self.title is not None:
            self.title.text = f"{film.name}   {film.t[k]:.3f} s"


def draw(scene: Any, view: FilmedStage) -> Drawn:
    """Put a view into viser's scene, not yet at any moment."""
    stage, scales, camera, loads = view.stage, view.scales, view.camera, view.loads
    drawn, size = Drawn(scales), stage.size
    scene.set_up_direction(tuple(float(part) for part in stage.up))
    _light(scene, stage, camera)
    _ground(scene, stage, camera)
    for i, body in enumerate(stage.bodies):
        node = f"/bodies/{i} {_plain(body.name)}"
        drawn.bodies.append(scene.add_frame(node, show_axes=False))
        for j, shape in enumerate(body.shapes):
            colour = shape.colour or body_colour(i)
            mesh = _mesh(scene, f"{node}/{j}", shape, colour, opacity=SEE_THROUGH)
            drawn.meshes.append(mesh)
    for i, pivot in enumerate(stage.pivots):
        node = f"{drawn.bodies[pivot.body].name}/joint {i} {_plain(pivot.name)}"
        mark = _mark(pivot, size).moved(pivot.R, pivot.p)
        drawn.pivots.append(_mesh(scene, node, mark, UNKNOWN))
        drawn.names.append(
            scene.add_label(
                f"{node}/name", pivot.name, position=pivot.p, visible=False,
                font_screen_scale=0.8, anchor="bottom-left",
            )
        )  # fmt: skip
    for i, tie in enumerate(stage.ties):
        node, ball = f"/closures/{i} {_plain(tie.name)}", sphere(BALL * size)
        a, b = (
            _mesh(scene, f"{node}/{end}", ball, colour)
            for end, colour in zip("ab", ENDS, strict=True)
        )
        drawn.ends.append((a, b))
        drawn.names.append(
            scene.add_label(
                f"{node}/a/name", tie.name, visible=False, font_screen_scale=0.8,
                anchor="top-left",
            )
        )  # fmt: skip
    if stage.ties:
        drawn.gaps = scene.add_line_segments(
            "/closures/gaps", np.zeros((len(stage.ties), 2, 3), np.float32), colors=(40, 40, 40),
            thickness=0.3 * BALL * size,
        )  # fmt: skip
    if loads is not None and scales.force > 0:
        drawn.forces = _arrows(scene, "/forces", loads, ENDS, size)
    if loads is not None and scales.moment > 0:
        drawn.moments = _arrows(scene, "/moments", loads, MOMENTS, size)
    return drawn


def aim(page: Any, view: FilmedStage) -> None:
    """Set the camera with which a page opens."""
    camera, first = view.camera, page.initial_camera
    distance = float(np.linalg.norm(camera.position - camera.target))
    first.position, first.look_at, first.up = camera.position, camera.target, view.stage.up
    first.fov, first.near, first.far = float(ANGLE), 0.01 * distance, 100.0 * distance


def _plain(name: str) -> str:
    """A name in which the scene's tree sees no branch."""
    return re.sub(r"[^\w .+\-]", "_", name)[:60]


def _mesh(
    scene: Any,
    node: str,
    shape: Shape,
    colour: Colour,
    opacity: float | None = None,
    shadow: bool = True,
) -> Any:
    return scene.add_mesh_simple(
        node, shape.vertices, shape.faces, color=colour, flat_shading=shape.flat, side="double",
        opacity=opacity, cast_shadow=shadow,
    )  # fmt: skip


def _mark(pivot: Pivot, size: float) -> Shape:
    if pivot.rotational:
        return cylinder(DISC * size, 1.6 * DISC * size)
    return box((0.5 * DISC * size, 0.5 * DISC * size, BAR * size))


def _light(scene: Any, stage: Stage, camera: Camera) -> None:
    """Even light: under viser's own, colours that mean something go white."""
    scene.configure_environment_map(None)
    scene.configure_default_lights(enabled=False)
    scene.add_light_ambient("/light/all round", intensity=1.7)
    towards = camera.position - camera.target
    right = np.cross(stage.up, towards)
    over = np.linalg.norm(towards) * stage.up
    key = camera.target + 0.5 * towards + 0.9 * right + 1.2 * over
    scene.add_light_directional("/light/key", intensity=1.9, position=key, cast_shadow=True)


def _ground(scene: Any, stage: Stage, camera: Camera) -> None:
    corners = camera.box
    lowest = min(float(corner @ stage.up) for corner in corners)
    middle = camera.target + (lowest - camera.target @ stage.up - 0.02 * camera.size) * stage.up
    R = turned_to(stage.up)
    cell = float(10.0 ** np.floor(np.log10(max(camera.size, 1e-6) / 3.0)))
    width = cell * np.ceil(1.6 * camera.size / cell)
    scene.add_grid(
        "/ground", width=width, height=width, cell_size=cell, section_size=5 * cell,
        cell_color=(215, 218, 224), section_color=(185, 190, 200), fade_distance=20 * camera.size,
        position=middle, wxyz=wxyz(R),
    )  # fmt: skip


def _arrows(scene: Any, node: str, loads: Loads, colours: Any, size: float) -> list[Any]:
    radius, shape = THICK * size, arrow()
    slim = replace(shape, vertices=shape.vertices * [radius, radius, 1.0])
    return [
        _mesh(scene, f"{node}/{i} {_plain(name)}", slim, colours[int(second)], shadow=False)
        for i, (name, second) in enumerate(zip(loads.names, loads.second, strict=True))
    ]


def _point(
    arrows: list[Any], loads: Loads | None, what: str, k: int, largest: float, length: float
) -> None:
    """Arrows as long as the loads are large; slimmer where they are short, gone where unknown."""
    if loads is None:
        for each in arrows:
            each.scale = (LEAST, LEAST, LEAST)
        return
    vectors = np.nan_to_num(getattr(loads, what)[k])
    for each, vector, at in zip(arrows, vectors, loads.at[k], strict=True) if arrows else ():
        reach = length * float(np.linalg.norm(vector)) / largest
        slim = min(max(reach / (SLIM * length), LEAST), 1.0)
        each.position, each.wxyz = np.nan_to_num(at), wxyz(turned_to(vector))
        each.scale = (slim, slim, max(reach, LEAST))
