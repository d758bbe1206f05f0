"""Numbers of a simulator's own laws with which it moves as the machine does.

MuJoCo's dry friction is soft and its damping implicit, both depend on the step: with true values a
motion is off by 0.5 mrad at 1 ms. The numbers θ = (damping, frictionloss of each joint, time
constant of friction) are therefore those whose motion is nearest to the exact one, under the
same controller:

    θ = argmin Σ_k |q(t_k; θ) − q_exact(t_k)|²        (Gauss–Newton on rollouts, θ ≥ 0)

q_exact is `ident.integrate`, with dry friction that really sticks and all effects that it can
integrate, those too that the target has no words for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.display import Progress, no_progress
from ident.export.laws import BANDWIDTH, JointLaws, Translation, felt_inertia, nominal_motion
from ident.export.machine import Machine
from ident.export.mjcf import Numbers, bias_of, write_mjcf
from ident.export.rollout import compiled, joint_places, mujoco_module, simulated, with_controllers
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.simulate import PD, integrate

DURATION = 3.0  # range: [s] of the motion that numbers are fitted to
RATE = 500.0  # range: [Hz] at which motions are compared
STEPS = 6  # work: of Gauss–Newton
DIFFERENCE = 1e-3  # numerics: of a parameter's size, for forward differences
PULL = 3e-3  # numerics: of the largest column: what no motion tells stays at its physical value
ENOUGH = 1e-3  # numerics: relative fall of the sum of squares below which the search ends
# range: share of its error that must remain at most, or the physical values stay: ones that hardly
# move a controlled motion nearer may move one under torques alone far away
WORTH = 0.8
PHYSICAL = 0.02  # shown: relative change from which a number is said to be no longer physical
TOLERANCE = 1e-8  # numerics: of the exact motion


@dataclass(frozen=True, eq=False)
class Fitted:
    """Numbers of a file, and how near its motion is."""

    translation: Translation
    numbers: Numbers
    before: float  # rms [rad | m] of the motion with the physical values
    after: float  # the same with the fitted ones
    changed: Mapping[
        str, tuple[float, float]
    ]  # physical and fitted value by name, where they differ

    @property
    def notes(self) -> list[str]:
        """What is no longer physical, and why."""
        step = 1e3 * self.numbers.step
        if not self.changed:
            return [
                f"at a step of {step:g} ms the motion with the physical values is off by "
                f"{1e3 * self.before:.2g} mrad rms, and no others bring it much nearer"
            ]
        text = (
            f"fitted to MuJoCo's own friction and a step of {step:g} ms: motion off by "
            f"{1e3 * self.after:.2g} mrad rms instead of {1e3 * self.before:.2g}"
        )
        names = [
            f"{name} {old:.4g} → {new:.4g}"
            for name, (old, new) in self.changed.items()
            if abs(new - old) > PHYSICAL * max(abs(old), 1e-12)
        ]
        physical = f"; no longer physical: {', '.join(names)}" if names else ""
        return [f"{text}{physical}"]


def controller(machine: Machine) -> dict[str, tuple[float, float]]:
    """Return Kp, Kd of every drive: the servo's own, or 5 Hz and critically damped."""
    inertia, gains = felt_inertia(machine), {}
    for name in machine.mechanism.driven:
        if name not in inertia:
            continue
        servo = machine.values.get("servo", {}).get((name,))
        m = inertia[name]
        gains[name] = (servo["kp"], servo["kd"]) if servo else (BANDWIDTH**2 * m, 2 * BANDWIDTH * m)
    return gains


def servos(machine: Machine) -> bool:
    """Return whether the file has position servos, whose damping then is part of its law."""
    return bool(machine.values.get("servo"))


def bare(machine: Machine) -> Mechanism:
    """Return the mechanism without what it cannot integrate, or what is of the log and drives."""
    effects = [
        effect
        for effect in machine.mechanism.effects
        if not effect.corrects and not effect.not_integrable and not effect.reads()
    ]
    return replace(machine.drawing, effects=tuple(effects))


@dataclass(frozen=True, eq=False)
class Exact:
    """A motion under a PD controller, exactly, and what commands it."""

    t: np.ndarray  # (n,)
    q: np.ndarray  # (n, links) true coordinates
    gains: Mapping[str, tuple[float, float]]
    # times (m,), step [s] → Kp q_ref + Kd v_ref (m, drives), rates half a step later, where the
    # implicit method takes them
    command: Callable[[np.ndarray, float], np.ndarray]
    start: tuple[np.ndarray, np.ndarray, np.ndarray]  # q, v, a (links,)


