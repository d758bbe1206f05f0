"""One function applied to many tasks, in this process, in local processes or on a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Sized
from typing import Any

import cloudpickle

from ident.errors import IdentError, line_of
from ident.pool import local
from ident.pool.local import Done, Function, outcome

__all__ = ["Done", "cores", "spread"]


def spread(
    function: Function,
    tasks: Iterable[Any],
    *,
    common: Any = None,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Generator[Done, None, None]:
    """Call `function(common, task)` for every task, in processes that may die.

    A task whose process dies is tried again, three times in all, and alone, so that it is not
    blamed for the fault of another. Linear algebra has one thread in each process. Closing the
    generator ends what still runs; without that it may outlive an exception.

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
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise IdentError(f"jobs {jobs!r}; valid: a whole number, 1 or more")
    if scheduler is not None:
        try:
            from ident.pool import cluster  # Dask is an extra, and slow to import
        except ImportError:
            raise IdentError(
                'a scheduler needs Dask, which is not installed; pip install "ident[cluster]", on '
                "the workers too, or leave it out for processes on this machine"
            ) from None
        return cluster.run(function, enumerate(tasks), _pickled(common), scheduler)
    most = len(tasks) if isinstance(tasks, Sized) else cores()
    jobs = min(cores() if jobs is None else jobs, max(most, 1))
    if jobs == 1:
        return (Done(i, *outcome(function, common, task)) for i, task in enumerate(tasks))
    return local.run(function, enumerate(tasks), _pickled(common), jobs)


def cores() -> int:
    """Return the number of cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


def _pickled(common: Any) -> bytes:
    try:
        return cloudpickle.dumps(common)
    except Exception as error:
        raise IdentError(
            f"what all tasks share cannot be sent to other processes ({line_of(error)}); use this "
            "process alone: jobs=1"
        ) from None
