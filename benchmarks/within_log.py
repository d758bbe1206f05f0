"""Changes within a log: six kinds, ten seeds each, and what `diagnose` says of them.

    python benchmarks/within_log.py [--seeds 10] [--kind KIND …]

An arm of four joints with known kinds of friction, 8 s at 100 Hz, noise of 1 % of each torque. At a
time between a third and two thirds of the log

    tool        a load on the last link is taken off
    exchange    two torque channels are exchanged
    brake       dry friction of a joint rises by 40 to 100 % of its torque's fifth
    push        a joint is pushed for 0.5 to 1 s
    warming     the offset of a torque channel grows from then on
    joined      another run begins, of another load and another friction

Named: the kind and, within 0.3 s, the time.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path

import numpy as np

import ident
from ident.diagnosis.changes import CODE

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from identification import motion_log, plant, robot

KINDS = ("tool", "exchange", "brake", "push", "warming", "joined")
RATE, SECONDS = 100.0, 8.0
SENSORS = (ident.Noise("tau", 0.01, relative=True), ident.Noise("q", 1e-5))
WITHIN = 0.3  # s


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--kind", action="append", choices=KINDS)
    options = parser.parse_args()
    print("| change | kind | time too | said otherwise |\n|---|---|---|---|")
    begin = time.process_time()
    for kind in options.kind or KINDS:
        right, at, others = 0, 0, []
        for seed in range(options.seeds):
            words, when, text = diagnosed(kind, seed)
            good = any(word in text for word in words)
            found = re.search(r"t = ([0-9.]+)", text)
            near = found is not None and abs(float(found[1]) - when) < WITHIN
            right, at = right + good, at + (good and near)
            if not (good and near):
                others.append(f"{text or 'nothing'} for {words[0]} at {when:.2f}")
        counts = f"{right}/{options.seeds} | {at}/{options.seeds}"
        print(f"| {kind} | {counts} | {'; '.join(others) or '–'} |", flush=True)
    print(f"\n{time.process_time() - begin:.0f} s of processor time.")


def diagnosed(kind: str, seed: int) -> tuple[tuple[str, ...], float, str]:
    """Return what the change may be called, its time, and what is said of it; "" if nothing."""
    random = np.random.default_rng([KINDS.index(kind), seed])
    model = robot("arm").with_effect("viscous").with_effect("coulomb")
    values = {name: random.uniform(0.2, 0.6) for e in model.effects for name in e.names}
    when = SECONDS * random.uniform(1 / 3, 2 / 3)
    joints = model.driven
    joint = joints[random.integers(len(joints))]
    before = after = model
    then = dict(values)
    load = model.with_effect("payload:hand")
    tool = {f"payload.hand.{n}": x for n, x in zip(
        ("dm", "dmx", "dmy", "dmz", "dLxx", "dLyy", "dLzz", "dLxy", "dLxz", "dLyz"),
        (random.uniform(0.3, 1.0), *random.uniform(-0.05, 0.05, 3), *[0.001] * 3, *[0.0] * 3),
        strict=True)}  # fmt: skip
    words: tuple[str, ...] = (f"coulomb:{joint}",)
    if kind == "tool":
        before, words = load, ("payload:hand",)
    elif kind == "brake":
        then[f"coulomb.{joint}.Fc"] += random.uniform(0.4, 1.0)
    elif kind == "joined":
        after, words = load, ("payload:hand", f"coulomb:{joint}")
        then[f"coulomb.{joint}.Fc"] += 0.3
    waves = motion_log("arm", RATE, SECONDS)

    def logged(mechanism: ident.Mechanism, numbers: dict[str, float]) -> ident.Log:
        known = {n: x for n, x in (tool | numbers).items() if n in
                 {name for e in mechanism.effects for name in e.names}}  # fmt: skip
        return plant(mechanism, waves, known, noise=SENSORS, seed=seed).log

    one, two = logged(before, values), logged(after, then)
    t, late = one.t, one.t >= when
    columns = {n: np.where(late, two.columns[n], x) if n.startswith("tau.") else x
               for n, x in one.columns.items()}  # fmt: skip
    torque = columns[f"tau.{joint}"]
    size = float(np.sqrt(np.mean(torque**2)))
    if kind == "push":
        columns[f"tau.{joint}"] = torque + 0.5 * size * (
            late & (t < when + random.uniform(0.5, 1.0))
        )
        words = (f"a push on {joint}",)
    elif kind == "warming":
        columns[f"tau.{joint}"] = torque + 0.3 * size * np.maximum(t - when, 0.0)
        words = (f"tau.{joint} drifts",)
    elif kind == "exchange":
        other = joints[(joints.index(joint) + 1) % len(joints)]
        for a, b in ((joint, other), (other, joint)):
            columns[f"tau.{a}"] = np.where(late, two.columns[f"tau.{b}"], one.columns[f"tau.{a}"])
        words = (f"{joint} and {other} are exchanged", f"{other} and {joint} are exchanged")
    log = ident.Log.from_arrays("run.csv", t, columns)
    diagnosis = ident.diagnose(ident.identify(model, ident.complete(model, log)))
    texts = (str(finding) for finding in diagnosis.health.findings if finding.code == CODE)
    return words, when, next(texts, "")


if __name__ == "__main__":
    main()
