"""What a target can say of a joint, the nearest it can say of the rest, and what is lost by that.

    torque that joint j must supply   Ia a + Fv v + Fd v|v| + Fc sign(v) + P(q)

An effect that the target has no element for is replaced by the nearest of the target's own laws:
least squares over the motion, no coefficient below zero; what remains is the loss. In rad it is
what a position controller would be off by:

    rad = rms / (ω² m_j),   ω = 2π 5 Hz,   m_j the inertia that the drive of the joint feels
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from ident.effects import Effect
from ident.effects.joint import direction
from ident.effects.transmission import Backlash
from ident.equations.rows import Scene
from ident.equations.unknowns import NOTHING
from ident.errors import IdentError, MotionError
from ident.export.machine import Machine
from ident.information import linear
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.motion.closures import independent_joints

BANDWIDTH = 2 * np.pi * 5.0  # range: [rad/s] of the controller in whose error a torque is stated
AMPLITUDES = (0.5, 0.2, 0.05, 0.01)  # range: [rad | m] of the nominal motion, the first that goes
SECONDS, RATE = 6.0, 200.0  # range: [s], [Hz] of the nominal motion
SAMPLES = 200  # work: of a motion, at which the torque of gravity is taken
FREQUENCY = 0.5  # range: [Hz] of its first joint; each further one is a little faster
FRICTIONS = ("dry", "level", "state")  # `Unknown.acts` of friction
# kinds that tell how a log was made, not how the machine moves
OF_THE_LOG = ("delay", "position_delay", "gravity_compensation")
DRIVES = ("servo", "motor_current", "motor_voltage", "command_delay")


@dataclass(frozen=True)
class JointLaws:
    """Coefficients of one joint's laws, in its true coordinate q [rad | m]."""

    armature: float = 0.0  # Ia [kg m² | kg]
    viscous: float = 0.0  # Fv
    drag: float = 0.0  # Fd
    coulomb: float = 0.0  # Fc
    position: tuple[float, ...] = ()  # P(q) = Σ p_i qⁱ
    gain: float = 1.0  # share of the commanded torque that acts


@dataclass(frozen=True)
class Lost:
    """What a target cannot say, and what that is worth."""

    label: str  # the effect's, or the closure's
    where: str  # its joint, link or closure
    torque: float  # rms [N m | N] over the motion, of what remains
    largest: float  # its largest size
    before: float  # rms of the whole effect
    position: float  # [rad | m] by which a controller of 5 Hz would be off
    units: tuple[str, str]  # of torque and position
    nearest: str = ""  # what stands in for it


@dataclass(frozen=True)
class Vocabulary:
    """What a target can hold.

    Attributes:
        effects: the element that holds an effect, by its kind.
        closures: the element that holds a closure, by its kind.
        degree: of the polynomial of q that a joint can have; −1: none.
        needed: by element, what another program than the target's own needs to know of it.
    """

    effects: Mapping[str, str]
    closures: Mapping[str, str] = field(default_factory=dict)
    degree: int = -1

    def frictions(self) -> list[str]:
        """Return the names of laws of speed that it has."""
        return [word for word in ("coulomb", "viscous", "drag") if word in self.effects]


@dataclass(frozen=True, eq=False)
class Translation:
    """A machine in a target's words.

    Attributes:
        laws: of every joint of the tree.
        held: (effect's label, element) of everything that is said exactly.
        lost: what is not.
        motion: over which sizes were measured, in words.
    """

    machine: Machine
    laws: Mapping[str, JointLaws]
    fixed: tuple[tuple[str, str], ...]
    lost: tuple[Lost, ...]
    motion: str


