"""A simulated log against Pinocchio and MuJoCo, its noise, and what cannot be simulated."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import ident
from helpers import ROBOTS, J, Truth, series, tree_urdf, write_mechanism
from ident import Log, MechanismError, MotionError, Noise
from identification import motion_log, robot

# --- torques -----------------------------------------------------------------------------------


def test_torques_of_the_arm_are_pinocchios(robots):
    log, said = ident.simulate(robot("arm"), motion_log("arm", 100.0))
    model = pin.buildModelFromUrdf(str(robots / "arm" / "arm.urdf"))
    data = model.createData()
    names = list(model.names)[1:]
    q, v, a = (np.stack([log.columns[f"{c}.{n}"] for n in names], axis=1) for c in "qva")
    tau = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    for i, name in enumerate(names):
        np.testing.assert_allclose(log.columns[f"tau.{name}"], tau[:, i], atol=1e-11)
    np.testing.assert_array_equal(said.measured, 0 * said.measured)  # nothing was measured


def test_a_motion_is_given_as_any_log_is(tmp_path):
    motion = motion_log("arm", 100.0)
    motion.write(tmp_path / "motion.csv")
    of_log, of_path = (
        ident.simulate(robot("arm"), given, noise=[Noise("tau", 0.1)], seed=3)[0]
        for given in (motion, str(tmp_path / "motion.csv"))
    )
    for name, x in of_log.columns.items():
        np.testing.assert_allclose(of_path.columns[name], x, atol=1e-9)


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "slider_crank"])
def test_torques_of_loops_do_the_work_of_the_open_tree(name):
    """d'Alembert: drives and open tree do the same work along what the loop can do, ẏ = Z u̇."""
    mechanism = robot(name)
    motion = motion_log(name, 100.0, 2.0)
    log, said = ident.simulate(mechanism, motion)
    truth = Truth(name)
    t, q, v, a = series(name, 100.0, 2.0)
    Q, V, A = truth.complete(t, q, v, a)
    order = sorted(truth.index, key=truth.index.get)
    q, v, a = (np.stack([x[j] for j in order], axis=1) for x in (Q, V, A))
    tau = np.array([pin.rnea(truth.model, truth.data, *s) for s in zip(q, v, a, strict=True)])
    power = (tau * v).sum(axis=1)
    drives = sum(log.columns[f"tau.{n}"] * V[n] for n in mechanism.driven)
    np.testing.assert_allclose(drives, power, atol=1e-9 * np.abs(power).max())
    if name == "four_bar":  # its closure's rows are not those of `Truth`
        return
    for i in range(0, len(t), 20):  # with the multipliers every row is balanced: Γp + Jᵀλ = τ
        _, jacobian, _ = truth.rows(q[i], v[i])
        applied = np.zeros(len(order))
        for n in mechanism.driven:
            applied[truth.index[n]] = log.columns[f"tau.{n}"][i]
        total = tau[i] + jacobian.T @ said.multipliers[i]
        np.testing.assert_allclose(total, applied, atol=1e-9 * np.abs(tau[i]).max())


EFFECTS = {
    "viscous.a.Fv": 0.3, "viscous.b.Fv": 0.7, "coulomb.a.Fc": 0.4, "coulomb.s.Fc": 0.6,
    "rotor_inertia.b.Ia": 0.05, "rotor_inertia.s.Ia": 0.8, "spring.a.k": 2.0, "spring.a.b": 0.0,
    "spring.s.k": 30.0, "spring.s.b": 0.0,
}  # fmt: skip


