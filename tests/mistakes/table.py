"""Makes the table of mistakes: `python tests/mistakes/table.py [PATTERN] [--machine NAME …]`.

Every mistake is made on every machine; the table says what `ident identify` makes of it. A run
that was interrupted goes on from the file of `--keep`.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Collection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import further  # noqa: F401  registers its kinds
from kinds import MADE
from subjects import clean, subjects
from verdict import OUTCOMES, Verdict, judge

Results = dict[str, dict[str, Verdict]]


def results(
    pattern: str, folder: Path, keep: Path | None = None, machines: Collection[str] = ()
) -> Results:
    """Verdicts by mistake and machine; without names, of all machines."""
    chosen_subjects = [each for each in subjects() if not machines or each.name in machines]
    cases = [clean(each, folder / each.name / "truth") for each in chosen_subjects]
    found: Results = {}
    if keep is not None and keep.exists():
        for line in keep.read_text().splitlines():
            name, machine, *rest = json.loads(line)
            found.setdefault(name, {})[machine] = Verdict(rest[0], tuple(rest[1]), *rest[2:])
    chosen = [mistake for mistake in MADE if re.search(pattern, mistake.name)]
    for case in cases:
        for mistake in chosen:
            row, machine = found.setdefault(mistake.name, {}), case.subject.name
            if machine in row:
                continue
            try:
                mistake.of(case)
            except KeyError:  # it needs a second driven joint
                continue
            each = row[machine] = judge(case, mistake, folder)
            sys.stderr.write(f"{machine:14}{each.outcome:12}{mistake.name}\n")
            if keep is not None:
                values = [each.outcome, each.said, each.off, each.seconds]
                with keep.open("a") as file:
                    file.write(json.dumps([mistake.name, machine, *values]) + "\n")
    return found


def markdown(found: Results) -> str:
    """The table, and why what is hidden is hidden."""
    machines = list(dict.fromkeys(machine for row in found.values() for machine in row))
    lines = [f"| mistake | {' | '.join(machines)} |", "|---" * (len(machines) + 1) + "|"]
    notes = []
    for mistake in MADE:
        if mistake.name not in found:
            continue
        cells = []
        for machine in machines:
            verdict = found[mistake.name].get(machine)
            if verdict is None:
                cells.append("–")
                continue
            why = mistake.hidden.get(machine) or mistake.hidden.get("every")
            wrong = verdict.outcome in ("silent", "wrong name")
            cells.append(f"**{verdict.outcome}**" if wrong and not why else verdict.outcome)
            if wrong and why:
                cells[-1] = "hidden"
                notes.append(f"* {mistake.name}, {machine}: {why}")
        lines.append(f"| {mistake.name} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", *dict.fromkeys(notes)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pattern", nargs="?", default="", help="of mistakes' names")
    parser.add_argument("--machine", action="append", default=[], help="only this one, or these")
    parser.add_argument("--keep", type=Path, help="file of verdicts; what it has is not run again")
    parser.add_argument("--said", action="store_true", help="print what was said as well")
    parser.add_argument("--markdown", action="store_true", help="print the table of docs/trust.md")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = results(given.pattern, Path(folder), given.keep, given.machine)
    for name, row in found.items():
        for machine, verdict in row.items():
            if given.said or verdict.outcome in ("silent", "wrong name"):
                off, seconds = f"{verdict.off:.3g} s.e. off", f"{verdict.seconds:.2f} s"
                print(f"\n{name} · {machine}: {verdict.outcome}, {off}, {seconds}")
                print("\n".join(f"    {text[:400]}" for text in verdict.said))
    if given.markdown:
        print(markdown(found))
    count = Counter(each.outcome for row in found.values() for each in row.values())
    print(f"\n{len(found)} kinds:", ", ".join(f"{each} {count[each]}" for each in OUTCOMES))


if __name__ == "__main__":
    main()
