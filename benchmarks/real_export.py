"""Torques of real machines by exported C and by MuJoCo's inverse dynamics of the exported file.

    python benchmarks/real_export.py [--data DIR]… [NAME …]

DIR as for `machines.py`. Each machine is identified with viscous and dry friction, rotors, the
effects of its sensors, and Stribeck friction of two joints and a ripple of the first one, which
MuJoCo has no words for; of the TX40 the coupling of its wrist as well. The motion is that of its
validation log. By joint, in N m: rms of the torque that `ident` predicts, of C less that, of MuJoCo
less that, and what the list of the export says is lost there. C on samples in which the joint turns
by more than 0.05 rad/s, as its dry friction is smooth below that; MuJoCo on those above the log's
speed of standstill.
"""

from __future__ import annotations

import ctypes
import importlib
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from machines import arguments, located

import ident
from ident.export.export import Export, export
from ident.export.mjcf import bias_of
from ident.export.rollout import compiled, joint_places
from ident.fit.prediction import predict

NAMES = ("tx40", "ur10e", "lwr4")
MORE = {"tx40": ("coupling:joint_5,joint_6",)}
SLOW = 0.05  # [rad/s] below which dry friction is left out
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
CALL = """#include "x.h"
void torques(const double *q, const double *v, const double *a, double *tau, int n);
void torques(const double *q, const double *v, const double *a, double *tau, int n)
{
    for (int i = 0; i < n; i++) {
        const int k = i * x_DOF;
        x_inverse_dynamics(q + k, v + k, a + k, tau + k);
    }
}
"""


def main() -> None:
    names, places = arguments(__doc__, NAMES)
    print("| machine, joint | predicted | C − ident | MuJoCo − ident | the list says | lost |")
    print("|---|---|---|---|---|---|")
    for name in names:
        module = importlib.import_module(f"machines.{name}")
        source = located(module.SOURCE, places)
        if source is None:
            print(f"| {name} | no {module.SOURCE} | | | | |")
            continue
        with tempfile.TemporaryDirectory() as folder:
            for row in rows(name, module.convert(source, Path(folder)), Path(folder)):
                print(f"| {name} {' | '.join(row)} |", flush=True)


def rows(name: str, machine: object, folder: Path) -> list[list[str]]:
    """A row a joint."""
    mechanism = ident.load(machine.mechanism)
    for effect in machine.effects:
        mechanism = mechanism.with_effect(effect)
    stribeck = [f"stribeck:{joint}:vs=0.1" for joint in mechanism.driven[1:3]]
    ripple = f"ripple:{mechanism.driven[0]}:N=6"
    for effect in ("viscous", "coulomb", "rotor_inertia", ripple, *stribeck, *MORE.get(name, ())):
        mechanism = mechanism.with_effect(effect)
    fit = ident.identify(mechanism, ident.complete(mechanism, list(machine.train)))
    log = machine.validate or machine.train
    motion = ident.complete(mechanism, list(log[:1]), cutoff=fit.motion.band.cutoff or "none")
    c = export(fit, "c", log=motion, out=folder / "x.h")
    mjcf = export(fit, "mjcf", log=motion, fitted=False, out=folder / "x.xml")
    for made in (c, mjcf):
        made.write()
    result, lost = [], mjcf.lost
    (prediction,) = predict(mjcf.machine.mechanism, motion, mjcf.machine.point)
    e = prediction.scene.e
    by_c, by_mujoco = torques_of_c(folder, e.q, e.v, e.a), torques_of_mujoco(mjcf, e.q, e.v, e.a)
    coupled = {joint for effect in mechanism.effects if effect.kind == "coupling"
               for joint in effect.joints}  # fmt: skip
    for u, joint in enumerate(prediction.joints):
        k = mechanism.joint(joint).index
        speeds = [e.v[:, k]]
        if joint in coupled:
            speeds.append(e.v[:, [mechanism.joint(x).index for x in coupled]].sum(axis=1))
        speed = np.abs(speeds).min(axis=0)
        turns, moves = e.usable & (speed > SLOW), e.usable & (speed > e.still[k])
        here = [item for item in lost if item.where == joint]
        right = prediction.predicted[:, u]
        sizes = [right[turns], (by_c[:, k] - right)[turns], (by_mujoco[:, k] - right)[moves]]
        said = float(np.sqrt(sum(item.torque**2 for item in here)))
        cells = [f"{np.sqrt(np.mean(x**2)):.3g}" for x in sizes] + [f"{said:.3g}"]
        result.append([joint, *cells, ", ".join(item.label for item in here) or "–"])
    return result


def torques_of_c(folder: Path, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques (n, joints) by the compiled header `x.h`."""
    (folder / "x.c").write_text(CALL)
    command = ["gcc", *FLAGS, "-shared", "-fPIC", "-o", "x.so", "x.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    function = ctypes.CDLL(str(folder / "x.so")).torques
    series = [np.ascontiguousarray(x) for x in (q, v, a)]
    tau = np.empty(q.shape)
    function(*(x.ctypes.data_as(ctypes.c_void_p) for x in (*series, tau)), len(q))
    return tau


def torques_of_mujoco(made: Export, *state: np.ndarray) -> np.ndarray:
    """Torques (n, joints) that the file's actuators are asked for, by mj_inverse."""
    links: Sequence = made.machine.links
    model = compiled(made.text.encode())
    at_q, at_v = joint_places(model, [link.joint.name for link in links])
    order = [link.joint.index for link in links]
    laws = [made.translation.laws[link.joint.name] for link in links]
    constant, gain = np.array([bias_of(x) for x in laws]), np.array([x.gain for x in laws])
    data, tau = mujoco.MjData(model), np.empty(state[0].shape)
    for i, (q, v, a) in enumerate(zip(*state, strict=True)):
        data.qpos[at_q], data.qvel[at_v], data.qacc[at_v] = q[order], v[order], a[order]
        mujoco.mj_inverse(model, data)
        tau[i, order] = (data.qfrc_inverse[at_v] + constant) / gain
    return tau


if __name__ == "__main__":
    main()
