"""Tasks on the workers of a Dask scheduler, which sees to those that die or join meanwhile.

Dask's `map` and joblib's Dask backend would hand all tasks out at once, check no versions and end
with the first worker that is killed; the client of `distributed` is used directly.
"""

from __future__ import annotations

import asyncio
import contextlib
import pickle
import platform
import secrets
import threading
from collections.abc import Generator, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from functools import cached_property
from typing import Any, cast

from distributed import Client, Future, KilledWorker, Security, WorkerPlugin, get_worker, wait
from distributed.comm import connect

import ident
from ident.errors import IdentError, line_of
from ident.pool.local import Done, Function, outcome

ANSWER = 5  # [s] within which a scheduler answers
EMPTY = 60  # [s] without any worker after which the run is given up
LOOK = 1  # [s] between looks at whether there are workers


def run(
    function: Function,
    tasks: Iterator[tuple[int, Any]],
    common: bytes,
    scheduler: str,
) -> Generator[Done, None, None]:
    """Yield how each task ended on some worker; no more are sent than there are workers."""
    with _client(scheduler) as client, _shared(client, common, scheduler) as name:
        running: dict[Future, int] = {}
        ended: list[Done] = []
        without = 0
        try:
            while True:
                workers = len(client.scheduler_info(n_workers=-1)["workers"])
                while len(running) < max(workers, 1) and (task := next(tasks, None)) is not None:
                    future = client.submit(call, name, function, task[1], pure=False)
                    running[future] = task[0]
                yield from ended  # while others work
                if not running:
                    return
                ended = []
                with contextlib.suppress(TimeoutError), client.as_current():
                    for future in wait(list(running), LOOK, return_when="FIRST_COMPLETED").done:
                        ended.append(_done(running.pop(future), future))
                without = 0 if workers else without + LOOK
                if without >= EMPTY:
                    raise IdentError(
                        f"scheduler {scheduler}: has had no workers for {EMPTY} s; start some "
                        f"(dask worker {scheduler}) and run this again"
                    )
        except CancelledError:
            raise IdentError(
                f"scheduler {scheduler}: stopped answering; start it and its workers anew and run "
                "this again"
            ) from None
        finally:
            with contextlib.suppress(Exception):
                client.cancel(list(running), force=True)


def _done(index: int, future: Future) -> Done:
    try:
        return Done(index, *future.result())
    except (UnfitWorker, CancelledError):  # an unfit worker would fail all tasks: it is always free
        raise
    except KilledWorker as error:
        times = error.allowed_failures + 1
        return Done(index, error=f"its process died each of the {times} times it was tried")
    except Exception as error:
        return Done(index, error=line_of(error))


@contextlib.contextmanager
def _client(scheduler: str) -> Iterator[Client]:
    try:
        with ThreadPoolExecutor(1) as apart:  # from the event loop that a notebook runs in
            apart.submit(asyncio.run, _knock(scheduler)).result()
    except (OSError, ValueError) as error:
        raise IdentError(
            f"scheduler {scheduler}: does not answer ({line_of(error)}); valid: an address as "
            "tcp://host:8786, which 'dask scheduler' prints; it needs workers: dask worker "
            f"{scheduler}"
        ) from None
    with Client(scheduler, set_as_default=False) as client:
        try:
            client.wait_for_workers(1, timeout=ANSWER)
        except TimeoutError:
            raise IdentError(
                f"scheduler {scheduler}: has no workers; start some: dask worker {scheduler} "
                "--nworkers 4 --nthreads 1"
            ) from None
        yield client


async def _knock(scheduler: str) -> None:
    comm = await connect(scheduler, timeout=ANSWER, **Security().get_connection_args("client"))
    await comm.close()


@contextlib.contextmanager
def _shared(client: Client, common: bytes, scheduler: str) -> Iterator[str]:
    name = f"ident-{secrets.token_hex(8)}"
    try:
        try:
            client.register_plugin(Common(name, common))
        except IdentError:
            raise
        except Exception as error:
            raise IdentError(
                f"scheduler {scheduler}: a worker cannot be used ({line_of(error)}); install ident "
                "there"
            ) from None
        yield name
    finally:
        with contextlib.suppress(Exception):
            client.unregister_worker_plugin(name)


# --- on a worker ----------------------------------------------------------------------------------


class UnfitWorker(IdentError):
    """A worker whose versions differ, so that it might give other results than this process."""


class Common(WorkerPlugin):
    """What all tasks need, on every worker that there is or will be.

    Pinocchio's and CasADi's objects belong to one thread, so a worker runs one task at a time,
    however many threads it has.
    """

    def __init__(self, name: str, pickled: bytes) -> None:
        self.name, self.pickled, self.versions = name, pickled, versions()

    def setup(self, worker: Any) -> None:
        """Refuse a worker that has other versions."""
        self.lock, self.address = threading.Lock(), worker.address
        self.check()

    def check(self) -> None:
        """Refuse a worker that has other versions; called for each task, as workers may join."""
        for package, theirs in versions().items():
            if theirs != (ours := self.versions[package]):
                raise UnfitWorker(
                    f"worker {self.address}: has {package} {theirs}, here it is {ours}; install "
                    "the same on both"
                )

    @cached_property
    def content(self) -> Any:
        """Unpickled once a worker: its functions are compiled with the first task."""
        return pickle.loads(self.pickled)


def versions() -> dict[str, str]:
    """Return the versions that must be equal on all machines, by name."""
    return {"ident": ident.__version__, "Python": ".".join(platform.python_version_tuple()[:2])}


def call(name: str, function: Function, task: Any) -> tuple[Any, str | None]:
    """Call the function for one task; `name` is that of `Common`."""
    plugin = cast(Common, get_worker().plugins[name])
    plugin.check()
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:  # it limits the threads of linear algebra
        threadpool_limits = lambda n: contextlib.nullcontext()  # noqa: E731
    with plugin.lock, threadpool_limits(1):
        return outcome(function, plugin.content, task)
