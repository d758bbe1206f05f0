"""`demo`: the commands that find a hidden effect, run one after the other."""

from __future__ import annotations

import contextlib
import json
import secrets
import shlex
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from ident.cli.console import notes, result, styled
from ident.cli.options import flag, setting
from ident.errors import IdentError
from ident.text import wrapped

if TYPE_CHECKING:
    from ident.show.demo import Puzzle

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
    from ident.show.demo import MACHINE, make_puzzle

    seed = secrets.randbelow(1000) if seed is None else seed
    if puzzle and out is None:
        raise IdentError("--puzzle: needs a folder to put it into; add --out DIR")
    with contextlib.ExitStack() as stack:
        if out is None:  # commands name a folder that is gone afterwards
            place = stack.enter_context(tempfile.TemporaryDirectory())
            stack.enter_context(contextlib.chdir(place))
        made = make_puzzle(out or MACHINE, seed=seed)
        styled(f"A machine that keeps something to itself (seed {seed})", "bold")
        result("\n".join(wrapped(INTRODUCTION)))
        if out is not None:
            (out / "answer.txt").write_text(f"{made.hidden}\n", encoding="utf-8")
            notes([f"the answer is in {out / 'answer.txt'}"])
        if puzzle:
            result("\nTo find it yourself, begin with")
            for _, command in (BEFORE[0], BEFORE[3]):
                styled(f"   $ ident {command.format(made.folder).partition(' --out')[0]}", "cyan")
            return
        _story(made)
    if out is not None:
        notes([f"wrote {out}; open {out / 'diagnosis' / 'report.html'}"])
        return
    result("\nTo go on by hand, or for another machine to find out by yourself:")
    for options in (f"--seed {seed}", "--puzzle"):
        styled(f"   $ ident demo {options} --out {MACHINE}", "cyan")


def _story(made: Puzzle) -> None:
    """Run the commands, and say how near they came."""
    from ident.show.demo import answered

    folder = made.folder
    for step in BEFORE:
        _step(*step, folder)
    found = json.loads((folder / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    if best := found["best"]:
        for step in AFTER:
            _step(*step, folder, f"{best['effect']}:{','.join(best['joints'])}")
    styled("\nThe answer", "bold")
    result("\n".join(wrapped(f"Hidden was {made.hidden}. {answered(made)}")))


def _step(title: str, command: str, *names: object) -> None:
    """Show and run a command."""
    from ident.cli.app import command_of

    words = [word.format(*names) for word in command.split()]
    styled(f"\n{title}", "bold")
    styled(f"   $ ident {shlex.join(words)}", "cyan")
    command_of(words[0]).main(words[1:], standalone_mode=False)
