"""The mechanism: a tree, its closures, its drives, what is known of it, and its effects."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, reduce
from itertools import combinations
from operator import add
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import pinocchio as pin

from ident.display import Displayed, render
from ident.effects import KINDS, Correction, Effect, FrameForce, Sites, create, parse
from ident.errors import MechanismError, one_of
from ident.information import linear
from ident.log import Column
from ident.mechanism.assembly import CLOSED, Assembly, assemble
from ident.mechanism.calibration import Calibration
from ident.mechanism.chains import Chain
from ident.mechanism.closures import Closure, shifted
from ident.mechanism.drives import parse_drives, with_common_delay
from ident.mechanism.frames import moving_frames, path_to
from ident.mechanism.kinematics import Kinematics, rank_of
from ident.mechanism.motors import Motor, parallel_joints
from ident.mechanism.parameters import Bodies, Consistency, Covariance

SHOWN = 6  # shown: open loops in a message
FEWEST_DUMMIES = 2  # range: bodies of the same numbers, which no machine has
GENERAL_STEP = 0.05  # range: [rad | m] from the assembled configuration to one in general position
SHORTEST = 1e-6  # numerics: [m] of a length of the drawing that may be wrong
DEGREES = {"free": -1, "linear": 1, "cubic": 3, "quintic": 5}


class KinematicsInUse(threading.local):
    """A thread's kinematics by the identity of their model and closures, which they keep; what is
    compiled writes to memory of its own, so that two threads never share one.
    """

    def __init__(self) -> None:
        self.known = WeakValueDictionary[tuple[int, int], Kinematics]()


_in_use = KinematicsInUse()


@dataclass(frozen=True)
class Joint:
    """One scalar coordinate of the tree (`index` into q and v) or of a closure (into its own)."""

    name: str
    rotational: bool
    index: int
    in_tree: bool = True
    lower: float = -np.inf  # [rad | m]; limits are infinite where the URDF gives none
    upper: float = np.inf
    velocity: float = np.inf  # [rad/s | m/s]
    effort: float = np.inf  # [N m | N]

    @property
    def unit(self) -> str:
        """Unit of the coordinate."""
        return "rad" if self.rotational else "m"

    @property
    def force_unit(self) -> str:
        """Unit of the torque or force."""
        return "N m" if self.rotational else "N"


@dataclass(frozen=True)
class Multipliers:
    """The time basis of λ(t): `free` (one value a sample) or splines of a spacing [s]."""

    basis: str = "free"
    spacing: float = 0.0

    @property
    def degree(self) -> int:
        """Degree of the basis functions; −1 for `free`."""
        return DEGREES[self.basis]


def multipliers(basis: str, spacing: float, where: str) -> Multipliers:
    """A checked time basis."""
    if basis not in DEGREES:
        raise MechanismError(f"{where}: basis = '{basis}'; {one_of(basis, DEGREES)}")
    if basis != "free" and not 0 < spacing < np.inf:
        raise MechanismError(
            f"{where}: basis '{basis}' needs a spacing above 0 s, such as 0.01; given: {spacing:g}"
        )
    return Multipliers(basis, spacing)


@dataclass(frozen=True, eq=False, repr=False)
class Mechanism(Displayed):
    """A machine as it is known without a log. `mechanism + effect` is a new one.

    Attributes:
        name: of the folder or URDF.
        model: Pinocchio's, with gravity; its inertias are the prior.
        bodies: names of the moving bodies.
        joints: every named coordinate, of the tree and of closures.
        closures: constraint functions.
        passive: joints whose torque is zero; those in `driven` have a measured torque.
        start: (nq,) near where the loops are assembled.
        unknown: names of the dynamic parameters to identify.
        effects: beyond rigid bodies.
        multipliers: the time basis of the closures' forces.
        columns: this robot's names of log columns.
        urdf: path of the URDF; toml: of its mechanism.toml, if it has one.
        notes: what was understood otherwise than it is written.
        locked: joints held at a coordinate [rad | m]; they are in none of the above.
        idle: those of the locked joints whose turn is a rod's about itself.
        chains: ball and floating joints, whose scalar joints are among `joints`.
        motors: those that do not sit at the joints, whose coordinates are among `joints`.
        unmeasured: driven joints of a tree whose torque has no sensor: their equations, which the
            torques of no other joint need, are left out.
        consistency: bounds on parameters and the total mass, for a consistent fit.
        covariance: of known values, where an earlier fit has found them.
        calibration: what may be a little wrong with its sensors and its drawing.
        plausible: (10 · bodies,) the URDF's dynamic parameters with 0 in place of numbers that
            cannot be, None where all can.
    """

    name: str
    model: pin.Model
    bodies: Bodies
    joints: tuple[Joint, ...]
    closures: tuple[Closure, ...]
    driven: tuple[str, ...]
    passive: tuple[str, ...]
    start: np.ndarray
    unknown: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    multipliers: Multipliers = Multipliers()
    columns: Mapping[str, Column] = field(default_factory=dict)
    urdf: Path = Path()
    toml: Path | None = None
    notes: tuple[str, ...] = ()
    locked: Mapping[str, float] = field(default_factory=dict)
    unmeasured: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()
    chains: tuple[Chain, ...] = ()
    motors: tuple[Motor, ...] = ()
    consistency: Consistency = field(default_factory=Consistency)
    covariance: Covariance | None = None
    calibration: Calibration = field(default_factory=Calibration)
    plausible: np.ndarray | None = None

    @property
    def measured(self) -> tuple[str, ...]:
        """Driven joints whose torque is measured."""
        return tuple(
            name for name in self.driven if name not in self.unmeasured and name not in self.drives
        )

    @property
    def drives(self) -> Mapping[str, Effect]:
        """Effects that supply a joint's torque in place of a sensor, by joint."""
        return {
            name: effect
            for effect in self.effects
            if effect.supplies_torque
            for name in effect.joints
        }

    @cached_property
    def unmeasured_rows(self) -> list[int]:
        """Rows of the equations of a tree whose torque is not measured."""
        return [self.joint(name).index for name in self.unmeasured]

    # --- kinematics -----------------------------------------------------------------------------

    @cached_property
    def kinematics(self) -> Kinematics:
        """Φ, J and J̇v as compiled functions, once for mechanisms that differ in effects alone."""
        tree = {joint.name: joint.index for joint in self.joints if joint.in_tree}
        key = id(self.model), id(self.closures)  # the entry keeps both alive
        known = _in_use.known.get(key)
        if known is None or known.coordinates != tree:
            known = _in_use.known[key] = Kinematics(self.model, self.closures, tree)
        return known

    @cached_property
    def prior(self) -> np.ndarray:
        """Dynamic parameters (10 · bodies,) of the URDF, in Γ's order."""
        return np.concatenate(
            [inertia.toDynamicParameters() for inertia in self.model.inertias[1:]]
        )

    @cached_property
    def has_dummy_bodies(self) -> bool:
        """Whether all bodies have the same numbers, as in a first URDF, which sizes nothing."""
        bodies = self.prior.reshape(len(self.bodies.links), -1)
        bodies = bodies[bodies.any(axis=1)]
        alike = len(bodies) >= FEWEST_DUMMIES and bool(np.allclose(bodies, bodies[:1], rtol=1e-9))
        return alike and not bodies[:, 1:4].any()

    @cached_property
    def plausible_prior(self) -> np.ndarray:
        """The prior (10 · bodies,) with 0 for unknown numbers that cannot be those of a body."""
        if self.plausible is None:
            return self.prior
        unknown = {*self.unknown}
        free = np.array([name in unknown for name in self.bodies.names])
        return np.where(free, self.plausible, self.prior)

    @cached_property
    def joint_index(self) -> Mapping[str, int]:
        """Where a joint stands in `joints`, by name."""
        return {joint.name: i for i, joint in enumerate(self.joints)}

    def joint(self, name: str) -> Joint:
        """The joint called `name`.

        Raises:
            MechanismError: if there is none, with the nearest name.
        """
        if name not in self.joint_index:
            raise MechanismError(
                f"{self.name}: no joint '{name}'; {one_of(name, self.joint_index)}"
            )
        return self.joints[self.joint_index[name]]

    @cached_property
    def degrees_of_freedom(self) -> int:
        """nv − rank J in general position."""
        return self.model.nv - self.rank

    @cached_property
    def rank(self) -> int:
        """Rank of J in general position, where its redundant equations show."""
        return rank_of(self.kinematics.closure_rows(self.general[None]).rate[0])

    @cached_property
    def general(self) -> np.ndarray:
        """A configuration (nq,) beside the assembled one, which may be stretched or folded."""
        q, random = self.assembled, np.random.default_rng(0)
        if not self.closures:
            return q
        J = self.kinematics.closure_rows(q[None]).rate[0]
        free = linear.svd(J)[2][rank_of(J) :]  # directions in which it moves
        step = random.normal(size=len(free)) @ free
        step *= GENERAL_STEP / max(np.abs(step).max(initial=0.0), 1e-300)
        general, error = self.kinematics.assemble(pin.integrate(self.model, q, step))
        return general if error < CLOSED else q

    @cached_property
    def assembly(self) -> Assembly:
        """The search for a configuration at which all closures hold, beginning at `start`."""
        turning = np.ones(self.model.nv, dtype=bool)
        for joint in self.joints:
            if joint.in_tree:
                turning[joint.index] = joint.rotational
        return assemble(self.kinematics, self.start, turning)

    @cached_property
    def assembled(self) -> np.ndarray:
        """The configuration (nq,) nearest to `start` at which all closures hold.

        Raises:
            MechanismError: if the loops cannot be assembled; it names those that stay open.
        """
        if self.assembly.closed:
            return self.assembly.q
        gaps = sorted(self.assembly.gaps.items(), key=lambda item: -item[1])
        still_open = [
            f"'{name}' by {gap:.3g} {self._open_unit(name)}" for name, gap in gaps if gap >= CLOSED
        ]
        more = f" and {len(still_open) - SHOWN} more" if len(still_open) > SHOWN else ""
        if by_themselves := self.assembly.alone:
            verb = "does" if len(by_themselves) == 1 else "do"
            names = ", ".join(f"'{name}'" for name in by_themselves)
            more += f" ({names} {verb} not close alone: frames or joint types there are wrong)"
        locks = ", ".join(f"{joint} at {value:.4g}" for joint, value in self.locked.items())
        raise MechanismError(
            f"{self.name}: the loops do not close from [joints] start, nor from starts at random: "
            f"open stay {', '.join(still_open[:SHOWN])}{more}; give a start near an assembled "
            "position, and check the closures' frames"
            + f" and where joints are locked: {locks}"
            * bool(locks)
        )

    def _open_unit(self, closure: str) -> str:
        """Unit of what is left open of a closure: λ does work along it."""
        rows = self.kinematics.rows_of_closures[[c.name for c in self.closures].index(closure)]
        units = {{"N": "m", "N m": "rad"}.get(unit, "") for unit in self.kinematics.units[rows]}
        return " or ".join(sorted(units))

    @property
    def found_start(self) -> dict[str, float]:
        """The assembled coordinates [rad | m] to keep as [joints] start, where it was searched for
        from elsewhere than the mechanism's own start; else empty.
        """
        if not self.closures or not self.assembly.closed or not self.assembly.starts:
            return {}
        at = {joint.name: self.assembly.q[joint.index] for joint in self.joints if joint.in_tree}
        return {name: round(float(x), 6) + 0.0 for name, x in at.items()}

    # --- effects --------------------------------------------------------------------------------

    @cached_property
    def sites(self) -> Sites:
        """Everything on which an effect can sit; `logged` are all joints, as no log is known."""
        names = tuple(self.joint_index)
        closure_joints = tuple(joint.name for joint in self.joints if not joint.in_tree)
        return Sites(
            joint=names, driven=self.driven, sensed=self.measured, geared=self._geared,
            commanded=tuple(name for name, x in self.drives.items() if "delay" in x.settings),
            loaded=(*self.driven, *closure_joints), logged=names,
            link=self.bodies.links, place=tuple(self.lengths),
            closure=tuple(closure.name for closure in self.closures),
            frame=moving_frames(self.model), flying=self._flying,
            loop=tuple(closure.name for closure in self.closures if closure.frames),
            length=tuple(
                place for place, x in self.lengths.items()
                if abs(x) > SHORTEST and not self._across(place)
            ),
        )  # fmt: skip

    @property
    def _flying(self) -> tuple[str, ...]:
        """Links that floating joints move, one for each."""
        last = {chain.turns[-1] for chain in self.chains if chain.floating}
        links = zip([*self.model.names][1:], self.bodies.links, strict=True)
        return tuple(link for joint, link in links if joint in last & {*self.passive})

    @property
    def _geared(self) -> tuple[tuple[str, str], ...]:
        """Pairs of driven joints of one type that follow each other or are on one body."""
        model = self.model
        motors = {motor.name for motor in self.motors if not motor.is_joint}
        at = {x: model.getJointId(x) for x in self.driven if model.existJointName(x)}
        at = {x: index for x, index in at.items() if x not in motors}
        # the next driven joint towards the base; supports begin there and end with the joint
        before = {
            x: next((k for k in [*model.supports[j]][-2::-1] if k in at.values()), 0)
            for x, j in at.items()
        }
        return tuple(
            (a, b)
            for a, b in combinations(at, 2)
            if self.joint(a).rotational == self.joint(b).rotational
            if model.parents[at[a]] == model.parents[at[b]]
            or before[b] == at[a]
            or before[a] == at[b]
        )

    @cached_property
    def lengths(self) -> Mapping[str, float]:
        """Coordinates [m] of joints and closures in the drawing, by place; 0 of a first joint."""
        places: dict[str, float] = {}
        for joint in self.joints:
            if joint.in_tree:
                index = self.model.getJointId(joint.name)
                at = self.model.jointPlacements[index].translation
                inside = self.model.parents[index] > 0
                places |= {f"{joint.name}.{a}": x * inside for a, x in zip("xyz", at, strict=True)}
        for closure in self.closures:
            places |= closure.places
        return places

    def _across(self, place: str) -> bool:
        """Whether a place moves at right angles to the plane of a planar mechanism, whose joints
        all turn about its normal or slide in it: no torque and no loop feels that.
        """
        model, data = self.model, self.model.createData()
        J = pin.computeJointJacobians(model, data, self.start)
        turns = np.linalg.norm(J[3:], axis=0) > 0.5
        if not turns.any():
            return False
        axes, slides = J[3:, turns], J[:3, ~turns]
        normal = axes[:, 0]
        if abs(normal @ axes).min() < 1 - CLOSED or abs(normal @ slides).max(initial=0) > CLOSED:
            return False
        owner, _, axis = place.rpartition(".")
        ends = [(c.name, i, f) for c in self.closures for i, f in enumerate(c.frames)]
        frames = {f"{name}.{'ab'[i]}": frame.joint for name, i, frame in ends}
        if model.existJointName(owner):
            frames[owner] = model.parents[model.getJointId(owner)]
        if owner not in frames:  # a length is in no direction
            return False
        direction = data.oMi[frames[owner]].rotation[:, "xyz".index(axis)]
        return bool(abs(normal @ direction) > 1 - CLOSED)

    def candidates(
        self, logged: Collection[str] | None = None, columns: Collection[str] = ()
    ) -> list[Effect]:
        """Every effect of the library that could be missing, in the library's order.

        Args:
            logged: joints whose position is logged; all, where they are not known.
            columns: further columns of the logs, such as `temperature.elbow`.
        """
        sites = self.sites if logged is None else replace(self.sites, logged=tuple(logged))
        labels = {effect.label for effect in self.effects}
        moved = {name for chain in self.chains if chain.floating for name in chain.names}
        every = (kind(joints) for kind in KINDS.values() for joints in kind.candidates(sites))
        hidden = {*(motor.link for motor in self.motors), *parallel_joints(self.motors)}
        return [
            self.placed(effect)
            for effect in every
            if effect.label not in labels and not hidden & {*effect.joints}
            if not (effect.local and moved.issuperset(effect.joints))  # no friction is in a flight
            if labels.issuperset(effect.required) and {*columns}.issuperset(effect.reads())
        ]

    @property
    def sources(self) -> dict[str, Column]:
        """Columns of a log's file by ident's names: those of [log], and q_elbow for q.elbow."""
        kinds = ("q", "v", "tau")
        names = [f"{kind}.{joint.name}" for kind in kinds for joint in self.joints]
        usual = {name: Column(name.replace(".", "_", 1), required=False) for name in names}
        taken = {column.column for column in self.columns.values()}
        free = {name: column for name, column in usual.items() if column.column not in taken}
        return {**free, **self.columns}

    def with_effect(self, text: str, values: Mapping[str, float] | None = None) -> Mechanism:
        """This mechanism with the effect(s) that `kind:joint[,joint]` or `kind` names.

        `kind` alone stands for every driven joint that does not have it yet or, where all have it
        with known values, for all of them; or for the whole mechanism, where the effect has no
        joint. One that it has with known values is unknown then.

        Args:
            text: names it, as `curve:elbow:q:pieces=8` with a signal and known values, or
                `encoder_offset:elbow@log` with values of its own in each log.
            values: parameters that are known, by short name.

        Raises:
            MechanismError: for a kind or joint that is not there, or an effect it has already.
        """
        kind, joints, signal, stated, per = parse(text)
        values = {**stated, **(values or {})}
        cls = KINDS[kind]
        if joints or cls.arity != 1 or cls.sits == "place":
            return self + create(kind, joints, values, signal=signal, per=per)
        everywhere = {"link": self.bodies.links, "closure": self.sites.closure}
        present = {effect.label: effect.known for effect in self.effects}
        every = [
            create(kind, name, values, per=per) for name in everywhere.get(cls.sits, self.driven)
        ]
        new = [effect for effect in every if effect.label not in present]
        if not new and all(present[effect.label] for effect in every) and not values:
            new = every
        if not new:
            what = "link" if cls.sits == "link" else "driven joint"
            raise MechanismError(
                f"{self.name}: every {what} has '{kind}' already; leave it out, or name one whose "
                f"known value is to become unknown: {kind}:NAME"
            )
        return reduce(add, new, self)

    def with_drives(self, *texts: str) -> Mechanism:
        """This mechanism with drives in place of torque sensors, as `--drive` names them.

        Args:
            texts: `elbow:kp=20,kd=1.5` for one joint, `kp=20` for all driven joints, `servo` alone
                for servos of which nothing is known.

        Raises:
            MechanismError: for a joint that is not driven, an unknown key or an impossible value.
        """
        new = parse_drives(texts, self.driven)
        given = {drive.joints[0] for drive in new if drive.supplies_torque}
        if not given & {*self.drives}:
            return reduce(add, new, self)
        known_delays = {
            joint: effect.values["d"]
            for effect in self.effects
            if effect.through_drives and effect.known
            for joint in effect.joints
        }
        drives = []
        for joint, drive in self.drives.items():
            if joint in given:
                continue
            if "delay" in drive.settings and joint in known_delays:
                delay = drive.values.get("delay", 0.0) + known_delays[joint]
                drive = replace(drive, values={**drive.values, "delay": delay})
            drives.append(drive)
        drives += [drive for drive in new if drive.supplies_torque]
        others = [e for e in self.effects if not e.supplies_torque and not e.through_drives]
        return reduce(add, with_common_delay(drives), replace(self, effects=tuple(others)))

    def check_required(self) -> None:
        """Refuse an effect without the other effect that it changes.

        Raises:
            MechanismError: for friction_width, say, where there is no coulomb.
        """
        present = {effect.label for effect in self.effects}
        for effect in self.effects:
            absent = [other for other in effect.required if other not in present]
            if absent:
                raise MechanismError(
                    f"{self.name}: effect '{effect.label}' changes '{absent[0]}', which is not "
                    f"there; add it, or leave out {effect.label}"
                )

    def with_calibration(self, text: str) -> Mechanism:
        """This mechanism with what a text states of its calibration, beside what it states already.

        Args:
            text: as `tau=0.5%,q=0.1deg,clock=exact`, `tau.elbow=1%`, or `exact` for all.

        Raises:
            MechanismError: for an entry that is none, with a valid one.
        """
        names = [*self.joint_index, *(closure.name for closure in self.closures)]
        stated = Calibration.of(text, names)
        return replace(self, calibration=self.calibration | stated)

    def without(self, label: str) -> Mechanism:
        """This mechanism without one of its effects, named as `kind:joint`.

        Args:
            label: of the effect.

        Raises:
            MechanismError: if it has no such effect.
        """
        labels = [effect.label for effect in self.effects]
        if label not in labels:
            raise MechanismError(f"{self.name}: has no effect '{label}'; {one_of(label, labels)}")
        return replace(self, effects=tuple(e for e in self.effects if e.label != label))

    def __add__(self, effect: Effect) -> Mechanism:
        if not isinstance(effect, Effect):
            return NotImplemented
        new = self.placed(effect)
        labels = [present.label for present in self.effects]
        if effect.label not in labels:
            return replace(self, effects=(*self.effects, new))
        at = labels.index(effect.label)
        if effect.known or not {*effect.values} < {*self.effects[at].values}:
            raise MechanismError(f"{self.name}: has the effect '{effect.label}' already")
        # its known values become unknown
        return replace(self, effects=(*self.effects[:at], new, *self.effects[at + 1 :]))

    def for_logs(self, logs: Sequence[str]) -> Mechanism:
        """Return the mechanism with effects that have values of their own `per` log once for each
        of the logs of a fit, by name.
        """
        if all(effect.log or not effect.per for effect in self.effects):
            return self
        effects = list[Effect]()
        for effect in self.effects:
            is_open = effect.per and not effect.log
            effects += [replace(effect, log=log) for log in logs] if is_open else [effect]
        labels = [effect.label for effect in effects]
        if len({*labels}) < len(labels):
            twice = next(label for label in labels if labels.count(label) > 1)
            raise MechanismError(
                f"{self.name}: effect '{twice}': two logs have the same name; give them others"
            )
        return replace(self, effects=tuple(effects))

    @cached_property
    def _own_logs(self) -> dict[str, tuple[str, ...]]:
        """Logs with values of their own of an effect, by its common label."""
        logs = dict[str, tuple[str, ...]]()
        for effect in self.effects:
            if effect.log:
                logs[effect.common_label] = (*logs.get(effect.common_label, ()), effect.log)
        return logs

    def share_in(self, effect: Effect, log: str) -> float:
        """Return how much of an effect acts in a log: of one that each log has of its own, all in
        that log, nothing in the others, and in a log of which no value is known the mean of all.
        """
        if not effect.log or effect.log == log:
            return 1.0
        logs = self._own_logs.get(effect.common_label, (effect.log,))
        return 0.0 if log in logs else 1 / len(logs)

    def placed(self, effect: Effect) -> Effect:
        """Return an effect with the units of its joints, or the path to its frame.

        Raises:
            MechanismError: if the mechanism has no such joint, link, closure or place.
        """
        valid = getattr(self.sites, effect.sits, ())
        for name in effect.joints:
            if name not in valid:
                what = "driven joint" if effect.sits == "driven" else effect.sits
                raise MechanismError(
                    f"{self.name}: effect '{effect.label}': no {what} '{name}'; "
                    f"{one_of(name, valid)}"
                )
        if isinstance(effect, FrameForce):
            names = [joint.name for joint in self.joints]
            return effect.along(path_to(self.model, effect.joints[0], names))
        joints = effect.joints if effect.site == "joint" else ()
        return effect.placed([self.joint(name).rotational for name in joints] or [True])

    # --- changed --------------------------------------------------------------------------------

    def corrected(self, correction: Correction) -> Mechanism:
        """The mechanism with the tilt of its base and the lengths of a correction."""
        mechanism, (x, y) = self, correction.tilt
        if x or y:  # g → Rᵀ g, R = Rx(x) Ry(y)
            model = self.model.copy()
            R = pin.rpy.rpyToMatrix(x, 0.0, 0.0) @ pin.rpy.rpyToMatrix(0.0, y, 0.0)
            model.gravity.linear = R.T @ model.gravity.linear
            mechanism = self.with_same_kinematics(model=model)
        for place, by in correction.displaced.items():
            mechanism = mechanism.displaced(place, by)
        return mechanism

    def with_gravity(self, gravity: Sequence[float]) -> Mechanism:
        """The mechanism under another gravity (3,) [m/s²].

        Raises:
            MechanismError: unless it is three numbers.
        """
        g = np.asarray(gravity, dtype=float)
        if g.shape != (3,) or not np.isfinite(g).all():
            raise MechanismError(f"gravity {gravity!s}; give three numbers [m/s²], as 0, 0, -1.62")
        model = self.model.copy()
        model.gravity.linear = g
        return self.with_same_kinematics(model=model)

    def displaced(self, place: str, by: float) -> Mechanism:
        """The mechanism with a place of the drawing moved.

        Args:
            place: `<joint>.<x|y|z>`, a joint's origin in its parent's axes, or a closure's place.
            by: displacement along the axis [m].

        Raises:
            MechanismError: if there is no such place.
        """
        if place not in self.sites.place:
            raise MechanismError(
                f"{self.name}: no place '{place}'; {one_of(place, self.sites.place)}"
            )
        owner, _, axis = place.rpartition(".")
        if self.model.existJointName(owner):
            model = self.model.copy()
            index = model.getJointId(owner)
            model.jointPlacements[index] = shifted(model.jointPlacements[index], axis, by)
            bare = replace(self, model=model)
            moved = (bare.placed(x) if isinstance(x, FrameForce) else x for x in self.effects)
            other = replace(bare, effects=tuple(moved))
            if not any(closure.frames for closure in self.closures):  # they bind coordinates alone
                other.__dict__["kinematics"] = self.kinematics
            return other
        closures = [c.displaced(place, by) if place in c.places else c for c in self.closures]
        other = replace(self, closures=tuple(closures))
        other.__dict__["kinematics"] = self.kinematics.with_closures(other.closures)
        if "rank" in self.__dict__:  # its freedoms stay, whatever its lengths are
            other.__dict__["rank"] = self.rank
        return other

    def freed(self, names: Collection[str]) -> Mechanism:
        """The mechanism in which the parameters `names`, in full, are unknown: of the bodies' no
        others, of effects' those without a value as well.
        """
        effects = []
        for effect in self.effects:
            both = zip(effect.names, effect.parameters, strict=True)
            unknown = {parameter.name for full, parameter in both if full in names}
            values = {name: x for name, x in effect.values.items() if name not in unknown}
            effects.append(replace(effect, values=values))
        bodies = tuple(name for name in self.bodies.names if name in names)
        return replace(self, unknown=bodies, effects=tuple(effects))

    def with_same_kinematics(
        self,
        model: pin.Model | None = None,
        start: np.ndarray | None = None,
        multipliers: Multipliers | None = None,
    ) -> Mechanism:
        """The mechanism with changes that its kinematics, compiled functions of q, do not feel:
        another model of the same kinematics, start (nq,), time basis of the multipliers.
        """
        other = replace(
            self,
            model=self.model if model is None else model,
            start=self.start if start is None else start,
            multipliers=self.multipliers if multipliers is None else multipliers,
        )
        other.__dict__["kinematics"] = self.kinematics
        return other

    def __getstate__(self) -> dict[str, object]:
        """Its fields: other processes compile their functions themselves."""
        return {attribute.name: getattr(self, attribute.name) for attribute in fields(self)}

    def view(self) -> Any:
        """The mechanism in 3-D as it is assembled, in a notebook or, by `.serve()`, in a browser.

        Loops that do not close are shown as they start, with a note of what is left open.
        """
        return render(self, "view")
