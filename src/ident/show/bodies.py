"""Shapes of bodies: meshes, primitives and colours of a URDF, or rods and the inertia's ellipsoid.

Shapes are no part of the mechanism: what cannot be shown is left out with a note.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import ParseResult, unquote, urlparse

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError
from ident.mechanism import Mechanism
from ident.mechanism.description import read_urdf
from ident.mechanism.urdf import numbers
from ident.show.view3d import Shape, box, capsule, cylinder, ellipsoid, sphere

MESHES = (".stl", ".obj", ".ply", ".dae", ".glb", ".gltf", ".off")
LARGEST = 100_000_000  # bytes of a mesh
FACES = 200_000  # of a mesh; more would stutter in a browser
ROD = 0.012  # radius over the mechanism's size
WIDEST, THINNEST = 0.05, 0.015  # semi-axes of an inertia's ellipsoid over the size


def urdf_shapes(urdf: Path) -> tuple[dict[str, list[Shape]], list[str]]:
    """Return shapes in their link's axes, by link, and notes of those left out."""
    try:
        robot = read_urdf(urdf)
    except MechanismError:
        return {}, [f"{urdf.name}: is no URDF, so simple bodies are shown"]
    colours = _colours(robot.findall("material"))
    shapes: dict[str, list[Shape]] = {}
    notes: list[str] = []
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            try:
                shape = _shape(visual, urdf)
                shape = shape.moved(*_origin(visual, urdf.name))
            except MechanismError as error:
                notes.append(f"link '{link.get('name')}': a shape is left out: {error}")
                continue
            own = _colours(visual.findall("material"))
            names = [material.get("name") for material in visual.findall("material")]
            colour = next(iter(own.values()), None) or next(
                (colours[name] for name in names if name in colours), None
            )
            shape = shape if colour is None else replace(shape, colour=colour)
            shapes.setdefault(link.get("name"), []).append(shape)
    return shapes, notes


def _origin(visual: etree._Element, where: str) -> tuple[np.ndarray, np.ndarray]:
    origin = visual.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    rpy = numbers(origin, "rpy", "0 0 0", 3, where)
    return pin.rpy.rpyToMatrix(*rpy), np.array(numbers(origin, "xyz", "0 0 0", 3, where))


def _shape(visual: etree._Element, urdf: Path) -> Shape:
    geometry = visual.find("geometry")
    for element in [] if geometry is None else geometry:
        if element.tag == "box":
            return box(_positive(element, "size", 3, urdf.name))
        if element.tag == "cylinder":
            radius = _positive(element, "radius", 1, urdf.name)[0]
            return cylinder(radius, _positive(element, "length", 1, urdf.name)[0])
        if element.tag == "sphere":
            return sphere(_positive(element, "radius", 1, urdf.name)[0])
        if element.tag == "mesh":
            scale = numbers(element, "scale", "1 1 1", 3, urdf.name)
            return _mesh(element.get("filename") or "", np.array(scale), urdf)
    raise MechanismError(f"{urdf.name}:{visual.sourceline}: no box, cylinder, sphere or mesh")


def _positive(element: etree._Element, key: str, count: int, where: str) -> list[float]:
    values = numbers(element, key, "", count, where)
    if min(values) <= 0:
        raise MechanismError(f"{where}:{element.sourceline}: {key} must be above 0")
    return values


def _mesh(name: str, scale: np.ndarray, urdf: Path) -> Shape:
    import trimesh

    path = _mesh_file(name, urdf)
    if path is None:
        raise MechanismError(f"there is no mesh {name!r} on this machine")
    if path.suffix.lower() not in MESHES:
        raise MechanismError(f"mesh {name!r}: valid: {', '.join(MESHES)}")
    if path.stat().st_size > LARGEST:
        raise MechanismError(f"mesh {name!r} has more than {LARGEST // 1_000_000} MB")
    try:
        mesh: Any = trimesh.load(path, force="mesh", process=True)
        vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, np.uint32)
    except Exception as error:  # readers of many formats, each with its own errors
        what = " ".join(str(error).split())[:120] or type(error).__name__
        raise MechanismError(f"mesh {name!r} cannot be read: {what}") from None
    if not len(faces) or not np.isfinite(vertices).all():
        raise MechanismError(f"mesh {name!r} has no triangles")
    if len(faces) > FACES:
        raise MechanismError(f"mesh {name!r} has {len(faces)} triangles; at most {FACES} are shown")
    return Shape(vertices * scale, faces)


