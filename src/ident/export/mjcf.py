"""A machine as a MuJoCo model.

    M q̇' + h + armature + damping + stiffness + frictionloss + Jᵀf = actuators

Several joints of one MuJoCo body stand for joints with massless links between them, which MuJoCo
refuses. A closure is an equality between sites, so that it holds whatever the model's zero is; with
a time constant of two steps it is as stiff as MuJoCo allows. Dry friction is MuJoCo's soft one, of
the same time constant; `ident.export.fitted` then moves its numbers so that the motion is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.errors import MechanismError
from ident.export.laws import JointLaws, Translation, Vocabulary
from ident.export.machine import Body, Link, Machine
from ident.mechanism.closures import Frame, FrameClosure, LinearClosure
from ident.mechanism.description import words

STEP = 1e-3  # range: [s] of a file, if none is asked for
STIFF = "0.9999 0.9999 0.001 0.5 2"  # range: solimp of constraints that give as little as can be
SIZE = 0.015  # shown: [m] radius of the capsules that stand for links
EFFECTS = {
    "viscous": "damping", "coulomb": "frictionloss", "rotor_inertia": "armature",
    "drag": "damping, its second number", "spring": "stiffness and springref",
    "cable": "stiffness, three numbers", "torque_offset": "biasprm of the actuator",
    "torque_gain": "gainprm of the actuator", "encoder_offset": "ref", "payload": "a body",
    "coupling": "a fixed tendon", "gravity_tilt": "gravity", "geometry": "pos",
    "servo": "a position actuator", "motor_current": "an actuator, in A",
    "motor_voltage": "an actuator, in V", "command_delay": "delay of the actuators",
}  # fmt: skip
CLOSURES = {
    "point": "connect", "fixed": "weld", "revolute": "two connects on the axis",
    "distance": "a tendon of constant length", "linear": "joint or tendon equality",
}  # fmt: skip
WORDS = Vocabulary(EFFECTS, CLOSURES, degree=3)
suffix = ".xml"


@dataclass(frozen=True)
class Numbers:
    """What the file says beside the machine.

    Attributes:
        step: of its integrator [s].
        soft: time constant [s] of dry friction; None: MuJoCo's default softness.
        loops: time constant [s] of equalities.
    """

    step: float = STEP
    soft: float | None = None
    loops: float | None = None

    @property
    def friction(self) -> float | None:
        """Time constant of dry friction."""
        return self.soft

    @property
    def closure(self) -> float:
        """Time constant of closures."""
        return self.loops or 2 * self.step


def write_mjcf(translation: Translation, numbers: Numbers) -> bytes:
    """Return the text of a MuJoCo model."""
    return _Writer(translation, numbers).text()


class _Writer:
    def __init__(self, translation: Translation, numbers: Numbers) -> None:
        self.translation, self.numbers = translation, numbers
        self.machine: Machine = translation.machine
        self.sites: dict[int, list[tuple[str, pin.SE3]]] = {}
        self.root = etree.Element("mujoco", model=self.machine.name)

    def text(self) -> bytes:
        machine, step = self.machine, self.numbers.step
        etree.SubElement(self.root, "compiler", angle="radian", autolimits="true")
        etree.SubElement(
            self.root, "option", timestep=words([step]), integrator="implicitfast",
            gravity=words(machine.gravity),
        )  # fmt: skip
        tendon, equality = etree.Element("tendon"), etree.Element("equality")
        self._closures(tendon, equality)
        self._couplings(tendon)
        world = etree.SubElement(self.root, "worldbody")
        for name, placement in self.sites.get(-1, ()):
            self._site(world, name, placement)
        self._children(world, -1, pin.SE3.Identity(), [])
        for element in (tendon, equality):
            if len(element):
                self.root.append(element)
        self._actuators()
        keys = etree.SubElement(self.root, "keyframe")
        start = [machine.start[link.joint.index] - link.offset for link in self._order]
        etree.SubElement(keys, "key", name="start", qpos=words(start))
        etree.indent(self.root)
        text: bytes = etree.tostring(self.root, encoding="utf-8")
        return text + b"\n"

    # --- tree -----------------------------------------------------------------------------------

    @property
    def _order(self) -> list[Link]:
        """Links in the order of the file, which is that of qpos."""
        links = self.machine.links
        result: list[Link] = []

        def visit(parent: int) -> None:
            for i, link in enumerate(links):
                if link.parent == parent:
                    result.append(link)
                    visit(i)

        visit(-1)
        return result

    def _children(
        self, element: etree._Element, parent: int, before: pin.SE3,
        pending: list[tuple[Link, pin.SE3]],
    ) -> None:  # fmt: skip
        """Append the bodies below a link; `pending` joints of massless links are theirs as well,
        with their places in the frame in which `before` is that of the parent.
        """
        children = [i for i, link in enumerate(self.machine.links) if link.parent == parent]
        for i in children:
            link = self.machine.links[i]
            at = before * link.placement
            joints = [*pending, (link, at)]
            if Body.of(self.machine.total(link)).none:
                below = [j for j, other in enumerate(self.machine.links) if other.parent == i]
                if len(below) != 1 or i in self.sites:
                    raise MechanismError(
                        f"link '{link.name}' has no mass and {len(below)} links below it: MuJoCo "
                        f"wants a mass of every moving body; give it one: --set {link.name}.m=0.01 "
                        f"--set {link.name}.Ixx=1e-5 (and Iyy, Izz)"
                    )
                self._children(element, i, at, joints)
                continue
            self._body(element, i, at, joints)

    def _body(
        self, element: etree._Element, i: int, at: pin.SE3, joints: list[tuple[Link, pin.SE3]]
    ) -> None:
        machine, link = self.machine, self.machine.links[i]
        body = etree.SubElement(element, "body", name=link.name, **_pose(at))
        for item, place in joints:
            self._joint(body, item, at.inverse() * place)
        separate = machine.separate_payload(link)
        inertia = Body.of(link.pi if separate else machine.total(link))
        _inertial(body, inertia)
        if separate:
            payload = machine.payloads(link.name)
            assert payload is not None
            load = etree.SubElement(body, "body", name=f"{link.name}_payload")
            _inertial(load, Body.of(payload))
        for name, placement in self.sites.get(i, ()):
            self._site(body, name, placement)
        shown = [o.placement.translation for o in machine.links if o.parent == i]
        for end in shown or [inertia.centre]:
            if np.linalg.norm(end) > SIZE:
                etree.SubElement(
                    body, "geom", type="capsule", size=words([SIZE]), contype="0", conaffinity="0",
                    fromto=words([0, 0, 0, *end]), mass="0", group="1",
                )  # fmt: skip
        self._children(body, i, pin.SE3.Identity(), [])

    def _joint(self, body: etree._Element, link: Link, place: pin.SE3) -> None:
        joint, laws = link.joint, self.translation.laws[link.joint.name]
        attributes = {
            "name": joint.name,
            "type": "hinge" if joint.rotational else "slide",
            "axis": words(place.rotation @ link.axis),
        }
        if np.abs(place.translation).max() > 1e-15:
            attributes["pos"] = words(place.translation)
        if link.offset:
            attributes["ref"] = words([-link.offset])
        if np.isfinite([joint.lower, joint.upper]).all():
            ends = np.array([joint.lower, joint.upper]) - link.offset
            attributes["range"] = words(ends)
        attributes |= joint_attributes(laws, link.offset)
        if laws.coulomb and self.numbers.friction:
            attributes["solreffriction"] = words([self.numbers.friction, 1])
            attributes["solimpfriction"] = STIFF
        etree.SubElement(body, "joint", attributes)

    @staticmethod
    def _site(body: etree._Element, name: str, placement: pin.SE3) -> None:
        etree.SubElement(body, "site", name=name, size="0.005", **_pose(placement))

    # --- loops ----------------------------------------------------------------------------------

    def _closures(self, tendon: etree._Element, equality: etree._Element) -> None:
        solver = {"solref": words([self.numbers.closure, 1]), "solimp": STIFF}
        for closure in self.machine.drawing.closures:
            if closure.kind not in CLOSURES:
                raise MechanismError(
                    f"closure '{closure.name}' of kind {closure.kind}: MuJoCo has no such "
                    f"equality; it has those of {', '.join(CLOSURES)}"
                )
            if isinstance(closure, LinearClosure):
                self._linear(closure, tendon, equality, solver)
            elif isinstance(closure, FrameClosure):
                self._frames(closure, tendon, equality, solver)

    def _linear(
        self, closure: LinearClosure, tendon: etree._Element, equality: etree._Element,
        solver: dict[str, str],
    ) -> None:  # fmt: skip
        """Write Σ r q = offset, in the file's coordinates q − δ: q₁ = (offset' − r₂ q₂)/r₁."""
        links = [self.machine.by_joint[name] for name in closure.joints]
        offset = closure.offset - sum(
            r * link.offset for r, link in zip(closure.ratios, links, strict=True)
        )
        if len(links) == 2:
            first, second = closure.ratios
            # MuJoCo: (q1 − ref1) = c0 + c1 (q2 − ref2), ref = −δ, and so of true coordinates
            c0, c1 = closure.offset / first, -second / first
            etree.SubElement(
                equality, "joint", name=closure.name, joint1=closure.joints[0],
                joint2=closure.joints[1], polycoef=words([c0, c1, 0, 0, 0]), **solver,
            )  # fmt: skip
            return
        fixed = etree.SubElement(tendon, "fixed", name=closure.name)
        for name, ratio in zip(closure.joints, closure.ratios, strict=True):
            etree.SubElement(fixed, "joint", joint=name, coef=words([ratio]))
        # of a tendon MuJoCo keeps length − length at qpos0, where qpos = ref = −δ
        zero = sum(-r * link.offset for r, link in zip(closure.ratios, links, strict=True))
        etree.SubElement(
            equality, "tendon", name=f"{closure.name}_length", tendon1=closure.name,
            polycoef=words([offset - zero, 0, 0, 0, 0]), **solver,
        )  # fmt: skip

    def _frames(
        self, closure: FrameClosure, tendon: etree._Element, equality: etree._Element,
        solver: dict[str, str],
    ) -> None:  # fmt: skip
        a, b = closure.frames
        kind = closure.kind
        pairs = [(a.placement, b.placement, "")]
        if kind == "point" and len(closure.position) < 3:
            pairs = [(a.placement, self._matched(closure, a, b), "")]
        if kind == "revolute":  # a second point on the axis
            along = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
            pairs.append((a.placement * along, b.placement * along, "_axis"))
        for at_a, at_b, more in pairs:
            names = [f"{closure.name}{more}_{end}" for end in "ab"]
            for frame, name, place in ((a, names[0], at_a), (b, names[1], at_b)):
                self.sites.setdefault(frame.joint - 1, []).append((name, place))
            ends = {"site1": names[0], "site2": names[1]}
            if kind == "distance":
                self._distance(closure, names, tendon, equality, solver)
            else:
                element = "weld" if kind == "fixed" else "connect"
                etree.SubElement(equality, element, name=f"{closure.name}{more}", **ends, **solver)

    def _distance(
        self, closure: FrameClosure, names: list[str], tendon: etree._Element,
        equality: etree._Element, solver: dict[str, str],
    ) -> None:  # fmt: skip
        rod = etree.SubElement(tendon, "spatial", name=closure.name)
        for name in names:
            etree.SubElement(rod, "site", site=name)
        zero = self._gap(closure, np.zeros(len(self.machine.start)))
        length = float(getattr(closure, "length"))  # noqa: B009
        etree.SubElement(
            equality, "tendon", name=f"{closure.name}_length", tendon1=closure.name,
            polycoef=words([length - float(np.linalg.norm(zero)), 0, 0, 0, 0]), **solver,
        )  # fmt: skip

    def _placed(self, frame: Frame, q: np.ndarray) -> pin.SE3:
        model = self.machine.drawing.model
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        return data.oMi[frame.joint] * frame.placement

    def _gap(self, closure: FrameClosure, q: np.ndarray) -> np.ndarray:
        a, b = (self._placed(frame, q) for frame in closure.frames)
        return np.asarray(b.translation - a.translation)

    def _matched(self, closure: FrameClosure, a: Frame, b: Frame) -> pin.SE3:
        """Return b's place moved along the axes that a planar loop leaves open, onto a."""
        q = self.machine.start
        gap = self._gap(closure, q)
        for axis in closure.position:
            gap["xyz".index(axis)] = 0.0
        in_b = self._placed(b, q).rotation.T @ -gap
        return b.placement * pin.SE3(np.eye(3), in_b)

    def _couplings(self, tendon: etree._Element) -> None:
        for joints, x in self.machine.values.get("coupling", {}).items():
            sizes = {"armature": x["Im"], "damping": x["Fvm"], "frictionloss": x["Fcm"]}
            fixed = etree.SubElement(
                tendon, "fixed", name="_".join(("coupling", *joints)),
                **{key: words([value]) for key, value in sizes.items() if value},
            )  # fmt: skip
            if x["Fcm"] and self.numbers.friction:
                fixed.set("solreffriction", words([self.numbers.friction, 1]))
                fixed.set("solimpfriction", STIFF)
            for name in joints:
                etree.SubElement(fixed, "joint", joint=name, coef="1")

    # --- actuators ------------------------------------------------------------------------------

    def _actuators(self) -> None:
        section = etree.SubElement(self.root, "actuator")
        mechanism, values = self.machine.mechanism, self.machine.values
        late = next((x["d"] for x in values.get("command_delay", {}).values() if "d" in x), 0.0)
        for link in self._order:
            name = link.joint.name
            laws, driven = self.translation.laws[name], name in mechanism.driven
            constant = bias_of(laws)
            if not driven and not constant:
                continue
            attributes = actuator(self.machine, link, laws, constant, late, self.numbers.step)
            etree.SubElement(section, attributes.pop("tag"), attributes)


