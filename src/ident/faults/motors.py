"""Motors elsewhere as a fault of the data: a log of motors that was taken for one of joints.

With m = A q and A of one of the usual forms (a motor on the base that turns with the sum or the
difference of two joints, a differential of two motors, a ratio), the rows of the motors are

    A⁻ᵀ Γ(A⁻¹ m, A⁻¹ ṁ, A⁻¹ m̈) p + E(m, ṁ, m̈) c = τ_m

with the same columns E of friction, rotors and offsets in the logged coordinates as without: a
hypothesis has as many unknowns as the log as it is, or one more, its ratio.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ident.equations.table import Table
from ident.faults.fault import Fault, joints_before
from ident.information.linear import Array
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.motors import Motor
from ident.motion import State

RATIOS = np.geomspace(0.01, 100.0, 25)  # work: of a lone motor that are tried, refined then
WIDTH = 1.3  # work: factor on either side within which a ratio is refined
NICE = (1.0, 2.0, 3.0, 4.0, 5.0)  # range: usual ratios, or their inverses, which go first


@dataclass(frozen=True)
class MotorCoordinates:
    """A change of the state: logged coordinates m = A q are those of motors.

    Attributes:
        names: of the joints, in the order of the equations.
        matrix: A, one row a motor.
    """

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]

    @property
    def inverse(self) -> Array:
        """A⁻¹ (J, J)."""
        return np.linalg.inv(np.array(self.matrix))

    def __call__(self, mechanism: Mechanism, e: State) -> tuple[Mechanism, State]:
        """Return the state of joints q = A⁻¹ m."""
        known = e.known(mechanism, self.names) @ self.inverse.T
        return mechanism, e.at(mechanism, known, self.names, start="near")

    def table(self, logged: Table, of_joints: Table) -> Table:
        """Return the rows of the motors from those as logged and those of the joints."""
        B, columns = self.inverse, logged.columns
        bodies = np.concatenate([np.arange(len(columns.rigid)), *(x for _, x in columns.loads)])
        bodies = bodies[bodies >= 0].astype(int)
        A = logged.A.copy()
        A[:, :, bodies] = np.einsum("nik,iu->nuk", of_joints.A[:, :, bodies], B)
        b = (of_joints.b - of_joints.tau) @ B + logged.tau
        experiments = []
        for e in of_joints.motion.experiments:
            transmission = np.broadcast_to(B, (len(e), *B.shape))
            experiments.append(replace(e, loop=(transmission, transmission)))
        motion = replace(logged.motion, experiments=tuple(experiments))
        return replace(logged, A=A, b=b, motion=motion)

    @property
    def signs(self) -> tuple[tuple[float, ...], ...]:
        """Signs of A."""
        return tuple(tuple(map(float, np.sign(row))) for row in self.matrix)

    @property
    def motors(self) -> tuple[Motor, ...]:
        """The motors as [motors] states them, among them joints with their own in the same rows."""
        motors, coupled = [], set[str]()
        for name, row in zip(self.names, self.matrix, strict=True):
            ratios = {joint: x for joint, x in zip(self.names, row, strict=True) if x}
            if ratios != {name: 1.0}:
                motors.append(Motor(f"m_{name}", ratios))
                coupled |= {*ratios}
        changed = {motor.name.removeprefix("m_") for motor in motors}
        at_joints = (Motor(name, {name: 1.0}) for name in self.names if name in coupled - changed)
        return (*at_joints, *motors)

    @property
    def lines(self) -> str:
        """The lines of a mechanism.toml, as messages write them."""
        motors = [f'{m.name} = "{m.formula}"' for m in self.motors]
        names = [m.name.removeprefix("m_") for m in self.motors if not m.is_joint]
        log = [f'"{kind}.m_{name}" = "{kind}.{name}"' for name in names for kind in ("q", "tau")]
        return f"[motors] {' and '.join(motors)}, [log] {' and '.join(log)}"


def motor_faults(
    none: Fault, mechanism: Mechanism, logged: tuple[str, ...], poor: Collection[str]
) -> Iterator[Fault]:
    """Yield the usual matrices between motors and joints, where the torque of one is poor.

    Only of a tree whose joints all have a position and a torque.
    """
    names = tuple(sorted(logged, key=lambda name: mechanism.joint(name).index))
    if mechanism.closures or {*names} != {*mechanism.measured} or len(names) != mechanism.model.nv:
        return
    joints = [name for name in names if mechanism.joint(name).rotational]
    at = {name: i for i, name in enumerate(names)}

    def fault(rows: dict[str, dict[str, float]], *number: float) -> Fault:
        A = np.eye(len(names))
        for name, row in rows.items():
            A[at[name]] = 0.0
            for joint, x in row.items():
                A[at[name], at[joint]] = x
        state = MotorCoordinates(names, tuple(map(tuple, A.tolist())))
        return none.replaced("motors", *(number or (1.0,)), joints=(*rows,), state=state)

    def scaled(rows: dict[str, dict[str, float]], by: float) -> Fault:
        times = {name: {j: by * x for j, x in row.items()} for name, row in rows.items()}
        return replace(fault(times, by), at=lambda x: scaled(rows, x))

    before = {name: dict(joints_before(mechanism, name)) for name in joints}
    pairs = {*mechanism.sites.geared} | {(i, j) for j in joints for i in before[j]}
    pairs = {(i, j) for i, j in pairs if {i, j} <= {*joints} and {i, j} & {*poor}}
    for i, j in sorted(pairs, key=lambda pair: (at[pair[0]], at[pair[1]])):
        for sign in (1.0, -1.0):
            yield fault({j: {i: sign, j: 1.0}})
            yield fault({i: {i: 1.0, j: sign}})
        for a, b in product((1.0, -1.0), repeat=2):
            for size in (1.0, 0.5):
                yield scaled({i: {i: 1.0, j: a}, j: {i: b, j: -a * b}}, size)
    for j in joints:  # a parallelogram on every link of a chain
        row = {j: 1.0}
        for i, sign in before[j].items():
            row = {**row, i: sign}
            if len(row) > 2 and {*row} & {*poor}:
                yield fault({j: row})
    for j in joints if poor else ():  # the error of a wrong ratio may be in other joints
        for ratio in RATIOS[abs(np.log(RATIOS)) > np.log(WIDTH)]:
            yield scaled({j: {j: 1.0}}, float(ratio))


def nearest_nice(ratio: float) -> float:
    """Return the small whole number, or the inverse of one, that is nearest to a ratio."""
    return min((n**p for n in NICE for p in (1, -1)), key=lambda n: abs(np.log(ratio / n)))
