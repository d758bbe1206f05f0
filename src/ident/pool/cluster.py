"""Workers of a Dask scheduler; it sees to those that die or join while the tasks run."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from typing import Any

from ident.errors import IdentError
from ident.pool.call import Done, line_of

try:
    from distributed import Client, Future, KilledWorker, Security, wait
    from distributed.comm import connect

    from ident.pool.worker import Common, Unfit, there
except ImportError:
    raise IdentError(
        'a scheduler needs Dask, which is not installed; pip install "ident[cluster]", on the '
        "workers too, or leave it out for processes on this machine"
    ) from None

ANSWER = 5  # seconds within which a scheduler answers
EMPTY = 60  # seconds without any worker after which the run is given up
LOOK = 1  # seconds between looks at whether there are workers

Function = Callable[[Any, Any], Any]


def on_cluster(
    function: Function, tasks: Iterator[tuple[int, Any]], common: bytes, scheduler: str
) -> Generator[Done, None, None]:
    """Every task on some worker: no more are sent than there are workers, so none waits in line."""
    with _client(scheduler) as client, _shared(client, common, scheduler) as name:
        flying: dict[Future, int] = {}
        ended: list[Done] = []
        without = 0
        try:
            while True:
                workers = len(client.scheduler_info(n_workers=-1)["workers"])
                while len(flying) < max(workers, 1) and (task := next(tasks, None)) is not None:
                    future = client.submit(there, name, function, task[1], pure=False)
                    flying[future] = task[0]
                yield from ended  # while others work
                if not flying:
                    return
                ended = [
                    _done(flying.pop(each), each) for each in _ended(client, flying, scheduler)
                ]
                without = 0 if workers else without + LOOK
                if without >= EMPTY:
                    raise IdentError(
                        f"scheduler {scheduler}: has had no workers for {EMPTY} s; start some "
                        f"(dask worker {scheduler}) and run this again"
                    )
        finally:
            with contextlib.suppress(Exception):
                client.cancel(list(flying), force=True)


def _ended(client: Client, flying: Iterable[Future], scheduler: str) -> set[Future]:
    """Those that ended within a second.

    Raises:
        IdentError: if the scheduler is gone.
    """
    try:
        with client.as_current():
            return set(wait(list(flying), LOOK, return_when="FIRST_COMPLETED").done)
    except TimeoutError:
        return set()
    except CancelledError:
        raise IdentError(
            f"scheduler {scheduler}: stopped answering; start it and its workers anew and run this "
            "again"
        ) from None


def _done(index: int, future: Future) -> Done:
    try:
        return Done(index, *future.result())
    except Exception as error:
        failed = error
    if isinstance(failed, Unfit):  # it would fail all tasks, and be the first to be free for more
        raise failed
    if isinstance(failed, KilledWorker):
        times = failed.allowed_failures + 1
        return Done(index, error=f"its process died each of the {times} times it was tried")
    return Done(index, error=line_of(failed))


@contextlib.contextmanager
def _client(scheduler: str) -> Iterator[Client]:
    """A connection to a scheduler that has workers.

    Raises:
        IdentError: if there is none.
    """
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
    """Whether somebody answers; a Client that nobody answers cannot be closed."""
    comm = await connect(scheduler, timeout=ANSWER, **Security().get_connection_args("client"))
    await comm.close()


@contextlib.contextmanager
def _shared(client: Client, common: bytes, scheduler: str) -> Iterator[str]:
    """The name under which the workers find what is common.

    Raises:
        IdentError: if one of them cannot use it.
    """
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