def joint_attributes(laws: JointLaws, offset: float) -> dict[str, str]:
    """Return the attributes of a joint's laws; `offset`: of its encoder, true less logged."""
    result = {}
    if laws.viscous or laws.drag:
        result["damping"] = words([laws.viscous, laws.drag, 0] if laws.drag else [laws.viscous])
    if laws.coulomb:
        result["frictionloss"] = words([laws.coulomb])
    if laws.armature:
        result["armature"] = words([laws.armature])
    stiffness, rest = spring_of(laws.position)
    if stiffness:
        result["stiffness"] = words(stiffness if len(stiffness) == 1 else [*stiffness, 0.0][:3])
        result["springref"] = words([rest - offset])
    return result


def spring_of(position: Sequence[float]) -> tuple[list[float], float]:
    """Return MuJoCo's stiffness (1 or 3 numbers) and springref of a polynomial P(q).

        P(q) = x (k0 + k1 x + k2 x²),   x = q − q0,   P(q0) = 0

    A polynomial without a root loses its constant, which `bias_of` gives to the actuator.
    """
    p = np.array([*position, 0.0, 0.0])[: max(len(position), 2)]
    if not np.any(p[1:]):
        return [], 0.0
    p[0] -= bias_of(JointLaws(position=tuple(position)))
    roots = np.roots(p[::-1])
    real = roots[np.abs(roots.imag) < 1e-9].real
    q0 = float(real[np.abs(real).argmin()])
    shifted = [
        sum(
            float(p[i]) * float(np.prod(range(i, i - k, -1))) / float(np.prod(range(k, 0, -1)))
            * q0 ** (i - k)
            for i in range(k, len(p))
        )
        for k in range(1, len(p))
    ]  # fmt: skip
    return (shifted[:1] if not np.any(shifted[1:]) else shifted), q0


