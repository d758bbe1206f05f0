"""The page of `ident explore`: when its address is there, and where the time of a click goes.

    python benchmarks/explore.py [samples]

A log of seven joints and 10,000 samples; rigid bodies alone are given, all 70 parameters unknown;
friction of all joints is in the log. The board is driven without a browser: what a browser needs to
draw comes on top. One process, BLAS on one thread; CPU seconds beside wall seconds, which others
may share.
"""

import dataclasses
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import arm7

import ident
from ident.assess.exploration import Exploration
from ident.show.board import Board, contents

ADDRESS = 3.0  # s from the command to the address of the page
FIRST, TARGET = 0.5, 3.0  # s from a click to errors and ladder, and to all that is new
CLICKS = ("viscous:joint_1", "coulomb:joint_1", "viscous:joint_5", "coulomb:joint_7")
SEARCHED = "stribeck:joint_3"


def clocked(work: Callable[[], object]) -> tuple[object, float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    found = work()
    return found, time.perf_counter() - wall, time.process_time() - cpu


def address() -> float:
    """Seconds from the command to the printed address, which is before anything is read."""
    with tempfile.TemporaryDirectory() as out:
        words = ["robots/arm", "robots/arm/run.csv", "--no-browser", "--out", out]
        command = [sys.executable, "-u", "-m", "ident", "explore", *words]
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        process.stdout.readline()
        seconds = time.perf_counter() - start
        process.terminate()
        process.communicate()
    return seconds


class Clocked(Board):
    """A board that notes when each key of its state changes for the first time."""

    seen: dict[str, tuple[float, float]]

    def _tell(self, **changes: object) -> None:
        super()._tell(**changes)
        for name in changes:
            self.seen.setdefault(name, (time.perf_counter(), time.process_time()))

    def click(self, label: str, present: bool) -> list[tuple[float, float]]:
        """Seconds, wall and CPU, to errors and ladder, to pictures, to what is announced next."""
        wall, cpu = time.perf_counter(), time.process_time()
        self.seen = {}
        self.act({"do": "remove" if present else "add", "label": label})
        end = time.perf_counter(), time.process_time()
        times = (self.seen["ladder"], self.seen["shown"], end)
        return [(w - wall, c - cpu) for w, c in times]


def stages(e: Exploration) -> None:
    """One click, taken apart."""
    print(f"\n{'one click, taken apart':34s} {'wall':>6} {'CPU':>6}")
    grown, *times = clocked(lambda: e.with_effect(CLICKS[0]))
    assert isinstance(grown, Exploration)
    rows = [("refit", times)]
    fit = grown.fit
    rows.append(("torques predicted", clocked(fit.predict)[1:]))
    rows.append(("residual", clocked(lambda: fit.residual)[1:]))
    rows.append(("on what it depends", clocked(lambda: fit.residual.where)[1:]))
    rows.append(("pictures of one joint", clocked(lambda: contents(grown, "Joint", "joint_1"))[1:]))
    rows.append(("falls announced", clocked(grown.screened)[1:]))
    for name, (wall, cpu) in rows:
        print(f"{name:34s} {wall:6.2f} {cpu:6.2f}")


def main() -> None:
    samples = int(sys.argv[1]) if sys.argv[1:] else 10_000
    print(f"{platform.machine()}, Python {platform.python_version()}, one process, one BLAS thread")
    opened = min(address() for _ in range(3))
    print(f"address, best of three: {opened:.2f} s of wall, target {ADDRESS:g} s")
    true = arm7.mechanism()
    log = arm7.log(true, samples, 0.01)
    model = dataclasses.replace(true, effects=())
    motion = ident.complete(model, log)
    e, wall, cpu = clocked(lambda: Exploration.of(model, motion).screened())
    assert isinstance(e, Exploration)
    print(f"before the page is there: {wall:.2f} s ({cpu:.2f} s CPU), {len(e.candidates)} effects")
    stages(e)
    board = Clocked("arm7", "explored")
    board.seen = {}
    board.begin(lambda progress: e, lambda what, share: None)

    def clicks() -> bool:
        print(
            f"\n{'seconds from a click to':34s} {'ladder':>13} {'pictures':>13} {'announced':>13}"
        )
        first = slowest = 0.0
        for label, present in [*((x, False) for x in CLICKS), (CLICKS[0], True), (SEARCHED, False)]:
            times = board.click(label, present)
            if label != SEARCHED:
                first, slowest = max(first, times[0][1]), max(slowest, times[2][1])
            said = " ".join(f"{wall:6.2f} {cpu:6.2f}" for wall, cpu in times)
            print(f"{'−' if present else '+'} {label:32s} {said}")
        print(
            f"slowest, nothing searched: first answer {first:.2f} s of CPU, target {FIRST:g} s; "
            f"all that is new {slowest:.2f} s, target {TARGET:g} s"
        )
        return opened < ADDRESS and first < FIRST and slowest < TARGET

    sys.exit(0 if clicks() else 1)


if __name__ == "__main__":
    main()
