"""Makes the table of mistakes: `python tests/mistakes/table.py [--markdown FILE] [PATTERN]`.

Every mistake is made on every machine; the table says what `ident identify` makes of it.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from kinds import MADE
from subjects import clean, subjects
from verdict import OUTCOMES, Verdict, judge

Results = dict[str, dict[str, Verdict]]


def results(pattern: str, folder: Path, verbose: bool = True) -> Results:
    """Verdicts by mistake and machine."""
    cases = [clean(each, folder / each.name / "truth") for each in subjects()]
    found: Results = {}
    for mistake in MADE:
        if not re.search(pattern, mistake.name):
            continue
        found[mistake.name] = {case.subject.name: judge(case, mistake, folder) for case in cases}
        if verbose:
            row = "  ".join(f"{each.outcome:10}" for each in found[mistake.name].values())
            sys.stderr.write(f"{mistake.name[:54]:54} {row}\n")
    return found


def main() -> None:
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    verbose = "--said" in sys.argv
    with tempfile.TemporaryDirectory() as folder:
        found = results(words[0] if words else "", Path(folder))
    count: Counter[str] = Counter()
    for name, row in found.items():
        for machine, verdict in row.items():
            count[verdict.outcome] += 1
            if verbose or (
                verdict.outcome in ("silent", "wrong name") and "--short" not in sys.argv
            ):
                print(
                    f"\n{name} · {machine}: {verdict.outcome}, {verdict.off:.3g} s.e. off, {verdict.seconds:.2f} s"
                )
                for text in verdict.said:
                    print(f"    {text[:400]}")
    print("\n", len(found), "kinds:", ", ".join(f"{each} {count[each]}" for each in OUTCOMES))


if __name__ == "__main__":
    main()
