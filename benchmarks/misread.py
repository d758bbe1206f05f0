"""Sixty mistakes of a calibration three times as large as their prior: named, or in the interval?

    python benchmarks/misread.py [--machines arm five_bar ur5] [--each 4] [--diagnose]
                                 [--out FILE] [--read FILE …]

One gain, zero, length or lateness, or the clock, is off by three standard deviations of its prior,
all else is right; 8 s at 200 Hz with 1 % noise of the torques, bodies up to 30 % off the URDF's.
Every case has a seed of its own. Held: the largest error of a base parameter is below three of its
standard errors; named: a finding says the cause, or what this log cannot tell from it; blamed: a
finding names another channel or the machine. `--diagnose`: what a diagnosis says is missing.
A case is a line of the file `--out`; `--read`: the table of such files.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from priors import MACHINES, machine
from rows import kept, rows_of
from verdict import CAUSES

import ident
from ident import Fit
from ident.mechanism.calibration import KINDS
from ident.mechanism.causes import Cause, causes_of
from miscalibrated import misread

TIMES, FARTHEST = 3.0, 3.0  # of a prior; standard errors
# kinds of effects that say the same of a log, by the kind of cause
SAME = {
    "clock": ("clock", "time"),
    "tau": ("torque_gain", "scale"),
    "q": ("encoder_offset", "zero"),
    "length": ("geometry",),
    "lateness": ("delay", "position_delay"),
}


@dataclass(frozen=True)
class Case:
    """What was said of one mistake.

    Attributes:
        cause: what is off; hold: share of 95 % intervals that hold; off, plain: largest errors of
            base parameters in all and in noise's standard errors; named: by a finding; blamed:
            codes and places of findings that blame something else; missing: what a diagnosis says.
    """

    machine: str
    kind: str
    cause: str
    seed: int
    hold: float
    off: float
    plain: float
    named: bool
    blamed: tuple[str, ...]
    missing: str = ""


def told(fit: Fit, cause: Cause) -> tuple[bool, tuple[str, ...]]:
    """Whether a finding names a cause, and what is blamed instead."""
    place = cause.place.removeprefix("tau.").removeprefix("q.")
    named, blamed = False, list[str]()
    for finding in fit.all_findings:
        words = str(finding)
        at_place = not place or place in words
        if finding.code == "calibration" and cause.name in words:
            named = True
        elif finding.code in CAUSES:
            if finding.code in SAME[cause.kind] and at_place:
                named = True
            else:
                blamed.append(f"{finding.code} {' '.join(finding.where)}")
    return named, tuple(blamed)


def cases(names: Sequence[str], each: int, diagnose: bool) -> Iterator[Case]:
    """The cases, one of each machine in turn."""
    machines = {name: machine(name) for name in names}
    for number in range(each):
        for order, kind in enumerate(KINDS):
            for at, (name, (mechanism, motion)) in enumerate(machines.items()):
                seed = 1000 * at + 10 * number + order
                random = np.random.default_rng(seed)
                logged = tuple(x[2:] for x in motion.columns if x.startswith("q."))
                rate = (len(motion.t) - 1) / float(motion.t[-1] - motion.t[0])
                every = [c for c in causes_of(mechanism, logged, rate) if c.kind == kind]
                cause = every[random.integers(len(every))]
                size = TIMES * random.choice([-1.0, 1.0])

                def error(
                    other: Cause, _: object, wrong: str = cause.name, size: float = size
                ) -> float:
                    return size if other.name == wrong else 0.0

                case = misread(mechanism, motion, seed, size=error)
                fit = case.fit()
                z, plain = np.abs(case.off(fit)), np.abs(case.plain(fit))
                missing = ""
                if diagnose:
                    diagnosis = ident.diagnose(fit)
                    missing = diagnosis.verdict
                    if diagnosis.verdict == "missing" and diagnosis.best is not None:
                        missing = diagnosis.best.label
                yield Case(
                    name, kind, cause.name, seed, float((z < 1.96).mean()), float(z.max()),
                    float(plain.max()), *told(fit, cause), missing,
                )  # fmt: skip


def table(every: Sequence[Case]) -> list[str]:
    """Lines of the table, a kind each, and of the cases that are neither."""
    lines = [
        "| mistake | cases | intervals hold | held | named | neither | largest | of noise alone |",
        "|---|---|---|---|---|---|---|---|",
    ]
    kinds = [*dict.fromkeys(case.kind for case in every)]
    for kind in [*kinds, "all"]:
        some = [case for case in every if kind in (case.kind, "all")]
        held = [case.off < FARTHEST for case in some]
        neither = sum(not (h or c.named) for h, c in zip(held, some, strict=True))
        lines.append(
            f"| {kind} | {len(some)} | {100 * np.mean([c.hold for c in some]):.0f} % | {sum(held)} "
            f"| {sum(c.named for c in some)} | {neither} | {max(c.off for c in some):.1f} | "
            f"{max(c.plain for c in some):.0f} |"
        )
    lines.append("")
    for case in every:
        wrong = case.missing and case.missing.partition(":")[0] not in (
            "nothing", "undecided", "unexplained", *SAME[case.kind],
        )  # fmt: skip
        if case.blamed or wrong or not (case.named or case.off < FARTHEST):
            said = ", ".join(filter(None, [*case.blamed, case.missing])) or "nothing"
            named = "named" if case.named else "not named"
            lines.append(f"* {case.machine}, {case.cause}: {case.off:.1f}, {named}, said: {said}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--machines", nargs="+", default=["arm", "five_bar", "ur5"], choices=MACHINES
    )
    parser.add_argument("--each", type=int, default=4, help="cases of a kind and machine")
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--read", type=Path, nargs="+")
    given = parser.parse_args()
    made = cases(given.machines, given.each, given.diagnose)
    rows = rows_of(given.read, Case) if given.read else [*kept(made, given.out)]
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
