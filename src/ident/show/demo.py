"""`ident demo`: a machine with a hidden effect, made from a seed, and how it is found.

The machine is simulated. What identification is given is what a user would have: a mechanism folder
whose URDF is some percent off, and a noisy log of the two drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from ident.diagnosis import Diagnosis, diagnose
from ident.effects import Effect
from ident.errors import IdentError
from ident.files import write_all
from ident.fit import Fit, identify
from ident.log import Log, read_log
from ident.mechanism import Mechanism, load
from ident.mechanism.write import add_effects
from ident.motion import complete
from ident.progress import Progress
from ident.show.residual import error_rows
from ident.show.simulate import csv_text
from ident.simulate import Noise, simulate
from ident.text import listed, percent, table, wrapped

Shower = Callable[[], AbstractContextManager[Progress]]
MACHINE = "picker"
SECONDS, STEP = 15.0, 0.004
NOISE = (Noise("q", 2e-5), Noise("tau", 0.01, relative=True))  # rad; share of the torque's rms
KNOWN = {
    "viscous.left.Fv": 0.03,
    "viscous.right.Fv": 0.025,
    "coulomb.left.Fc": 0.08,
    "coulomb.right.Fc": 0.06,
}
SECRETS: tuple[tuple[str, dict[str, tuple[float, float]]], ...] = (  # sizes from, to
    ("coulomb:left_elbow", {"Fc": (0.03, 0.07)}),
    ("coulomb:right_elbow", {"Fc": (0.03, 0.07)}),
    ("spring:right_elbow", {"k": (0.2, 0.4), "b": (-0.5, -0.2)}),
    ("ripple:left", {"A": (0.03, 0.07), "B": (-0.05, 0.05), "N": (12.0, 20.0)}),
    ("ripple:right", {"A": (0.03, 0.07), "B": (-0.05, 0.05), "N": (18.0, 28.0)}),
    ("end_stop:left", {"k": (2.0, 4.0), "q1": (2.2, 2.28), "side": (1.0, 1.0)}),
    ("end_stop:right", {"k": (2.0, 4.0), "q1": (0.72, 0.8), "side": (-1.0, -1.0)}),
    ("stribeck:left", {"Fs": (0.06, 0.14), "vs": (0.3, 0.5)}),
    ("load_friction:left", {"mu": (0.06, 0.1)}),
    ("load_friction:right", {"mu": (0.06, 0.1)}),
)


@dataclass(frozen=True, eq=False)
class Puzzle:
    """A mechanism folder with a log, and what the folder does not say. Made by `make_puzzle`.

    Attributes:
        seed: of everything that is random.
        folder: holds mechanism.toml, the URDF and the log.
        log: path of the log.
        answer: the hidden effect, with its values.
    """

    seed: int
    folder: Path
    log: Path
    answer: Effect

    @property
    def mechanism(self) -> Mechanism:
        """As its maker believes it to be."""
        return load(self.folder)

    @property
    def truth(self) -> dict[str, float]:
        """The answer's parameters by full name."""
        names = (each.name for each in self.answer.parameters)
        return {
            full: self.answer.values[name]
            for full, name in zip(self.answer.names, names, strict=True)
        }

    @property
    def hidden(self) -> str:
        """The answer in one line."""
        units = dict(zip(self.answer.names, self.answer.units, strict=True))
        values = (f"{n} = {v:.4g} {units[n]}".removesuffix(" 1") for n, v in self.truth.items())
        return f"{self.answer.label} ({self.answer.summary()}): {listed(values)}"


