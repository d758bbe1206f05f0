"""Mutants through the library and through the command.

    python tests/properties/run.py [--library 2000] [--commands 300] [--seed 0] [--kind values …]

Prints, by kind of mutant, how many ended in an error, a finding, the same answer or another that
the data cannot tell from it, then every fault: a traceback, more than 20 s, an absurd result
without a finding. The exit status is 1 if there was one. `--one NAME KIND SEED` runs one of the
library and shows where it fails.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(Path(__file__).parent)]

from bases import NAMES  # noqa: E402
from hypothesis import HealthCheck, Phase, given, seed, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from mutants import MUTANTS, SHARES  # noqa: E402
from outcomes import FAULTS, OUTCOMES, Outcome, outcome_in_library, outcome_of_command  # noqa: E402

KINDS = [kind for kind, share in SHARES.items() for _ in range(share)]


def drawn(
    run: Callable[[str, str, int, Path], Outcome], count: int, first: int, kinds: list[str]
) -> list[Outcome]:
    """The outcomes of so many mutants, drawn by Hypothesis from a seed."""
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as scrap:

        @seed(first)
        @settings(
            max_examples=count, deadline=None, database=None, phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        @given(st.sampled_from(NAMES), st.sampled_from(kinds), st.integers(0, 2**31))
        def every(name: str, kind: str, number: int) -> None:
            outcomes.append(run(name, kind, number, Path(scrap)))
            if outcomes[-1].verdict in FAULTS:
                print(f"{outcomes[-1].verdict}: {outcomes[-1].what}\n   {outcomes[-1].detail}",
                      flush=True)  # fmt: skip
            if len(outcomes) % 100 == 0:
                print(f"{len(outcomes)} of {count}", file=sys.stderr, flush=True)

        every()
    return outcomes


def table(title: str, outcomes: list[Outcome]) -> str:
    """Counts by kind and verdict."""
    count = Counter((each.kind, each.verdict) for each in outcomes)
    lines = [f"{title:12s}" + "".join(f"{verdict:>10s}" for verdict in OUTCOMES)]
    for kind in [*MUTANTS, ""]:
        row = [sum(n for (k, v), n in count.items() if kind in ("", k) and v == verdict)
               for verdict in OUTCOMES]  # fmt: skip
        if any(row):
            lines.append(f"{kind or 'all':12s}" + "".join(f"{n:10d}" for n in row))
    slowest = max(outcomes, key=lambda each: each.seconds)
    return "\n".join([*lines, f"slowest: {slowest.seconds:.1f} s, {slowest.what}"])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--library", type=int, default=2000)
    parser.add_argument("--commands", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", action="append", choices=list(MUTANTS))
    parser.add_argument("--changed", action="store_true", help="list those whose values changed")
    parser.add_argument("--one", nargs=3)
    given_ = parser.parse_args()
    if given_.one:
        name, kind, number = given_.one
        with tempfile.TemporaryDirectory() as scrap:
            print(outcome_in_library(name, kind, int(number), Path(scrap)))
        return 0
    every: list[Outcome] = []
    kinds = given_.kind or KINDS
    runs = (("library", outcome_in_library, given_.library),
            ("command", outcome_of_command, given_.commands))  # fmt: skip
    for title, run, count in runs:
        if count:
            outcomes = drawn(run, count, given_.seed, kinds)
            print(table(title, outcomes), flush=True)
            every += outcomes
    if given_.changed:
        for each in every:
            if each.verdict == "changed":
                print(f"changed: {each.what}\n   {each.detail}")
    return int(any(each.verdict in FAULTS for each in every))


if __name__ == "__main__":
    sys.exit(main())
