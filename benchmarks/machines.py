"""Real machines: published errors, those of the defaults, those of the grown model, its effects.

    python benchmarks/machines.py [--data DIR]… [--picture FILE] [NAME …]

Looks for measurements in DIR, in $IDENT_DATA and in ../shared/data beside the checkout: folders of
shared data, and clones of the public repositories that the converters in `machines/` name. Each
machine runs in a process of its own, with BLAS on one thread. Errors are of the torque below the
cut-off of the published ones, or else of the fit, ‖τ − τ̂‖/‖τ‖ of each joint in % on the
validation logs, or held out in time without any, in motion; in brackets with rows of standstill, at
which dry friction is open, and of the whole vector of torques. `by hand`: the defaults' errors with
the one of some training cut-offs that serves the joints best, judged in the same band; `possible
bodies`: with --consistent. The picture has a panel a machine: published errors, those of the
defaults, those of the grown model.
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
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from machines import SHARED, located
from matplotlib.patches import Patch

import ident

NAMES = (
    "tx40", "kr300", "kr300_slow", "panda", "lwr4", "ur10e", "baxter", "xl330", "airbot", "ur10",
    "xmate",
)  # fmt: skip
COLUMNS = (
    "machine", "published", "viscous + Coulomb", "by hand", "possible bodies", "grown", "effects",
    "time", "memory",
)  # fmt: skip
BY_HAND = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0)  # times the cut-off of the defaults


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=f"of {', '.join(NAMES)}; default: all")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options.names[0], options.one)))
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
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if run.returncode:
            print(f"| {name} | failed: {run.stderr.strip().splitlines()[-1]} |", flush=True)
            continue
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


def measured(name: str, source: Path) -> dict[str, Any]:
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
        history = ident.grow(bare, motion, validate=judged)
        spent = time.process_time() - begin
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # without those by hand
        fits = [defaults] if judged is None or band is None else [
            ident.identify(plain, ident.complete(bare, list(machine.train), cutoff=k * band),
                           validate=judged)
            for k in BY_HAND
        ]  # fmt: skip
    best = min(fits, key=misfit)
    chosen = "" if best is defaults else f"{best.motion.band.cutoff:.3g} Hz: "
    return {
        "viscous + Coulomb": errors(defaults),
        "by hand": "–" if judged is None else chosen + errors(best).split(" (")[0],
        "possible bodies": errors(possible).split(" (")[0],
        "grown": errors(history.fit),
        "bars": {
            title: [100 * e.relative for e in by_joint(fit)]
            for title, fit in (("defaults", defaults), ("grown", history.fit))
        },
        "effects": ", ".join(effect.label for effect in history.added),
        "time": f"{spent:.0f} s",
        "memory": f"{memory:.2f} GB",
    }


def by_joint(fit: Any) -> list[Any]:
    """Errors of all joints in the first validation log, or held out in time."""
    logs = list(fit.validation.values())
    return list((logs[0] if logs else fit.held_out).values())


def misfit(fit: Any) -> float:
    """Mean logarithm of the relative errors of all joints."""
    return float(np.mean([np.log(error.relative) for error in by_joint(fit)]))


def errors(fit: Any) -> str:
    """Relative errors in motion [%], and with standstill: of all joints, of the whole vector."""
    joints, whole = by_joint(fit), [error.with_standstill for error in by_joint(fit)]
    moving, every = (
        " ".join(f"{100 * error.relative:.3g}" for error in each) for each in (joints, whole)
    )
    squares = np.array([(e.rms**2, (e.rms / e.relative) ** 2) for e in whole]).sum(axis=0)
    vector = 100 * np.sqrt(squares[0] / squares[1])
    return f"{moving} (with standstill {every}, whole vector {vector:.3g})"


if __name__ == "__main__":
    main()
