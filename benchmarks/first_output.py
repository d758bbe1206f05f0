"""How long a person who types a command waits for its first output.

    python benchmarks/first_output.py [command …]

Every command runs in a terminal of its own, in which progress is shown, and is ended after its
first output. Wall time, best of three: the machine may be shared.
"""

import os
import pty
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TARGET = 1.0  # s
ARM = ("robots/arm", "robots/arm/run.csv")
SLIDER = ("robots/slider_crank", "robots/slider_crank/run.csv")


def commands(folder: Path) -> dict[str, tuple[str, ...]]:
    """Arguments of every command; what it writes goes into a folder."""
    fit, out = str(folder / "fit" / "fit.json"), str(folder / "made.csv")
    return {
        "check": ARM, "identify": ARM, "compare": (*ARM, "--fit", fit), "diagnose": ARM,
        "grow": ARM, "add": (str(folder / "arm"), "viscous"), "effects": (),
        "simulate": (*ARM, "--out", out), "excite": (ARM[0], "--harmonics", "2"),
        "explore": ARM, "montecarlo": (*SLIDER, "--snr", "40", "--runs", "2"),
        "monitor": (*ARM, "--with", "viscous"), "view": ARM, "demo": (),
    }  # fmt: skip


def first(name: str, arguments: tuple[str, ...]) -> tuple[float, str]:
    """Seconds to the first output, and its first line."""
    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "ident", name, *arguments]
    start = time.perf_counter()
    process = subprocess.Popen(words, stdin=theirs, stdout=theirs, stderr=theirs)
    text = os.read(ours, 1000).decode(errors="replace")
    seconds = time.perf_counter() - start
    process.kill()
    process.wait()
    os.close(theirs)
    os.close(ours)
    return seconds, text.strip().splitlines()[0][:60] if text.strip() else ""


def main() -> None:
    os.environ |= {"TERM": "xterm", "BROWSER": "true"}
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder)
        fitted = ["-m", "ident", "identify", *ARM, "--out", str(made / "fit")]
        subprocess.run([sys.executable, *fitted], capture_output=True, check=True)
        shutil.copytree(ARM[0], made / "arm")
        every, slowest = commands(made), 0.0
        for name in sys.argv[1:] or every:
            seconds, line = min(first(name, every[name]) for _ in range(3))
            slowest = max(slowest, seconds)
            print(f"{name:12s} {seconds:5.2f} s   {line!r}", flush=True)
    print(f"slowest {slowest:.2f} s, target {TARGET:g} s")
    sys.exit(slowest > TARGET)


if __name__ == "__main__":
    main()
