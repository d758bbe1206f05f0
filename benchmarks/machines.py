"""Real machines: published errors, those of the defaults, those of the grown model, its effects.

    python benchmarks/machines.py [--data DIR]… [--picture FILE] [NAME …]

Looks for measurements in DIR, in $IDENT_DATA and in ../shared/data beside the checkout: folders of
shared data, and clones of the public repositories that the converters in `machines/` name. Each
machine runs in a process of its own, with BLAS on one thread. Errors are of the torque below the
cut-off of the published ones, or else of the fit, ‖τ − τ̂‖/‖τ‖ of each joint in % on the
validation logs, or held out in time without any, in motion; in brackets with rows of standstill, at
which dry friction is open, and of the whole vector of torques. `possible bodies`: with
--consistent. With --by-hand the defaults' errors with the one of some training cut-offs that serves
the joints best, judged in the same band. `grown` never saw the validation logs. Of its ladder:
`last / best`, by joint, the error of the last rung there over that of the best rung; `test / held
out`, the geometric mean over joints of the error there over the held-out one, and the joint with
the largest ratio; `weak`, effects none of whose values is three standard errors of
noise from zero, or whose torque is below 1 % of each joint's. The picture has a panel a machine:
published errors, those of the defaults, those of the grown model.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from machines import SHARED, located
from matplotlib.patches import Patch

import ident

NAMES = (
    "tx40", "kr300", "kr300_slow", "panda", "lwr4", "ur10e", "baxter", "xl330", "airbot", "ur10",
    "xmate", "tiago", "mtm", "mtm_poses", "psm", "psm_whole",
    "double_pendulum",
)  # fmt: skip
COLUMNS = (
    "machine", "published", "viscous + Coulomb", "by hand", "possible bodies", "grown", "effects",
    "last / best", "test / held out", "weak", "time", "memory",
)  # fmt: skip
BY_HAND = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0)  # times the cut-off of the defaults


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=f"of {', '.join(NAMES)}; default: all")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    parser.add_argument("--by-hand", action="store_true")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options.names[0], options.one, options.by_hand)))
        return
    places = [*options.data, SHARED]
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    bars: dict[str, dict[str, list[float]]] = {}
    for name in options.names or NAMES:
        module = importlib.import_module(f"machines.{name}")
        source = located(module.SOURCE, places)
        if source is None:
            print(f"| {name} | no {module.SOURCE} in {', '.join(map(str, places))} |", flush=True)
            continue
        command = [sys.executable, __file__, "--one", str(source), name]
        command += ["--by-hand"] if options.by_hand else []
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if run.returncode:
            print(f"| {name} | failed: {run.stderr.strip().splitlines()[-1]} |", flush=True)
            continue
        sys.stderr.write(run.stderr)  # errors of all rungs
        row = json.loads(run.stdout.splitlines()[-1])
        cells = (name, module.PUBLISHED, *(str(row[key]) for key in COLUMNS[2:]))
        print(f"| {' | '.join(cells)} |", flush=True)
        bars[name] = row["bars"]
        published = re.findall(r"\d+\.\d+", module.PUBLISHED)
        if len(published) == len(row["bars"]["defaults"]):
            bars[name] = {"published": [float(x) for x in published], **row["bars"]}
    if options.picture and bars:
        drawn(bars, options.picture)


def drawn(bars: dict[str, dict[str, list[float]]], path: Path) -> None:
    """Errors [%] of each machine's joints."""
    colours = {"published": "0.75", "defaults": "tab:orange", "grown": "tab:blue"}
    figure, panels = plt.subplots(
        1 + len(bars) // 2, 2, figsize=(9, 2 * (1 + len(bars) // 2)), squeeze=False
    )
    for panel in panels.flat[len(bars) :]:
        panel.axis("off")
    for panel, (name, sets) in zip(panels.flat, bars.items(), strict=False):
        for k, (title, values) in enumerate(sets.items()):
            at = np.arange(1, len(values) + 1) + (k - (len(sets) - 1) / 2) * 0.27
            panel.bar(at, values, 0.25, color=colours[title], label=title)
        panel.set(title=name, ylabel="error [%]", xlabel="joint")
        panel.set_xticks(range(1, 1 + len(sets["grown"])))
    names = [Patch(color=colour, label=title) for title, colour in colours.items()]
    panels.flat[-1].legend(handles=names, loc="center", frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=70)


def measured(name: str, source: Path, by_hand: bool) -> dict[str, Any]:
    """The row of one machine."""
    with tempfile.TemporaryDirectory() as folder:
        module = importlib.import_module(f"machines.{name}")
        machine = module.convert(source, Path(folder))
        bare = ident.load(machine.mechanism)
        for effect in machine.effects:
            bare = bare.with_effect(effect)
        begin = time.process_time()
        motion = ident.complete(bare, list(machine.train))
        band = motion.band.cutoff
        cutoff = getattr(module, "BAND", band) or "auto"  # one band, else errors are no measure
        judged = None
        if machine.validate:
            judged = ident.complete(bare, list(machine.validate), cutoff=cutoff)
        plain = bare.with_effect("viscous").with_effect("coulomb")
        defaults = ident.identify(plain, motion, validate=judged)
        possible = ident.identify(plain, motion, validate=judged, consistent=True)
        history = ident.grow(bare, motion)
        spent = time.process_time() - begin
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # without what follows
        rungs = models(history, motion, judged)
        fits = [defaults] if judged is None or band is None or not by_hand else [
            ident.identify(plain, ident.complete(bare, list(machine.train), cutoff=k * band),
                           validate=judged)
            for k in BY_HAND
        ]  # fmt: skip
    best = min(fits, key=misfit)
    chosen = "" if best is defaults else f"{best.motion.band.cutoff:.3g} Hz: "
    return {
        "viscous + Coulomb": errors(defaults),
        "by hand": chosen + errors(best).split(" (")[0] if chosen else "–",
        "possible bodies": errors(possible).split(" (")[0],
        "grown": errors(rungs[-1]),
        **ladder(rungs, judged is not None),
        "weak": ", ".join(weak(history)) or "–",
        "bars": {
            title: [100 * share for share in shares(fit)]
            for title, fit in (("defaults", defaults), ("grown", rungs[-1]))
        },
        "effects": f"{len(history.added)}: {', '.join(e.label for e in history.added)}",
        "time": f"{spent:.0f} s",
        "memory": f"{memory:.2f} GB",
    }


