"""The equations of a machine as CasADi expressions, for code without Pinocchio.

    τ = RNEA(q, q̇, q̈; π) + E(q, q̇, q̈) c            Γ = ∂RNEA/∂π

Newton–Euler in the links' frames, outwards w, ẇ, p̈ and inwards f, n (Featherstone, Rigid Body
Dynamics Algorithms, ch. 5). PyPI's `pin` has no CasADi binding; tested against Pinocchio.

Dry friction is F tanh(q̇/w): a controller that switches at rest would hum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ident.export.laws import Translation
from ident.export.machine import Machine
from ident.information import linear
from ident.mechanism.description import tidy
from ident.motion.closures import independent_joints

Values = Mapping[str, float]
RANK = 1e-8  # numerics: of J's largest singular value: a smaller one is of a repeated equation


def _sat(x: ca.SX) -> ca.SX:
    return ca.fmin(ca.fmax(x, -1.0), 1.0)


# dry friction's largest size at speed v, beyond Coulomb's; s: parameters of the effect
DRY: Mapping[str, Callable[[ca.SX, Values], ca.SX]] = {
    "stribeck": lambda v, s: s["Fs"] * ca.exp(-((v / s["vs"]) ** 2)),
    "friction_width": lambda v, s: s["Fw"] * (ca.fmin(ca.fabs(v) / s["w"], 1.0) - 1.0),
}
# torques of the position
POSITION: Mapping[str, Callable[[ca.SX, Values], ca.SX]] = {
    "ripple": lambda q, s: s["A"] * ca.sin(s["N"] * q) + s["B"] * ca.cos(s["N"] * q),
    "end_stop": lambda q, s: (
        s["k"] * (ca.fmax(q - s["q1"], 0.0) if s["side"] >= 0 else ca.fmin(q - s["q1"], 0.0))
    ),
}


@dataclass(frozen=True, eq=False)
class Equations:
    """A machine's equations in n coordinates of its tree, with d of them independent."""

    translation: Translation
    smooth: float  # w [rad/s | m/s] of dry friction

    @property
    def machine(self) -> Machine:
        """What is described."""
        return self.translation.machine

    @property
    def n(self) -> int:
        """Coordinates of the tree."""
        return len(self.machine.links)

    @cached_property
    def symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """q, q̇, q̈ (n,)."""
        q, v, a = (ca.SX.sym(word, self.n) for word in "qva")
        return q, v, a

    def rigid(self, q: ca.SX, v: ca.SX, a: ca.SX, pi: ca.SX) -> ca.SX:
        """Return Γ π (n,) of dynamic parameters π (10 n,)."""
        links = self.machine.links
        w, dw, acc, R, F, N = ([ca.SX.zeros(3)] * len(links) for _ in range(6))
        for i, link in enumerate(links):
            k, axis = link.joint.index, ca.SX(tidy(link.axis))
            turn, place = ca.SX(tidy(link.placement.rotation)), ca.SX(link.placement.translation)
            parent = link.parent
            w0, dw0 = (w[parent], dw[parent]) if parent >= 0 else (ca.SX.zeros(3), ca.SX.zeros(3))
            a0 = acc[parent] if parent >= 0 else ca.SX(-self.machine.gravity)
            if link.joint.rotational:
                K = ca.skew(axis)
                turn = turn @ (ca.SX.eye(3) + ca.sin(q[k]) * K + (1 - ca.cos(q[k])) * (K @ K))
            else:
                place = place + turn @ (axis * q[k])
            R[i] = turn
            a_at = a0 + ca.cross(dw0, place) + ca.cross(w0, ca.cross(w0, place))
            w[i], dw[i], acc[i] = turn.T @ w0, turn.T @ dw0, turn.T @ a_at
            if link.joint.rotational:
                dw[i] += axis * a[k] + ca.cross(w[i], axis * v[k])
                w[i] += axis * v[k]
            else:
                acc[i] += axis * a[k] + 2 * ca.cross(w[i], axis * v[k])
            p = pi[10 * i : 10 * i + 10]
            m, h = p[0], ca.vertcat(p[1], p[2], p[3])
            L = ca.vertcat(
                ca.horzcat(p[4], p[5], p[7]),
                ca.horzcat(p[5], p[6], p[8]),
                ca.horzcat(p[7], p[8], p[9]),
            )
            F[i] = m * acc[i] + ca.cross(dw[i], h) + ca.cross(w[i], ca.cross(w[i], h))
            N[i] = L @ dw[i] + ca.cross(w[i], L @ w[i]) + ca.cross(h, acc[i])
        tau = ca.SX.zeros(self.n)
        for i in reversed(range(len(links))):
            link = links[i]
            axis = ca.SX(tidy(link.axis))
            tau[link.joint.index] = ca.dot(axis, N[i] if link.joint.rotational else F[i])
            if link.parent >= 0:
                place = ca.SX(link.placement.translation)
                if not link.joint.rotational:
                    turned = ca.SX(tidy(link.placement.rotation))
                    place = place + turned @ (axis * q[link.joint.index])
                f = R[i] @ F[i]
                F[link.parent] = F[link.parent] + f
                N[link.parent] = N[link.parent] + R[i] @ N[i] + ca.cross(place, f)
        return tau

    @cached_property
    def pi(self) -> np.ndarray:
        """(10 n,) dynamic parameters, payloads included."""
        return np.concatenate([self.machine.total(link) for link in self.machine.links])

    def _at(self, kind: str, joint: str) -> Values | None:
        return self.machine.values.get(kind, {}).get((joint,))

    def dry(self, v: ca.SX) -> ca.SX:
        """Return the largest size F (n,) of dry friction at speeds v."""
        total = ca.SX.zeros(self.n)
        for link in self.machine.links:
            k, name = link.joint.index, link.joint.name
            total[k] = self.translation.laws[name].coulomb
            for kind, law in DRY.items():
                if (s := self._at(kind, name)) is not None:
                    total[k] += law(v[k], s)
        return total

    def slipping(self, v: ca.SX) -> ca.SX:
        """Return viscous friction and drag (n,)."""
        total = ca.SX.zeros(self.n)
        for link in self.machine.links:
            k, laws = link.joint.index, self.translation.laws[link.joint.name]
            total[k] = laws.viscous * v[k] + laws.drag * v[k] * ca.fabs(v[k])
        for joints, s in self.machine.values.get("coupling", {}).items():
            at = [self.machine.by_joint[name].joint.index for name in joints]
            for k in at:
                total[k] += s["Fvm"] * (v[at[0]] + v[at[1]])
        return total

    def coupled(self, v: ca.SX) -> ca.SX:
        """Return dry friction at the sum of two joints' rates (n,)."""
        total = ca.SX.zeros(self.n)
        for joints, s in self.machine.values.get("coupling", {}).items():
            at = [self.machine.by_joint[name].joint.index for name in joints]
            for k in at:
                total[k] += s["Fcm"] * ca.tanh((v[at[0]] + v[at[1]]) / self.smooth)
        return total

    def springs(self, q: ca.SX) -> ca.SX:
        """Return torques of the position (n,)."""
        total = ca.SX.zeros(self.n)
        for link in self.machine.links:
            k, name = link.joint.index, link.joint.name
            for i, p in enumerate(self.translation.laws[name].position):
                total[k] += p * q[k] ** i
            for kind, law in POSITION.items():
                if (s := self._at(kind, name)) is not None:
                    total[k] += law(q[k], s)
        return total

    def rotors(self, a: ca.SX) -> ca.SX:
        """Return torques of rotors (n,)."""
        total = ca.SX.zeros(self.n)
        for link in self.machine.links:
            k = link.joint.index
            total[k] = self.translation.laws[link.joint.name].armature * a[k]
        for joints, s in self.machine.values.get("coupling", {}).items():
            at = [self.machine.by_joint[name].joint.index for name in joints]
            for k in at:
                total[k] += s["Im"] * (a[at[0]] + a[at[1]])
        return total

    @cached_property
    def offsets(self) -> np.ndarray:
        """(n,) true coordinates less logged ones."""
        result = np.zeros(self.n)
        for link in self.machine.links:
            result[link.joint.index] = link.offset
        return result

    @cached_property
    def gains(self) -> np.ndarray:
        """(n,) share of the commanded torque that acts."""
        result = np.ones(self.n)
        for link in self.machine.links:
            result[link.joint.index] = self.translation.laws[link.joint.name].gain
        return result

    # --- loops ----------------------------------------------------------------------------------

    @cached_property
    def independent(self) -> tuple[str, ...]:
        """Joints whose coordinates are the arguments: driven ones before passive ones."""
        mechanism = self.machine.drawing
        names = [link.joint.name for link in self.machine.links]
        order = [*(j for j in mechanism.driven if j in names), *names]
        return independent_joints(mechanism, order)

    @cached_property
    def closures(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Φ (r,), J (r, n) and J̇v (r,) of the equations that do not repeat others."""
        mechanism = self.machine.drawing
        q, v, _ = self.symbols
        function = mechanism.kinematics.closure_function
        phi, J, drift = function.call([q, v])
        rows: list[int] = []
        numbers = mechanism.kinematics.closure_rows(mechanism.general[None]).rate[0]
        for i in range(len(numbers)):
            s = linear.svd(numbers[[*rows, i]])[1]
            if s[-1] > RANK * s[0]:
                rows.append(i)
        return phi[rows], J[rows, :], drift[rows]

    # --- functions ------------------------------------------------------------------------------

    @cached_property
    def functions(self) -> dict[str, ca.Function]:
        """The functions of the tree by name, each with dense outputs, in true coordinates."""
        q, v, a = self.symbols
        pi, none = ca.SX(self.pi), ca.SX.zeros(self.n)
        sign = ca.tanh(v / self.smooth)
        friction = self.slipping(v) + self.dry(v) * sign + self.coupled(v)
        rest = self.springs(q) + friction + self.rotors(a)
        total = self.rigid(q, v, a, pi) + rest
        gravity = self.rigid(q, none, none, pi) + self.springs(q)
        symbolic = ca.SX.sym("pi", 10 * self.n)
        regressor = ca.jacobian(self.rigid(q, v, a, symbolic), symbolic)
        inertial = self.rigid(q, none, a, pi) - self.rigid(q, none, none, pi) + self.rotors(a)
        bias = self.rigid(q, v, none, pi) + self.springs(q) + self.slipping(v) + self.coupled(v)
        outputs = {
            "inverse_dynamics": ([q, v, a], [total / ca.DM(self.gains)]),
            "gravity": ([q], [gravity / ca.DM(self.gains)]),
            "friction": ([v], [friction / ca.DM(self.gains)]),
            "regressor": ([q, v, a], [regressor]),
            "mass_matrix": ([q], [ca.jacobian(inertial, a)]),
            "bias": ([q, v], [bias]),
            "dry_friction": ([v], [self.dry(v)]),
        }
        if self.machine.drawing.closures:
            phi, J, drift = self.closures
            outputs["closure"] = ([q], [phi, J])
            outputs["closure_drift"] = ([q, v], [drift])
        return {
            name: ca.Function(name, inputs, [ca.densify(x) for x in results], {"cse": True})
            for name, (inputs, results) in outputs.items()
        }
