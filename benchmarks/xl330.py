"""A Dynamixel XL330 from goals and positions alone: mean error at gains that were not fitted.

    python benchmarks/xl330.py [--data DIR]

The logs are public: git clone https://github.com/Rhoban/bam, the parent of commit 2f67dc6
(`bam/data.bak/raw/2026-01-15_….json`): a mass of 0.49 kg at 0.1 m, four motions at each of four
gains of the firmware. The clone is looked for in DIR and in the folder of shared data; without it
nothing runs. Fitted: gains 100 and 400; played from one start to its end: 200 and 800. The mass is
known, and that the duty is 0.00288 a rad and unit of gain (the encoder's 4096 counts a turn over
256 · 885), at most 1, so that the limit of the torque follows from a first fit.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

import ident

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
from machines import SHARED, Checkout, located  # noqa: E402

SOURCE, COMMIT, FOLDER = "Rhoban/bam", "2f67dc6^", "bam/data.bak/raw"
FITTED, HELD_OUT = (100, 400), (200, 800)
FULL = 4096 / (2 * np.pi) / (256 * 885)  # duty a rad of 1 of the gain
EFFECTS = ("coulomb", "viscous", "rotor_inertia")
ALL = 60.0  # [s] longer than any log: one window
URDF = f"""<robot name="xl330"><link name="base"/><link name="arm"><inertial>
<origin xyz="0.1 0 0"/><mass value="0.49"/>
<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="servo" type="revolute"><parent link="base"/><child link="arm"/>
<origin xyz="0 0 0" rpy="0 {np.pi / 2} 0"/><axis xyz="0 0 1"/>
<limit lower="-6.3" upper="6.3" effort="100" velocity="30"/></joint></robot>"""


def logs_of(checkout: Checkout) -> dict[int, list[pl.DataFrame]]:
    """Return the logs by gain."""
    command = ["git", "-C", str(checkout.folder), "ls-tree", "-r", "--name-only"]
    listing = [*command, checkout.commit, FOLDER]
    names = subprocess.run(listing, check=True, capture_output=True, text=True).stdout.split()
    logs: dict[int, list[pl.DataFrame]] = {}
    for name in names:
        x = json.loads(checkout.read(name))
        keys = ("timestamp", "position", "goal_position", "torque_enable")
        t, q, goal, on = (np.array([float(row[key]) for row in x["entries"]]) for key in keys)
        columns = {"t": t, "q.servo": q, "ref.servo": goal, "on.servo": on}
        gain = np.full(len(t), float(x["kp"]))
        logs.setdefault(x["kp"], []).append(pl.DataFrame({**columns, "kp.servo": gain}))
    return logs


def fitted(mechanism: ident.Mechanism, logs: list[pl.DataFrame]) -> ident.Fit:
    """Return the fit within the limit that a first one shows."""
    options: tuple[str, ...] = ("servo",)
    for _ in range(2):
        model = mechanism.with_drives(*options)
        for effect in EFFECTS:
            model = model.with_effect(effect)
        fit = ident.identify(model, ident.complete(model, logs))
        limit = fit.point.values["servo.servo.kp"] / FULL
        options = ("servo", f"servo:limit={limit}")
    return fit


def played(fit: ident.Fit, logs: list[pl.DataFrame], title: str) -> None:
    """Print the mean absolute error of logs that are played from their start to their end."""
    errors = []
    for log in logs:
        motion = ident.complete(fit.mechanism, log, cutoff=fit.motion.band.cutoff)
        (run,) = next(iter(ident.replay(fit, motion=motion, window=ALL).runs.values()))
        errors.append(float(np.nanmean(np.abs(run.simulated - run.measured))))
        print(*run.failures, end="")
    words = " ".join(f"{error:.3f}" for error in errors)
    print(f"{title}: {np.mean(errors):.4f} rad ({words})")


def main() -> None:
    """Fit, grow and play."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", action="append", type=Path, default=[])
    clone = located(SOURCE, [*parser.parse_args().data, SHARED])
    if clone is None:
        print(f"no clone of github.com/{SOURCE}: give --data, the folder that holds it")
        return
    logs = logs_of(Checkout(clone, COMMIT))
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "xl330.urdf"
        path.write_text(URDF)
        arm = ident.load(path)
        mechanism = replace(arm, unknown=arm.bodies.select([], "benchmark"))
        train = [log for gain in FITTED for log in logs[gain]]
        fit = fitted(mechanism, train)
        grown = ident.grow(fit.mechanism, fit.motion)
        print(grown)
        for title, model in (("dry and viscous friction", fit), ("grown", grown.fit)):
            played(model, train, f"{title}, fitted gains")
            played(model, [x for gain in HELD_OUT for x in logs[gain]], f"{title}, held out")


if __name__ == "__main__":
    main()
