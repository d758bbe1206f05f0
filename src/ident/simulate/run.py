"""The noun: what an integration leaves, and the log that the machine would have written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Correcting, Signals
from ident.effects.drive import Delay
from ident.equations.correct import late
from ident.equations.point import Point
from ident.equations.samples import Samples
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import complete
from ident.motion.independent import independent_joints
from ident.show.html import Shown
from ident.simulate.instant import STICK
from ident.simulate.trace import Trace, Transition

SHOWN = 12  # transitions that are printed


@dataclass(frozen=True, eq=False)
class Run(Shown):
    """An integrated motion with n samples. Made by `ident.integrate`.

    Attributes:
        mechanism: that was integrated, as its effects correct it.
        log: as the machine would have written it, with offsets, delays and noise.
        t: (n,) [s]; q, v, a: (n, nq), (n, nv), (n, nv).
        y, yd, ydd: (n, J) of the mechanism's joints.
        tau: (n, driven) torques that acted [N m | N].
        multipliers: (n, m) λ [N | N m], the smallest where closures repeat each other.
        friction: (n,) by joint, torque of dry friction; stuck: (n,) by joint.
        transitions: when joints stopped and broke away.
        closure_error: largest |Φ| [m | rad].
        evaluations: of the right side.
    """

    mechanism: Mechanism
    log: Log
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    y: np.ndarray
    yd: np.ndarray
    ydd: np.ndarray
    tau: np.ndarray
    multipliers: np.ndarray
    friction: Mapping[str, np.ndarray]
    stuck: Mapping[str, np.ndarray]
    transitions: tuple[Transition, ...]
    closure_error: float
    evaluations: int

    @property
    def summary(self) -> str:
        """In a few lines."""
        t = self.t
        lines = [
            f"simulated {self.mechanism.name}: {len(t)} samples, {t[-1] - t[0]:.4g} s; "
            f"{self.evaluations} evaluations of the equations of motion"
        ]
        if self.mechanism.closures:
            lines.append(f"  closure error: {self.closure_error:.2g}")
        for name, held in self.stuck.items():
            count = sum(each.joint == name for each in self.transitions)
            lines.append(
                f"  dry friction at {name}: stuck {100 * held.mean():.3g} % of the time, "
                f"{count} changes"
            )
        return "\n".join(lines)

    def __str__(self) -> str:
        shown = [f"  {each}" for each in self.transitions[:SHOWN]]
        more = len(self.transitions) - SHOWN
        return "\n".join([self.summary, *shown, *([f"  … {more} more"] if more > 0 else [])])

    __repr__ = __str__


def run_of(mechanism: Mechanism, trace: Trace, log: Log, names: Sequence[str]) -> Run:
    """The noun of a trace; its log is put in later.

    Args:
        names: of the joints with dry friction.
    """
    t = np.array(trace.t)
    q, v = (np.array([getattr(m, key) for m in trace.moments]) for key in "qv")
    a = np.array([b.a for b in trace.balances])
    y, yd, ydd = _coordinates(mechanism, q, v, a)
    closed = mechanism.kinematics.closure_rows(q).value
    friction = np.array([b.friction for b in trace.balances]).reshape(len(t), -1)
    stuck = np.array(trace.modes).reshape(len(t), -1) == STICK
    return Run(
        mechanism, log, t, q, v, a, y, yd, ydd,
        np.array([b.tau for b in trace.balances]),
        np.array([b.multipliers for b in trace.balances]),
        dict(zip(names, friction.T, strict=True)), dict(zip(names, stuck.T, strict=True)),
        tuple(trace.transitions), float(np.abs(closed).max(initial=0.0)), trace.evaluations,
    )  # fmt: skip


def _coordinates(
    mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """y, ẏ, ÿ (n, J) of all joints; turns of closures' own joints are counted."""
    y, yd, ydd = (np.empty((len(q), len(mechanism.joints))) for _ in range(3))
    own = None
    for i, joint in enumerate(mechanism.joints):
        if joint.in_tree:
            y[:, i], yd[:, i], ydd[:, i] = q[:, joint.index], v[:, joint.index], a[:, joint.index]
            continue
        own = own or mechanism.kinematics.own_rows(q, v)
        value, W = own.value[:, joint.index], own.rate[:, joint.index]
        y[:, i] = np.unwrap(value) if joint.rotational else value
        yd[:, i] = np.einsum("nk,nk->n", W, v)
        ydd[:, i] = np.einsum("nk,nk->n", W, a) + own.drift[:, joint.index]
    return y, yd, ydd