def exact_motion(
    machine: Machine, reference: Log | None = None, duration: float = DURATION
) -> Exact:
    """Return the machine's motion under PD control along the positions of a log."""
    from scipy.interpolate import CubicSpline

    mechanism = bare(machine)
    if reference is None:
        (e,) = nominal_motion(mechanism).experiments
        columns = {
            f"{c}.{name}": x[:, mechanism.joint_index[name]]
            for c, x in zip("qva", (e.y, e.yd, e.ydd), strict=True)
            for name in mechanism.driven
        }
        reference = Log.from_arrays("nominal motion", e.t, columns)
    gains = controller(machine)
    names = {full for effect in mechanism.effects for full in effect.names}
    values = {name: x for name, x in machine.point.values.items() if name in names}
    run = integrate(
        mechanism, PD(reference, gains), duration=duration, rate=RATE, values=values,
        pi=machine.point.pi, tolerance=TOLERANCE,
    )  # fmt: skip
    tree = [mechanism.joint_index[link.joint.name] for link in machine.links]
    driven = [name for name in mechanism.driven if name in gains]
    series = []
    for name in driven:
        kp, kd = gains[name]
        q = CubicSpline(reference.t, reference.columns[f"q.{name}"])
        rate = reference.columns.get(f"v.{name}")
        v = q.derivative() if rate is None else CubicSpline(reference.t, rate)
        series.append((kp, kd, q, v))

    later = 0.0 if servos(machine) else 0.5  # a servo's damping is in the file, as it is

    def command(t: np.ndarray, dt: float) -> np.ndarray:
        return np.stack([kp * q(t) + kd * v(t + later * dt) for kp, kd, q, v in series], axis=1)

    start = run.y[0, tree], run.yd[0, tree], run.ydd[0, tree]
    return Exact(run.t, run.y[:, tree], gains, command, start)


class Rollouts:
    """The motion of a file's text under the controller of an exact motion."""

    def __init__(self, machine: Machine, exact: Exact) -> None:
        self.machine, self.exact = machine, exact
        self.names = [link.joint.name for link in machine.links]
        self.offsets = np.array([link.offset for link in machine.links])

    def motion(self, text: bytes, laws: Mapping[str, JointLaws]) -> np.ndarray:
        """Return true coordinates (n, links) at the exact motion's times."""
        constant = {name: b for name, x in laws.items() if (b := bias_of(x))}
        return self.of_model(with_controllers(text, self.exact.gains, constant))

    def of_model(self, model: Any) -> np.ndarray:
        """Return the same of a model with controllers, the drives' first."""
        exact = self.exact
        at_q, at_v = joint_places(model, self.names)
        qpos, qvel = np.zeros(model.nq), np.zeros(model.nv)
        dt = float(model.opt.timestep)
        q0, v0, a0 = exact.start
        qpos[at_q], qvel[at_v] = q0 - self.offsets, v0 - 0.5 * dt * a0
        span = float(exact.t[-1] - exact.t[0])
        times = exact.t[0] + dt * np.arange(int(np.ceil(span / dt - 1e-9)) + 1)
        control = np.zeros((len(times) - 1, model.nu))
        command = exact.command(times[:-1], dt)
        # coordinates of the file are true ones less the encoders' offsets
        kp = [exact.gains[name][0] for name in exact.gains]
        offset = [self.machine.by_joint[name].offset for name in exact.gains]
        control[:, : command.shape[1]] = command - np.multiply(kp, offset)
        q, v = simulated(model, qpos, qvel, control)
        from scipy.interpolate import CubicHermiteSpline

        states = CubicHermiteSpline(times, q[:, at_q] + self.offsets, v[:, at_v])
        return np.asarray(states(np.minimum(exact.t, times[-1])))


