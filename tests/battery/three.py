"""Three effects of one joint, drawn at random: does `grow` find all three?

python tests/battery/three.py [--logs 16]
"""

from __future__ import annotations

import argparse
import random
import tempfile
from pathlib import Path

from cases import Case, effects
from generate import make
from judge import read

import ident

KINDS = (
    "coulomb", "viscous", "spring", "torque_offset", "stribeck", "ripple", "hysteresis", "drag",
    "end_stop", "rotor_inertia", "delay", "drift",
)  # fmt: skip
JOINTS = {"arm3": ("shoulder", "elbow"), "arm6": ("joint_2", "joint_3", "joint_4")}
HIDDEN = ("rotor_inertia", "shoulder")  # no data of the arm shows it
SEED = 9000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--logs", type=int, default=16)
    found = list(map(all_found, range(count := parser.parse_args().logs)))
    print(f"{sum(found)} of {count}")


def all_found(number: int) -> bool:
    choice = random.Random(SEED + number)
    mechanism = choice.choice(list(JOINTS))
    joint = choice.choice(JOINTS[mechanism])
    kinds = [k for k in choice.sample(KINDS, 4) if (k, joint) != HIDDEN][:3]
    labels = {f"{kind}:{joint}" for kind in kinds}
    (hidden,) = effects(" + ".join(sorted(labels)))
    noise, motion = (0.01, 0.03)[number % 2], 71 + number % 5
    case = Case("three", "two", mechanism, hidden, 1.0, noise, 1e-3, motion, SEED + number)
    made = make(case)
    with tempfile.TemporaryDirectory() as folder:
        model = ident.load(made.folder(Path(folder)))
        history = ident.grow(model, ident.complete(model, read(made.logs)))
    added = [effect.label for effect in history.added]
    print(
        f"{number:3d} {'ok' if labels <= set(added) else '--'} {sorted(labels)} {added}", flush=True
    )
    return labels <= set(added)


if __name__ == "__main__":
    main()
