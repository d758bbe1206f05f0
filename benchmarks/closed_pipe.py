"""`ident identify … | true`, again and again: is every folder complete?

    python benchmarks/closed_pipe.py [--runs 100]

The reader of the pipe leaves at once, before or while the command writes. The command must end with
status 0, or 141 as a shell's tools do, without a traceback, and its folder must hold the same files
as that of a run whose output is read, fit.json with the same content.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ARM = ("robots/arm", "robots/arm/run.csv", "--with", "viscous", "--with", "coulomb")


def files(folder: Path) -> dict[str, str]:
    """Return the files of a folder, fit.json by its content."""
    paths = sorted(x for x in folder.rglob("*") if x.is_file())
    fit = json.loads((folder / "fit.json").read_text())
    return {str(x.relative_to(folder)): "" for x in paths} | {"fit.json": json.dumps(fit)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=100)
    runs = parser.parse_args().runs
    complete, statuses = 0, Counter()
    with tempfile.TemporaryDirectory() as scratch:
        for k in range(runs + 1):
            out = Path(scratch) / str(k)
            words = [sys.executable, "-m", "ident", "identify", *ARM, "--out", str(out)]
            shell = '"$@" | true; exit ${PIPESTATUS[0]}' if k else '"$@"'
            command = ["bash", "-c", shell, "bash", *words]
            run = subprocess.run(command, capture_output=True, text=True, check=False)
            if k == 0:
                whole = files(out)
                continue
            statuses[run.returncode] += 1
            quiet = run.returncode in (0, 141) and "Traceback" not in run.stderr
            complete += quiet and out.is_dir() and files(out) == whole
    print(f"{complete} of {runs} folders complete; statuses {dict(statuses)}")
    sys.exit(complete < runs)


if __name__ == "__main__":
    main()
