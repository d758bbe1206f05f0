"""Who does the work of a gathering, and what becomes of tasks that fail."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from ident.errors import IdentError
from ident.pool import spread
from ident.progress import Told


@dataclass(frozen=True, eq=False)
class Crew:
    """Processes, and the logs that are left out.

    Attributes:
        jobs, scheduler: as `pool.spread` takes them.
        alone: whether there is one log only, so that what is wrong with it is an error.
        progress: called with (what is being done, share done).
        broken: by name of a log, why it is left out.
    """

    jobs: int | None = 1
    scheduler: str | None = None
    alone: bool = True
    progress: Told | None = None
    broken: dict[str, str] = field(default_factory=dict)

    def over(
        self,
        function: Callable[[Any, Any], Any],
        tasks: Sequence[Any],
        common: Any,
        names: Sequence[str],
        what: str,
    ) -> Iterator[tuple[int, Any]]:
        """(index, value) of the tasks in the order in which they end; None for one that failed.

        Args:
            function: of `common` and a task.
            tasks: what is done.
            common: sent once to each process.
            names: of each task's log.
            what: is being done, for the progress.

        Raises:
            IdentError: if the only log, or the last one that was left, is broken.
        """
        done = spread(function, tasks, common=common, jobs=self.jobs, scheduler=self.scheduler)
        with closing(done):
            for count, each in enumerate(done, start=1):
                if self.progress:
                    self.progress(what, count / len(tasks))
                if each.error is not None:
                    if self.alone:
                        raise IdentError(each.error)
                    self.broken.setdefault(names[each.index], each.error)
                yield each.index, each.value
