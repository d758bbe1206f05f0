"""`demo`."""

from __future__ import annotations

import secrets
import tempfile
from pathlib import Path
from typing import Annotated

from ident.cli.console import notes, progress
from ident.cli.options import option
from ident.errors import IdentError

KEPT = "picker"  # what commands call the folder where none is kept


def demo(
    seed: Annotated[
        int | None,
        option("Which machine; a new one each time by default.", "N", min=0),
    ] = None,
    puzzle: Annotated[
        bool,
        option(
            "Only make the machine and its log in --out, for you to find out.", None, "--puzzle"
        ),
    ] = False,
    out: Annotated[
        Path | None,
        option("Keep mechanism, log, fits and reports in this new folder.", "DIR"),
    ] = None,
) -> None:
    """A hidden effect found, step by step, in half a minute.

    A machine is simulated that has something its model lacks. Check, identify, compare, diagnose
    and add find out what, and say which command does each step.
    """
    from ident.show.demo import make_puzzle, tell_puzzle, tell_story

    seed = secrets.randbelow(1000) if seed is None else seed
    if puzzle:
        if out is None:
            raise IdentError("--puzzle: needs a folder to put it into; add --out DIR")
        tell_puzzle(make_puzzle(out, seed=seed))
        return
    if out is not None:
        tell_story(make_puzzle(out, seed=seed), str(out), progress, keep=True)
        notes([f"wrote {out}; open {out / 'diagnosis' / 'report.html'}"])
        return
    with tempfile.TemporaryDirectory() as folder:
        tell_story(make_puzzle(Path(folder) / KEPT, seed=seed), KEPT, progress, keep=False)
