"""A Dask scheduler and its workers as processes of their own, on loopback."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from distributed import Client

PATIENCE = 60  # seconds after which what should have happened never will


def until(happened: Callable[[], object]) -> None:
    """Waits for it."""
    end = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < end, f"{happened} did not happen in {PATIENCE} s"
        time.sleep(0.02)


@dataclass
class Cluster:
    """A scheduler at an address, and processes of workers with one thread each."""

    folder: Path
    address: str
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, name: str, *options: str) -> subprocess.Popen[bytes]:
        """One more worker, or, with `--nworkers`, several."""
        process = _dask(
            self.folder, "worker", self.address, "--nthreads", "1", "--host", "127.0.0.1",
            "--local-directory", str(self.folder), "--name", name, *options,
        )  # fmt: skip
        self.processes.append(process)
        return process

    def wait_for(self, workers: int) -> None:
        """Until so many are there."""
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE)

    def busy(self, name: str) -> bool:
        """Whether a worker has a task."""
        with Client(self.address, set_as_default=False) as client:
            workers = client.scheduler_info(n_workers=-1)["workers"]
            return any(
                keys and workers[at]["name"] == name for at, keys in client.processing().items()
            )


@contextlib.contextmanager
def cluster(folder: Path, *options: str) -> Iterator[Cluster]:
    """A scheduler; it ends with its workers, whatever happens."""
    file = folder / "scheduler.json"
    scheduler = _dask(
        folder,
        "scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--scheduler-file",
        str(file),
        *options,
    )
    made = Cluster(folder, "", [scheduler])
    try:
        until(lambda: file.exists() and file.read_text().rstrip().endswith("}"))
        made.address = json.loads(file.read_text())["address"]
        yield made
    finally:
        for process in reversed(made.processes):  # the scheduler last: workers take leave of it
            process.send_signal(signal.SIGCONT)
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _dask(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    number = len(list(folder.glob("*.log")))
    with (folder / f"{words[0]}_{number}.log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--no-dashboard"],
            stdout=log,
            stderr=log,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
