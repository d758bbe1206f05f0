"""One function applied to many tasks: in this process, in local processes or on a Dask cluster.

joblib's `Parallel` ends with the first process that dies and sends what all tasks share with each
of them, so its executor (loky) and Dask's are used directly: both return futures.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import platform
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence, Sized
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

import cloudpickle

from ident.display import Progress, part
from ident.errors import IdentError, check_whole, line_of
from ident.files import version
from ident.threads import ONE_THREAD

TRIES = 3  # work: of a task whose process dies
IDLE = 300  # range: [s] after which a process that has nothing to do ends
HANDED_OUT = 5  # range: [s] within which a submitted task reaches its process
CERTIFICATES = (
    "name them by DASK_DISTRIBUTED__COMM__TLS__CA_FILE, …__TLS__CLIENT__CERT and …__CLIENT__KEY in "
    "the environment, as docs/large_logs.md shows"
)
STOPPED = "stopped answering; start it and its workers anew and run this again"
ANSWER = 5  # range: [s] within which a scheduler answers and has workers
EMPTY = 60  # range: [s] without any worker after which the run is given up
LOOK = 1  # range: [s] between looks at whether there are workers
# whose results and pickles differ between versions; as pip and conda call them
NUMERICAL = {"NumPy": ("numpy",), "Pinocchio": ("pin", "pinocchio"), "CasADi": ("casadi",)}

Function = Callable[[Any, Any], Any]
Tasks = Iterator[tuple[int, Any]]
one_at_a_time = threading.Lock()  # Pinocchio's and CasADi's objects belong to one thread


@dataclass(frozen=True)
class Done:
    """How a task ended."""

    index: int  # number of the task, from 0, in the order given
    value: Any = None  # what the function returned; None where it failed
    error: str | None = None  # one line; None where it did not fail


class UnfitWorker(IdentError):
    """A worker whose versions differ, so that it might give other results than this process."""


def spread(
    function: Function,
    tasks: Iterable[Any],
    *,
    common: Any = None,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Generator[Done, None, None]:
    """Call `function(common, task)` for every task, in processes that may die.

    A task whose process dies is tried again, alone, so that it is not blamed for the fault of
    another. Linear algebra has one thread in each process. Closing the generator ends what still
    runs; without that it may outlive an exception.

    Args:
        function: of a module, called with `common` and one task; what it returns can be pickled.
        tasks: taken one by one, as processes become free.
        common: sent to each process once.
        jobs: local processes; None: one a core that this process may use; 1: this process alone.
        scheduler: address of a Dask scheduler whose workers take the tasks; then `jobs` must be
            None.

    Yields:
        One `Done` a task, in the order in which they end. An exception in a task is its `error`.

    Raises:
        IdentError: for an invalid number of jobs, if function or common cannot be sent to other
            processes, or if the scheduler does not answer or has no workers.
    """
    if scheduler is not None and jobs is not None:
        raise IdentError(
            f"jobs {jobs} and scheduler {scheduler}: its workers are the processes; give one of "
            "the two"
        )
    if jobs is None:
        from joblib import cpu_count  # takes 0.3 s to import

        jobs = cpu_count()
    check_whole("jobs", jobs, 1)
    if isinstance(tasks, Sized):
        jobs = min(jobs, max(len(tasks), 1))
    if scheduler is None and jobs == 1:
        return (Done(i, *_outcome(function, common, task)) for i, task in enumerate(tasks))
    try:
        pickled = cloudpickle.dumps(common)
    except Exception as error:
        raise IdentError(
            f"what all tasks share cannot be sent to other processes ({line_of(error)}); use this "
            "process alone: jobs=1"
        ) from None
    if scheduler is not None:
        return _on_cluster(function, enumerate(tasks), pickled, scheduler)
    return _in_processes(function, enumerate(tasks), pickled, jobs)


@dataclass(frozen=True, eq=False)
class Workers:
    """Processes that do the work, and the logs that turned out to be broken."""

    jobs: int | None = 1
    scheduler: str | None = None  # jobs, scheduler: as `spread` takes them
    alone: bool = True  # whether there is one log only, so that what is wrong with it is an error
    on_progress: Progress | None = None  # called with (what is being done, share done)
    broken: dict[str, str] = field(default_factory=dict)  # by name of a log, why it is left out

    def between(self, start: float, end: float) -> Workers:
        """Return the same workers for a part of the work, between two shares of the whole."""
        return replace(self, on_progress=part(self.on_progress, start, end))

    def run(
        self,
        function: Callable[[Any, Any], Any],
        tasks: Sequence[Any],
        common: Any,
        names: Sequence[str],
        what: str,
    ) -> Iterator[tuple[Any, Any]]:
        """Yield (task, value) in the order of the tasks, None for one that failed.

        The order in which they end is not that of the tasks, and floating-point sums depend on it.
        """
        done = spread(function, tasks, common=common, jobs=self.jobs, scheduler=self.scheduler)
        early: dict[int, Any] = {}
        at = 0
        with contextlib.closing(done):
            for count, item in enumerate(done, start=1):
                if self.on_progress:
                    self.on_progress(what, count / len(tasks))
                if item.error is not None:
                    if self.alone:
                        raise IdentError(item.error)
                    name = names[item.index]
                    self.broken.setdefault(name, item.error.removeprefix(f"{name}: "))
                early[item.index] = item.value
                while at in early:
                    yield tasks[at], early.pop(at)
                    at += 1


@cache
def versions() -> dict[str, str]:
    """Return the versions that must be equal on all machines, by name."""
    versions_found = {"ident": version(), "Python": ".".join(platform.python_version_tuple()[:2])}
    for name, packages in NUMERICAL.items():
        known = filter(None, (version(package, "") for package in packages))
        versions_found[name] = next(known, "of an unknown version")
    return versions_found


def _outcome(function: Function, common: Any, task: Any) -> tuple[Any, str | None]:
    """Return what the function returns, or the line of its exception."""
    try:
        return function(common, task), None
    except Exception as error:
        return None, line_of(error)


@lru_cache(maxsize=1)  # so that functions of a mechanism are compiled once a process
def _common(shared: str | bytes) -> Any:
    return pickle.loads(Path(shared).read_bytes() if isinstance(shared, str) else shared)


def _call(shared: str | bytes, function: Function, task: Any) -> tuple[Any, str | None]:
    return _outcome(function, _common(shared), task)


KILLED = "its process died each of the {} times it was tried"


@contextlib.contextmanager
def _not_interrupted() -> Iterator[None]:
    """Ignore Ctrl-C for a moment: processes that are started in it never get it, nor print it."""
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, before)


def _in_processes(
    function: Function, tasks: Tasks, common: bytes, jobs: int
) -> Generator[Done, None, None]:
    """Yield how each task ended in one of `jobs` processes, which read what is common in a file.

    When a process dies, loky ends the others too: each of their tasks is tried again, alone.
    """
    from joblib.externals.loky import get_reusable_executor

    executor = partial(get_reusable_executor, jobs, timeout=IDLE, env=ONE_THREAD)

    def died(future: Future[Any]) -> bool:
        return isinstance(future.exception(), BrokenProcessPool)

    with tempfile.TemporaryDirectory(prefix="ident-") as folder:
        file = Path(folder) / "common"
        file.write_bytes(common)
        call = partial(_call, str(file), function)
        running: dict[Future[tuple[Any, str | None]], tuple[int, Any]] = {}
        ended: list[Done] = []
        try:
            while True:
                while len(running) < jobs and (numbered := next(tasks, None)) is not None:
                    try:
                        with _not_interrupted():
                            future = executor().submit(call, numbered[1])
                        running[future] = numbered
                    except BrokenProcessPool:
                        tasks = chain([numbered], tasks)
                        if running:  # what runs is about to end so too
                            break
                yield from ended  # while others work
                if not running:
                    return
                futures = wait(running, return_when=FIRST_COMPLETED).done
                if any(map(died, futures)):
                    futures = wait(running).done
                ended = []
                for future in futures:
                    index, task = running.pop(future)
                    for _ in range(TRIES - 1):
                        if died(future):
                            future = executor().submit(call, task)
                            wait([future])
                    if (error := future.exception()) is None:
                        ended.append(Done(index, *future.result()))
                    else:  # else the task or its result cannot be pickled
                        why = KILLED.format(TRIES) if died(future) else line_of(error)
                        ended.append(Done(index, error=why))
        except BaseException:  # Ctrl-C, or nobody wants the rest
            until = time.monotonic() + HANDED_OUT
            # loky's thread fails on what it has not handed out yet
            while time.monotonic() < until and not all(f.running() or f.done() for f in running):
                time.sleep(0.001)
            executor().shutdown(kill_workers=True)
            raise


# --- Dask ----------------------------------------------------------------------------------------


def _on_cluster(
    function: Function, tasks: Tasks, common: bytes, scheduler: str
) -> Generator[Done, None, None]:
    """Yield how each task ended on some worker; no more are sent than there are workers."""
    with _client(scheduler) as client:
        from distributed import wait

        # a task of its own is made again if the worker that holds its result dies
        shared = client.submit(bytes, common, pure=False)
        call = partial(_call_on_worker, versions())
        running: dict[Any, int] = {}
        ended: list[Done] = []
        without = 0
        try:
            while True:
                workers = len(client.scheduler_info(n_workers=-1)["workers"])
                while len(running) < max(workers, 1) and (task := next(tasks, None)) is not None:
                    running[client.submit(call, shared, function, task[1], pure=False)] = task[0]
                yield from ended  # while others work
                if not running:
                    return
                ended = []
                with contextlib.suppress(TimeoutError), client.as_current():
                    for future in wait(list(running), LOOK, return_when="FIRST_COMPLETED").done:
                        ended.append(_done_on_worker(running.pop(future), future))
                without = 0 if workers else without + LOOK
                if without >= EMPTY:
                    why = f"had no worker for {EMPTY} s; start some (dask worker {scheduler}) and "
                    raise _fault(scheduler, f"{why}run this again")
        except CancelledError:
            raise _fault(scheduler, STOPPED) from None
        finally:
            with contextlib.suppress(Exception):
                client.cancel(list(running), force=True)


def _fault(scheduler: str, why: str) -> IdentError:
    return IdentError(f"scheduler {scheduler}: {why}")


def _done_on_worker(index: int, future: Any) -> Done:
    from distributed import KilledWorker

    try:
        return Done(index, *future.result())
    except (UnfitWorker, CancelledError):  # an unfit worker would fail all tasks: it is always free
        raise
    except KilledWorker as error:
        return Done(index, error=KILLED.format(error.allowed_failures + 1))
    except Exception as error:
        return Done(index, error=line_of(error))


@contextlib.contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    """Connect, and check that there are workers and that ident is installed on them."""
    try:
        from distributed import Client, Security  # Dask is an extra, and slow to import
        from distributed.utils import silence_logging_cmgr
    except ImportError:
        raise IdentError(
            'a scheduler needs Dask, which is not installed; pip install "ident[cluster]", on '
            "the workers too, or leave it out for processes on this machine"
        ) from None
    try:
        security = Security()
        args = security.get_connection_args("client")
    except (OSError, ValueError, TypeError) as error:  # files that are named and cannot be read
        raise _fault(scheduler, f"{line_of(error)}; {CERTIFICATES}") from None
    if scheduler.startswith("tls:") and args.get("ssl_context") is None:
        raise _fault(scheduler, f"needs certificates; {CERTIFICATES}")
    client = Client.__new__(Client)
    try:
        Client.__init__(client, scheduler, set_as_default=False, timeout=ANSWER, security=security)
    except (OSError, ValueError) as error:
        # left to the garbage collector, it may end in the thread that the next client starts: both
        # then wait for the lock of all clients' loops
        client.close()
        why = f"does not answer ({line_of(error)}); valid: an address as tcp://host:8786, which "
        why += f"'dask scheduler' prints; it needs workers: dask worker {scheduler}"
        raise _fault(scheduler, why) from None
    # lost connections end in one line here; Dask would write tracebacks of them, too
    with silence_logging_cmgr(logging.CRITICAL), client:
        try:
            client.wait_for_workers(1, timeout=ANSWER)
        except TimeoutError:
            command = f"dask worker {scheduler} --nworkers 4 --nthreads 1"
            raise _fault(scheduler, f"has no workers; start some: {command}") from None
        try:
            client.run(_check_worker, versions())
        except UnfitWorker:
            raise
        except (OSError, CancelledError):
            raise _fault(scheduler, STOPPED) from None
        except Exception as error:
            why = f"a worker cannot be used ({line_of(error)}); install ident there"
            raise _fault(scheduler, why) from None
        yield client


def _check_worker(ours: dict[str, str]) -> None:
    """Raise UnfitWorker on a worker that has other versions."""
    for package, other in versions().items():
        if other != ours.get(package, other):
            raise UnfitWorker(
                f"worker on {platform.node()}: has {package} {other}, here it is "
                f"{ours[package]}; install the same on both"
            )


def _call_on_worker(
    ours: dict[str, str], shared: bytes, function: Function, task: Any
) -> tuple[Any, str | None]:
    from threadpoolctl import threadpool_limits

    _check_worker(ours)  # a worker may have joined since
    with one_at_a_time, threadpool_limits(1):
        return _call(shared, function, task)