def columns_of(
    run: Run, point: Point, channels: Sequence[str], joints: Sequence[str] | None
) -> dict[str, np.ndarray]:
    """The log's columns (n,) by name, as sensors with these effects would have them, without noise.

    Args:
        channels: of q, v, a, tau.
        joints: whose q, v and a; default: the drives, or all joints of the tree where drives are
            fewer than degrees of freedom.
    """
    mechanism = run.mechanism
    names = _logged(mechanism) if joints is None else tuple(joints)
    y, yd, ydd = run.y.copy(), run.yd.copy(), run.ydd.copy()
    for effect in mechanism.effects:
        for name, dq in _shifts(run, effect, point).items():
            i = mechanism.joint_index[name]
            dv = np.gradient(dq, run.t)
            y[:, i], yd[:, i], ydd[:, i] = (
                y[:, i] - dq, yd[:, i] - dv, ydd[:, i] - np.gradient(dv, run.t)
            )  # fmt: skip
    found = {}
    for channel, series in (("q", y), ("v", yd), ("a", ydd)):
        for name in names if channel in channels else ():
            mechanism.joint(name)
            found[f"{channel}.{name}"] = series[:, mechanism.joint_index[name]]
    if "tau" in channels:
        delays = {
            effect.joints[0]: point.of(effect)[1]["d"]
            for effect in mechanism.effects
            if isinstance(effect, Delay)
        }
        for i, name in enumerate(mechanism.driven):
            found[f"tau.{name}"] = late(run.t, run.tau[:, i], delays.get(name, 0.0))
    return found


def _logged(mechanism: Mechanism) -> tuple[str, ...]:
    enough = independent_joints(mechanism, mechanism.driven)
    if len(enough) == mechanism.degrees_of_freedom:
        return mechanism.driven
    tree = tuple(joint.name for joint in mechanism.joints if joint.in_tree)
    return tree or tuple(joint.name for joint in mechanism.joints)


def _shifts(run: Run, effect: object, point: Point) -> Mapping[str, np.ndarray]:
    """By joint, what its true coordinate has beyond the logged one (n,)."""
    if not isinstance(effect, Correcting) or effect.kind in ("gravity_tilt", "geometry"):
        return {}
    _, shape = point.of(effect)
    n = len(run.t)
    if not effect.implicit:
        nothing = np.zeros((n, len(effect.joints)))
        seen = Signals(run.t, nothing, nothing, nothing, np.zeros(len(effect.joints)), shape=shape)
    else:
        seen = replace(_samples(run, point).signals(effect.joints), shape=shape)
    dq = effect.correction(seen).dq
    return {name: np.broadcast_to(np.asarray(x, dtype=float), (n,)) for name, x in dq.items()}


def _samples(run: Run, point: Point) -> Samples:
    """What effects that depend on the load see of the whole run."""
    mechanism = run.mechanism
    columns = {
        f"{channel}.{joint.name}": series[:, i]
        for channel, series in (("q", run.y), ("v", run.yd), ("a", run.ydd))
        for i, joint in enumerate(mechanism.joints)
        if joint.name in _logged(mechanism)
    } | {f"tau.{name}": run.tau[:, i] for i, name in enumerate(mechanism.driven)}
    motion = complete(mechanism, Log.from_arrays("run", run.t, columns), cutoff=None)
    return Samples(mechanism, motion.experiments[0], slice(None), point)
