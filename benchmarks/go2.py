"""The legs of a Unitree Go2 from its commands: error of held-out motion, and what `grow` names.

    python benchmarks/go2.py [--data DIR] [grow]

The log is public: git clone https://github.com/iit-DLSLab/sim2real-robot-identification, commit
06739ea (`datasets/go2/traj_0.pt`, `robot_model/go2/go2.xml`). The clone is looked for in DIR and
in the folder of shared data; without it nothing runs. kp = 20 N m/rad and kd = 1.5 N m s/rad are
known, as are the bodies (of the MJCF), and the base is fixed. Fitted: friction, rotors and torque
offsets of 12 joints and the delay, on the first half; played from one start to its end: the second.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

import ident
from ident.formats.torch_log import read_torch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
from machines import SHARED, Checkout, located  # noqa: E402

SOURCE, COMMIT = "iit-DLSLab/sim2real-robot-identification", "06739ea"
JOINTS = tuple(
    f"{leg}_{joint}_joint" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")
)
EFFECTS = ("coulomb", "viscous", "rotor_inertia", "torque_offset")
ALL = 60.0  # [s] longer than half of the log: one window


def halves(folder: Path, checkout: Checkout) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return the first and the second half of the log."""
    path = folder / "traj_0.pt"
    path.write_bytes(checkout.read("datasets/go2/traj_0.pt"))
    x = read_torch(path).columns
    columns = {"t": x["time"]}
    for i, joint in enumerate(JOINTS):
        columns |= {f"q.{joint}": x[f"dof_pos.{i}"], f"ref.{joint}": x[f"des_dof_pos.{i}"]}
    log = pl.DataFrame(columns)
    return log[: len(log) // 2], log[len(log) // 2 :]


def legs(folder: Path, checkout: Checkout) -> ident.Mechanism:
    """Return the robot with its base fixed, and what is unknown."""
    xml = checkout.read("robot_model/go2/go2.xml").decode()
    path = folder / "go2.xml"
    path.write_text(re.sub(r"<freejoint/>|<keyframe>.*?</keyframe>", "", xml, flags=re.S))
    robot = ident.load(path)
    known = replace(robot, unknown=robot.bodies.select([], "benchmark"))
    mechanism = known.with_drives("kp=20,kd=1.5")
    for effect in EFFECTS:
        mechanism = mechanism.with_effect(effect)
    return mechanism


def played(fit: ident.Fit, log: pl.DataFrame, title: str) -> None:
    """Print the rms error of a log that is played from its start to its end."""
    motion = ident.complete(fit.mechanism, log, cutoff=fit.motion.band.cutoff)
    (run,) = next(iter(ident.replay(fit, motion=motion, window=ALL).runs.values()))
    errors = 1e3 * np.array([run.errors[joint].rms for joint in JOINTS])
    words = " ".join(f"{error:.1f}" for error in errors)
    print(f"{title}: {np.sqrt(np.mean(errors**2)):.2f} mrad rms ({words})", *run.failures)


def main() -> None:
    """Fit, play, diagnose and grow."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", action="append", type=Path, default=[])
    parser.add_argument("way", nargs="?", choices=("grow",))
    given = parser.parse_args()
    clone = located(SOURCE, [*given.data, SHARED])
    if clone is None:
        print(f"no clone of github.com/{SOURCE}: give --data, the folder that holds it")
        return
    checkout = Checkout(clone, COMMIT)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first, second = halves(folder, checkout)
        mechanism = legs(folder, checkout)
        begin = time.process_time()
        motion = ident.complete(mechanism, first)
        fit = ident.identify(mechanism, motion)
        print(f"fitted in {time.process_time() - begin:.2f} s of processor time")
        played(fit, second, "held out")
        begin = time.process_time()
        diagnosis = ident.diagnose(fit)
        print(f"diagnosed in {time.process_time() - begin:.1f} s: {diagnosis.verdict}")
        if given.way:
            begin = time.process_time()
            grown = ident.grow(mechanism, motion)
            print(grown)
            print(f"grown in {time.process_time() - begin:.1f} s")
            played(grown.fit, second, "grown, held out")


if __name__ == "__main__":
    main()