def translate(machine: Machine, words: Vocabulary, motion: Motion | None) -> Translation:
    """Return a machine in the words of a target; `motion`: over which losses are measured, a
    nominal one by default.
    """
    laws = {link.joint.name: _exact(machine, link.joint.name, words) for link in machine.links}
    fixed, lost = [], list[Effect]()
    for effect in machine.mechanism.effects:
        in_tree = effect.site != "joint" or all(name in laws for name in effect.joints)
        if effect.kind in OF_THE_LOG:
            fixed.append((effect.label, "of the log, nothing that a simulator needs"))
        elif effect.kind in words.effects and in_tree and _sayable(machine, effect, words):
            fixed.append((effect.label, words.effects[effect.kind]))
        elif effect.label and effect.kind in DRIVES:
            fixed.append((effect.label, "its torque is the command here"))
        elif effect.corrects or any(machine.point.of(effect)[0]):
            lost.append(effect)
    if not lost:
        return Translation(machine, laws, tuple(fixed), (), "")
    words_of_motion = "the log's motion"
    if motion is None:
        motion, words_of_motion = nominal_motion(machine.mechanism), "a nominal motion"
    measured = _Measured(machine, motion)
    result = []
    for effect in lost:
        for i, name in enumerate(effect.joints or ("",)):
            loss, changed = measured.loss(effect, i, words, laws.get(name))
            result += [loss] if loss is not None else []
            if changed is not None:
                laws[name] = changed
    return Translation(machine, laws, tuple(fixed), tuple(result), words_of_motion)


def _exact(machine: Machine, joint: str, words: Vocabulary) -> JointLaws:
    """Return the laws of a joint that a target has exactly."""

    def value(kind: str, name: str) -> float:
        return machine.value(kind, joint, name) if kind in words.effects else 0.0

    position = np.zeros(8)
    position[:2] += value("spring", "b"), value("spring", "k")
    position[0] += value("torque_offset", "c")
    cable = machine.values.get("cable", {}).get((joint,), {})
    if "cable" in words.effects and int(cable.get("degree", 0)) <= words.degree:
        position += [cable.get(f"k{i}", 0.0) for i in range(8)]
    return JointLaws(
        armature=value("rotor_inertia", "Ia"),
        viscous=value("viscous", "Fv"),
        drag=value("drag", "Fd"),
        coulomb=value("coulomb", "Fc"),
        position=tuple(map(float, np.trim_zeros(position, "b"))),
        gain=1.0 / (1.0 + value("torque_gain", "g")),  # logged: (1 + g) times what acts
    )


def _sayable(machine: Machine, effect: Effect, words: Vocabulary) -> bool:
    if effect.kind == "cable":
        return effect.setting("degree") <= words.degree
    return effect.kind in DRIVES or not (effect.corrects and effect.implicit)


# --- sizes ----------------------------------------------------------------------------------------


def nominal_motion(mechanism: Mechanism) -> Motion:
    """Return a motion of all drives about the start, within limits, where there is no log.

    Raises:
        MotionError: if the mechanism cannot move about its start.
    """
    joints = independent_joints(
        mechanism, [*mechanism.driven, *(joint.name for joint in mechanism.joints)]
    )
    t = np.arange(0.0, SECONDS, 1 / RATE)
    q0 = mechanism.assembled
    error: IdentError | None = None
    for amplitude in AMPLITUDES:
        columns: dict[str, np.ndarray] = {}
        for i, name in enumerate(joints):
            joint, w = mechanism.joint(name), 2 * np.pi * FREQUENCY * (1 + 0.3 * i)
            span = min(amplitude, 0.25 * (joint.upper - joint.lower)) * (
                1.0 if joint.rotational else 0.2
            )
            centre = q0[joint.index] if joint.in_tree else 0.0
            if not mechanism.closures:  # a simulator stops a joint at its limits
                within = 1.5 * span
                centre = float(np.clip(centre, joint.lower + within, joint.upper - within))
            columns |= {
                f"q.{name}": centre + span * np.sin(w * t),
                f"v.{name}": span * w * np.cos(w * t),
                f"a.{name}": -span * w**2 * np.sin(w * t),
            }
        extra = {
            name: np.full(len(t), 25.0 if name.startswith("temperature.") else 0.0)
            for effect in mechanism.effects
            if not effect.supplies_torque
            for name in effect.reads()
        }
        try:
            log = Log.from_arrays("nominal motion", t, columns | extra)
            return complete(mechanism, log, torques=False)
        except MotionError as raised:
            error = raised
    assert error is not None
    raise error


