"""A payload and a friction that change together: does `monitor` name both?

    python benchmarks/service.py [ROBOT …] [--seeds N]

After a service a tool is heavier and a joint rubs more. Of each robot one minute and twenty seconds
of normal running are the reference; then in each of N logs of 24 s a body of 0.5 to 1 kg is put on
the last link and dry friction of a joint grows by half, both at 8 s. Random sums of three sines a
joint, 100 Hz, positions and torques only, 1.5 % noise of torques. The arm is the one that is
shipped, the UR5 that of the package example-robot-data.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from robots import urdfs

import ident

ROOT = Path(__file__).resolve().parents[1]
RATE, BEGINS, SECONDS = 100.0, 8.0, 24.0  # Hz, s, s
FREQUENCIES, SWING = (0.3, 0.62, 1.06), 0.8  # Hz, rad
NOISE, ENCODER = 0.015, 2e-5  # of a torque's standard deviation; rad
MASSES, RISE = (0.5, 0.75, 1.0), 1.5  # kg; of the dry friction
CENTRE = np.array([0.0, 0.04, 0.05])  # m, of the body's mass in its link
GYRATION = 1e-3  # m², moment of inertia of the body about its centre by its mass


@dataclass(frozen=True)
class Robot:
    """A robot with friction: file, link that is loaded, by joint the middle of its motion [rad],
    viscous [N m s/rad] and dry friction [N m], and the logs of normal running [s].
    """

    file: str
    link: str
    joints: Mapping[str, tuple[float, float, float]]


ROBOTS = {
    "arm": Robot("arm.urdf", "hand", {
        "yaw": (0.0, 1.2, 2.0), "shoulder": (0.4, 1.5, 2.5), "elbow": (-0.8, 0.5, 0.9),
        "wrist": (0.0, 0.02, 0.04),
    }),
    "ur5": Robot("ur5_robot.urdf", "wrist_3_link", {
        "shoulder_pan_joint": (0.0, 8.0, 6.0), "shoulder_lift_joint": (-1.2, 8.0, 7.0),
        "elbow_joint": (1.3, 6.0, 5.0), "wrist_1_joint": (-0.8, 1.5, 1.2),
        "wrist_2_joint": (-1.2, 1.5, 1.2), "wrist_3_joint": (0.0, 1.0, 0.8),
    }),
}  # fmt: skip
RUBBING = 3  # joints, the first of each robot, whose friction changes


def loaded(name: str) -> tuple[ident.Mechanism, dict[str, float]]:
    """A robot with friction, and its true values."""
    robot = ROBOTS[name]
    shipped = ROOT / "robots" / name
    path = shipped if shipped.is_dir() else next(p for p in urdfs() if p.name == robot.file)
    mechanism = ident.load(path).with_effect("viscous").with_effect("coulomb")
    values = {}
    for joint, (_, viscous, dry) in robot.joints.items():
        values |= {f"viscous.{joint}.Fv": viscous, f"coulomb.{joint}.Fc": dry}
    return mechanism, values


def known(mechanism: ident.Mechanism, values: Mapping[str, float]) -> ident.Mechanism:
    """The same with nothing unknown."""
    effects = tuple(
        replace(e, values={e.parameters[0].name: values[e.names[0]]}) for e in mechanism.effects
    )
    return replace(mechanism, effects=effects, unknown=())


def motion_of(
    name: str,
    seed: int,
    seconds: float,
    label: str = "",
    changed: Mapping[str, float] | None = None,
) -> ident.Motion:
    """A noisy log; from `BEGINS` on with an effect and values beyond the usual ones."""
    mechanism, values = loaded(name)
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    columns = {}
    for joint, (centre, *_) in ROBOTS[name].joints.items():
        share, x = rng.uniform(0.5, 1.0, 3), np.full(len(t), centre)
        for a, f in zip(SWING * share / share.sum(), FREQUENCIES, strict=True):
            x = x + a * np.sin(2 * np.pi * (f * rng.uniform(0.85, 1.15) * t + rng.uniform()))
        columns[f"q.{joint}"] = x
    motion = ident.Log.from_arrays(f"{name}.csv", t, columns)
    log, _ = ident.simulate(mechanism, motion, values=values, columns=("q", "tau"))
    columns = dict(log.columns)
    sd = {key: NOISE * np.std(x) if key.startswith("tau") else ENCODER
          for key, x in columns.items()}  # fmt: skip
    if changed:
        other, given = mechanism.with_effect(label), {**values, **changed}
        after, _ = ident.simulate(other, motion, values=given, columns=("q", "tau"))
        columns = {key: np.where(log.t < BEGINS, x, after.columns[key])
                   for key, x in columns.items()}  # fmt: skip
    noisy = {key: x + sd[key] * rng.standard_normal(len(x)) for key, x in columns.items()}
    return ident.complete(
        mechanism, ident.Log.from_arrays(f"{name}.csv", log.t, noisy), cutoff=6.0, smoothing=0.12
    )


def body(m: float) -> dict[str, float]:
    """The ten parameters of the body that is put on the last link."""
    inertia = m * (GYRATION * np.eye(3) + CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
    names = ("Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")
    places = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    moments = dict(zip(("mx", "my", "mz"), (m * CENTRE).tolist(), strict=True))
    return {"m": m, **moments,
            **{n: float(inertia[at]) for n, at in zip(names, places, strict=True)}}  # fmt: skip


def studied(name: str, seeds: int) -> None:
    """Print a line a log, and how many of them have both names and no other."""
    mechanism, values = loaded(name)
    normal = [motion_of(name, seed, 40.0) for seed in (2, 3)]
    both = replace(normal[0], experiments=tuple(e for x in normal for e in x.experiments))
    reference = ident.Monitor.of(known(mechanism, values), both, patience=8.0)
    joints, link, right, begin = [*ROBOTS[name].joints], ROBOTS[name].link, 0, time.process_time()
    for seed in range(seeds):
        joint, m = joints[seed % RUBBING], MASSES[seed // RUBBING % len(MASSES)]
        planted = {f"payload:{link}", f"coulomb:{joint}"}
        dry = f"coulomb.{joint}.Fc"
        changed = {f"payload.{link}.{key}": x for key, x in body(m).items()}
        changed[dry] = RISE * values[dry]
        monitor = reference.fresh()
        motion = motion_of(name, 50 + seed, SECONDS, f"payload:{link}", changed)
        alarms = monitor.watch(motion) + monitor.finish()
        named = {part for x in alarms for label in x.suspects for part in label.split(" + ")}
        right += named == planted
        row = {"robot": name, "seed": seed, "joint": joint, "kg": m, "named": sorted(named)}
        print(json.dumps(row | {"right": named == planted}), flush=True)
    spent = time.process_time() - begin
    print(f"| {name} | {right} of {seeds} | {spent / seeds:.1f} s |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("robots", nargs="*", default=[*ROBOTS], metavar="ROBOT")
    parser.add_argument("--seeds", type=int, default=20)
    given = parser.parse_args()
    for name in given.robots:
        studied(name, given.seeds)


if __name__ == "__main__":
    main()
