"""Processes on this machine (loky's); one that dies takes nothing with it but its own task."""

from __future__ import annotations

import pickle
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from pathlib import Path
from typing import Any

from joblib.externals.loky import get_reusable_executor

from ident.pool.call import TRIES, Done, line_of, tried

IDLE = 300  # seconds after which a process that has nothing to do ends
SOON = 5  # seconds within which a task that is handed in is handed out
LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
# two processes with two threads of linear algebra each are slower on two cores than with one each
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in LIBRARIES}

Function = Callable[[Any, Any], Any]
Numbered = tuple[int, Any]


def locally(
    function: Function, tasks: Iterator[Numbered], common: bytes, jobs: int
) -> Generator[Done, None, None]:
    """Every task in one of `jobs` processes, which find what is common in a file."""
    with tempfile.TemporaryDirectory(prefix="ident-") as folder:
        file = Path(folder) / "common"
        file.write_bytes(common)
        running = _Running(function, tasks, str(file), jobs)
        try:
            yield from running.all()
        except BaseException:  # Ctrl-C, or nobody wants the rest
            running.end()
            raise


class _Running:
    """Tasks in flight, one a process, and those to be tried again.

    When a process dies loky ends the others too, as nobody knows what it left behind; then all that
    ran is suspect. The last try of a suspect is alone.
    """

    def __init__(self, function: Function, tasks: Iterator[Numbered], file: str, jobs: int) -> None:
        self.function, self.tasks, self.file, self.jobs = function, tasks, file, jobs
        self.processes = self._started()
        self.flying: dict[Future[tuple[Any, str | None]], Numbered] = {}
        self.again: deque[Numbered] = deque()
        self.deaths: Counter[int] = Counter()

    def _started(self) -> Any:
        """Those of an earlier call, if they live."""
        return get_reusable_executor(self.jobs, timeout=IDLE, env=ONE_THREAD)

    def all(self) -> Iterator[Done]:
        """How each task ended."""
        ended: list[Done] = []
        while True:
            more = self._fill()
            yield from ended  # while others work
            if not self.flying and not more:
                return
            ended = self._ended()

    def end(self) -> None:
        """Ends what still runs."""
        until = time.monotonic() + SOON
        # loky's thread trips over what it has not handed out yet
        while time.monotonic() < until and not all(
            each.running() or each.done() for each in self.flying
        ):
            time.sleep(0.001)
        self.processes.shutdown(kill_workers=True)

    def _ended(self) -> list[Done]:
        """Those that have, once some have; of processes that died, new ones are started."""
        landed = wait(self.flying, return_when=FIRST_COMPLETED).done
        if broken := not landed or any(_lost(future) for future in landed):
            landed = wait(self.flying).done
        found = [self._landed(future) for future in landed]
        if broken:
            self.processes = self._started()
        return [done for done in found if done is not None]

    def _fill(self) -> bool:
        """Starts what there is room for; whether there is more to do than flies."""
        while (task := self._next()) is not None:
            try:
                future = self.processes.submit(_there, self.file, self.function, task[1])
            except BrokenProcessPool:  # what flies is about to end so too
                self.again.appendleft(task)
                return True
            self.flying[future] = task
        return bool(self.again)

    def _next(self) -> Numbered | None:
        alone = [self._last(index) for index, _ in self.flying.values()]
        if any(alone) or len(alone) >= self.jobs:
            return None
        if not self.again:
            return next(self.tasks, None)
        return None if alone and self._last(self.again[0][0]) else self.again.popleft()

    def _last(self, index: int) -> bool:
        return self.deaths[index] == TRIES - 1

    def _landed(self, future: Future[tuple[Any, str | None]]) -> Done | None:
        """How a task ended; None if it is to be tried again."""
        index, task = self.flying.pop(future)
        if _lost(future):
            self.deaths[index] += 1
            if self.deaths[index] < TRIES:
                self.again.append((index, task))
                return None
            return Done(index, error=f"its process died each of the {TRIES} times it was tried")
        if (failed := future.exception()) is not None:  # the task or its result cannot be sent
            return Done(index, error=line_of(failed))
        return Done(index, *future.result())


def _lost(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _there(file: str, function: Function, task: Any) -> tuple[Any, str | None]:
    return tried(function, _read(file), task)


@lru_cache(maxsize=1)
def _read(file: str) -> Any:
    """Once a process: its functions are compiled with the first task."""
    return pickle.loads(Path(file).read_bytes())