class _Measured:
    """Sizes of effects over a motion."""

    def __init__(self, machine: Machine, motion: Motion) -> None:
        self.machine = machine
        self.scenes = [
            Scene.of(machine.mechanism, NOTHING, e, machine.point, motion.band.cutoff)
            for e in motion.experiments
        ]
        self.inertia = felt_inertia(machine)

    def loss(
        self, effect: Effect, i: int, words: Vocabulary, laws: JointLaws | None
    ) -> tuple[Lost | None, JointLaws | None]:
        """Return what is lost of an effect at its i-th joint, and the laws that stand in for it."""
        where = effect.joints[i] if effect.joints else self.machine.name
        joint = self.machine.mechanism.joint_index.get(where)
        if effect.kind == "gravity_tilt":
            return self._of_gravity(effect), None
        if joint is None or effect.corrects:
            return self._of_correction(effect, where), None
        c, shape = self.machine.point.of(effect)
        torque, q, v, signs = (list[np.ndarray]() for _ in range(4))
        for scene in self.scenes:
            use = scene.e.usable
            torque.append((scene.samples.columns(effect, shape)[:, i] @ c)[use])
            q.append(scene.e.y[use, joint])
            v.append(scene.e.yd[use, joint])
            signs.append(direction(v[-1][:, None], scene.e.still[[joint]])[:, 0])
        y, q_all, v_all, sign = (np.concatenate(x) for x in (torque, q, v, signs))
        rest, changed, nearest = y, None, ""
        if laws is not None:
            rest, changed, nearest = _nearest(effect, words, laws, y, q_all, v_all, sign)
        units = self.machine.mechanism.joints[joint]
        rms = float(np.sqrt(np.mean(rest**2))) if len(rest) else 0.0
        return Lost(
            effect.label, where, rms, float(np.abs(rest).max(initial=0.0)),
            float(np.sqrt(np.mean(y**2))) if len(y) else 0.0,
            rms / (BANDWIDTH**2 * self.inertia.get(where, np.inf)),
            (units.force_unit, units.unit), nearest,
        ), changed  # fmt: skip

    def _of_gravity(self, effect: Effect) -> Lost:
        """Return what a tilted gravity is at the driven joint that it would move most."""
        machine = self.machine
        mechanism, tilted, level = machine.mechanism, machine.model(), machine.model()
        level.gravity = mechanism.model.gravity
        tree = [mechanism.joint_index[link.joint.name] for link in machine.links]
        q = np.concatenate([scene.e.y[scene.e.usable][:, tree] for scene in self.scenes])
        q = q[:: -(-len(q) // SAMPLES) or 1]
        sides = [
            np.stack([pin.computeGeneralizedGravity(model, model.createData(), x) for x in q])
            for model in (tilted, level)
        ]
        drives = [link for link in machine.links if link.joint.name in mechanism.driven]
        drives = drives or list(machine.links)
        torque = self._at_joints(q, sides[0] - sides[1], [link.joint.index for link in drives])
        rms, largest = np.sqrt(np.mean(torque**2, axis=0)), np.abs(torque).max(axis=0)
        inertia = np.array([self.inertia[link.joint.name] for link in drives])
        position = rms / (BANDWIDTH**2 * inertia)
        i = int(position.argmax())
        joint = drives[i].joint
        return Lost(
            effect.label, joint.name, float(rms[i]), float(largest[i]), float(rms[i]),
            float(position[i]), (joint.force_unit, joint.unit), "gravity of the simulator's world",
        )  # fmt: skip

    def _at_joints(self, q: np.ndarray, torque: np.ndarray, at: Sequence[int]) -> np.ndarray:
        """Return torques (n, len(at)) of some joints that do what those of all (n, nv) do."""
        drawing = self.machine.drawing
        if not drawing.closures:
            return torque[:, at]
        rate = drawing.kinematics.closure_rows(q).rate
        Z = [linear.svd(J)[2][drawing.rank :].T for J in rate]
        both = zip(Z, torque, strict=True)
        return np.stack([linear.pinv(z[at].T, 1e-9) @ z.T @ x for z, x in both])

    def _of_correction(self, effect: Effect, where: str) -> Lost | None:
        """Return the size of an effect that is an angle, or of no torque at one joint."""
        size, largest = 0.0, 0.0
        for scene in self.scenes:
            s = scene.samples.signals(effect.acting)
            _, shape = self.machine.point.of(effect)
            if effect.extent:  # the link turns on its own, behind its motor
                joint = self.machine.mechanism.joint(where)
                at = self.machine.mechanism.joint_index[where]
                twist = (scene.e.q[:, joint.index] - scene.e.y[:, at])[scene.e.usable]
                if isinstance(effect, Backlash):  # which a load that keeps its sign never shows
                    twist = np.append(twist, 0.5 * shape[effect.extent])
                    size = max(size, 0.5 * shape[effect.extent])
                size = max(size, float(np.sqrt(np.mean(twist**2))))
                largest = max(largest, float(np.abs(twist).max(initial=0.0)))
            if not effect.corrects:
                continue
            for dq in effect.correction(replace(s, shape=shape)).dq.values():
                dq = np.broadcast_to(np.asarray(dq, dtype=float), s.t.shape)[scene.e.usable]
                size = max(size, float(np.sqrt(np.mean(dq**2))))
                largest = max(largest, float(np.abs(dq).max(initial=0.0)))
        inertia = self.inertia.get(where, 0.0)
        as_torque = BANDWIDTH**2 * inertia
        rotational = effect.rotational
        units = ("N m", "rad") if rotational else ("N", "m")
        return Lost(
            effect.label,
            where,
            size * as_torque,
            largest * as_torque,
            size * as_torque,
            size,
            units,
        )


def _nearest(
    effect: Effect,
    words: Vocabulary,
    laws: JointLaws,
    y: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    sign: np.ndarray,
) -> tuple[np.ndarray, JointLaws | None, str]:
    """Return what the nearest laws leave of a torque y (n,), a joint's laws with them, and words.

    Friction is replaced by friction and functions of position by such, each with a column of the
    target: an effect is not to be hidden in one of another nature.
    """
    from scipy.optimize import lsq_linear  # takes 0.2 s to import

    names: list[str] = []
    columns: list[np.ndarray] = []
    if any(unknown.acts in FRICTIONS for unknown in effect.unknowns) or effect.signal.startswith(
        "v."
    ):
        series = {"coulomb": sign, "viscous": v, "drag": v * np.abs(v)}
        names += words.frictions()
        columns += [series[name] for name in names]
    if effect.of_position or effect.signal.startswith("q.") or effect.kind == "spring":
        degree = min(words.degree, 3)
        names += [f"position{i}" for i in range(degree + 1)]
        columns += [q**i for i in range(degree + 1)]
    if not columns or not len(y):
        return y, None, ""
    X = np.stack(columns, axis=1)
    scale = np.linalg.norm(X, axis=0)
    scale[scale == 0] = 1.0
    low = np.array([-getattr(laws, n) if hasattr(laws, n) else -np.inf for n in names]) * scale
    result = lsq_linear(X / scale, y, (low - 1e-300, np.inf)).x / scale
    changed, position = laws, np.zeros(8)
    position[: len(laws.position)] = laws.position
    said = []
    for name, x in zip(names, map(float, result), strict=True):
        if name.startswith("position"):
            position[int(name[-1])] += x
        else:
            changed = replace(changed, **{name: getattr(changed, name) + x})
            said.append(f"{name} {x:+.3g}")
    changed = replace(changed, position=tuple(map(float, np.trim_zeros(position, "b"))))
    if any(name.startswith("position") for name in names):
        said.append("a polynomial of the position")
    return y - X @ result, changed, ", ".join(said)


def felt_inertia(machine: Machine) -> dict[str, float]:
    """Return by joint the inertia [kg m² | kg] that its drive feels at the start."""
    mechanism, q, model = machine.drawing, machine.start, machine.model()
    M = pin.crba(model, model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    for link in machine.links:
        i = link.joint.index
        M[i, i] += machine.value("rotor_inertia", link.joint.name, "Ia")
    if not mechanism.closures:
        return {
            link.joint.name: float(M[link.joint.index, link.joint.index]) for link in machine.links
        }
    J = mechanism.kinematics.closure_rows(q[None]).rate[0]
    Z = linear.svd(J)[2][mechanism.rank :].T
    mobility = Z @ linear.pinv(Z.T @ M @ Z, 1e-9) @ Z.T
    diagonal = np.diag(mobility)
    return {
        link.joint.name: float(1 / max(diagonal[link.joint.index], 1e-12)) for link in machine.links
    }


def texts(lost: Sequence[Lost]) -> list[str]:
    """Return one line for each loss."""
    lines = []
    for item in lost:
        torque, position = item.units
        where = "" if item.where in item.label else f" at {item.where}"
        stands = f"; nearest: {item.nearest}" if item.nearest else ""
        lines.append(
            f"{item.label}{where}: {item.torque:.2g} {torque} rms (largest {item.largest:.2g}), "
            f"{item.position:.2g} {position} at a controller of 5 Hz{stands}"
        )
    return lines
