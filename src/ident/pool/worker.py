"""At a Dask worker: what all tasks need, and one of them called."""

from __future__ import annotations

import contextlib
import pickle
import platform
import threading
from collections.abc import Callable
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any, cast

from distributed import WorkerPlugin, get_worker

from ident.errors import IdentError
from ident.pool.call import tried


class Unfit(IdentError):
    """A worker that would answer otherwise than this process would."""


class Common(WorkerPlugin):
    """What all tasks need, at every worker that there is or will be.

    Pinocchio's and CasADi's objects belong to one thread, so a worker runs one task at a time,
    however many threads it has.
    """

    def __init__(self, name: str, packed: bytes) -> None:
        self.name, self.packed, self.versions = name, packed, versions()

    def setup(self, worker: Any) -> None:
        """Refuses a worker that has other versions."""
        self.lock, self.address = threading.Lock(), worker.address
        self.check()

    def check(self) -> None:
        """Refuses tasks too, of a worker that joined later.

        Raises:
            Unfit: if it has other versions than are here.
        """
        for package, there in versions().items():
            if there != (here := self.versions[package]):
                raise Unfit(
                    f"worker {self.address}: has {package} {there}, here it is {here}; install the "
                    "same on both"
                )

    @cached_property
    def unpacked(self) -> Any:
        """Once a worker: its functions are compiled with the first task."""
        return pickle.loads(self.packed)


def versions() -> dict[str, str]:
    """What must be the same here and there, by name."""
    try:
        own = version("ident")
    except PackageNotFoundError:  # run from a checkout that is not installed
        own = "0"
    return {"ident": own, "Python": ".".join(platform.python_version_tuple()[:2])}


def there(name: str, function: Callable[[Any, Any], Any], task: Any) -> tuple[Any, str | None]:
    """What `tried` says; `name` is that of `common`."""
    plugin = cast(Common, get_worker().plugins[name])
    plugin.check()
    with plugin.lock, _one_thread():
        return tried(function, plugin.unpacked, task)


def _one_thread() -> contextlib.AbstractContextManager[Any]:
    """Of linear algebra, where the means for that are installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return contextlib.nullcontext()
    return threadpool_limits(1)
