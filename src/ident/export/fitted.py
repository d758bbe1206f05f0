"""Numbers of a simulator's own laws with which it moves as the machine does.

MuJoCo's dry friction is soft and its damping implicit, both depend on the step: with true values a
motion is off by 0.5 mrad at 1 ms. The numbers θ = (damping, frictionloss of each joint, time
constant of friction) are therefore those whose motion is nearest to the exact one, under the
same controller:

    θ = argmin Σ_j Σ_k (q_j(t_k; θ) − q_j,exact(t_k))² / e_j²    (Gauss–Newton on rollouts, θ ≥ 0)

e_j is the rms error of joint j with the physical values: in plain radians a light joint that a
controller moves badly would buy its error with the friction of a heavy one that it moves well. The
numbers of a joint are written only if it moves nearer on a part of the motion to which they were
not fitted, and no other joint worse; else they stay physical. Errors that no friction makes, as
Coriolis forces half a step late, thus are left as they are.

q_exact is `ident.integrate`, with dry friction that really sticks and all effects that it can
integrate, those too that the target has no words for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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

FIT_DURATION = 3.0  # range: [s] of the motion that numbers are fitted to
TEST_DURATION = 2.0  # range: [s] of the same motion, after it, on which they are judged
RATE = 500.0  # range: [Hz] at which motions are compared
STEPS = 6  # work: of Gauss–Newton
DIFFERENCE = 1e-3  # numerics: of a parameter's size, for forward differences
PULL = 3e-3  # numerics: of the largest column: what no motion tells stays at its physical value
ENOUGH = 1e-3  # numerics: relative fall of the sum of squares below which the search ends
# range: share of a joint's error on the test motion that must remain at most, or its physical
# values stay: ones that hardly move a controlled motion nearer may move one under torques far away
WORTH = 0.8
# range: growth of a joint's error on the test motion above which it moves worse
WORSE = 1.1
SHOWN = 4  # shown: joints of a note, those with the largest errors
# numerics: [rad | m] below which an error is not weighed: the exact motion and its interpolation
LEAST = 1e-6
PHYSICAL = 0.02  # shown: relative change from which a number is said to be no longer physical
TOLERANCE = 1e-8  # numerics: of the exact motion


@dataclass(frozen=True, eq=False)
class Fitted:
    """Numbers of a file, and how near its motion is on a part that they were not fitted to.

    Attributes:
        translation, numbers: the machine and the file's numbers.
        errors: by driven joint, rms [rad | m] of the test motion with physical and fitted values.
        changed: physical and written value of every fitted number, by name; empty where the
            physical ones are written.
        physical: joints with friction whose numbers are the physical ones.
        units: of joints.
    """

    translation: Translation
    numbers: Numbers
    errors: Mapping[str, tuple[float, float]]
    changed: Mapping[str, tuple[float, float]]
    physical: tuple[str, ...]
    units: Mapping[str, str]

    @property
    def notes(self) -> list[str]:
        """What was measured, what is no longer physical, and what stays."""
        at = f"at a step of {1e3 * self.numbers.step:g} ms"
        motion = f"{TEST_DURATION:g} s of a nominal motion under a controller"
        order = sorted(self.errors, key=lambda name: -self.errors[name][0])
        rest = len(order) - SHOWN
        more = f", {rest} joints less" if rest > 0 else ""
        before, after = (
            ", ".join(
                f"{name} {1e3 * self.errors[name][i]:.2g} m{self.units[name]}"
                for name in order[:SHOWN]
            )
            for i in (0, 1)
        )
        if not self.changed:
            tried = f"; with fitted ones by {after}" if self.physical else ""
            return [
                f"{at} physical values are written: {motion} is off by {before}{more} rms{tried}"
            ]
        names = [
            f"{name} {old:.4g} → {new:.4g}"
            for name, (old, new) in self.changed.items()
            if abs(new - old) > PHYSICAL * max(abs(old), 1e-12)
        ]
        fitted = f"; no longer physical: {', '.join(names)}" if names else ""
        others = f"; physical values of {', '.join(self.physical)} stay" if self.physical else ""
        return [
            f"fitted to MuJoCo's own friction {at}: {motion}, other than the fitted, is off by "
            f"{after} instead of {before}{more} rms{fitted}{others}"
        ]


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
    v: np.ndarray  # (n, links)
    a: np.ndarray  # (n, links)
    gains: Mapping[str, tuple[float, float]]
    # times (m,), step [s] → Kp q_ref + Kd v_ref (m, drives), rates half a step later, where the
    # implicit method takes them
    command: Callable[[np.ndarray, float], np.ndarray]

    def parts(self, time: float) -> tuple[Exact, Exact]:
        """Return the motions before and after a time [s] from the start."""
        k = int(np.searchsorted(self.t, self.t[0] + time - 1e-9))
        return self._part(slice(0, k + 1)), self._part(slice(k, None))

    def _part(self, part: slice) -> Exact:
        return replace(self, t=self.t[part], q=self.q[part], v=self.v[part], a=self.a[part])


def exact_motion(
    machine: Machine, reference: Log | None = None, duration: float = FIT_DURATION + TEST_DURATION
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

    q, v, a = (x[:, tree] for x in (run.y, run.yd, run.ydd))
    return Exact(run.t, q, v, a, gains, command)


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

    def off(self, text: bytes, laws: Mapping[str, JointLaws]) -> np.ndarray:
        """Return the same less the exact motion."""
        return self.motion(text, laws) - self.exact.q

    def errors(self, text: bytes, laws: Mapping[str, JointLaws]) -> dict[str, float]:
        """Return its rms [rad | m] by joint."""
        rms = np.sqrt(np.mean(self.off(text, laws) ** 2, axis=0))
        return dict(zip(self.names, map(float, rms), strict=True))

    def of_model(self, model: Any) -> np.ndarray:
        """Return the same of a model with controllers, the drives' first."""
        exact = self.exact
        at_q, at_v = joint_places(model, self.names)
        qpos, qvel = np.zeros(model.nq), np.zeros(model.nv)
        dt = float(model.opt.timestep)
        qpos[at_q] = exact.q[0] - self.offsets
        qvel[at_v] = exact.v[0] - 0.5 * dt * exact.a[0]
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
        exact: the motion: fitted to its first `FIT_DURATION`, judged on what follows.
        soft: whether the time constant of friction is fitted as well; the file's own stays else.
        text: writes the model.
        progress: called with (what is being done, share done).
    """
    mujoco_module()
    machine = translation.machine
    fit_motion, test_motion = exact.parts(FIT_DURATION)
    search = _Search(translation, numbers, Rollouts(machine, fit_motion), text, progress)
    test = Rollouts(machine, test_motion)
    before = test.errors(text(translation, numbers), translation.laws)
    movable = [name for name, laws in translation.laws.items() if _words_of(machine, laws)]
    new, at, changed = translation, numbers, dict[str, tuple[float, float]]()
    joints, tries = list(movable), [before]
    while joints:
        new, at, changed = search.best(joints, soft)
        tries.append(test.errors(text(new, at), new.laws))
        shares = {name: x / max(before[name], LEAST) for name, x in tries[-1].items()}
        nearer = [name for name in joints if shares[name] <= WORTH]
        worse = any(share > WORSE for share in shares.values())
        if nearer == joints and not worse:
            break
        # first the numbers that gain nothing, then the softness that all joints share
        joints, soft = (nearer, soft) if nearer != joints else (joints if soft else [], False)
    after = tries[-1]
    if not joints:
        new, at, changed, after = translation, numbers, {}, tries[min(1, len(tries) - 1)]
    links = [link for link in machine.links if link.joint.name in machine.mechanism.driven]
    errors = {link.joint.name: (before[link.joint.name], after[link.joint.name]) for link in links}
    units = {link.joint.name: link.joint.unit for link in links}
    stay = tuple(name for name in movable if name not in joints)
    return Fitted(new, at, errors, changed, stay, units)


def _words_of(machine: Machine, laws: JointLaws) -> list[str]:
    """Return the names of a joint's numbers that are fitted."""
    words = ("viscous", "coulomb", *(["armature"] if servos(machine) else []))
    return [word for word in words if getattr(laws, word) > 0]