def test_torques_of_a_tree_with_effects_are_mujocos(tmp_path):
    """Damping, dry friction, armature and stiffness of MuJoCo's inverse dynamics."""
    mujoco = pytest.importorskip("mujoco")
    joints = [
        J("a", axis="0 1 0"), J("b", axis="1 0 0", parent="a"),
        J("s", "prismatic", "0 1 1", parent="b"), J("c", axis="0 0 1", parent="a"),
    ]  # fmt: skip
    urdf = tree_urdf(joints, seed=8)
    mechanism = ident.load(write_mechanism(tmp_path, urdf))
    for label in dict.fromkeys(":".join(name.split(".")[:2]) for name in EFFECTS):
        mechanism = mechanism.with_effect(label)
    rng = np.random.default_rng(3)
    t, columns = np.arange(300) / 100, {}
    for joint in ("a", "b", "s", "c"):
        w, phase = rng.uniform(2, 6, 2), rng.uniform(0, 6, 2)
        angle = np.outer(t, w) + phase
        columns[f"q.{joint}"] = 0.3 * np.sin(angle).sum(axis=1)
        columns[f"v.{joint}"] = 0.3 * np.cos(angle) @ w
        columns[f"a.{joint}"] = -0.3 * np.sin(angle) @ w**2
    log, _ = ident.simulate(mechanism, Log.from_arrays("log", t, columns), values=EFFECTS)

    model = mujoco.MjModel.from_xml_string(urdf)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.dof_solref[:, 0] = 1e-4  # friction turns with the direction of motion, at once
    model.opt.timestep = 1e-5
    at = {joint: model.joint(joint).dofadr[0] for joint in ("a", "b", "s", "c")}
    for name, value in EFFECTS.items():
        kind, joint, word = name.split(".")
        i = at[joint]
        if kind == "viscous":
            model.dof_damping[i] = value
        elif kind == "coulomb":
            model.dof_frictionloss[i] = value
        elif kind == "rotor_inertia":
            model.dof_armature[i] = value
        elif word == "k":
            model.jnt_stiffness[model.joint(joint).id] = value
    model.qpos_spring[:] = 0.0
    data = mujoco.MjData(model)
    tau = {joint: np.empty(len(t)) for joint in at}
    for k in range(len(t)):
        for joint, i in at.items():
            data.qpos[i], data.qvel[i], data.qacc[i] = (
                columns[f"{c}.{joint}"][k] for c in "qva"
            )  # fmt: skip
        mujoco.mj_inverse(model, data)
        for joint, i in at.items():
            tau[joint][k] = data.qfrc_inverse[i]
    for joint in at:
        speed = np.abs(columns[f"v.{joint}"])
        moving = speed > 0.02 * speed.max()  # at standstill dry friction is open
        scale = np.abs(tau[joint]).max()
        found = log.columns[f"tau.{joint}"]
        np.testing.assert_allclose(found[moving], tau[joint][moving], atol=2e-6 * scale)


def test_parameters_may_be_given_by_name_or_all():
    arm, motion = robot("arm"), motion_log("arm", 50.0, 1.0)
    pi = arm.prior.copy()
    pi[arm.bodies.names.index("hand.m")] += 0.5
    one, _ = ident.simulate(arm, motion, values={"hand.m": pi[30]})
    other, _ = ident.simulate(arm, motion, pi=pi)
    prior, _ = ident.simulate(arm, motion)
    for name, x in one.columns.items():
        np.testing.assert_array_equal(x, other.columns[name])
    assert np.abs(one.columns["tau.elbow"] - prior.columns["tau.elbow"]).max() > 0.1


def test_a_surplus_drive_does_what_the_log_says():
    mechanism = robot("slider_crank")
    motion = motion_log("slider_crank", 100.0, 2.0)
    idle, still = ident.simulate(mechanism, motion)
    push = Log.from_arrays(
        "push", motion.t, dict(motion.columns) | {"tau.s": 0.5 * np.sin(6 * motion.t)}
    )
    pushed, _ = ident.simulate(mechanism, push)
    np.testing.assert_array_equal(pushed.columns["tau.s"], push.columns["tau.s"])
    np.testing.assert_array_equal(idle.columns["tau.s"], 0 * idle.columns["tau.s"])
    e = ident.complete(mechanism, motion, cutoff=None, torques=False).experiments[0]
    lever = e.leverage[:, mechanism.joint_index["s"], 0]
    found = pushed.columns["tau.theta"] + lever * pushed.columns["tau.s"]
    np.testing.assert_allclose(found, idle.columns["tau.theta"], atol=1e-12)
    assert still.multipliers.shape == (len(motion.t), 3)


# --- noise, columns ----------------------------------------------------------------------------


