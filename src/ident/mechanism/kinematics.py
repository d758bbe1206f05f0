"""Φ, J and J̇v of all closures, and their own joints, evaluated for many samples at once.

    Φ(q) = 0        J v = 0          J a + J̇v = 0        J = ∂Φ/∂q · N(q),  q̇ = N(q) v

J and J̇v are CasADi's derivatives of Φ; nothing is derived by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ident.information import linear
from ident.lazy import lazy
from ident.mechanism.closures import Closure, Constraint, OwnJoint, Placement, placements, rates

if TYPE_CHECKING:
    import casadi as ca
else:
    ca = lazy("casadi")

CHUNK = 4096  # work: samples a CasADi call maps over
MAPS = 64  # work: numbers of samples for which mapped functions are cached
LARGEST_STEP = 0.5  # numerics: [rad | m] of one of Newton's steps


@dataclass(frozen=True)
class ConstraintRows:
    """A vector function of q over samples: value (n, m), rate matrix (n, m, nv), drift (n, m).

    For closures Φ, J, J̇v; for closures' own joints y, W, Ẇv, so that ẏ = W v, ÿ = W a + Ẇv.
    """

    value: np.ndarray
    rate: np.ndarray
    drift: np.ndarray


class Mapped:
    """A function of two vectors over n samples that reads and writes NumPy memory.

    Conversion to and from CasADi's matrices takes 50 times as long. Not for two threads at once.
    """

    def __init__(self, function: ca.Function, n: int) -> None:
        self._buffer, self._run = (function.map(n) if n > 1 else function).buffer()
        self._inputs = [np.zeros((n, function.size1_in(i))) for i in range(2)]
        # CasADi's columns are consecutive: samples, then columns, then rows
        shapes = map(function.size_out, range(function.n_out()))
        self._outputs = [np.zeros((n, columns, rows)) for rows, columns in shapes]
        for i, x in enumerate(self._inputs):
            self._buffer.set_arg(i, memoryview(x))  # type: ignore[call-arg, arg-type]
        for i, y in enumerate(self._outputs):
            self._buffer.set_res(i, memoryview(y))  # type: ignore[call-arg, arg-type]

    def __call__(self, first: np.ndarray, second: np.ndarray) -> list[np.ndarray]:
        """Return the function's outputs, each (n, rows, columns)."""
        self._inputs[0][:], self._inputs[1][:] = first, second
        self._run()
        return [x.copy().transpose(0, 2, 1) for x in self._outputs]


