"""A machine as a URDF, with `<dynamics>`; and as one with Drake's own elements.

URDF says two numbers of a joint, damping and friction; simulators read what they please of them.
Drake adds rotor inertia and actuators (`drake:` elements), and closes loops by constraints of
frames; it has no dry friction of joints.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ident.errors import IdentError, MechanismError, near
from ident.export.edit import Element, XmlEdit
from ident.export.laws import Translation, Vocabulary
from ident.export.machine import Body, Machine
from ident.export.target import Job, Product, Target, translated
from ident.files import regular
from ident.fit.files import link_inertials
from ident.mechanism.closures import FrameClosure, LinearClosure
from ident.mechanism.description import read_description, words
from ident.mechanism.parameters import COUNT

NAMESPACE = "http://drake.mit.edu"
URDF_WORDS = Vocabulary(
    {"viscous": "dynamics damping", "coulomb": "dynamics friction", "payload": "inertial",
     "geometry": "origin"},
    {"linear": "mimic"},
)  # fmt: skip
DRAKE_WORDS = Vocabulary(
    {"viscous": "dynamics damping", "rotor_inertia": "drake:rotor_inertia", "payload": "inertial",
     "geometry": "origin", "servo": "drake:controller_gains", "gravity_tilt": "gravity_vector"},
    {"linear": "mimic", "point": "drake:ball_constraint", "fixed": "drake:ball_constraint, two"},
)  # fmt: skip
TERMS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def write_urdf(job: Job) -> Product:
    """Return the mechanism's own URDF, or the user's, with the machine's numbers."""
    return _write(job, URDF_WORDS, drake=False)


def write_drake(job: Job) -> Product:
    """Return a URDF with Drake's elements."""
    return _write(job, DRAKE_WORDS, drake=True)


def _write(job: Job, vocabulary: Vocabulary, *, drake: bool) -> Product:
    translation = translated(job, vocabulary)
    machine = job.machine
    source = machine.mechanism.urdf if job.like is None else job.like
    data = regular(source).read_bytes()
    if job.like is None and source.suffix.lower() != ".urdf":
        data = read_description(source).urdf
    edit = XmlEdit(data, str(source))
    # those of transmissions have the same names
    joints = {x.attributes.get("name", ""): x for x in edit.root.children if x.tag == "joint"}
    missing = [name for name in machine.by_joint if name not in joints]
    if missing:
        pairs = ", ".join(f"{name} → {near(name, joints) or '?'}" for name in missing)
        raise MechanismError(
            f"--like {source}: has no joint {', '.join(missing)}; nearest: {pairs}; rename them, "
            "or give another --like"
        )
    if drake and "xmlns:drake" not in edit.root.attributes:
        edit.set(edit.root, "xmlns:drake", NAMESPACE)
    for name, laws in translation.laws.items():
        element = joints[name]
        dynamics = element.find("dynamics")
        wanted = {"damping": laws.viscous, "friction": laws.coulomb}
        if dynamics is None and any(wanted.values()):
            edit.insert(
                element, "dynamics", {k: words([x]) for k, x in wanted.items() if x}, last=True
            )
        elif dynamics is not None:
            for key, kind in (("damping", "viscous"), ("friction", "coulomb")):
                if wanted[key] or machine.speaks_of(kind, name):
                    edit.set(dynamics, key, words([wanted[key]]))
        _place(edit, element, machine, name)
    own_file = source.resolve() == machine.mechanism.urdf.resolve()
    bodies = _inertials(machine, own_file)
    links = {x.attributes.get("name", ""): x for x in edit.root.children if x.tag == "link"}
    for link, pi in bodies.items():
        if link in links and pi is not None:
            _inertia(edit, links[link], Body.of(pi))
        elif link in links and (inertial := links[link].find("inertial")) is not None:
            _empty(edit, inertial)
    _mimics(edit, machine, joints)
    notes = _drake(edit, machine, translation) if drake else []
    return Product({job.out.name: edit.result()}, translation, tuple(notes))


