"""Real machines: published errors, those of the defaults, those of the grown model, its effects.

    python benchmarks/machines.py [--data DIR]… [NAME …]

Looks for measurements in DIR, in $IDENT_DATA and in ../shared/data beside the checkout: folders of
shared data, and clones of the public repositories that the converters in `machines/` name. Each
machine runs in a process of its own, with BLAS on one thread. Errors are of the torque below the
cut-off, ‖τ − τ̂‖/‖τ‖ of each joint in % on the validation logs, or held out in time without any;
`whole`: of the whole vector; `moving`: without rows of standstill, at which dry friction is open.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from machines import located

import ident

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("tx40", "kr300", "panda", "lwr4", "ur10e", "baxter", "xl330")
COLUMNS = ("machine", "published", "viscous + Coulomb", "grown", "effects", "time", "memory")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=f"of {', '.join(NAMES)}; default: all")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options.names[0], options.one)))
        return
    places = [*options.data, Path(os.environ.get("IDENT_DATA", ROOT.parent / "shared" / "data"))]
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
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


def measured(name: str, source: Path) -> dict[str, Any]:
    """The row of one machine."""
    with tempfile.TemporaryDirectory() as folder:
        machine = importlib.import_module(f"machines.{name}").convert(source, Path(folder))
        bare = ident.load(machine.mechanism)
        for effect in machine.effects:
            bare = bare.with_effect(effect)
        begin = time.process_time()
        motion = ident.complete(bare, list(machine.train))
        cutoff = motion.band.cutoff or "auto"  # one band, else errors are no measure
        judged = None
        if machine.validate:
            judged = ident.complete(bare, list(machine.validate), cutoff=cutoff)
        plain = bare.with_effect("viscous").with_effect("coulomb")
        defaults = ident.identify(plain, motion, validate=judged)
        history = ident.grow(bare, motion, validate=judged)
    return {
        "viscous + Coulomb": errors(defaults, judged),
        "grown": errors(history.fit, judged),
        "effects": ", ".join(effect.label for effect in history.added),
        "time": f"{time.process_time() - begin:.0f} s",
        "memory": f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB",
    }


def errors(fit: Any, judged: Any) -> str:
    """Relative errors of all joints [%], of the whole vector, and of all joints in motion."""
    logs = list(fit.validation.values())
    joints = (logs[0] if logs else fit.held_out).values()
    each = " ".join(f"{100 * error.relative:.3g}" for error in joints)
    squares = np.array([(e.rms**2, (e.rms / e.relative) ** 2) for e in joints]).sum(axis=0)
    found = f"{each} (whole {100 * np.sqrt(squares[0] / squares[1]):.3g}"
    if judged is None:
        return found + ")"
    traces = ident.compare(fit, motion=judged).residuals.popitem()[1].traces
    part = [
        sum(
            np.where(trace.informed, x**2, 0.0).sum(axis=0)
            for trace, x in zip(traces, of, strict=True)
        )
        for of in ([t.residual for t in traces], [t.measured for t in traces])
    ]
    moving = " ".join(f"{100 * x:.3g}" for x in np.sqrt(part[0] / part[1]))
    return f"{found}; moving {moving})"


if __name__ == "__main__":
    main()
