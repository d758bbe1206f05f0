"""`ident demo`: a machine with a hidden effect, made from a seed, and how it is found.

The machine is simulated. What identification is given is what a user would have: a mechanism folder
whose URDF is some percent off, and a noisy log of the two drives.

The commands that find the effect run one after the other.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import shlex
import tempfile
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.cli.app import command_of, notes, result, styled
from ident.cli.options import flag, setting
from ident.errors import IdentError
from ident.files import write_all
from ident.text import listed, wrapped

if TYPE_CHECKING:
    from ident.effects import Effect
    from ident.log import Log
    from ident.mechanism import Mechanism

MACHINE = "picker"
SECONDS, STEP = 15.0, 0.004
NOISE = {"q": (2e-5, False), "tau": (0.01, True)}  # rad; share of the torque's rms
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
        folder: holds mechanism.toml, the URDF and the log.
        log: path of the log.
        answer: the hidden effect, with its values.
    """

    folder: Path
    log: Path
    answer: Effect

    @property
    def mechanism(self) -> Mechanism:
        """As its maker believes it to be."""
        from ident.mechanism import load

        return load(self.folder)

    @property
    def truth(self) -> dict[str, float]:
        """The answer's parameters by full name."""
        return {full: self.answer.values[full.rpartition(".")[2]] for full in self.answer.names}

    @property
    def hidden(self) -> str:
        """The answer in one line."""
        pairs = zip(self.truth.items(), self.answer.units, strict=True)
        values = (f"{name} = {x:.4g} {unit}".removesuffix(" 1") for (name, x), unit in pairs)
        return f"{self.answer.label} ({self.answer.summary()}): {listed(values)}"


def make_puzzle(folder: str | Path, *, seed: int) -> Puzzle:
    """Make a machine's folder with a log, where there is neither; the seed chooses the hidden
    effect, its size, the true inertias, the motion and the noise.
    """
    from ident.mechanism import load
    from ident.simulate import Noise, simulate

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
    noise = [Noise(name, size, relative=relative) for name, (size, relative) in NOISE.items()]
    log, _ = simulate(
        true, _motion(rng), values=KNOWN, pi=pi, noise=noise, seed=seed, columns=("q", "tau")
    )
    write_all(folder, {"run.csv": log.polars().write_csv().encode()})
    return Puzzle(folder, folder / "run.csv", true.effects[-1])


def _motion(rng: np.random.Generator) -> Log:
    """Motion of both drives: four sines each, with a common period, to both ends of a range, where
    an end stop is touched.
    """
    from ident.log import Log

    t = np.arange(0.0, SECONDS, STEP)
    w = 2 * np.pi * np.array([0.2, 0.4, 0.6, 1.0])[:, None]
    q = {}
    for joint, (middle, half) in {"left": (1.96, 0.45), "right": (1.05, 0.4)}.items():
        phase = rng.uniform(0, 2 * np.pi, (4, 1))
        x = np.array([1.0, 0.8, 0.5, 0.35]) @ np.sin(w * t + phase)
        q[f"q.{joint}"] = middle + half * (2 * (x - x.min()) / np.ptp(x) - 1)
    return Log.from_arrays("run.csv", t, q)


INTRODUCTION = (
    "An upright five-bar: two drives on the ground, two arms, two rods that meet in a pin. The "
    "drives were moved; their positions and torques are logged. The model has all bodies, with "
    "inertias some percent off, and friction in both drives. The machine has one thing more, "
    "somewhere, that the model lacks."
)
BEFORE = (  # what a step is for, and its command in the folder {0}
    ("What is understood", "check {0} {0}/run.csv"),
    ("Identify what is known: the held-out errors are far above noise of 1 %, most of which is "
     "filtered away", "identify {0} {0}/run.csv --out {0}/before"),
    ("Where does it fail? The shape of a residual is a hint, no proof: many causes look alike",
     "compare {0} {0}/run.csv --fit {0}/before/fit.json"),
    ("What is missing?", "diagnose {0} {0}/run.csv --out {0}/diagnosis"),
)  # fmt: skip
AFTER = (
    ("Add it", "add {0} {1}"),
    ("See the error fall", "identify {0} {0}/run.csv --out {0}/after"),
    ("Is anything left?", "diagnose {0} {0}/run.csv"),
)


def demo(
    seed: int | None = setting("Seed of the machine; a new one each time by default.", "N", min=0),
    puzzle: bool = flag(
        "Only make the machine and its log in --out, for you to find out.", "--puzzle"
    ),
    out: Path | None = setting("Keep mechanism, log, fits and reports in this new folder.", "DIR"),
) -> None:
    """Show how a hidden effect is found, step by step.

    A machine is simulated that has something its model lacks. Check, identify, compare, diagnose
    and add find out what, and say which command does each step.
    """
    seed = secrets.randbelow(1000) if seed is None else seed
    if puzzle and out is None:
        raise IdentError("--puzzle: needs a folder to put it into; add --out DIR")
    with contextlib.ExitStack() as stack:
        if out is None:  # commands name a folder that is deleted afterwards
            place = stack.enter_context(tempfile.TemporaryDirectory())
            stack.enter_context(contextlib.chdir(place))
        made = make_puzzle(out or MACHINE, seed=seed)
        styled(f"A machine with a hidden effect (seed {seed})", bold=True)
        result("\n".join(wrapped(INTRODUCTION)))
        if out is not None:
            (out / "answer.txt").write_text(f"{made.hidden}\n", encoding="utf-8")
            notes([f"the answer is in {out / 'answer.txt'}"])
        if puzzle:
            result("\nTo find it yourself, begin with")
            for _, command in (BEFORE[0], BEFORE[3]):
                styled(
                    f"   $ ident {command.format(made.folder).partition(' --out')[0]}", fg="cyan"
                )
            return
        for step in BEFORE:
            _step(*step, made.folder)
        file = made.folder / "diagnosis" / "diagnosis.json"
        diagnosis = json.loads(file.read_text(encoding="utf-8"))
        outcome = f"gave no name: {diagnosis['verdict']}"
        if best := diagnosis["best"]:
            name = f"{best['effect']}:{','.join(best['joints'])}"
            outcome = f"named {name}"
            for step in AFTER:
                _step(*step, made.folder, name)
        styled("\nThe answer", bold=True)
        result("\n".join(wrapped(f"Hidden was {made.hidden}. The diagnosis {outcome}.")))
    if out is not None:
        notes([f"wrote {out}; open {out / 'diagnosis' / 'report.html'}"])
        return
    result("\nTo go on by hand, or for another machine to find out by yourself:")
    for options in (f"--seed {seed}", "--puzzle"):
        styled(f"   $ ident demo {options} --out {MACHINE}", fg="cyan")


def _step(title: str, command: str, *names: object) -> None:
    words = [word.format(*names) for word in command.split()]
    styled(f"\n{title}", bold=True)
    styled(f"   $ ident {shlex.join(words)}", fg="cyan")
    command_of(words[0]).main(words[1:], standalone_mode=False)
