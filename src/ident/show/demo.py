"""`ident demo`: a machine with a hidden effect, made from a seed, and how it is found.

The machine is simulated. What identification is given is what a user would have: a mechanism folder
whose URDF is some percent off, and a noisy log of the two drives.
"""

from __future__ import annotations

import textwrap
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
from ident.fit.compare import compare
from ident.fit.values import BaseValue, Value
from ident.log import Log, read_log
from ident.mechanism import Mechanism, load
from ident.mechanism.write import add_effects
from ident.motion import Motion, complete
from ident.progress import Progress
from ident.show.simulate import csv_text
from ident.simulate import Noise, simulate
from ident.text import listed, percent

Shower = Callable[[], AbstractContextManager[Progress]]
WIDTH, BAR = 96, 40  # characters
LITTLE = 0.05  # of the misfit: a joint with less is not spoken of
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
    """Of both drives: four sines each, with a common period, inside the loop's reach."""
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
    _write_answer(made)
    _beginning(made)
    words("The answer is in answer.txt of that folder. To find it yourself, begin with")
    command(f"ident check {folder} {made.log}")
    command(f"ident diagnose {folder} {made.log}")


def _write_answer(made: Puzzle) -> None:
    (made.folder / "answer.txt").write_text(f"{sought(made)}\n", encoding="utf-8")


