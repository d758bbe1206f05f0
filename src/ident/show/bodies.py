"""Shapes of a mechanism: its bodies, and marks of joints and closures.

Shapes are no part of the mechanism: what cannot be shown is left out with a note.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError
from ident.mechanism import Mechanism
from ident.mechanism.closures import FrameClosure
from ident.mechanism.description import align_z, joint_axis, numbers, read_urdf

Colour = tuple[int, int, int]
BODIES: tuple[Colour, ...] = (
    (98, 132, 168),
    (143, 163, 104),
    (196, 154, 108),
    (126, 111, 156),
    (92, 152, 149),
    (178, 125, 134),
)
GROUND: Colour = (150, 150, 150)
EFFECT: Colour = (214, 51, 132)  # of a named effect
ENDS: tuple[Colour, Colour] = ((200, 30, 60), (30, 80, 200))  # of a closure's a and b
UNKNOWN: Colour = (90, 90, 96)  # a joint of which no residual is known
MESHES = (".stl", ".obj", ".ply", ".dae", ".glb", ".gltf", ".off")
LARGEST = 100_000_000  # bytes of a mesh; a larger one would take long to be read
SIDES = 12  # of a circle
OPEN = 0.02  # numerics: share of edges with one face, beyond which a mesh has no inside
HULL = 150  # directions in which the outermost points of a mesh are its hull
ROD, DISC, BAR, BALL = 0.012, 0.022, 0.15, 0.012  # sizes of marks over the mechanism's size
FACES = 600  # shown: of a mesh; a finer one is decimated
DENSITY = 2700.0  # shown: [kg/m³] of the ball that stands for a payload: aluminium
SMALLEST, LARGEST_BALL = 0.02, 0.08  # shown: of the mechanism's size, radius of that ball
TURNS, STEPS, WIRE = 4, 12, 0.12  # shown: of a coil, its steps a turn, and wire over its radius


@dataclass(frozen=True, eq=False)
class Shape:
    """A closed surface that moves with a joint of the mechanism's model.

    Attributes:
        kind: `body`, `joint`, `closure` or `effect`; name: of its link, joint, closure or effect.
        joint: its number in the model, 0 the ground.
        corners: (n, 3) [m] in the joint's frame; faces: (m, 3) numbers of corners, outward.
    """

    kind: str
    name: str
    joint: int
    colour: Colour
    corners: np.ndarray
    faces: np.ndarray


def shapes_of(mechanism: Mechanism, q: np.ndarray) -> tuple[list[Shape], float, list[str]]:
    """Return the shapes of a mechanism, its size at the configuration q (nq,) [m], and notes."""
    model, names = mechanism.model, ("ground", *mechanism.bodies.links)
    colours = (GROUND, *(BODIES[i % len(BODIES)] for i in range(len(names) - 1)))
    shapes: list[Shape] = []

    def add(
        kind: str, name: str, joint: int, place: pin.SE3, cloud: np.ndarray, colour: Colour,
        faces: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        corners, faces = hull(cloud) if faces is None else (cloud, faces)
        corners = corners @ place.rotation.T + place.translation
        shapes.append(Shape(kind, name, joint, colour, corners, faces))

    drawn, notes = urdf_shapes(mechanism.urdf)
    for link, place, (cloud, faces), colour in drawn:
        joint = names.index(link) if link in names[1:] else 0
        if model.existBodyName(link):
            frame = model.frames[model.getBodyId(link)]
            joint, place = frame.parentJoint, frame.placement * place
        add("body", link, joint, place, cloud, colour or colours[joint], faces)
    points = sites(mechanism)
    size = _size(mechanism, q, [*((x.joint, x.corners) for x in shapes), *enumerate(points)])
    for joint in set(range(model.njoints)) - {shape.joint for shape in shapes}:
        for place, cloud in simple_body(model.inertias[joint], points[joint], size):
            add("body", names[joint], joint, place, cloud, colours[joint])
    disc = cylinder(DISC * size, 1.6 * DISC * size)
    bar = box(np.array([0.5 * DISC, 0.5 * DISC, BAR]) * size)
    for name, rotational, joint, place in pivots_of(mechanism):
        add("joint", name, joint, place, disc if rotational else bar, UNKNOWN)
    for closure in tied(mechanism):
        for frame, end in zip(closure.frames, ENDS, strict=True):
            add("closure", closure.name, frame.joint, frame.placement, sphere(BALL * size), end)
    return shapes, size, notes


def payload_shape(
    mechanism: Mechanism, link: str, mass: float, centre: np.ndarray, size: float
) -> Shape:
    """Return a ball of a payload's mass [kg] at its centre (3,) [m] in the frame of its joint."""
    radius = (3 * abs(mass) / (4 * np.pi * DENSITY)) ** (1 / 3)
    radius = float(np.clip(radius, SMALLEST * size, LARGEST_BALL * size))
    joint = ("ground", *mechanism.bodies.links).index(link)
    corners, faces = hull(sphere(radius))
    return Shape("effect", f"payload:{link}", joint, EFFECT, corners + centre, faces)


