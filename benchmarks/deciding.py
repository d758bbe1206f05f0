"""Which of the named numbers decide anything: each is halved and doubled, and logs are fitted anew.

    python benchmarks/deciding.py [PACKAGE ...]       all kernel packages, or some (fit motion …)

Four logs with noise: an arm; the same with jittering stamps, encoders of 12 bit and a model without
dry friction; a five-bar; the slider-crank of the paper. A number decides where a base parameter
moves by more than a tenth of its standard error, a standard error changes by 5 %, an error by 2 %,
or where another finding is made. What decides on broken data alone is not among them: for numbers
of a diagnosis see ablation.py. Prints a Markdown row for each that decides, and their count. Needs
a system with fork.
"""

from __future__ import annotations

import ast
import importlib
import os
import pickle
import pkgutil
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

import numpy as np
from inside import ROOT, modules, named_numbers

import ident

SECONDS = 60  # after which a changed number counts as one that ends in an error
KERNEL = ("information", "log", "motion", "equations", "fit")
ROBOTS = ROOT / "robots"
Case = tuple[str, ident.Mechanism, ident.Log]
Outcome = tuple[dict[str, tuple[float, float]], list[float], set[str]]


def cases() -> list[Case]:
    """The logs and their models."""
    arm = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")
    values = {name: 0.3 for effect in arm.effects for name in effect.names}
    noise = [ident.Noise("tau", 0.01, True), ident.Noise("q", 2e-4)]
    run = ident.read_log(ROBOTS / "arm" / "run.csv")
    log, _ = ident.simulate(arm, run, values=values, columns=["q", "tau"], seed=1, noise=noise)
    shift = np.random.default_rng(0).uniform(-0.3, 0.3, len(log.t)) * np.median(np.diff(log.t))
    step = 2 * np.pi / 2**12
    poor = {
        name: np.round(np.interp(log.t + shift, log.t, x) / step) * step if name[0] == "q" else x
        for name, x in log.columns.items()
    }
    found = [("arm", arm, log)]
    bare = ident.load(ROBOTS / "arm").with_effect("viscous")
    found.append(("jitter", bare, ident.Log.from_arrays("jitter", log.t, poor)))
    for name, noises in (
        ("five_bar", [ident.Noise("tau", 0.02, True), ident.Noise("q", 1e-4)]),
        ("slider_crank", [ident.Noise(each, 0.01, True) for each in ("q", "v", "a", "tau")]),
    ):
        mechanism, run = ident.load(ROBOTS / name), ident.read_log(ROBOTS / name / "run.csv")
        columns = sorted({each.channel for each in noises})
        made, _ = ident.simulate(mechanism, run, columns=columns, seed=1, noise=noises)
        found.append((name, mechanism, made))
    return found


def outcome(mechanism: ident.Mechanism, log: ident.Log) -> Outcome:
    """Base parameters with standard errors, errors, and codes of findings."""
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    base = {x.name: (float(x.value), float(x.stderr or 0.0)) for x in fit.base_parameters}
    codes = {each.code for each in fit.all_findings if each.code != "note"}
    return base, [each.rms for each in fit.train.values()], codes


def difference(a: Outcome, b: Outcome | str) -> str:
    """What another outcome has that is different; empty for nothing that matters."""
    if isinstance(b, str):
        return b
    if {*a[0]} != {*b[0]}:
        return "other base parameters"
    if a[2] != b[2]:
        return f"findings {', '.join(sorted(a[2] ^ b[2]))}"
    pairs = [(a[0][name], b[0][name]) for name in a[0]]
    moved = max((abs(y - x) / max(s, 1e-300) for (x, s), (y, _) in pairs), default=0.0)
    wider = max((abs(np.log((t + 1e-300) / (s + 1e-300))) for (_, s), (_, t) in pairs), default=0.0)
    errors = max(abs(np.log((y + 1e-300) / (x + 1e-300))) for x, y in zip(a[1], b[1], strict=True))
    if moved > 0.1:
        return f"values by {moved:.2g} standard errors"
    if wider > 0.05:
        return f"standard errors by {100 * wider:.0f} %"
    return f"errors by {100 * errors:.0f} %" if errors > 0.02 else ""


def outcomes(logs: list[Case], change: Callable[[], object]) -> list[Outcome | str]:
    """The outcomes of all logs in a process of its own in which something was changed."""
    reading, writing = os.pipe()
    if not (child := os.fork()):
        signal.alarm(SECONDS)
        change()
        found: list[Outcome | str] = []
        for _, mechanism, log in logs:
            try:
                found.append(outcome(mechanism, log))
            except Exception as error:
                found.append(f"{type(error).__name__}: {error}"[:60])
        with os.fdopen(writing, "wb") as stream:
            pickle.dump(found, stream)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        content = stream.read()
    os.waitpid(child, 0)
    return list(pickle.loads(content)) if content else ["no end"] * len(logs)


def numbers(packages: list[str]) -> Iterator[tuple[str, str, Any, list[str]]]:
    """Module, name and value of every named number but those of rounding and display, and the
    modules that have it.
    """
    users = dict[tuple[str | None, str], list[str]]()
    for module, (_, tree) in modules().items():
        for node in tree.body:
            for each in node.names if isinstance(node, ast.ImportFrom) else ():
                users.setdefault((node.module, each.name), []).append(module)
    for module, name, kind in named_numbers():
        if kind not in ("numerics", "shown") and module.split(".")[1] in packages:
            value = getattr(sys.modules[module], name)
            yield module, name, value, [module, *users.get((module, name), [])]


def scaled(value: Any, factor: float) -> Any:
    """A number, or all of several, times a factor."""
    if isinstance(value, tuple):
        return tuple(scaled(x, factor) for x in value)
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def put(modules: list[str], name: str, value: Any) -> None:
    """Give a name another value in some modules."""
    for module in modules:
        setattr(sys.modules[module], name, value)


def main() -> None:
    for each in pkgutil.walk_packages(ident.__path__, "ident."):
        if not each.name.endswith("__main__"):
            importlib.import_module(each.name)
    logs = cases()
    usual = outcomes(logs, lambda: None)
    count = deciding = 0
    print("| number | value | halved | doubled |\n|---|---|---|---|")
    for module, name, value, places in numbers(sys.argv[1:] or list(KERNEL)):
        cells = []
        for factor in (0.5, 2.0):
            found = outcomes(logs, partial(put, places, name, scaled(value, factor)))
            changes = [difference(a, b) for a, b in zip(usual, found, strict=True)]
            pairs = zip((each[0] for each in logs), changes, strict=True)
            cells.append("; ".join(f"{log}: {text}" for log, text in pairs if text))
        count += 1
        if any(cells):
            deciding += 1
            where = module.removeprefix("ident.")
            print(f"| {where}.{name} | {value} | {' | '.join(cells)} |", flush=True)
    print(f"\n{deciding} of {count} named numbers decide on these logs")


if __name__ == "__main__":
    main()