class TreeSymbols:
    """Symbols q and v of one model, and the placements of its joints, each made once."""

    def __init__(self) -> None:
        self._symbols: tuple[ca.SX, ca.SX] | None = None
        self._placements: list[Placement] = []

    def symbols(self, model: pin.Model) -> tuple[ca.SX, ca.SX]:
        """Return q (nq,) and v (nv,)."""
        if self._symbols is None:
            self._symbols = ca.SX.sym("q", model.nq), ca.SX.sym("v", model.nv)
        return self._symbols

    def placements(self, model: pin.Model) -> list[Placement]:
        """Return world placements of all joints' frames at q, the world first."""
        if not self._placements:
            self._placements = placements(model, self.symbols(model)[0])
        return self._placements


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The closures of one model as compiled functions."""

    model: pin.Model
    closures: tuple[Closure, ...]  # in the order of the multipliers
    coordinates: Mapping[str, int]  # index into q of every joint of the tree, by name
    # of one model and its coordinates, for kinematics with other closures too
    tree: TreeSymbols = field(default_factory=lambda: TreeSymbols(), repr=False)

    @cached_property
    def _mapped(self) -> Callable[[ca.Function, int], Mapped]:
        return lru_cache(MAPS)(Mapped)  # a motion is evaluated many times

    def with_closures(self, closures: tuple[Closure, ...]) -> Kinematics:
        """Return the kinematics of the same tree with other closures."""
        return replace(self, closures=closures)

    @property
    def _symbols(self) -> tuple[ca.SX, ca.SX]:
        return self.tree.symbols(self.model)

    @cached_property
    def _constraints(self) -> tuple[Constraint, ...]:
        if not self.closures:
            return ()
        q, _ = self._symbols
        placed = self.tree.placements(self.model)
        joints = {name: q[index] for name, index in self.coordinates.items()}
        constraints: dict[str, Constraint] = {}
        for between_frames in (True, False):  # the others may count closures' own joints
            for closure in self.closures:
                if bool(closure.frames) == between_frames:
                    constraints[closure.name] = closure.constraint(placed, joints)
            joints |= {
                joint.name: joint.expression for c in constraints.values() for joint in c.joints
            }
        return tuple(constraints[closure.name] for closure in self.closures)

    @cached_property
    def multipliers(self) -> tuple[str, ...]:
        """Names of the multipliers, `<closure>.<x|y|z|rx|ry|rz|1…>`."""
        return tuple(name for constraint in self._constraints for name in constraint.names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the multipliers."""
        return tuple(unit for constraint in self._constraints for unit in constraint.units)

    @cached_property
    def closure_joints(self) -> tuple[OwnJoint, ...]:
        """The closures' own joints."""
        return tuple(joint for constraint in self._constraints for joint in constraint.joints)

    @cached_property
    def rows_of_closures(self) -> tuple[slice, ...]:
        """Which of the equations each closure has."""
        ends = np.cumsum([0, *(len(constraint.names) for constraint in self._constraints)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def forces_of(self, name: str) -> list[int]:
        """Which multipliers are forces of a closure, given its name or that of an own joint."""
        forces, first = [], 0
        for closure, constraint in zip(self.closures, self._constraints, strict=True):
            if name in (closure.name, *(joint.name for joint in constraint.joints)):
                forces += [first + i for i, unit in enumerate(constraint.units) if unit == "N"]
            first += len(constraint.names)
        return forces

    def _compile(self, name: str, value: ca.SX, outputs: slice = slice(None)) -> ca.Function:
        q, v = self._symbols
        N = rates(self.model, q)
        qd = N @ v  # a second derivative along q̇: N(q) is differentiated too
        every: list[Callable[[], ca.SX]] = [
            lambda: value,
            lambda: ca.jacobian(value, q) @ N,
            lambda: ca.jtimes(ca.jtimes(value, q, qd), q, qd),
        ]
        return ca.Function(name, [q, v], [ca.densify(make()) for make in every[outputs]])

    @cached_property
    def _phi(self) -> ca.SX:
        return ca.vertcat(*(constraint.phi for constraint in self._constraints))

    @cached_property
    def closure_function(self) -> ca.Function:
        """(q, v) → (Φ, J, J̇v) of one sample, for callers that cannot go over many at once."""
        return self._compile("closure", self._phi)

    @cached_property
    def _place_function(self) -> ca.Function:
        """(q, v) → (Φ, J), half the work."""
        return self._compile("place", self._phi, slice(2))

    @cached_property
    def _value_function(self) -> ca.Function:
        """(q, v) → Φ, a twelfth of the work."""
        return self._compile("value", self._phi, slice(1))

    @cached_property
    def _drift_function(self) -> ca.Function:
        """(q, v) → J̇v, half the work."""
        return self._compile("drift", self._phi, slice(2, None))

    @cached_property
    def own_function(self) -> ca.Function:
        """(q, v) → (y, W, Ẇv) of one sample."""
        joints = (joint.expression for joint in self.closure_joints)
        return self._compile("joints", ca.vertcat(*joints))

    def closure_rows(self, q: np.ndarray, v: np.ndarray | None = None) -> ConstraintRows:
        """Return Φ (n, m), J (n, m, nv), J̇v (n, m) of q (n, nq), v (n, nv); v = 0 if left out."""
        if not self.closures:
            none = np.zeros((len(q), 0))
            return ConstraintRows(none, np.zeros((len(q), 0, self.model.nv)), none)
        return self._rows(self._place_function if v is None else self.closure_function, q, v)

    def closure_rates(self, q: np.ndarray) -> np.ndarray:
        """Return J (n, m, nv) alone, of q (n, nq); in the memory of one sample where it is the same
        at all q.
        """
        if self._constant_rates and len(q):
            J = self.closure_rows(q[:1]).rate
            return np.broadcast_to(J, (len(q), *J.shape[1:]))
        return self.closure_rows(q).rate

    @cached_property
    def _constant_rates(self) -> bool:
        """Whether J is the same at all q: of gears, belts and cables."""
        if not self.closures:
            return False
        q, _ = self._symbols
        return bool((ca.jacobian(self._phi, q) @ rates(self.model, q)).is_constant())

    def closure_values(self, q: np.ndarray) -> np.ndarray:
        """Return Φ (n, m) alone, of q (n, nq)."""
        if not self.closures:
            return np.zeros((len(q), 0))
        if self._constant_rates and self.model.nq == self.model.nv:  # Φ is linear
            at_zero = self.closure_rows(np.zeros((1, self.model.nq)))
            return np.asarray(q @ at_zero.rate[0].T + at_zero.value)
        still = np.zeros((len(q), self.model.nv))
        return self._outputs(self._value_function, q, still)[0][..., 0]

    def closure_drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return J̇v (n, m) alone, of q (n, nq) and v (n, nv)."""
        if not self.closures or self._constant_rates:
            return np.zeros((len(q), len(self.multipliers)))
        return self._outputs(self._drift_function, q, v)[0][..., 0]

    def own_rows(self, q: np.ndarray, v: np.ndarray | None = None) -> ConstraintRows:
        """Return y, W and Ẇv of the closures' own joints, as `closure_rows`."""
        return self._rows(self.own_function, q, v)

    def _outputs(self, function: ca.Function, q: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        """Return the outputs of a function of q and v, each (n, rows, columns)."""
        parts = []
        for start in range(0, max(len(q), 1), CHUNK):
            part = slice(start, start + CHUNK)
            parts.append(self._mapped(function, len(q[part]))(q[part], v[part]))
        return [np.concatenate(x) for x in zip(*parts, strict=True)]

    def _rows(self, function: ca.Function, q: np.ndarray, v: np.ndarray | None) -> ConstraintRows:
        v = np.zeros((len(q), self.model.nv)) if v is None else v
        value, rate, *moving = self._outputs(function, q, v)
        drift = moving[0][..., 0] if moving else np.zeros(value.shape[:2])
        return ConstraintRows(value[..., 0], rate, drift)

    def assemble(self, q: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the configuration nearest to q at which all closures hold, and its error."""
        error = 0.0
        for _ in range(50 if self.closures else 0):
            rows = self.closure_rows(q[None])
            error = float(np.abs(rows.value).max())
            if error < 1e-13:
                break
            step = linear.lstsq(rows.rate[0], -rows.value[0], rcond=1e-10)[0]
            step *= min(1.0, LARGEST_STEP / max(np.abs(step).max(), 1e-300))
            q = pin.integrate(self.model, q, step)
        return q, error


def rank_of(J: np.ndarray) -> int:
    """Return the rank of a Jacobian (m, nv)."""
    return int((linear.svd(J)[1] > 1e-8 * max(1.0, np.abs(J).max(initial=0.0))).sum())
