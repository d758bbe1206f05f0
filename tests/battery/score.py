"""Scores ident on the battery.

python tests/battery/score.py --cases ci                     a dozen cases, minutes
python tests/battery/score.py --cases scoring --jobs 2 --write   the whole, kept in SCORES.md
python tests/battery/score.py --cases scoring --seed 7000   the same effects, all else drawn anew
python tests/battery/score.py --rescore RESULTS.jsonl        from results of a former run
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # before numpy: the jobs share the cores
    os.environ.setdefault(name, "1")

from cases import CATEGORIES, Case, cases  # noqa: E402
from generate import cache, make  # noqa: E402
from judge import Result, judge  # noqa: E402
from scores import failures, table  # noqa: E402

KEPT = Path(__file__).parent / "SCORES.md"


def main() -> int:
    options = arguments()
    if options.rescore:
        results = [json.loads(line) for line in options.rescore.read_text().splitlines()]
    else:
        chosen = [
            case
            for case in with_noise(
                cases(options.cases, options.encoder, options.seed), options.coloured
            )
            if not options.only or case.category in options.only
            if options.match in case.name
        ][:: options.every]
        if options.simulate:
            for case in chosen:
                make(case)
            return 0
        results = run(chosen, options.jobs, options.results or cache() / f"{options.cases}.jsonl")
    print(table(results))
    if options.list_failures:
        print(failures(results))
    if options.write:
        KEPT.write_text(page(options, results))
    return 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", choices=("tuning", "scoring", "ci"), default="ci")
    parser.add_argument("--only", action="append", choices=list(CATEGORIES), metavar="CATEGORY")
    parser.add_argument("--match", default="", help="cases whose name contains this")
    parser.add_argument("--encoder", type=float, help="noise of positions; default: as of torques")
    parser.add_argument("--seed", type=int, help="first number of the seeds, for a new set")
    parser.add_argument(
        "--coloured",
        action="store_true",
        help="3 %% of correlated noise on torques, stamps off by 1 ms rms, give --encoder 0.001",
    )
    parser.add_argument("--every", type=int, default=1, help="only one case in so many")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, help="JSON lines, one a case")
    parser.add_argument("--rescore", type=Path, help="score results of a former run")
    parser.add_argument("--list-failures", action="store_true")
    parser.add_argument("--simulate", action="store_true", help="only fill the cache")
    parser.add_argument("--write", action="store_true", help=f"keep the table in {KEPT.name}")
    return parser.parse_args()


def with_noise(chosen: Sequence[Case], coloured: bool) -> list[Case]:
    return [replace(case, noise=0.03, coloured=True) if coloured else case for case in chosen]


def run(chosen: Sequence[Case], jobs: int, place: Path) -> list[Result]:
    """Results in the order of the cases; each is written as soon as it is there."""
    found: dict[str, Result] = {}
    with place.open("w") as lines:
        for result in judged(chosen, jobs):
            found[result["name"]] = result
            print(json.dumps(result, default=float), file=lines, flush=True)
            shown = f"{len(found)}/{len(chosen)} {result['name']}"
            print(f"\r{shown[:100]:<100}", end="", file=sys.stderr, flush=True)
    print(f"\nresults: {place}", file=sys.stderr)
    return [found[case.name] for case in chosen]


def judged(chosen: Sequence[Case], jobs: int) -> Iterator[Result]:
    if jobs == 1:
        yield from map(judge, chosen)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for done in as_completed([pool.submit(judge, case) for case in chosen]):
            yield done.result()


def page(options: argparse.Namespace, results: Sequence[Result]) -> str:
    command = " ".join(["python", "tests/battery/score.py", *sys.argv[1:]])
    return (
        f"# Scores of the battery\n\nSet `{options.cases}`, {len(results)} cases, made by\n\n"
        f"    {command}\n\n{table(results)}\n"
    )


if __name__ == "__main__":
    sys.exit(main())