def models(history: Any, motion: Any, judged: Any) -> list[Any]:
    """Fits of all rungs, those that `grow` announced as well, with errors on the validation logs;
    only the last without any.
    """
    model, fits = history.steps[0].fit.mechanism, []
    for step in history.steps:
        for effect in step.removed:
            model = model.without(effect.label)
        for effect in step.added:
            model = model + effect
        if step is history.steps[-1]:
            model = step.fit.mechanism
        if step is history.steps[-1] or judged is not None:
            start = step.fit.point if step.fit else None
            fits.append(
                ident.identify(
                    model, motion, validate=judged, start=start, estimator="least-squares"
                )
            )
    return fits


def ladder(fits: Sequence[Any], judged: bool) -> dict[str, str]:
    """What rungs say of a log that was never seen."""
    if not judged:
        return {"last / best": "–", "test / held out": "–"}
    joints = [joint for joint, e in fits[-1].held_out.items() if not e.unmeasured]
    rungs = np.array([shares(fit) for fit in fits])
    last = rungs[-1] / rungs.min(axis=0)
    held_out = np.array(shares(fits[-1], measured_joints(fits[-1].held_out)))
    optimism = rungs[-1] / held_out
    for fit, errors in zip(fits, rungs, strict=True):
        print(len(fit.mechanism.effects), *(f"{100 * e:.3g}" for e in errors), file=sys.stderr)
    print("held out", *(f"{100 * e:.3g}" for e in held_out), file=sys.stderr)
    worst = int(optimism.argmax())
    return {
        "last / best": " ".join(f"{x:.2f}" for x in last),
        "test / held out": f"{np.exp(np.log(optimism).mean()):.2f}, "
        f"{joints[worst]} {optimism[worst]:.2f}",
    }


def weak(history: Any) -> list[str]:
    """Labels of added effects that no value or no torque carries."""
    fit, labels = history.fit, {effect.label for effect in history.added}
    parts, found = fit.residual.parts, []
    for e in fit.logged_effects:
        sizes = [abs(v.value) / v.stderr for v in e.parameters if v.stderr]
        torque = parts.get(e.effect.label, parts["measured"])
        share = np.max(torque / np.maximum(parts["measured"], 1e-300))
        if e.effect.label in labels and (max(sizes, default=0.0) < 3 or share < 0.01):
            found.append(f"{e.effect.label} ({max(sizes, default=0.0):.1f} s.e., {share:.1%})")
    return found


def by_joint(fit: Any) -> list[Any]:
    """Errors of all measured joints in the first validation log, or held out in time."""
    logs = list(fit.validation.values())
    return measured_joints(logs[0] if logs else fit.held_out)


def measured_joints(errors: Mapping[str, Any]) -> list[Any]:
    """Errors of the joints whose torque is logged."""
    return [error for error in errors.values() if not error.unmeasured]


def shares(fit: Any, errors: Sequence[Any] | None = None) -> list[float]:
    """Errors of all joints over their torque, of those without over gravity's torque in the fit."""
    errors = by_joint(fit) if errors is None else errors
    sizes = np.mean([np.mean(trace.gravity**2, axis=0) for trace in fit.residual.traces], axis=0)
    gravity = dict(zip(fit.motion.independent, np.sqrt(sizes), strict=True))
    joints = [joint for joint, e in fit.held_out.items() if not e.unmeasured]
    return [
        e.rms / gravity[joint] if e.relative is None else e.relative
        for joint, e in zip(joints, errors, strict=True)
    ]


def misfit(fit: Any) -> float:
    """Mean logarithm of the relative errors of all joints."""
    return float(np.mean(np.log(shares(fit))))


def errors(fit: Any) -> str:
    """Relative errors in motion [%], and with standstill: of all joints, of the whole vector; of a
    machine that swings freely, shares of gravity's torque.
    """
    whole = [error.with_standstill for error in by_joint(fit)]
    moving, every = (
        " ".join(f"{100 * share:.3g}" for share in shares(fit, each)) for each in (None, whole)
    )
    if any(error.relative is None for error in whole):
        return f"{moving} (with standstill {every})"
    squares = np.array([(e.rms**2, (e.rms / e.relative) ** 2) for e in whole]).sum(axis=0)
    vector = 100 * np.sqrt(squares[0] / squares[1])
    return f"{moving} (with standstill {every}, whole vector {vector:.3g})"


if __name__ == "__main__":
    main()