def fit_numbers(
    translation: Translation,
    numbers: Numbers,
    exact: Exact,
    *,
    soft: bool = True,
    text: Callable[[Translation, Numbers], bytes] = write_mjcf,
    progress: Progress = no_progress,
) -> Fitted:
    """Return the numbers of a MuJoCo model with which its motion is nearest to the exact one.

    Args:
        translation: the machine in MuJoCo's words, with physical values.
        numbers: step and time constants to begin with.
        exact: the motion.
        soft: whether the time constant of friction is fitted as well; the file's own stays else.
        text: writes the model.
        progress: called with (what is being done, share done).
    """
    mujoco_module()
    rollouts = Rollouts(translation.machine, exact)
    keys = [
        (name, word)
        for name, laws in translation.laws.items()
        for word in ("viscous", "coulomb", *(["armature"] if servos(translation.machine) else []))
        if getattr(laws, word) > 0
    ]
    inertia = felt_inertia(translation.machine)
    fit_soft = soft and any(word == "coulomb" for _, word in keys)

    def made(x: np.ndarray) -> tuple[Translation, Numbers]:
        laws = dict(translation.laws)
        for (name, word), value in zip(keys, x, strict=False):
            number: dict[str, Any] = {word: float(value)}
            laws[name] = replace(laws[name], **number)
        constant = max(float(x[-1]), 2 * numbers.step) if fit_soft else numbers.soft
        return replace(translation, laws=laws), replace(numbers, soft=constant)

    def motion(x: np.ndarray) -> np.ndarray:
        new, at = made(x)
        return rollouts.motion(text(new, at), new.laws)

    start = np.array([getattr(translation.laws[name], word) for name, word in keys])
    size = np.array([
        max(v, 0.01 * inertia.get(name, 1.0)) for v, (name, _) in zip(start, keys, strict=True)
    ])  # fmt: skip
    if fit_soft:
        start, size = np.append(start, numbers.soft or 0.02), np.append(size, 2 * numbers.step)
    x, now = start, motion(start) - exact.q
    before = cost = float(np.sum(now**2))
    pull = 0.0

    def penalty(x: np.ndarray) -> np.ndarray:
        return pull * (x - start) / size

    for k in range(STEPS if len(x) else 0):
        progress("fitting to the target's law", k / STEPS)
        h = DIFFERENCE * size * (50.0 if fit_soft else 1.0) ** (np.arange(len(x)) == len(x) - 1)
        columns = [
            (motion(x + h * e) - exact.q - now).ravel() / h[i] for i, e in enumerate(np.eye(len(x)))
        ]
        J = np.stack(columns, axis=1) * size
        pull = pull or PULL * float(np.linalg.norm(J, axis=0).max())
        A = np.vstack([J, pull * np.eye(len(x))])
        b = np.concatenate([-now.ravel(), -penalty(x)])
        step = np.linalg.lstsq(A, b, rcond=None)[0] * size
        cost = float(np.sum(now**2) + np.sum(penalty(x) ** 2))
        for share in (1.0, 0.5, 0.2, 0.05):
            trial = np.maximum(x + share * step, 0.0)
            if fit_soft:
                trial[-1] = max(trial[-1], 2 * numbers.step)
            rest = motion(trial) - exact.q
            new_cost = float(np.sum(rest**2) + np.sum(penalty(trial) ** 2))
            if np.isfinite(rest).all() and new_cost < cost:
                break
        else:
            break
        fall, x, now = 1 - new_cost / cost, trial, rest
        if fall < ENOUGH:
            break
    after = float(np.sum(now**2))
    if len(x) and after > WORTH**2 * before:
        rms = _rms(before, exact.q.size)
        return Fitted(translation, numbers, rms, rms, {})
    new, at = made(x)
    words = {"viscous": "damping", "coulomb": "frictionloss", "armature": "armature"}
    changed = {
        f"{words[word]} of {name}": (float(old), float(value))
        for (name, word), old, value in zip(keys, start, x, strict=False)
    }
    count = exact.q.size
    return Fitted(new, at, _rms(before, count), _rms(after, count), changed)


def _rms(total: float, count: int) -> float:
    return float(np.sqrt(total / count))


def error_of(
    text: bytes, laws: Mapping[str, JointLaws], machine: Machine, exact: Exact
) -> dict[str, float]:
    """Return by joint the rms [rad | m] between a model's motion and the exact one."""
    compiled(text)
    off = Rollouts(machine, exact).motion(text, laws) - exact.q
    rms = np.sqrt(np.mean(off**2, axis=0))
    return dict(zip([link.joint.name for link in machine.links], map(float, rms), strict=True))
