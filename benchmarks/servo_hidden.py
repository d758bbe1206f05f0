"""Something hidden in one joint of a servo arm: is it named, and nothing where nothing is?

    python benchmarks/servo_hidden.py [--seeds N] [--clean N] [--first SEED] [CASE …]

By MuJoCo, by default seeds from 4000 on: a spring between motor and link whose
resonance is in the band, a play of ten to thirty counts of the encoder, a drive that follows its
command late, friction that grows with the load, a gain that is given wrong, in a joint that is
drawn; and logs in which nothing is hidden. `tests/truth/servo_hidden.py` draws them. Right is the
planted effect in the planted joint, first of what is named; another effect named is wrong.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl

import ident

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "truth")]
from servo_hidden import CASES, hidden  # noqa: E402

FIRST = 4000  # seed


def main() -> None:
    """Run the cases that are asked for and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("cases", nargs="*", default=[], metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--clean", type=int, default=40)
    parser.add_argument("--first", type=int, default=FIRST, help="the first seed")
    given = parser.parse_args()
    print("case            logs   right   wrong   in no joint   median |error|   s a log")
    for case in given.cases or CASES:
        right, wrong, off, seconds = 0, list[str](), list[float](), list[float]()
        count = given.clean if case == "nothing" else given.seeds
        for seed in range(given.first, given.first + count):
            log = hidden(case, seed)
            begin = time.process_time()
            motion = ident.complete(log.mechanism, pl.DataFrame(log.log))
            result = ident.diagnose(ident.identify(log.mechanism, motion))
            seconds.append(time.process_time() - begin)
            named = [m.label for m in result.selection.named] if result.verdict == "missing" else []
            if named[:1] == [log.label] or (not named and not log.label):
                right += result.verdict == ("missing" if log.label else "nothing")
            if named and named[0] != log.label:
                wrong.append(f"{seed}: {named[0]} for {log.label or 'nothing'}")
            if named[:1] == [log.label]:
                found = {p.name: p.value for p in result.candidates[0].parameters}
                name, value = next(iter(log.values.items()))
                off.append(abs(found[name] / value - 1) if name in found else np.nan)
        error = f"{np.nanmedian(off):.1%}" if off else "-"
        print(
            f"{case:15s} {count:4d} {right / count:7.0%} {len(wrong) / count:7.0%} "
            f"{(count - right - len(wrong)) / count:13.0%} {error:>16s} {np.median(seconds):9.1f}",
            *(f"   {text}" for text in wrong), sep="\n", flush=True,
        )  # fmt: skip


if __name__ == "__main__":
    main()
