"""Scores ident on laws that are in no library.

python tests/laws/score.py --cases tune --jobs 2 --results FILE
python tests/laws/score.py --cases score --only eddy
python tests/laws/score.py --rescore FILE…                  from results of former runs
python tests/laws/score.py --cases tune --attainable        what noise alone leaves of `apart`

`apart` and `closed` are defined in law_judge.py.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # before numpy: the jobs share the cores
    os.environ.setdefault(name, "1")

from law_cases import SETS, Case, cases  # noqa: E402
from law_judge import Result, attainable, judge  # noqa: E402

FORM, GAP = 0.02, 0.8  # `apart` of a right form, `closed` of a gap


def main() -> int:
    options = arguments()
    if options.rescore:
        lines = [line for place in options.rescore for line in place.read_text().splitlines()]
        results = [json.loads(line) for line in lines]
    else:
        chosen = [case for case in cases(options.cases) if options.only in case.name]
        if options.attainable:
            for case in chosen:
                print(f"{case.name:45} {attainable(case):.4f}", flush=True)
            return 0
        results = run(chosen, options.jobs, options.results)
    print(lines_of(results))
    print()
    print(table(results))
    return 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", choices=tuple(SETS), default="tune")
    parser.add_argument("--only", default="", metavar="NAME", help="cases with this in the name")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, help="JSON lines, one a case")
    parser.add_argument("--rescore", type=Path, nargs="+", help="score results of former runs")
    parser.add_argument("--attainable", action="store_true")
    return parser.parse_args()


def run(chosen: Sequence[Case], jobs: int, place: Path | None) -> list[Result]:
    """Results in the order of the cases; each is written as soon as it is there."""
    found: dict[str, Result] = {}
    lines = place.open("w") if place else None
    for result in judged([case.name for case in chosen], jobs):
        found[result["name"]] = result
        if lines:
            print(json.dumps(result, default=float), file=lines, flush=True)
        shown = f"{len(found)}/{len(chosen)} {result['name']}"
        print(f"\r{shown[:100]:<100}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return [found[case.name] for case in chosen]


def judged(names: Sequence[str], jobs: int) -> Iterator[Result]:
    if jobs == 1:
        yield from map(by_name, names)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for done in as_completed([pool.submit(by_name, name) for name in names]):
            yield done.result()


def by_name(name: str) -> Result:
    return judge(next(case for case in cases(name.split("/")[0]) if case.name == name))


# --- tables ---------------------------------------------------------------------------------------


def right_variables(r: Result) -> bool:
    """Of the formula, or of the curve where there is no formula."""
    return bool(r.get("formula_variables", r.get("curve_variables", False)))


def right_form(r: Result) -> bool:
    return bool(r.get("apart", 9.9) <= FORM or r.get("equal", False))


def gap_closed(r: Result) -> bool:
    """By the formula, on the other log."""
    return bool(r.get("closed", 0.0) >= GAP)


def keeps_name(r: Result) -> bool:
    """No formula; or one beside the right name, which stays."""
    kept = bool(r.get("kind")) and r.get("best") == f"{r['kind']}:{r['joint']}"
    return "error" not in r and (kept or not r.get("laws"))


def lines_of(results: Sequence[Result]) -> str:
    """One line a case: what is right, how far off, and what was said."""
    lines = ["case                                          noise vis  V F G  apart  closed  said"]
    for r in results:
        if "error" in r:
            said = r["error"].strip().splitlines()[-1][:80]
        else:
            formula = r["laws"][0]["formula"] if r["laws"] else None
            curve = ",".join(r["curves"][0]["signals"]) if r["curves"] else None
            said = f"{r['verdict']} best={r['best']} curve={curve} law={formula}"
        marks = " ".join("+" if ok(r) else "-" for ok in (right_variables, right_form, gap_closed))
        lines.append(
            f"{r['name']:45} {r['noise']:.3f} {r.get('visible', 0):.2f} {marks} "
            f"{r.get('apart', float('nan')):6.3f} {r.get('closed', float('nan')):6.3f}  {said}"
        )
    return "\n".join(lines)


def table(results: Sequence[Result]) -> str:
    """Markdown, one line a score."""
    hidden = [r for r in results if r.get("law") and not r.get("kind")]
    clean = [r for r in results if not r.get("law")]
    named = [r for r in results if r.get("kind")]
    scores = [
        ("right variables", 0.90, hidden, right_variables),
        ("right form (apart ≤ 2 %, or algebraically equal)", 0.70, hidden, right_form),
        ("gap of the other log closed to 80 %", 1.00, hidden, gap_closed),
        ("clean: no formula", 0.97, clean, keeps_name),
        ("named effects: no formula in their place", 0.97, named, keeps_name),
        ("named effects: named", 0.0, named,
         lambda r: r.get("best") == f"{r['kind']}:{r['joint']}"),
        ("at most 20 s of processor time", 1.00, results, lambda r: r.get("seconds", 99) <= 20),
        ("fields of the contract", 1.00, results, lambda r: not r.get("contract")),
    ]  # fmt: skip
    lines = ["| score | target | passed | of | share |", "|---|---|---|---|---|"]
    for title, target, items, passes in scores:
        if items:
            n = sum(map(passes, items))
            share = n / len(items)
            lines.append(f"| {title} | ≥ {target:.0%} | {n} | {len(items)} | {share:.0%} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