def bias_of(laws: JointLaws) -> float:
    """Return the constant torque [N m | N] that no spring can hold."""
    p = np.array([*laws.position, 0.0])
    if not np.any(p):
        return 0.0
    if not np.any(p[1:]):
        return float(p[0])
    roots = np.roots(np.trim_zeros(p, "b")[::-1])
    return 0.0 if (np.abs(roots.imag) < 1e-9).any() else float(p[0])


def actuator(
    machine: Machine, link: Link, laws: JointLaws, constant: float, late: float, step: float
) -> dict[str, str]:
    """Return the attributes of a joint's actuator, its element under `tag`.

    force = gain · control − constant − kp q − kd q̇
    """
    name, values = link.joint.name, machine.values
    servo = values.get("servo", {}).get((name,))
    current = values.get("motor_current", {}).get((name,))
    voltage = values.get("motor_voltage", {}).get((name,))
    gain, kp, kd, limit = laws.gain, 0.0, 0.0, np.inf
    if servo:
        gain, kp, kd, limit = servo["kp"], servo["kp"], servo["kd"], servo["limit"]
        late = late or servo["delay"]
    elif current:
        gain, limit = current["kt"], current.get("limit", np.inf)
    elif voltage:
        gain, kd, limit = voltage["gain"], voltage["kb"], voltage.get("limit", np.inf)
        late = late or voltage.get("delay", 0.0)
    else:
        late = 0.0
    result = {"name": name, "joint": name}
    limit = min(limit, link.joint.effort) if not servo else limit
    if np.isfinite(limit) and limit > 0:
        result["forcerange"] = words([-limit, limit])
    if late > 0:  # MuJoCo keeps a history of controls, one a step
        result |= {"delay": words([late]), "nsample": str(int(np.ceil(late / step)) + 2)}
    if servo and not constant:
        return {"tag": "position", **result, "kp": words([kp]), "kv": words([kd])}
    if gain == 1.0 and not any((constant, kp, kd)):
        return {"tag": "motor", **result}
    result["gainprm"] = words([gain])
    if any((constant, kp, kd)):
        result |= {"biastype": "affine", "biasprm": words([-constant, -kp, -kd])}
    return {"tag": "general", **result}


def _inertial(body: etree._Element, inertia: Body) -> None:
    etree.SubElement(
        body, "inertial", pos=words(inertia.centre), mass=words([inertia.mass]),
        fullinertia=words(inertia.six),
    )  # fmt: skip


def _pose(placement: pin.SE3) -> dict[str, str]:
    result = {}
    if np.any(placement.translation):
        result["pos"] = words(placement.translation)
    if not np.allclose(placement.rotation, np.eye(3), rtol=0, atol=1e-16):
        x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
        result["quat"] = words([w, x, y, z])
    return result