def _beginning(made: Puzzle) -> None:
    title(f"A machine that keeps something to itself (seed {made.seed})")
    words(
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
    _beginning(made)
    mechanism = made.mechanism
    with progress() as on_progress:
        motion = complete(mechanism, read_log(made.log), progress=on_progress)
        before = identify(mechanism, motion, estimator="least-squares", progress=on_progress)

    step(1, "What is understood", f"ident check {name} {log}")
    words(understood(before))

    step(2, "Identify what is known", f"ident identify {name} {log} --out {name}/before")
    bars({"": before})
    words("So much of each drive's torque the model does not predict. Noise is 1 %, and most "
               "of that is filtered away: something is missing.")  # fmt: skip

    step(3, "Where does it fail?", f"ident compare {name} {log} --fit {name}/before/fit.json")
    _where(before)

    step(4, "What is missing?", f"ident diagnose {name} {log} --out {name}/diagnosis")
    with progress() as on_progress:
        found = diagnose(before, progress=on_progress)
    _missing(found)
    after = None
    if found.best is not None:
        after = _add(found, motion, name, progress)
    if keep:
        _write_answer(made)
        before.write(made.folder / "before")
        found.write(made.folder / "diagnosis")
        if after is not None:
            after.write(made.folder / "after")

    title("The answer")
    words(answered(made, found, after))
    if keep:
        return
    words("To go on by hand, with the same machine, its log, fits and reports:")
    command(f"ident demo --seed {made.seed} --out {name}")
    words("Another machine, for you to find out:")
    command(f"ident demo --puzzle --out {name}")


def _where(fit: Fit) -> None:
    """Say on what the residual depends, joint by joint, the worst first."""
    (where,) = compare(fit).where.values()
    for failure in (each for each in where if each.share > LITTLE):
        seen = [f"{each.seen} against {each.signal}" for each in failure.depends_on[:2]]
        said = "noise" if failure.white else listed(seen) if seen else "no clear picture"
        fact(f"{failure.joint}: {percent(failure.relative)} off; {said}")
    words("The shape of a residual is a hint, no proof: many causes look alike.")


def _missing(found: Diagnosis) -> None:
    """List the candidates, and say the verdict."""
    tied = {each.label for each in found.rivals} | ({found.best.label} if found.best else set())
    for each in found.candidates[:5]:
        mark = "*" if each.effect.label in tied else " "
        change = f"{percent(each.error_before)} → {percent(each.error_after)}"
        fact(f"{mark} {each.effect.label:<24} {change}")
    tried = len(found.choice.evidence)
    if found.best is None:
        words(f"Of {tried} effects tried at their places none earns a name (verdict: "
                   f"{found.verdict}). That is said, rather than a guess.")  # fmt: skip
        return
    words(
        f"Tried: {tried} effects at their places, each with all else refitted, judged on stretches "
        f"of time that were left out of the fit. Missing is {described_effect(found.best)}."
    )
    if found.rivals:
        words(
            f"It could as well be {listed([r.label for r in found.rivals], 'or')}: this log "
            "cannot tell them apart, and a falling error is no proof."
        )


def _add(found: Diagnosis, motion: Motion, name: str, progress: Shower) -> Fit:
    """Add the effect to the model, refit, and say what is left."""
    assert found.best is not None
    step(5, "Add it", f"ident add {name} {found.best.label}")
    model = found.fit.mechanism + found.best
    path = add_effects(found.fit.mechanism, [found.best])
    fact(f"{path.name}: added {found.best.label}")

    log = f"{name}/run.csv"
    step(6, "See the error fall", f"ident identify {name} {log} --out {name}/after")
    with progress() as on_progress:
        after = identify(model, motion, estimator="least-squares", progress=on_progress)
        left = diagnose(after, progress=on_progress)
    bars({"before": found.fit, "after": after})
    for full in found.best.names:
        fact(valued(after[full]))
    if left.verdict == "nothing":
        words("Diagnosed again: what is left is noise.")
    else:
        named = f": {left.best.label} comes first" if left.best else ""
        words(f"Diagnosed again: {left.verdict}{named}. `ident grow` goes on from here.")
    return after


def title(text: str) -> None:
    """Print a heading."""
    line(f"\n{text}", "bold")


def step(number: int, text: str, shell: str) -> None:
    """Print a numbered heading and the command that does this step."""
    title(f"{number}. {text}")
    command(shell)


def command(text: str) -> None:
    """Print a command as it is typed."""
    line(f"   $ {text}", "cyan")


def fact(text: str) -> None:
    """Print one line of a result."""
    line(f"     {text}")


def words(text: str) -> None:
    """Print a paragraph."""
    for each in textwrap.wrap(text, WIDTH, break_on_hyphens=False, break_long_words=False):
        line(each)


def line(text: str, style: str = "") -> None:
    """Print a line to standard output."""
    Console(highlight=False, soft_wrap=True).print(Text(text, style))


def valued(value: Value | BaseValue) -> str:
    """`coulomb.elbow.Fc = 0.0501 ± 0.0001 N m`."""
    return str(value).removesuffix(" 1")


def described_effect(effect: Effect) -> str:
    """`coulomb:elbow (dry friction: constant against the direction of motion)`."""
    return f"{effect.label} ({effect.summary()})"


def understood(fit: Fit) -> str:
    """Mechanism and motion, from the fit that has both."""
    m, (e,) = fit.mechanism, fit.motion.experiments
    return (
        f"{len(m.joints)} joints, of which {listed(m.driven)} are driven; the loop leaves "
        f"{len(fit.motion.independent)} degrees of freedom, and the other joints follow from it. "
        f"Of {len(m.unknown)} inertial parameters this motion can tell the "
        f"{fit.rank - sum(len(effect.unknowns) for effect in m.effects)} combinations that torques "
        f"feel. {len(e.t)} samples in {e.t[-1] - e.t[0]:.0f} s."
    )


def bars(fits: Mapping[str, Fit]) -> None:
    """Held-out errors of the drives, a row a joint and fit."""
    errors = {
        (joint, name): fit.held_out[joint].relative or 0.0
        for joint in next(iter(fits.values())).held_out
        for name, fit in fits.items()
    }
    longest = max(errors.values()) or 1.0
    for (joint, name), error in errors.items():
        bar = "█" * max(1, round(BAR * error / longest))
        fact(f"{joint:<6} {name:<6} {percent(error):>7} {bar}")


def sought(made: Puzzle) -> str:
    """The answer in one line."""
    units = dict(zip(made.answer.names, made.answer.units, strict=True))
    said = [
        f"{name} = {value:.4g} {units[name]}".removesuffix(" 1")
        for name, value in made.truth.items()
    ]
    return f"{described_effect(made.answer)}: {listed(said)}"


def answered(made: Puzzle, found: Diagnosis, after: Fit | None) -> str:
    """The truth beside what was found, right or wrong."""
    hidden = f"Hidden was {sought(made)}."
    if after is None or found.best is None:
        return f"{hidden} The diagnosis gave no name: {found.verdict}."
    label, rivals = made.answer.label, [rival.label for rival in found.rivals]
    if found.best.label == label:
        values = listed([valued(after[name]) for name in made.truth])
        sure = " among rivals that fit as well" if rivals else ""
        return f"{hidden} Found{sure}: {values}."
    if label in rivals:
        return (
            f"{hidden} The diagnosis put {found.best.label} first and said that {label}, which it "
            "is, explains this log as well: the set of rivals is the answer, not its first name."
        )
    if found.best.kind in made.answer.nested_in and found.best.joints == made.answer.joints:
        return (
            f"{hidden} The diagnosis named {found.best.label}, which contains it: beside what they "
            "have in common its parameters should be zero within their errors."
        )
    return f"{hidden} The diagnosis named {found.best.label}: wrong this time."
