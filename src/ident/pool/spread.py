"""The verb `spread`: one function, many tasks, whoever is free takes the next one."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Sized
from typing import Any

from ident.errors import IdentError
from ident.pool.call import Done, packed, tried
from ident.pool.local import locally

Function = Callable[[Any, Any], Any]


def spread(
    function: Function,
    tasks: Iterable[Any],
    *,
    common: Any = None,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Generator[Done, None, None]:
    """Calls `function(common, task)` for every task, in processes that may die.

    A task whose process dies is tried again, three times in all; the last time nothing else runs
    beside it, so that it is not blamed for another's fault. Linear algebra has one thread in each
    process. Closing the generator ends what still runs; without that it may outlive an exception.

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
        IdentError: for jobs that are none, if function or common cannot be sent to other processes,
            or if the scheduler does not answer or has no workers.
    """
    if scheduler is not None and jobs is not None:
        raise IdentError(
            f"jobs {jobs} and scheduler {scheduler}: its workers are the processes; give one of "
            "the two"
        )
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise IdentError(f"jobs {jobs!r}; valid: a whole number, 1 or more")
    if scheduler is not None:
        from ident.pool.cluster import on_cluster  # Dask is an extra, and slow to import

        return on_cluster(function, enumerate(tasks), packed(common), scheduler)
    most = len(tasks) if isinstance(tasks, Sized) else cores()
    jobs = min(cores(), most) if jobs is None else min(jobs, max(most, 1))
    if jobs <= 1:
        return _here(function, tasks, common)
    return locally(function, enumerate(tasks), packed(common), jobs)


def cores() -> int:
    """That this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


def _here(function: Function, tasks: Iterable[Any], common: Any) -> Generator[Done, None, None]:
    for index, task in enumerate(tasks):
        value, error = tried(function, common, task)
        yield Done(index, value, error)