def test_noise_has_its_level():
    arm, motion = robot("arm"), motion_log("arm", 250.0, 20.0)
    clean, _ = ident.simulate(arm, motion)
    noise = [Noise("tau", 0.05, relative=True), Noise("q", 1e-3), Noise("v.elbow", 0.2)]
    noisy, _ = ident.simulate(arm, motion, noise=noise, seed=4)
    for name, x in clean.columns.items():
        off = noisy.columns[name] - x
        level = {"tau": 0.05 * x.std(), "q": 1e-3}.get(name.split(".")[0], 0.0)
        level = 0.2 if name == "v.elbow" else level
        assert off.std() == pytest.approx(level, rel=0.05)
        assert abs(off.mean()) <= 5 * level / np.sqrt(len(off))
    offs = [noisy.columns[f"tau.{j}"] - clean.columns[f"tau.{j}"] for j in ("yaw", "elbow")]
    assert abs(np.corrcoef(offs)[0, 1]) < 0.06  # each column has noise of its own


def test_noise_is_the_seeds():
    arm, motion = robot("arm"), motion_log("arm", 50.0, 1.0)
    logs = [
        ident.simulate(arm, motion, noise=[Noise("tau.*", 0.1)], seed=seed)[0] for seed in (1, 1, 2)
    ]
    tau = [log.columns["tau.yaw"] for log in logs]
    np.testing.assert_array_equal(tau[0], tau[1])
    assert np.abs(tau[0] - tau[2]).max() > 0.01


def test_the_prediction_is_free_of_noise():
    arm, motion = robot("arm"), motion_log("arm", 50.0, 1.0)
    clean, _ = ident.simulate(arm, motion)
    _, said = ident.simulate(arm, motion, noise=[Noise("tau", 0.1)])
    for u, joint in enumerate(said.joints):
        np.testing.assert_array_equal(said.predicted[:, u], clean.columns[f"tau.{joint}"])


def test_columns_are_those_wanted():
    mechanism, motion = robot("five_bar"), motion_log("five_bar", 50.0, 1.0)
    log, _ = ident.simulate(mechanism, motion, columns=("q", "tau"), joints=["left", "left_elbow"])
    assert set(log.columns) == {"q.left", "q.left_elbow", "tau.left", "tau.right"}
    arm = robot("arm")  # a tree: what is left out, a hand perhaps, is not of this log
    log, _ = ident.simulate(
        arm, motion_log("arm", 50.0, 1.0), columns=("q", "tau"), joints=["yaw", "elbow"]
    )
    assert set(log.columns) == {"q.yaw", "q.elbow", "tau.yaw", "tau.elbow"}
    whole, _ = ident.simulate(mechanism, motion)
    assert set(whole.columns) == {
        f"{c}.{j}" for c in ("q", "v", "a", "tau") for j in ("left", "right")
    }
    again, _ = ident.simulate(mechanism, whole)  # a simulated log is a motion too
    np.testing.assert_allclose(again.columns["tau.left"], whole.columns["tau.left"], atol=1e-12)


def test_other_columns_are_passed_on():
    motion = motion_log("arm", 50.0, 1.0)
    warm = dict(motion.columns) | {"temperature.yaw": 20 + motion.t}
    log, _ = ident.simulate(robot("arm"), Log.from_arrays("log", motion.t, warm))
    np.testing.assert_array_equal(log.columns["temperature.yaw"], warm["temperature.yaw"])


# --- what is refused ---------------------------------------------------------------------------


def test_an_effect_without_a_value_is_refused():
    arm = robot("arm").with_effect("viscous:elbow")
    with pytest.raises(MechanismError, match=r"give viscous\.elbow\.Fv a value"):
        ident.simulate(arm, motion_log("arm", 50.0, 1.0))
    given = robot("arm") + ident.effect("viscous", "elbow", {"Fv": 0.3})
    log, _ = ident.simulate(given, motion_log("arm", 50.0, 1.0))
    same, _ = ident.simulate(arm, motion_log("arm", 50.0, 1.0), values={"viscous.elbow.Fv": 0.3})
    np.testing.assert_array_equal(log.columns["tau.elbow"], same.columns["tau.elbow"])


