"""MuJoCo's motion of a written model: under a controller, or under the torques of a log.

A step takes its control at its beginning, as `data.ctrl[:] = …; mj_step(…)` of a user does.

    v_k+1 = v_k + dt a(q_k, …),   q_k+1 = q_k + dt v_k+1

is the leapfrog method, of second order in q, if v_k is read as the velocity half a step earlier:
a run starts with v(t₀ − dt/2), or else its positions are off by dt/2 (v − v₀), 0.5 mrad at 1 rad/s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from lxml import etree
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from ident.effects.servo import HOLD
from ident.equations.rows import Scene
from ident.equations.unknowns import NOTHING
from ident.errors import IdentError, MotionError, one_of
from ident.export.machine import Machine
from ident.motion import Motion, State
from ident.simulate.replay import ReplayedLog, tree_columns

if TYPE_CHECKING:
    import mujoco

STEP = 1e-3  # range: [s] of a file that states none
ABSENT = 'replaying in MuJoCo needs MuJoCo: pip install "ident[mjcf]"'


def mujoco_module() -> Any:
    """Return MuJoCo, or raise one line that says what to install."""
    try:
        import mujoco
    except ImportError:
        raise IdentError(ABSENT) from None
    return mujoco


def compiled(text: bytes | Path) -> mujoco.MjModel:
    """Compile a model's text, or its file.

    Raises:
        IdentError: with MuJoCo's reason.
    """
    module = mujoco_module()
    warnings: list[str] = []
    before = getattr(module, "get_mju_user_warning", lambda: None)()
    module.set_mju_user_warning(warnings.append)  # else it writes a MUJOCO_LOG.TXT
    try:
        if isinstance(text, Path):
            return module.MjModel.from_xml_path(str(text))
        return module.MjModel.from_xml_string(text.decode())
    except ValueError as error:
        raise IdentError(f"MuJoCo refuses the model: {' '.join(str(error).split())}") from None
    finally:
        module.set_mju_user_warning(before)


def with_controllers(
    text: bytes, gains: Mapping[str, tuple[float, float]], constant: Mapping[str, float]
) -> mujoco.MjModel:
    """Return a model whose actuators are PD controllers: force = control − Kp q − Kd q̇ − constant.

    Constants [N m | N] are what the file's own actuators hold beside the control.
    """
    module = mujoco_module()
    spec = module.MjSpec.from_string(text.decode())
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in dict.fromkeys((*gains, *constant)):
        kp, kd = gains.get(name, (0.0, 0.0))
        added = spec.add_actuator(name=name, target=name, trntype=module.mjtTrn.mjTRN_JOINT)
        added.gainprm[0] = 1.0
        added.biastype = module.mjtBias.mjBIAS_AFFINE
        added.biasprm[:3] = [-constant.get(name, 0.0), -kp, -kd]
    for key in list(spec.keys):
        spec.delete(key)
    # the exact motion has no ends of joints, which a controller without gravity may sag into
    spec.option.disableflags |= int(module.mjtDisableBit.mjDSBL_LIMIT)
    return spec.compile()


def urdf_model(text: bytes, machine: Machine) -> mujoco.MjModel:
    """Return MuJoCo's model of a URDF, with the motors, gravity and step that such a file lacks."""
    module = mujoco_module()
    compiled(text)  # refused with MuJoCo's reason
    spec = module.MjSpec.from_string(text.decode())
    spec.option.timestep, spec.option.gravity = STEP, machine.gravity
    for name in machine.mechanism.driven:
        motor = spec.add_actuator(name=name, target=name, trntype=module.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    return spec.compile()


def joint_places(model: mujoco.MjModel, joints: Sequence[str]) -> tuple[list[int], list[int]]:
    """Return where joints are in qpos and in qvel.

    Raises:
        IdentError: for a joint that the model does not have.
    """
    names = [model.joint(j).name for j in range(model.njnt)]
    for name in joints:
        if name not in names:
            raise IdentError(f"the model has no joint '{name}'; {one_of(name, names)}")
    at = [names.index(name) for name in joints]
    return [int(model.jnt_qposadr[j]) for j in at], [int(model.jnt_dofadr[j]) for j in at]


def simulated(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, control: np.ndarray,
    before: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return qpos (n + 1, nq) and qvel (n + 1, nv) of n steps with a control (n, nu).

    Actuators with a delay begin with the controls (m, nu) that `before` gives at times (m,) [s]
    below zero, or else with zeros.
    """
    module = mujoco_module()
    data = module.MjData(model)
    for i, (count, *_) in enumerate(getattr(model, "actuator_history", ())):
        if count and before is not None:
            times = model.opt.timestep * np.arange(-int(count), 0)
            past = np.ascontiguousarray(before(times)[:, i : i + 1])
            module.mj_initCtrlHistory(model, data, i, times[:, None], past)
    data.qpos[:], data.qvel[:] = qpos, qvel
    q, v = np.empty((len(control) + 1, model.nq)), np.empty((len(control) + 1, model.nv))
    q[0], v[0] = qpos, qvel
    step, current = module.mj_step, data.ctrl
    for k, now in enumerate(control):
        current[:] = now
        step(model, data)
        q[k + 1], v[k + 1] = data.qpos, data.qvel
    return q, v


def urdf_as_moved(text: bytes, machine: Machine) -> bytes:
    """Return a URDF whose joints are those of the machine: locked ones are fixed; without shapes,
    whose meshes may be missing.
    """
    root = etree.fromstring(text, etree.XMLParser(resolve_entities=False, huge_tree=False))
    for element in [*root.iter("visual", "collision")]:
        element.getparent().remove(element)
    for joint in root.iter("joint"):
        if joint.get("type") and joint.get("name") not in machine.by_joint:
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    result: bytes = etree.tostring(root)
    return result


def replayed(
    text: bytes | Path, machine: Machine, motion: Motion, window: float
) -> list[ReplayedLog]:
    """Return the written model's motion on every log, restarted from the measured state each
    `window` [s], as `ident.replay` does; driven by the log's torques, or by its commands where the
    model has drives.
    """
    if isinstance(text, bytes) and b"<robot" in text:
        model = urdf_model(urdf_as_moved(text, machine), machine)
    else:
        model = compiled(text)
    return [_replayed(model, machine, motion, e, window) for e in motion.experiments]


def _replayed(
    model: mujoco.MjModel, machine: Machine, motion: Motion, bare: State, window: float
) -> ReplayedLog:
    mechanism = machine.mechanism
    scene = Scene.of(mechanism, NOTHING, bare, machine.point, motion.band.cutoff)
    e = scene.e
    links = machine.links
    names = [link.joint.name for link in links]
    at_q, at_v = joint_places(model, names)
    offsets = np.array([link.offset for link in links])
    columns = [link.joint.index for link in links]
    control = _control(model, machine, e)
    logged = [mechanism.joint_index[name] for name in e.logged]
    tree = [mechanism.joint_index[name] for name in names]
    dt = float(model.opt.timestep)
    result, starts, failures = np.full(e.y.shape, np.nan), list[int](), list[str]()
    length = max(2, round(window * e.rate))
    for segment in e.segments():
        for a in range(segment.start, segment.stop - 1, length):
            starts.append(a)
            t = e.t[a : min(a + length, segment.stop - 1) + 1]
            qpos, qvel = np.zeros(model.nq), np.zeros(model.nv)
            qpos[at_q] = e.q[a, columns] - offsets
            qvel[at_v] = e.v[a, columns] - 0.5 * dt * e.a[a, columns]
            times = t[0] + dt * np.arange(int(np.ceil((t[-1] - t[0]) / dt - 1e-9)) + 1)
            q, v = simulated(model, qpos, qvel, control(times[:-1]), _earlier(control, times[0]))
            if not np.isfinite(q).all():
                failures.append(f"the model's motion is not finite after t = {t[0]:.4g} s")
                continue
            q, v = q[:, at_q] + offsets, v[:, at_v]
            result[a + 1 : a + len(t)][:, tree] = CubicHermiteSpline(times, q, v)(t[1:])
    joints = tuple(e.logged)
    units = tuple(mechanism.joints[i].unit for i in logged)
    measured = np.where(e.usable[:, None], e.y[:, logged], np.nan)
    return ReplayedLog(
        e.name, e.t, joints, units, measured, result[:, logged], tuple(starts),
        tuple(dict.fromkeys(failures)),
        result[:, tree_columns(mechanism)],
    )  # fmt: skip


def _earlier(control: Any, begin: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the controls at times before the begin of a run, which its clock has below zero."""
    return lambda times: np.asarray(control(begin + times))


def _control(model: mujoco.MjModel, machine: Machine, e: State) -> Any:
    """Return the control (n, nu) at times (n,): torques of the log, or commands of its drives."""
    mechanism, values = machine.mechanism, machine.values
    series: list[Any] = []
    for i in range(model.nu):
        joint = model.joint(int(model.actuator_trnid[i, 0])).name
        command = next(
            (word for kind, word in (("servo", "ref"), ("motor_current", "current"),
                                     ("motor_voltage", "voltage"))
             if (joint,) in values.get(kind, {})), None,
        )  # fmt: skip
        if command is not None:
            name = f"{command}.{joint}"
            if name not in e.extra:
                raise MotionError(
                    f"{e.name}: has no column '{name}', which the drive of '{joint}' follows"
                )
            straight = not e.extra.get(HOLD + joint, np.ones(1))[0]
            series.append((_straight if straight else _held)(e.t, e.extra[name]))
        elif joint in mechanism.driven:
            series.append(CubicSpline(e.t, e.tau[:, mechanism.driven.index(joint)]))
        else:
            series.append(np.zeros_like)
    return lambda t: np.stack([x(t) for x in series], axis=1) if series else np.zeros((len(t), 0))


def _held(t: np.ndarray, x: np.ndarray) -> Any:
    """Return a command that stays until its next sample."""
    return lambda now: x[np.clip(np.searchsorted(t, now + 1e-9, side="right") - 1, 0, len(x) - 1)]


def _straight(t: np.ndarray, x: np.ndarray) -> Any:
    """Return a command that goes straight on between samples."""
    return lambda now: np.interp(now, t, x)
