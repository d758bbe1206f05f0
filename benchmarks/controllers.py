"""Exported C for controllers: time of a call, flags, error, and FMUs.

    python benchmarks/controllers.py [--data DIR]

A Panda (example-robot-data, DIR as for `like.py`) with viscous and dry friction and rotors in its
seven joints; without it a chain of seven links that is written here. Best of nine rounds of 20,000
calls, compiled with `-O3`; the header itself compiles under the strict flags below. Errors are
against Pinocchio; the FMUs' are the largest difference of 0.5 s of motion from `ident.integrate`,
with the messages of FMPy's validation.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
from machines import SHARED
from real_export import torques_of_c
from replay_export import ROBOTS, robot

import ident
from ident import Mechanism, Torques
from ident.export.c import SMOOTH
from ident.export.export import export
from ident.log import Log

FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror")
CALLS = 20_000
BENCH = """#include <stdio.h>
#include <time.h>
#include "x.h"
int main(void)
{
    double q[x_DOF], v[x_DOF], a[x_DOF], out[10 * x_DOF * x_DOF], sum = 0;
    for (int f = 0; f < 3; f++) {
        double best = 1e9;
        for (int k = 0; k < 9; k++) {
            const clock_t begin = clock();
            for (int i = 0; i < CALLS; i++) {
                for (int j = 0; j < x_DOF; j++) {
                    q[j] = i * 1e-4 + j; v[j] = .5 * j; a[j] = .1 * j;
                }
                if (f == 0) x_inverse_dynamics(q, v, a, out);
                else if (f == 1) x_regressor(q, v, a, out);
                else x_gravity(q, out);
                sum += out[0];
            }
            const double us = (double)(clock() - begin) / CLOCKS_PER_SEC / CALLS * 1e6;
            if (us < best) best = us;
        }
        printf("%.3f ", best);
    }
    return sum > 1e300;
}
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        mechanism = robot("Panda", [*given.data, SHARED], folder) or ident.load(chain(folder))
        header(mechanism, folder)
    print("\n| FMU | FMI | messages of the validation | motion less ident's [rad] |")
    print("|---|---|---|---|")
    for name in ("arm", "four_bar", "five_bar"):
        for fmi in (2, 3):
            messages, error = fmu(name, fmi)
            print(f"| {name} | {fmi} | {messages or 'none'} | {error:.0e} |", flush=True)


def header(mechanism: Mechanism, folder: Path) -> None:
    """Print the row of the header."""
    for kind in ("viscous", "coulomb", "rotor_inertia"):
        mechanism = mechanism.with_effect(kind)
    random = np.random.default_rng(0)
    values = {n: float(random.uniform(0.1, 0.5)) for e in mechanism.effects for n in e.names}
    made = export(mechanism, "c", values=values, out=folder / "x.h")
    made.write()
    (folder / "strict.c").write_text('#include "x.h"\nint main(void) { return x_DOF == 0; }\n')
    subprocess.run(["gcc", *FLAGS, "-o", "strict", "strict.c", "-lm"], cwd=folder, check=True)
    (folder / "bench.c").write_text(BENCH)
    options = ["-std=gnu99", "-O3", f"-DCALLS={CALLS}"]
    subprocess.run(["gcc", *options, "-o", "bench", "bench.c", "-lm"], cwd=folder, check=True)
    times = subprocess.run(["./bench"], cwd=folder, check=True, capture_output=True, text=True)
    states = random.normal(size=(3, 200, mechanism.model.nv))
    tau, right = torques_of_c(folder, *states), np.empty(states[0].shape)
    data = mechanism.model.createData()
    Fv, Fc, Ia = (np.array([values[f"{kind}.{j}.{p}"] for j in mechanism.driven]) for kind, p in
                  (("viscous", "Fv"), ("coulomb", "Fc"), ("rotor_inertia", "Ia")))  # fmt: skip
    for i, (q, v, a) in enumerate(zip(*states, strict=True)):
        rigid = pin.rnea(mechanism.model, data, q, v, a)
        right[i] = rigid + Fv * v + Fc * np.tanh(v / SMOOTH) + Ia * a
    heap = "yes" if "malloc" in made.text else "no"
    microseconds = " | ".join(f"{float(x):.2f}" for x in times.stdout.split())
    print("| joints | inverse dynamics | regressor | gravity [µs] | error | heap | size | flags |")
    print("|---|---|---|---|---|---|---|---|")
    print(
        f"| {mechanism.model.nv} | {microseconds} | {np.abs(tau - right).max():.0e} N m | {heap} | "
        f"{len(made.text) / 1000:.0f} kB | {' '.join(FLAGS)} |"
    )


def chain(folder: Path) -> Path:
    """Seven links, each across the one before."""
    links = ['<robot name="chain"><link name="l0"/>']
    for k in range(1, 8):
        axis = ("0 0 1", "0 1 0", "1 0 0")[k % 3]
        links.append(
            f'<link name="l{k}"><inertial><origin xyz=".01 .02 .15"/><mass value="{8 - k}"/>'
            '<inertia ixx=".03" iyy=".04" izz=".02" ixy=".001" ixz=".002" iyz=".001"/></inertial>'
            f'</link><joint name="j{k}" type="revolute"><parent link="l{k - 1}"/>'
            f'<child link="l{k}"/><origin xyz="0 .02 .3" rpy=".1 .2 .3"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="99" velocity="9"/></joint>'
        )
    path = folder / "chain.urdf"
    path.write_text("".join([*links, "</robot>"]))
    return path


def fmu(name: str, fmi: int) -> tuple[str, float]:
    """Messages of FMPy, and the largest difference of the motion under constant torques."""
    import fmpy
    from fmpy.validation import validate_fmu

    mechanism = ident.load(ROBOTS / name)
    for kind in ("viscous", "coulomb"):
        mechanism = mechanism.with_effect(kind)
    values = {full: 0.05 for e in mechanism.effects for full in e.names}
    joints, t = list(mechanism.driven), np.linspace(0, 0.5, 51)
    with tempfile.TemporaryDirectory() as place:
        made = export(mechanism, "fmu", values=values, out=Path(place) / "x.fmu", fmi=fmi)
        (path,) = made.write()
        messages = validate_fmu(str(path))
        kinds = [("time", float), *((f"tau.{j}", float) for j in joints)]
        signals = np.array([(x, *[0.3] * len(joints)) for x in (0.0, 1.0)], dtype=kinds)
        result = fmpy.simulate_fmu(
            str(path), stop_time=0.5, output_interval=0.01, input=signals,
            fmi_type="CoSimulation", output=[f"q.{j}" for j in joints],
        )  # fmt: skip
    columns = {f"tau.{j}": np.full(51, 0.3) for j in joints}
    columns |= {f"q.{j}": np.full(51, mechanism.assembled[mechanism.joint(j).index])
                for j in joints}  # fmt: skip
    log = Log.from_arrays("constant", t, columns)
    run = ident.integrate(mechanism, Torques(log), values=values, rate=100.0)
    off = [np.interp(t, result["time"], result[f"q.{j}"]) - run.y[:, mechanism.joint_index[j]]
           for j in joints]  # fmt: skip
    return "; ".join(messages), float(np.abs(off).max())


if __name__ == "__main__":
    main()
