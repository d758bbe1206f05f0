"""Tasks in processes of this machine (loky's); one that dies loses nothing but its own task."""

from __future__ import annotations

import pickle
import tempfile
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

from ident.errors import line_of

TRIES = 3  # of a task whose process dies
IDLE = 300  # [s] after which a process that has nothing to do ends
HANDED_OUT = 5  # [s] within which a submitted task reaches its process
LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
# two processes with two threads of linear algebra each are slower on two cores than with one each
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in LIBRARIES}

Function = Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Done:
    """How a task ended."""

    index: int  # number of the task, from 0, in the order given
    value: Any = None  # what the function returned; None where it failed
    error: str | None = None  # one line; None where it did not fail


def outcome(function: Function, common: Any, task: Any) -> tuple[Any, str | None]:
    """Return what the function returns, or the line of its exception."""
    try:
        return function(common, task), None
    except Exception as error:
        return None, line_of(error)


def run(
    function: Function, tasks: Iterator[tuple[int, Any]], common: bytes, jobs: int
) -> Generator[Done, None, None]:
    """Yield how each task ended in one of `jobs` processes, which read what is common in a file.

    The processes are loky's. When one dies, loky ends the others too and every task that ran is
    lost; joblib's `Parallel` ends with it. So each of these tasks is tried again here, alone.
    """
    from joblib.externals.loky import get_reusable_executor

    with tempfile.TemporaryDirectory(prefix="ident-") as folder:
        file = Path(folder) / "common"
        file.write_bytes(common)

        def start(task: Any) -> Future[tuple[Any, str | None]]:
            processes = get_reusable_executor(jobs, timeout=IDLE, env=ONE_THREAD)
            return processes.submit(_call, str(file), function, task)

        running: dict[Future[tuple[Any, str | None]], tuple[int, Any]] = {}
        ended: list[Done] = []
        try:
            while True:
                while len(running) < jobs and (numbered := next(tasks, None)) is not None:
                    try:
                        running[start(numbered[1])] = numbered
                    except BrokenProcessPool:
                        tasks = chain([numbered], tasks)
                        if running:  # what runs is about to end so too
                            break
                yield from ended  # while others work
                if not running:
                    return
                futures = wait(running, return_when=FIRST_COMPLETED).done
                if any(map(_died, futures)):
                    futures = wait(running).done
                ended = []
                for future, (index, task) in [(each, running.pop(each)) for each in futures]:
                    for _ in range(TRIES - 1):
                        if _died(future):
                            future = start(task)
                            wait([future])
                    ended.append(_done(index, future))
        except BaseException:  # Ctrl-C, or nobody wants the rest
            until = time.monotonic() + HANDED_OUT
            # loky's thread fails on what it has not handed out yet
            while time.monotonic() < until and not all(f.running() or f.done() for f in running):
                time.sleep(0.001)
            get_reusable_executor(jobs, timeout=IDLE, env=ONE_THREAD).shutdown(kill_workers=True)
            raise


def _died(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _done(index: int, future: Future[tuple[Any, str | None]]) -> Done:
    if _died(future):
        return Done(index, error=f"its process died each of the {TRIES} times it was tried")
    if (error := future.exception()) is not None:  # the task or its result cannot be pickled
        return Done(index, error=line_of(error))
    return Done(index, *future.result())


def _call(file: str, function: Function, task: Any) -> tuple[Any, str | None]:
    return outcome(function, _common(file), task)


@lru_cache(maxsize=1)
def _common(file: str) -> Any:
    return pickle.loads(Path(file).read_bytes())