@pytest.mark.parametrize("name", ["viscous.elbow.Fv", "hand.mass", "hand.Lxq", "nothing"])
def test_a_value_of_nothing_is_refused(name):
    with pytest.raises(MechanismError, match=f"no parameter '{name}'"):
        ident.simulate(robot("arm"), motion_log("arm", 50.0, 1.0), values={name: 1.0})


def test_a_passive_independent_coordinate_is_refused(robots):
    pendulum = ident.load(robots / "pendulum")
    with pytest.raises(MotionError, match="passive"):
        ident.simulate(pendulum, motion_log("pendulum", 50.0, 1.0))
    idle = replace(robot("arm"), driven=("yaw", "shoulder", "elbow"), passive=("wrist",))
    with pytest.raises(MotionError, match="'wrist' is passive"):
        ident.simulate(idle, motion_log("arm", 50.0, 1.0))


def test_wrong_columns_joints_and_noise_are_refused():
    arm, motion = robot("arm"), motion_log("arm", 50.0, 1.0)
    with pytest.raises(MotionError, match="'torque'"):
        ident.simulate(arm, motion, columns=("torque",))
    with pytest.raises(MechanismError, match="no joint 'elbo'"):
        ident.simulate(arm, motion, joints=["elbo"])
    with pytest.raises(MotionError, match=r"no column 'tau\.elbo'"):
        ident.simulate(arm, motion, noise=[Noise("tau.elbo", 0.1)])


def test_the_load_of_a_joint_has_the_bodies_that_links_carry():
    """Of friction that depends on it, as if the body were the link's own."""
    arm, motion = robot("arm").with_effect("load_friction:elbow"), motion_log("arm", 100.0, 2.0)
    body, friction = {"m": 0.4, "mx": 0.02, "Lyy": 3e-3}, {"load_friction.elbow.mu": 0.06}
    names = ("m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")
    carried = {f"payload.hand.{name}": body.get(name, 0.0) for name in names}
    own = dict(zip(arm.bodies.names, arm.prior, strict=True))
    heavier = {f"hand.{name}": own[f"hand.{name}"] + x for name, x in body.items()}
    with_body, as_link = (
        ident.simulate(model, motion, values={**friction, **values})[0].columns["tau.elbow"]
        for model, values in ((arm.with_effect("payload:hand"), carried), (arm, heavier))
    )
    np.testing.assert_allclose(with_body, as_link, atol=1e-9)


def test_a_motion_with_holes_is_refused():
    motion = motion_log("arm", 100.0, 3.0)
    keep = (motion.t < 1.0) | (motion.t > 1.5)
    holed = Log.from_arrays("log", motion.t[keep], {k: x[keep] for k, x in motion.columns.items()})
    with pytest.raises(MotionError):
        ident.simulate(robot("arm"), holed)


def test_a_motion_of_noisy_positions_is_followed_between_its_spline_ends():
    mechanism = ident.load(ROBOTS / "arm")
    motion = ident.read_log(ROBOTS / "arm" / "run.csv")
    made, prediction = ident.simulate(mechanism, motion)
    assert 0.9 * len(motion.t) < len(made.t) == len(prediction.t) < len(motion.t)
    assert any("where splines end" in note for note in made.repairs)


def test_a_value_of_an_effect_that_the_model_has_not_says_how_to_add_it():
    mechanism, motion = robot("arm"), motion_log("arm", 100.0)
    with pytest.raises(MechanismError, match="--with coulomb:elbow, or"):
        ident.simulate(mechanism, motion, values={"coulomb.elbow.Fc": 0.1})
    with pytest.raises(MechanismError, match="--with gravity_tilt, or"):
        ident.simulate(mechanism, motion, values={"gravity_tilt.x": 0.1})
    for name in ("coulomb.elbow.Fx", "coulomb.elbo.Fc", "coulomb", "hand.mm"):
        with pytest.raises(MechanismError, match=f"no parameter '{name}'; "):
            ident.simulate(mechanism, motion, values={name: 0.1})