def coil_shape(mechanism: Mechanism, joint: str, name: str, size: float) -> Shape | None:
    """Return a coil around a joint's axis; nothing of a joint that is none of the tree's."""
    places = {title: (index, place) for title, _, index, place in pivots_of(mechanism)}
    if joint not in places:
        return None
    index, place = places[joint]
    corners, faces = coil(1.7 * DISC * size, 3.2 * DISC * size)
    return Shape(
        "effect", name, index, EFFECT, corners @ place.rotation.T + place.translation, faces
    )


# --- points (n, 3) [m] whose hull is a shape ------------------------------------------------------


def box(edges: np.ndarray) -> np.ndarray:
    """Return the corners of a box with edges (3,) [m], its middle in the origin."""
    return np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * edges / 2


def cylinder(radius: float, length: float) -> np.ndarray:
    """Return points of a cylinder along z, its middle in the origin."""
    turn = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn], axis=1)
    up = np.array([0.0, 0.0, length / 2])
    return np.concatenate([ring + up, ring - up])


def sphere(radius: float, count: int = SIDES * SIDES // 2) -> np.ndarray:
    """Return `count` points of a sphere, evenly on a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z**2)
    return radius * np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def coil(radius: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return corners and outward faces of a wire wound along z, its middle in the origin."""
    turn = np.linspace(0.0, 2 * np.pi * TURNS, TURNS * STEPS + 1)
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    middle = radius * out + np.stack([0 * turn, 0 * turn, length * (turn / turn[-1] - 0.5)], axis=1)
    up, wire = np.array([0.0, 0.0, 1.0]), WIRE * radius
    ring = np.stack([wire * out, wire * up + 0 * out, -wire * out, -wire * up + 0 * out], axis=1)
    corners = (middle[:, None] + ring).reshape(-1, 3)
    faces = []
    for k in range(len(turn) - 1):
        for i in range(4):
            a, b, c, d = 4 * k + i, 4 * k + (i + 1) % 4, 4 * k + 4 + i, 4 * k + 4 + (i + 1) % 4
            faces += [(a, c, b), (b, c, d)]
    return corners, np.array(faces)


def decimated(
    corners: np.ndarray, faces: np.ndarray, most: int = FACES
) -> tuple[np.ndarray, np.ndarray]:
    """Return a mesh of at most so many faces: corners of a cell of a grid are one, at their mean.

    The grid is the finest that leaves few enough faces (vertex clustering, Rossignac and Borrel,
    1993).
    """
    low, size = corners.min(axis=0), max(float(np.ptp(corners, axis=0).max()), 1e-12)
    for cells in (256, 128, 96, 64, 48, 36, 28, 22, 17, 13, 10, 8, 6):
        place = np.floor((corners - low) / size * cells).astype(int)
        _, number, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
        number = number.reshape(-1)
        remaining = number[faces]
        a, b, c = remaining.T
        remaining = remaining[(a != b) & (b != c) & (c != a)]
        remaining = remaining[np.unique(np.sort(remaining, axis=1), axis=0, return_index=True)[1]]
        if len(remaining) <= most:
            break
    means = np.stack([np.bincount(number, x) for x in corners.T], axis=1) / count[:, None]
    return means, remaining


def hull(cloud: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) and outward faces (m, 3) of their hull, of many only outer points."""
    if len(cloud) > HULL:
        cloud = cloud[np.unique((cloud @ sphere(1.0, HULL).T).argmax(axis=0))]
    points = coal.StdVec_Vec3s()
    points.extend(cloud)
    convex = coal.Convex.convexHull(points, True, "QJ Pp")  # joggled: flat ones too
    joggled = np.array(convex.points())
    number = ((joggled[:, None] - cloud) ** 2).sum(axis=2).argmin(axis=1)  # in the cloud
    triangles = (convex.polygons(i) for i in range(convex.num_polygons))
    faces = np.array([[triangle[i] for i in range(3)] for triangle in triangles])
    a, b, c = (joggled[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - joggled.mean(axis=0)) < 0
    faces[inward] = faces[inward][:, ::-1]
    return cloud, number[faces]


# --- marks, and bodies without a shape ------------------------------------------------------------


def tied(mechanism: Mechanism) -> list[FrameClosure]:
    """Return the closures that hold two frames together."""
    return [closure for closure in mechanism.closures if isinstance(closure, FrameClosure)]


def pivots_of(mechanism: Mechanism) -> list[tuple[str, bool, int, pin.SE3]]:
    """Return the mark of each joint: name, whether it turns, joint of the model, its place."""
    model, marks = mechanism.model, []
    tree = {joint.name for joint in mechanism.joints if joint.in_tree}
    for index in range(1, model.njoints):
        name = model.names[index]
        if name in tree:
            place = pin.SE3(align_z(joint_axis(model, index)), np.zeros(3))
            marks.append((name, mechanism.joint(name).rotational, index, place))
    for closure in tied(mechanism):
        if closure.free:
            name = closure.own_joint(closure.free[-1])
            marks.append((name, "rz" in closure.free, closure.a.joint, closure.a.placement))
    return marks


def poses_of(model: pin.Model, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (n, joints, 3, 3) and origins (n, joints, 3) [m], the ground first."""
    data = model.createData()
    R, p = np.zeros((len(q), model.njoints, 3, 3)), np.zeros((len(q), model.njoints, 3))
    for k, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for i, place in enumerate(data.oMi):
            R[k, i], p[k, i] = place.rotation, place.translation
    return R, p


def _size(mechanism: Mechanism, q: np.ndarray, points: Sequence[tuple[int, np.ndarray]]) -> float:
    """Return the diagonal [m] of the box around joints, closures, bodies and shapes at q."""
    bodies = list(enumerate(mechanism.model.inertias))[1:]
    masses = [(i, x.lever[None]) for i, x in bodies if x.mass > 0]
    (R,), (origin,) = poses_of(mechanism.model, q[None])
    cloud = np.concatenate([x @ R[i].T + origin[i] for i, x in (*points, *masses)])
    diagonal = float(np.linalg.norm(np.ptp(cloud, axis=0)))
    return diagonal if diagonal > 1e-6 else 1.0


def sites(mechanism: Mechanism) -> list[np.ndarray]:
    """Return points (k, 3) [m] on each body, the ground first: joints and closures' frames."""
    model = mechanism.model
    points: list[list[np.ndarray]] = [[] for _ in range(model.njoints)]
    for index in range(1, model.njoints):
        points[model.parents[index]].append(np.array(model.jointPlacements[index].translation))
        points[index].append(np.zeros(3))
    for closure in mechanism.closures:
        for frame in closure.frames:
            points[frame.joint].append(np.array(frame.placement.translation))
    return [np.array(of_body).reshape(-1, 3) for of_body in points]


def simple_body(
    inertia: pin.Inertia, points: np.ndarray, size: float
) -> list[tuple[pin.SE3, np.ndarray]]:
    """Return places and points of rods from a joint to its body's other points (k, 3) [m] and to
    the centre of mass, and of a ball there.
    """
    centres, shapes = [inertia.lever] if inertia.mass > 0 and len(points) else [], []
    for point in [*points[1:], *centres]:
        rod = point - points[0]
        if (length := float(np.linalg.norm(rod))) > 1e-6 * size:
            place = pin.SE3(align_z(rod), (points[0] + point) / 2)
            shapes.append((place, cylinder(ROD * size, length)))
    ball = sphere(2 * BALL * size)
    return shapes + [(pin.SE3(np.eye(3), centre), ball) for centre in centres]


# --- shapes of a URDF -----------------------------------------------------------------------------

SIZES: dict[str, tuple[Callable[..., np.ndarray], dict[str, int]]] = {
    "box": (box, {"size": 3}),
    "cylinder": (cylinder, {"radius": 1, "length": 1}),
    "sphere": (sphere, {"radius": 1}),
}
Surface = tuple[np.ndarray, np.ndarray | None]  # corners, and faces; None: those of their hull
Drawn = tuple[str, pin.SE3, Surface, Colour | None]  # link, place in it, surface, its own colour


def urdf_shapes(urdf: Path) -> tuple[list[Drawn], list[str]]:
    """Return the shapes of all links, and notes of those left out."""
    try:
        robot = read_urdf(urdf)
    except MechanismError:
        return [], [f"{urdf.name}: is no URDF, so simple bodies are shown"]
    colours = _colours(robot.findall("material"), urdf.name)
    shapes: list[Drawn] = []
    left_out: list[str] = []
    for link in robot.findall("link"):
        name = link.get("name")
        for visual in link.findall("visual"):
            materials = visual.findall("material")
            known = [
                *_colours(materials, urdf.name).values(),
                *(colours.get(material.get("name")) for material in materials),
            ]
            try:
                shapes.append((name, *_shape(visual, urdf), next(filter(None, known), None)))
            except MechanismError as error:
                left_out.append(f"link '{name}': {error}")
    if len(left_out) < 2:
        return shapes, [
            f"a shape of {material.replace(':', ' is left out:', 1)}" for material in left_out
        ]
    note = f"{len(left_out)} shapes are left out, one of {left_out[0]}"
    return shapes, [f"{note}; --mesh-path DIR says where packages are"]


def _shape(visual: etree._Element, urdf: Path) -> tuple[pin.SE3, Surface]:
    geometry, origin, where = visual.find("geometry"), visual.find("origin"), urdf.name
    place = pin.SE3.Identity()
    if origin is not None:
        rpy, xyz = (numbers(origin, name, "0 0 0", 3, where) for name in ("rpy", "xyz"))
        place = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))
    for element in [] if geometry is None else geometry:
        if element.tag in SIZES:
            points, sizes = SIZES[element.tag]
            values = {key: numbers(element, key, "", n, where) for key, n in sizes.items()}
            for key, sizes_of in values.items():
                if min(sizes_of) <= 0:
                    raise MechanismError(f"{where}:{element.sourceline}: {key} must be above 0")
            return place, (points(*map(np.squeeze, values.values())), None)
        if element.tag == "mesh":
            scale = np.array(numbers(element, "scale", "1 1 1", 3, where))
            path = _mesh_file(element.get("filename") or "", urdf)
            try:
                return place, _mesh(path, scale)
            except ValueError:
                raise MechanismError(f"mesh '{path.name}' cannot be read") from None
    raise MechanismError(f"{where}:{visual.sourceline}: no box, cylinder, sphere or mesh")


