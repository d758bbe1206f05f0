"""`ident demo`: a machine with a hidden effect, made from a seed, and how it is found.

The commands that find the effect run one after the other, on a five-bar with measured torques or
on an arm of position servos without (`ident.cli.puzzles`).
"""

from __future__ import annotations

import contextlib
import json
import secrets
import shlex
import tempfile
from pathlib import Path

from ident.cli.app import command_of, notes, result, styled
from ident.cli.options import flag, setting
from ident.cli.puzzles import MACHINE, SERVOS, Puzzle, make_puzzle, make_servo_puzzle
from ident.errors import IdentError
from ident.text import rounded, significant, table, wrapped

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
SERVO_INTRODUCTION = (
    "An arm of three position servos without a torque sensor: its log has commands and encoders "
    "only. A servo's torque is kp (ref(t - delay) - q) - kd v, and none of its numbers is known, "
    "nor dry friction and rotor inertia; the bodies are, which gives the torques a scale. The "
    "machine has one thing more, somewhere, that the model lacks."
)
SERVO_BEFORE = (
    ("What is understood, and what gives each servo its scale", "check {0} {0}/run.csv"),
    ("Identify gains, delay, friction and rotors: in some joint the errors stay above noise",
     "identify {0} {0}/run.csv --out {0}/before"),
    ("Where does it fail?", "compare {0} {0}/run.csv --fit {0}/before/fit.json"),
    ("What is missing?", "diagnose {0} {0}/run.csv --out {0}/diagnosis"),
)  # fmt: skip
SERVO_AFTER = (
    ("Add what is missing until nothing is", "grow {0} {0}/run.csv --out {0}/grown"),
    ("Play commands that were not fitted: errors of the motion in rad, before …",
     "compare {0} {0}/other.csv --fit {0}/before/fit.json --simulate"),
    ("… and after", "compare {0}/grown {0}/other.csv --fit {0}/grown/fit.json --simulate"),
)  # fmt: skip


def demo(
    seed: int | None = setting("Seed of the machine; a new one each time by default.", "N", min=0),
    puzzle: bool = flag(
        "Only make the machine and its log in --out, for you to find out.", "--puzzle"
    ),
    servo: bool = flag(
        "On an arm of position servos, whose log has commands and no torques.", "--servo"
    ),
    out: Path | None = setting("Keep mechanism, log, fits and reports in this new folder.", "DIR"),
) -> None:
    """Show how a hidden effect is found, step by step.

    A machine is simulated that has something its model lacks. Check, identify, compare, diagnose
    and add, or grow, find out what, and say which command does each step.
    """
    seed = secrets.randbelow(1000) if seed is None else seed
    if puzzle and out is None:
        raise IdentError("--puzzle: needs a folder to put it into; add --out DIR")
    machine, make = (SERVOS, make_servo_puzzle) if servo else (MACHINE, make_puzzle)
    before, after = (SERVO_BEFORE, SERVO_AFTER) if servo else (BEFORE, AFTER)
    with contextlib.ExitStack() as stack:
        if out is None:  # commands name a folder that is deleted afterwards
            place = stack.enter_context(tempfile.TemporaryDirectory())
            stack.enter_context(contextlib.chdir(place))
        made = make(out or machine, seed=seed)
        styled(f"A machine with a hidden effect (seed {seed})", bold=True)
        result("\n".join(wrapped(SERVO_INTRODUCTION if servo else INTRODUCTION)))
        if out is not None:
            (out / "answer.txt").write_text(f"{made.hidden}\n", encoding="utf-8")
            notes([f"the answer is in {out / 'answer.txt'}"])
        if puzzle:
            result("\nTo find it yourself, begin with")
            for _, command in (before[0], before[3]):
                styled(
                    f"   $ ident {command.format(made.folder).partition(' --out')[0]}", fg="cyan"
                )
            return
        for step in before:
            _step(*step, made.folder)
        file = made.folder / "diagnosis" / "diagnosis.json"
        diagnosis = json.loads(file.read_text(encoding="utf-8"))
        outcome = f"gave no name: {diagnosis['verdict']}"
        if best := diagnosis["best"]:
            name = f"{best['effect']}:{','.join(best['joints'])}"
            outcome = f"named {name}"
            for step in after:
                _step(*step, made.folder, name)
        styled("\nThe answer", bold=True)
        result("\n".join(wrapped(f"Hidden was {made.hidden}. The diagnosis {outcome}.")))
        if servo and best:
            _print_drives(made)
    if out is not None:
        notes([f"wrote {out}; open {out / 'diagnosis' / 'report.html'}"])
        return
    result("\nTo go on by hand, or for another machine to find out by yourself:")
    kind = "--servo " if servo else ""
    for options in (f"--seed {seed}", "--puzzle"):
        styled(f"   $ ident demo {kind}{options} --out {machine}", fg="cyan")


def _step(title: str, command: str, *names: object) -> None:
    words = [word.format(*names) for word in command.split()]
    styled(f"\n{title}", bold=True)
    styled(f"   $ ident {shlex.join(words)}", fg="cyan")
    command_of(words[0]).main(words[1:], standalone_mode=False)


def _print_drives(made: Puzzle) -> None:
    """Print planted values of the drives beside those identified before and after `grow`."""
    fits = []
    for name in ("before", "grown"):
        text = (made.folder / name / "fit.json").read_text(encoding="utf-8")
        parameters = (p for effect in json.loads(text)["effects"] for p in effect["parameters"])
        fits.append({p["name"]: p for p in parameters})
    rows = [["", "planted", "before", "grown", ""]]
    for name, value in {**made.drives, **made.truth}.items():
        entries = [fit.get(name) for fit in fits]
        unit = next((p["unit"] for p in entries if p), "")
        cells = [rounded(p["value"], p["stderr"]) if p else "" for p in entries]
        rows.append([name, significant(value, 4), *cells, unit.removeprefix("1")])
    result("\n".join(["", *table(rows)]))
