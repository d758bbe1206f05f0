"""`demo`: a hidden effect found, each step with the command that does it."""

from __future__ import annotations

import secrets
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from ident.cli.console import notes, progress
from ident.cli.telling import (
    Teller,
    answered,
    bars,
    described_effect,
    listed,
    sought,
    understood,
    valued,
)
from ident.compare import compare
from ident.demo import Puzzle, make_puzzle
from ident.diagnose import Diagnosis, diagnose
from ident.errors import IdentError
from ident.fit import Fit, identify
from ident.log import read_log
from ident.mechanism.write import add_effects
from ident.motion import Motion, complete
from ident.tables import percent

KEPT = "picker"  # what commands call the folder where none is kept
LITTLE = 0.05  # of the misfit: a joint with less is not spoken of


def demo(
    seed: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, help="Which machine; a new one each time by default."),
    ] = None,
    puzzle: Annotated[
        bool,
        typer.Option(
            "--puzzle", help="Only make the machine and its log in --out, for you to find out."
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Keep mechanism, log, fits and reports in this new folder."
        ),
    ] = None,
) -> None:
    """A hidden effect found, step by step, in half a minute.

    A machine is simulated that has something its model lacks. Check, identify, compare, diagnose
    and add find out what, and say which command does each step.
    """
    seed = secrets.randbelow(1000) if seed is None else seed
    if puzzle:
        if out is None:
            raise IdentError("--puzzle: needs a folder to put it into; add --out DIR")
        _puzzle(make_puzzle(out, seed=seed))
        return
    if out is not None:
        _tell(make_puzzle(out, seed=seed), str(out), keep=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        _tell(make_puzzle(Path(folder) / KEPT, seed=seed), KEPT, keep=False)


def _puzzle(made: Puzzle) -> None:
    tell, folder = Teller(), made.folder
    _keep_answer(made)
    _beginning(tell, made)
    tell.words("The answer is in answer.txt of that folder. To find it yourself, begin with")
    tell.command(f"ident check {folder} {made.log}")
    tell.command(f"ident diagnose {folder} {made.log}")


def _keep_answer(made: Puzzle) -> None:
    (made.folder / "answer.txt").write_text(f"{sought(made)}\n", encoding="utf-8")


def _beginning(tell: Teller, made: Puzzle) -> None:
    tell.title(f"A machine that keeps something to itself (seed {made.seed})")
    tell.words(
        "An upright five-bar: two drives on the ground, two arms, two rods that meet in a pin. The "
        "drives were moved; their positions and torques are logged. The model has all bodies, with "
        "inertias some percent off, and friction in both drives. The machine has one thing more, "
        "somewhere, that the model lacks."
    )


def _tell(made: Puzzle, name: str, *, keep: bool) -> None:
    """All of the story; `name` is what its commands call the folder."""
    tell, log = Teller(), f"{name}/run.csv"
    _beginning(tell, made)
    mechanism = made.mechanism
    with progress() as told:
        motion = complete(mechanism, read_log(made.log), progress=told)
        before = identify(mechanism, motion, estimator="least-squares", progress=told)

    tell.step(1, "What is understood", f"ident check {name} {log}")
    tell.words(understood(before))

    tell.step(2, "Identify what is known", f"ident identify {name} {log} --out {name}/before")
    bars(tell, {"": before})
    tell.words("So much of each drive's torque the model does not predict. Noise is 1 %, and most "
               "of that is filtered away: something is missing.")  # fmt: skip

    tell.step(3, "Where does it fail?", f"ident compare {name} {log} --fit {name}/before/fit.json")
    _where(tell, before)

    tell.step(4, "What is missing?", f"ident diagnose {name} {log} --out {name}/diagnosis")
    with progress() as told:
        found = diagnose(before, progress=told)
    _missing(tell, found)
    after = None
    if found.best is not None:
        after = _add(tell, made, found, motion, name)
    if keep:
        _write(made, before, found, after)

    tell.title("The answer")
    tell.words(answered(made, found, after))
    _goodbye(tell, made, name, keep=keep)


def _where(tell: Teller, fit: Fit) -> None:
    """Joint by joint, the worst first, and on what the residual depends there."""
    (where,) = compare(fit).where.values()
    for failure in (each for each in where if each.share > LITTLE):
        seen = [f"{each.seen} against {each.signal}" for each in failure.depends_on[:2]]
        said = "noise" if failure.white else listed(seen) or "no clear picture"
        tell.fact(f"{failure.joint}: {percent(failure.relative)} off; {said}")
    tell.words("The shape of a residual is a hint, no proof: many causes look alike.")


def _missing(tell: Teller, found: Diagnosis) -> None:
    """The candidates, and the verdict."""
    tied = {each.label for each in found.rivals} | ({found.best.label} if found.best else set())
    for each in found.candidates[:5]:
        mark = "*" if each.effect.label in tied else " "
        change = f"{percent(each.error_before)} → {percent(each.error_after)}"
        tell.fact(f"{mark} {each.effect.label:<24} {change}")
    tried = len(found.choice.evidence)
    if found.best is None:
        tell.words(f"Of {tried} effects tried at their places none earns a name (verdict: "
                   f"{found.verdict}). That is said, rather than a guess.")  # fmt: skip
        return
    tell.words(
        f"Tried: {tried} effects at their places, each with all else refitted, judged on stretches "
        f"of time that were left out of the fit. Missing is {described_effect(found.best)}."
    )
    if found.rivals:
        tell.words(
            f"It could as well be {listed([r.label for r in found.rivals], 'or')}: this log "
            "cannot tell them apart, and a falling error is no proof."
        )


def _add(tell: Teller, made: Puzzle, found: Diagnosis, motion: Motion, name: str) -> Fit:
    """The effect in the model, and whether anything is left."""
    assert found.best is not None
    tell.step(5, "Add it", f"ident add {name} {found.best.label}")
    model = found.fit.mechanism + found.best
    path = add_effects(found.fit.mechanism, [found.best])
    tell.fact(f"{path.name}: added {found.best.label}")

    log = f"{name}/run.csv"
    tell.step(6, "See the error fall", f"ident identify {name} {log} --out {name}/after")
    with progress() as told:
        after = identify(model, motion, estimator="least-squares", progress=told)
        left = diagnose(after, progress=told)
    bars(tell, {"before": found.fit, "after": after})
    for full in found.best.names:
        tell.fact(valued(after[full]))
    if left.verdict == "nothing":
        tell.words("Diagnosed again: what is left is noise.")
    else:
        named = f": {left.best.label} comes first" if left.best else ""
        tell.words(f"Diagnosed again: {left.verdict}{named}. `ident grow` goes on from here.")
    return after


def _write(made: Puzzle, before: Fit, found: Diagnosis, after: Fit | None) -> None:
    """What the commands of the story would have written."""
    _keep_answer(made)
    before.write(made.folder / "before")
    found.write(made.folder / "diagnosis")
    if after is not None:
        after.write(made.folder / "after")


def _goodbye(tell: Teller, made: Puzzle, name: str, *, keep: bool) -> None:
    if keep:
        notes([f"wrote {made.folder}; open {made.folder / 'diagnosis' / 'report.html'}"])
        return
    tell.words("To go on by hand, with the same machine, its log, fits and reports:")
    tell.command(f"ident demo --seed {made.seed} --out {name}")
    tell.words("Another machine, for you to find out:")
    tell.command(f"ident demo --puzzle --out {name}")