class _Search:
    """Gauss–Newton over the numbers of some joints, from the physical ones."""

    def __init__(
        self, translation: Translation, numbers: Numbers, rollouts: Rollouts,
        text: Callable[[Translation, Numbers], bytes], progress: Progress,
    ) -> None:  # fmt: skip
        self.translation, self.numbers = translation, numbers
        self.rollouts, self.text, self.progress = rollouts, text, progress
        errors = rollouts.errors(text(translation, numbers), translation.laws)
        self.scales = np.array([max(x, LEAST) for x in errors.values()])

    def best(
        self, joints: Sequence[str], soft: bool
    ) -> tuple[Translation, Numbers, dict[str, tuple[float, float]]]:
        """Return the numbers nearest on the motion, and (physical, new) of every one by name."""
        translation, numbers = self.translation, self.numbers
        keys = [
            (name, word)
            for name in joints
            for word in _words_of(translation.machine, translation.laws[name])
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

        def off(x: np.ndarray) -> np.ndarray:
            new, at = made(x)
            return self.rollouts.off(self.text(new, at), new.laws) / self.scales

        start = np.array([getattr(translation.laws[name], word) for name, word in keys])
        size = np.array([
            max(v, 0.01 * inertia.get(name, 1.0)) for v, (name, _) in zip(start, keys, strict=True)
        ])  # fmt: skip
        if fit_soft:
            start = np.append(start, numbers.soft or 0.02)
            size = np.append(size, 2 * numbers.step)
        x, now, pull = start, off(start), 0.0

        def penalty(x: np.ndarray) -> np.ndarray:
            return pull * (x - start) / size

        for k in range(STEPS):
            self.progress("fitting to the target's law", k / STEPS)
            h = DIFFERENCE * size * (50.0 if fit_soft else 1.0) ** (np.arange(len(x)) == len(x) - 1)
            columns = [(off(x + h * e) - now).ravel() / h[i] for i, e in enumerate(np.eye(len(x)))]
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
                rest = off(trial)
                new_cost = float(np.sum(rest**2) + np.sum(penalty(trial) ** 2))
                if np.isfinite(rest).all() and new_cost < cost:
                    break
            else:
                break
            fall, x, now = 1 - new_cost / cost, trial, rest
            if fall < ENOUGH:
                break
        words = {"viscous": "damping", "coulomb": "frictionloss", "armature": "armature"}
        changed = {
            f"{words[word]} of {name}": (float(old), float(value))
            for (name, word), old, value in zip(keys, start, x, strict=False)
        }
        return (*made(x), changed)


def error_of(
    text: bytes, laws: Mapping[str, JointLaws], machine: Machine, exact: Exact
) -> dict[str, float]:
    """Return by joint the rms [rad | m] between a model's motion and the exact one."""
    compiled(text)
    return Rollouts(machine, exact).errors(text, laws)