def _mimics(edit: XmlEdit, machine: Machine, joints: Mapping[str, Element]) -> None:
    """Say closures of two joints, q₁ = multiplier q₂ + offset, that the file does not say yet."""
    for closure in machine.drawing.closures:
        if not isinstance(closure, LinearClosure):
            continue
        if len(closure.joints) != 2:
            raise MechanismError(
                f"closure '{closure.name}' ties {len(closure.joints)} joints: <mimic> ties two; "
                "export to mjcf or c"
            )
        follower, leader = closure.joints
        if joints[follower].find("mimic") is not None:
            continue
        first, second = closure.ratios
        edit.insert(joints[follower], "mimic", {
            "joint": leader, "multiplier": words([-second / first]),
            "offset": words([closure.offset / first]),
        }, last=True)  # fmt: skip


def _inertials(machine: Machine, own_file: bool) -> Mapping[str, np.ndarray | None]:
    """Return by link what its `<inertial>` says; of the mechanism's own file what has changed."""
    pi = np.concatenate([machine.total(link) for link in machine.links])
    prior = machine.mechanism.prior.reshape(-1, COUNT)
    changed = [
        link.name
        for link, item, new in zip(machine.links, prior, pi.reshape(-1, COUNT), strict=True)
        if not own_file or np.abs(item - new).max() > 1e-12 * max(np.abs(item).max(), 1e-300)
    ]
    return link_inertials(machine.mechanism, pi, changed)


def _place(edit: XmlEdit, element: Element, machine: Machine, name: str) -> None:
    """Move a joint's origin where a length was found to be another."""
    link = machine.by_joint[name]
    model = machine.mechanism.model
    given = model.jointPlacements[model.getJointId(name)]
    by = link.placement.translation - given.translation
    if not np.any(by):
        return
    parent, origin = element.find("parent"), element.find("origin")
    above = "" if parent is None else parent.attributes.get("link", "")
    if origin is None or (link.parent >= 0 and machine.links[link.parent].name != above):
        raise IdentError(
            f"joint '{name}': its place was found to be another, and a link that is fixed in "
            "between cannot be moved here; export to mjcf"
        )
    edit.set(origin, "xyz", words(_numbers(origin, "xyz", 3) + by))


def _inertia(edit: XmlEdit, link: Element, body: Body) -> None:
    full_tensor = body.inertia
    tensor = dict(
        zip(
            TERMS,
            (
                full_tensor[0, 0],
                full_tensor[0, 1],
                full_tensor[0, 2],
                full_tensor[1, 1],
                full_tensor[1, 2],
                full_tensor[2, 2],
            ),
            strict=True,
        )
    )
    inertial = link.find("inertial")
    if inertial is None:
        if not body.none:
            edit.insert_text(
                link,
                f'<inertial><origin xyz="{words(body.centre)}"/>'
                f'<mass value="{words([body.mass])}"/><inertia '
                + " ".join(f'{key}="{words([x])}"' for key, x in tensor.items()) + "/></inertial>",
            )  # fmt: skip
        return
    origin, mass, inertia = (inertial.find(tag) for tag in ("origin", "mass", "inertia"))
    turned = pin.rpy.rpyToMatrix(*_numbers(origin, "rpy", 3))
    present = np.zeros((3, 3))
    for key in TERMS:
        i, j = "xyz".index(key[1]), "xyz".index(key[2])
        present[i, j] = present[j, i] = _numbers(inertia, key, 1)[0]
    present = turned @ present @ turned.T
    scale = max(float(np.abs(full_tensor).max()), 1e-300)
    if np.abs(present - full_tensor).max() > 1e-9 * scale and inertia is not None:
        for key, x in tensor.items():
            edit.set(inertia, key, words([x]))
        if origin is not None and np.any(_numbers(origin, "rpy", 3)):
            edit.set(origin, "rpy", "0 0 0")
    if mass is not None and abs(_numbers(mass, "value", 1)[0] - body.mass) > 1e-9 * body.mass:
        edit.set(mass, "value", words([body.mass]))
    if np.abs(_numbers(origin, "xyz", 3) - body.centre).max() > 1e-12:
        if origin is None:
            edit.insert(inertial, "origin", {"xyz": words(body.centre)})
        else:
            edit.set(origin, "xyz", words(body.centre))