def make_puzzle(folder: str | Path, *, seed: int) -> Puzzle:
    """A machine's folder with a log, into a folder that has neither.

    Args:
        folder: made where there is none.
        seed: chooses the hidden effect, its size, the true inertias, the motion and the noise.

    Raises:
        IdentError: if the folder has a mechanism or a log already, or cannot be written.
    """
    folder = Path(folder)
    files = {
        name: (resources.files("ident.show") / MACHINE / name).read_bytes()
        for name in (f"{MACHINE}.urdf", "mechanism.toml")
    }
    for name in (*files, "run.csv"):
        if (folder / name).exists():
            raise IdentError(f"{folder}: has a {name} already; name a new folder")
    write_all(folder, files)
    mechanism = load(folder)
    rng = np.random.default_rng(seed)
    label, sizes = SECRETS[rng.integers(len(SECRETS))]
    truth = {name: float(rng.uniform(low, high)) for name, (low, high) in sizes.items()}
    true = mechanism.with_effect(label, truth)
    pi = mechanism.prior * np.repeat(rng.uniform(0.85, 1.2, len(mechanism.prior) // 10), 10)
    log, _ = simulate(
        true, _motion(rng), values=KNOWN, pi=pi, noise=NOISE, seed=seed, columns=("q", "tau")
    )
    write_all(folder, {"run.csv": csv_text(log).encode()})
    return Puzzle(seed, folder, folder / "run.csv", true.effects[-1])


def _motion(rng: np.random.Generator) -> Log:
    """Motion of both drives: four sines each, with a common period, inside the workspace."""
    t = np.arange(0.0, SECONDS, STEP)
    w = 2 * np.pi * np.array([0.2, 0.4, 0.6, 1.0])[:, None]
    q = {}
    for joint, (middle, half) in {"left": (1.96, 0.45), "right": (1.05, 0.4)}.items():
        phase = rng.uniform(0, 2 * np.pi, (4, 1))
        x = np.array([1.0, 0.8, 0.5, 0.35]) @ np.sin(w * t + phase)
        q[f"q.{joint}"] = middle + half * x / np.abs(x).max()
    return Log.from_arrays("run.csv", t, q)


def show_puzzle(made: Puzzle) -> None:
    """Write the answer into the folder, and say how to begin."""
    folder = made.folder
    _begin(made, keep=True)
    say("The answer is in answer.txt of that folder. To find it yourself, begin with")
    say(f"   $ ident check {folder} {made.log}", "cyan")
    say(f"   $ ident diagnose {folder} {made.log}", "cyan")


def _begin(made: Puzzle, *, keep: bool) -> None:
    if keep:
        answer = made.folder / "answer.txt"
        answer.write_text(f"{made.hidden}\n", encoding="utf-8")
    say(f"\nA machine that keeps something to itself (seed {made.seed})", "bold")
    say(
        "An upright five-bar: two drives on the ground, two arms, two rods that meet in a pin. The "
        "drives were moved; their positions and torques are logged. The model has all bodies, with "
        "inertias some percent off, and friction in both drives. The machine has one thing more, "
        "somewhere, that the model lacks."
    )


def show_story(made: Puzzle, name: str, progress: Shower, *, keep: bool) -> None:
    """Identify, compare, diagnose and add, each step with the command that does it.

    Args:
        made: the machine.
        name: of its folder in commands.
        progress: makes a context with a function that is called with (words, share done).
        keep: whether fits and reports go into the folder.
    """
    log = f"{name}/run.csv"
    _begin(made, keep=keep)
    mechanism = made.mechanism
    with progress() as on_progress:
        motion = complete(mechanism, read_log(made.log), progress=on_progress)
        before = identify(mechanism, motion, estimator="least-squares", progress=on_progress)

    step("1. What is understood", f"ident check {name} {log}")
    say(f"{mechanism}\n{motion.summary}")

    step("2. Identify what is known", f"ident identify {name} {log} --out {name}/before")
    errors({"held out": before})
    say("So much of each drive's torque the model does not predict. Noise is 1 %, and most of that "
        "is filtered away: something is missing.")  # fmt: skip

    step("3. Where does it fail?", f"ident compare {name} {log} --fit {name}/before/fit.json")
    for failure in before.residual.where:
        seen = [f"{each.seen} against {each.signal}" for each in failure.depends_on[:2]]
        words = "noise" if failure.white else listed(seen) if seen else "no clear picture"
        say(f"  {failure.joint}: {percent(failure.relative)} off; {words}")
    say("The shape of a residual is a hint, no proof: many causes look alike.")

    step("4. What is missing?", f"ident diagnose {name} {log} --out {name}/diagnosis")
    with progress() as on_progress:
        found = diagnose(before, progress=on_progress)
    say(found.short)
    after = None if found.best is None else _add(found, found.best, name, progress)
    if keep:
        before.write(made.folder / "before")
        found.write(made.folder / "diagnosis")
        if after is not None:
            after.write(made.folder / "after")

    say("\nThe answer", "bold")
    say(f"Hidden was {made.hidden}. {answered(made.answer, found, after)}")
    if not keep:
        say("To go on by hand, with the same machine, its log, fits and reports:")
        say(f"   $ ident demo --seed {made.seed} --out {name}", "cyan")
        say("Another machine, for you to find out:")
        say(f"   $ ident demo --puzzle --out {name}", "cyan")


def _add(found: Diagnosis, best: Effect, name: str, progress: Shower) -> Fit:
    """Add the effect to the model, refit, and say what is left."""
    step("5. Add it", f"ident add {name} {best.label}")
    model, log = found.fit.mechanism + best, f"{name}/run.csv"
    say(f"  {add_effects(found.fit.mechanism, [best]).name}: added {best.label}")

    step("6. See the error fall", f"ident identify {name} {log} --out {name}/after")
    with progress() as on_progress:
        motion = found.fit.motion
        after = identify(model, motion, estimator="least-squares", progress=on_progress)
        left = diagnose(after, progress=on_progress)
    errors({"before": found.fit, "after": after})
    say("\n".join(f"  {after[full]}" for full in best.names))
    if left.verdict == "nothing":
        say("Diagnosed again: what is left is noise.")
    else:
        named = f": {left.best.label} comes first" if left.best else ""
        say(f"Diagnosed again: {left.verdict}{named}. `ident grow` goes on from here.")
    return after


def step(title: str, command: str) -> None:
    """Print a heading, and the command that does this step."""
    say(f"\n{title}", "bold")
    say(f"   $ {command}", "cyan")


def say(text: str, style: str = "") -> None:
    """Print text to standard output, long lines wrapped; what has a style stays as it is typed."""
    lines = text.split("\n")
    if not style:
        lines = [part for line in lines for part in wrapped(line) or [""]]
    Console(highlight=False, soft_wrap=True).print(Text("\n".join(lines), style))


def errors(fits: Mapping[str, Fit]) -> None:
    """Print held-out errors of the drives."""
    say("\n".join(table(error_rows({name: fit.held_out for name, fit in fits.items()}))))


def answered(answer: Effect, found: Diagnosis, after: Fit | None) -> str:
    """Return the truth beside what was found, right or wrong."""
    if after is None or found.best is None:
        return f"The diagnosis gave no name: {found.verdict}."
    label, rivals = answer.label, [rival.label for rival in found.rivals]
    if found.best.label == label:
        values = listed(str(after[name]) for name in answer.names)
        return f"Found{' among rivals that fit as well' if rivals else ''}: {values}."
    if label in rivals:
        return (
            f"The diagnosis put {found.best.label} first and listed {label}, the true effect, "
            "as a rival that explains this log as well: the answer is the set, not its first name."
        )
    if found.best.kind in answer.nested_in and found.best.joints == answer.joints:
        return (
            f"The diagnosis named {found.best.label}, which contains it: beside what they have in "
            "common its parameters should be zero within their errors."
        )
    return f"The diagnosis named {found.best.label}: wrong this time."