def _mesh(path: Path, scale: np.ndarray) -> Surface:
    """Return the surface of a mesh, decimated; one without faces, or open, is drawn as its hull."""
    mesh = coal.MeshLoader().load(str(path), scale)
    corners = np.array(mesh.vertices())
    triangles = [mesh.tri_indices(i) for i in range(mesh.num_tris)]
    faces = np.array([(t[0], t[1], t[2]) for t in triangles], dtype=int).reshape(-1, 3)
    if np.prod(scale) < 0:  # mirrored: outward is inward
        faces = faces[:, ::-1]
    _, number = np.unique(corners.round(9), axis=0, return_inverse=True)  # of an STL, each its own
    edges = np.sort(number.reshape(-1)[faces][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    if not len(edges) or (np.unique(edges, axis=0, return_counts=True)[1] < 2).mean() > OPEN:
        return corners, None
    return decimated(corners, faces)


def _mesh_file(name: str, urdf: Path) -> Path:
    """Return the file that a URDF calls `name`, by the ways in use; nothing is fetched."""
    scheme, is_url, rest = name.partition("://")
    package, _, inner = unquote(rest).partition("/")
    above, given = urdf.resolve().parents, list[Path]()
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        listed = os.environ.get(variable, "").split(os.pathsep)
        given += [Path(place) / inside for place in listed if place]
    files = [] if is_url else [urdf.parent / name]
    if scheme == "file":
        files = [Path("/" + inner if package == "localhost" else unquote(rest))]
    elif scheme in ("package", "model"):
        places = [place for folder in above for place in (folder, folder / "share")]
        files = [place / package / inner for place in (*places, *given)]
        files += [place / inner for place in given]
        files += [place / inner for place in above if place.name == package]
        files += [place / inner for place in above[:3]]  # a package that was renamed
    try:
        path = next((path for path in files if path.is_file()), None)
    except (OSError, ValueError):  # a name too long, or with a zero in it
        path = None
    if path is None:
        raise MechanismError(f"there is no mesh {name!r} on this machine")
    if path.suffix.lower() not in MESHES:
        raise MechanismError(f"mesh {name!r}: valid: {', '.join(MESHES)}")
    if path.stat().st_size > LARGEST:
        raise MechanismError(f"mesh {name!r} has more than {LARGEST // 1_000_000} MB")
    return path


def _colours(materials: list[etree._Element], where: str) -> dict[str, Colour]:
    """Return colours by material's name, of the materials that state one."""
    colours: dict[str, Colour] = {}
    for material in materials:
        for colour in material.findall("color"):
            with suppress(MechanismError):
                shares = numbers(colour, "rgba", "", 4, where)[:3]
                r, g, b = (round(255 * min(max(share, 0.0), 1.0)) for share in shares)
                colours[material.get("name") or ""] = (r, g, b)
    return colours