def _empty(edit: XmlEdit, inertial: Element) -> None:
    for tag, keys in (("mass", ("value",)), ("inertia", TERMS)):
        element = inertial.find(tag)
        if element is not None:
            for key in keys:
                edit.set(element, key, "0")


def _numbers(element: Element | None, key: str, count: int) -> np.ndarray:
    text = "" if element is None else element.attributes.get(key, "")
    values = [float(x) for x in text.split()]
    return np.array(values if len(values) == count else [0.0] * count)


def _drake(edit: XmlEdit, machine: Machine, translation: Translation) -> list[str]:
    """Add actuators with rotor inertia and gains, and constraints for loops."""
    root = edit.root
    transmissions = {
        joint.attributes.get("name", ""): transmission.find("actuator")
        for transmission in root.iter("transmission")
        for joint in transmission.children
        if joint.tag == "joint"
    }
    for link in machine.links:
        name = link.joint.name
        if name not in machine.mechanism.driven:
            continue
        laws, servo = translation.laws[name], machine.values.get("servo", {}).get((name,))
        inside = [
            f'<drake:rotor_inertia value="{words([laws.armature])}"/><drake:gear_ratio value="1"/>'
        ] if laws.armature else []  # fmt: skip
        if servo:
            inside.append(
                f'<drake:controller_gains p="{words([servo["kp"]])}" d="{words([servo["kd"]])}"/>'
            )
        if name in transmissions:
            actuator = transmissions[name]
            if actuator is not None and inside:
                for text in inside:
                    edit.insert_text(actuator, text, last=True)
            continue
        edit.insert_text(
            root,
            f'<transmission type="SimpleTransmission"><joint name="{name}"/>'
            f'<actuator name="{name}">{"".join(inside)}</actuator></transmission>',
            last=True,
        )
    for closure in machine.drawing.closures:
        if isinstance(closure, FrameClosure):
            _drake_ball(edit, closure)
    notes = ["Drake has no dry friction of joints: it would be a force element of one's own"]
    loops = [c.name for c in machine.drawing.closures if isinstance(c, FrameClosure)]
    if loops:
        notes.append(f"loops ({', '.join(loops)}) need Drake's discrete SAP solver")
    if np.abs(machine.gravity - [0, 0, -9.81]).max() > 1e-9:
        vector = ", ".join(f"{x:.6g}" for x in machine.gravity)
        notes.append(f"plant.mutable_gravity_field().set_gravity_vector([{vector}])")
    return notes


def _drake_ball(edit: XmlEdit, closure: FrameClosure) -> None:
    shifts = [np.zeros(3)]
    if closure.kind == "fixed":
        shifts += [np.array([0.1, 0, 0]), np.array([0, 0.1, 0])]
    for shift in shifts:
        ends = "".join(
            f'<drake:ball_constraint_body_{name} name="{frame.link}"/>'
            f'<drake:ball_constraint_p_{name}P value="'
            f'{words(frame.placement.act(shift))}"/>'
            for name, frame in zip("AB", closure.frames, strict=True)
        )
        edit.insert_text(
            edit.root, f"<drake:ball_constraint>{ends}</drake:ball_constraint>", last=True
        )


URDF = Target("urdf", "a URDF", ".urdf", URDF_WORDS, write_urdf, (".urdf", ".xml"))
DRAKE = Target("drake", "a URDF for Drake", ".urdf", DRAKE_WORDS, write_drake, (".urdf",))
