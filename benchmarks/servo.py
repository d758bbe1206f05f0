"""Servos without torque sensors: errors and cover of gains, friction, rotors and delay.

    python benchmarks/servo.py [LOGS]

LOGS (default 20) logs of MuJoCo's servos on `robots/servo_arm`: delays 0, 4, 8, 12 and 20 ms,
encoders of 12 and 14 bits in turn, planted values of each log drawn 30 % around those of
`tests/truth/servo_logs.py`, seeds from 1000 on, which nothing was tuned with. Two ways: bodies
known, and the last body known. Printed: median of |error| over logs and joints, the share of 95 %
intervals that contain the truth, and the error of held-out commands played.
"""

from __future__ import annotations

import sys
import time
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

import ident
from ident.errors import IdentError

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "truth")]
from servo_logs import Servos, servo_log  # noqa: E402

ARM = ROOT / "robots" / "servo_arm"
JOINTS = ("yaw", "shoulder", "elbow")
DELAYS = (0.0, 0.004, 0.008, 0.012, 0.020)  # s
SPREAD = 0.3  # of planted values
COVER = 1.96


def planted(number: int) -> tuple[Servos, int]:
    """Return the planted values and the encoder's bits of a log."""
    rng, usual = np.random.default_rng(1000 + number), Servos()
    draw = {
        name: tuple(np.array(getattr(usual, name)) * rng.uniform(1 - SPREAD, 1 + SPREAD, 3))
        for name in ("kp", "kd", "Fc", "Fv", "Ia")
    }
    return Servos(**draw, delay=DELAYS[number % len(DELAYS)]), (12, 14)[number % 2]


def truths(truth: Servos) -> dict[str, float]:
    """Return true values by name; kd is the sum with viscous friction, which is one column."""
    values = {"command_delay.yaw,shoulder,elbow.d": truth.delay}
    for i, joint in enumerate(JOINTS):
        values |= {
            f"servo.{joint}.kp": truth.kp[i], f"servo.{joint}.kd": truth.kd[i] + truth.Fv[i],
            f"coulomb.{joint}.Fc": truth.Fc[i], f"rotor_inertia.{joint}.Ia": truth.Ia[i],
        }  # fmt: skip
    return values


def models() -> dict[str, ident.Mechanism]:
    """Return the mechanism with what is known of it."""
    known = ident.load(ARM).with_calibration("exact")
    links = [link for link in known.bodies.links if link != "forearm"]
    last = replace(known, unknown=known.bodies.select(links, "benchmark"))
    return {"bodies known": known, "last body known": last}


def main() -> None:
    """Run all logs and print the table."""
    numbers = [int(x) for x in sys.argv[1:] if x.isdigit()]
    count = numbers[0] if numbers else 20
    off = defaultdict(lambda: defaultdict(list))
    inside = defaultdict(lambda: defaultdict(list))
    seconds, failed = defaultdict(list), defaultdict(list)
    replays = []
    for number in range(count):
        truth, bits = planted(number)
        frame = pl.DataFrame(servo_log(truth, 1000 + number, bits=bits))
        other = pl.DataFrame(servo_log(truth, 5000 + number, seconds=6.0, bits=14))
        for way, mechanism in models().items():
            begin = time.process_time()
            try:
                fit = ident.identify(mechanism, ident.complete(mechanism, frame))
            except IdentError as error:
                failed[way].append(str(error)[:90])
                continue
            seconds[way].append(time.process_time() - begin)
            found = {p.name: p for effect in fit.effects for p in effect.parameters}
            for name, value in truths(truth).items():
                p = found[name]
                if p.stderr is None:  # not determined by this log, and not claimed
                    failed[way].append(f"{name} has no error")
                    continue
                kind = name.rpartition(".")[2]
                error = p.value - value
                off[way][kind].append(1e3 * error if kind == "d" else 100 * error / value)
                inside[way][kind].append(abs(error) <= COVER * p.stderr)
            if way == "bodies known" and number < 5:
                motion = ident.complete(fit.mechanism, other)
                played = ident.replay(fit, motion=motion, window=1.0)
                errors = next(iter(played.runs.values()))[0].errors
                replays.append([1e3 * errors[joint].rms for joint in JOINTS])
    print(f"{count} logs of 20 s, 200 Hz, seeds 1000 to {1000 + count - 1}")
    print("median |error| in % (delay in ms), and share of 95 % intervals with the truth")
    for way in off:
        cells = [
            f"{kind} {np.median(np.abs(off[way][kind])):.2g} ({np.mean(inside[way][kind]):.0%})"
            for kind in ("kp", "Fc", "kd", "Ia", "d")
        ]
        every = np.mean(np.concatenate([*inside[way].values()]))
        print(f"{way:16s} " + "  ".join(cells) + f"  all ({every:.0%})   "
              f"{np.median(seconds[way]):.2g} s a log")  # fmt: skip
        for why, times in Counter(failed[way]).items():
            print(f"                 ! {why}, {times} times")
    if replays:
        text = " ".join(f"{x:.3f}" for x in np.median(replays, axis=0))
        print(f"held-out replay, windows of 1 s against 14 bit encoders: {text} mrad by joint")


if __name__ == "__main__":
    main()