def _mesh_file(name: str, urdf: Path) -> Path | None:
    """The file that a URDF calls `name`, by the ways in use; nothing is fetched."""
    try:
        url = urlparse(name)
        return next((path for path in _candidates(name, url, urdf) if path.is_file()), None)
    except (OSError, ValueError):  # a name too long, or with a zero in it
        return None


def _candidates(name: str, url: ParseResult, urdf: Path) -> list[Path]:
    above = list(urdf.resolve().parents)
    if url.scheme in ("http", "https"):
        return []
    if url.scheme == "file":
        return [Path(unquote(url.path))]
    if url.scheme not in ("package", "model"):
        return [urdf.parent / name]
    package, path = unquote(url.netloc), unquote(url.path).strip("/")
    places = [place for folder in above for place in (folder, folder / "share")]
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        listed = os.environ.get(variable, "").split(os.pathsep)
        places += [Path(place) / inside for place in listed if place]
    files = [place / package / path for place in places]
    files += [folder / path for folder in above if folder.name == package]
    return files + [folder / path for folder in above[:3]]  # a package that was renamed


def _colours(materials: list[etree._Element]) -> Mapping[str, tuple[int, int, int]]:
    """Colours by material's name, of the materials that state one."""
    colours = {}
    for material in materials:
        colour = material.find("color")
        words = [] if colour is None else (colour.get("rgba") or "").split()
        try:
            rgb = [float(word) for word in words[:3]]
        except ValueError:
            continue
        if len(rgb) == 3 and all(math.isfinite(part) for part in rgb):
            r, g, b = (round(255 * min(max(part, 0.0), 1.0)) for part in rgb)
            colours[material.get("name") or ""] = (r, g, b)
    return colours


def sites(mechanism: Mechanism) -> list[list[np.ndarray]]:
    """Return points (3,) [m] on each body, the ground first: joints and closures' frames."""
    model = mechanism.model
    points: list[list[np.ndarray]] = [[] for _ in range(model.njoints)]
    for index in range(1, model.njoints):
        points[model.parents[index]].append(np.array(model.jointPlacements[index].translation))
        points[index].append(np.zeros(3))
    for closure in mechanism.closures:
        for frame in closure.frames:
            points[frame.joint].append(np.array(frame.placement.translation))
    return points


def simple_body(mechanism: Mechanism, index: int, size: float) -> list[Shape]:
    """Return rods from the body's joint to its other points, and the ellipsoid of its inertia.

    Args:
        mechanism: the mechanism.
        index: of the body, from 1 on.
        size: of the mechanism [m].
    """
    origin, *others = sites(mechanism)[index] or [np.zeros(3)]
    shapes = [
        capsule(origin, other, ROD * size)
        for other in others
        if np.linalg.norm(other - origin) > 1e-6 * size
    ]
    inertia = mechanism.model.inertias[index]
    return [*shapes, *([_inertia_ellipsoid(inertia, size)] if inertia.mass > 0 else [])]


def _inertia_ellipsoid(inertia: pin.Inertia, size: float) -> Shape:
    """Of even density with the same inertia, made smaller where it would hide the mechanism."""
    # I_x = m (b² + c²) / 5, so a² = 5 (I_y + I_z − I_x) / (2 m)
    moments, axes = np.linalg.eigh(inertia.inertia)
    squares = 2.5 * (moments.sum() - 2 * moments) / inertia.mass
    semi = np.sqrt(np.maximum(squares, 0.0))
    semi = np.maximum(semi * min(1.0, WIDEST * size / max(semi.max(), 1e-300)), THINNEST * size)
    if np.linalg.det(axes) < 0:
        axes = axes * [1, 1, -1]
    return ellipsoid(semi).moved(axes, inertia.lever)
