"""`ident explore` as a process, and Debian's browser to drive it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import pytest

from pages import WRITTEN

Serve = Callable[..., "Served"]


@dataclass
class Served:
    """The process, and its address."""

    process: subprocess.Popen[str]
    address: str

    def interrupt(self) -> tuple[int, str]:
        """Ctrl-C: exit status and standard error."""
        self.process.send_signal(signal.SIGINT)
        _, said = self.process.communicate(timeout=120)
        return self.process.returncode, said


@dataclass
class Seen:
    """A page in the browser, what went wrong on it, and from which hosts it fetched."""

    page: Any
    faults: list[str] = field(default_factory=list)
    hosts: set[str] = field(default_factory=set)


@pytest.fixture
def serve(tmp_path) -> Iterator[Serve]:
    """`serve(*arguments)`: `ident explore` with them, as soon as it says its address."""
    started: list[Served] = []

    def run(*arguments: object) -> Served:
        command = [sys.executable, "-m", "ident", "explore", *map(str, arguments), "--no-browser"]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            # a shell's background work ignores Ctrl-C, and so would its children
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )  # fmt: skip
        assert process.stdout is not None
        said = process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/\S+/", said)
        if not found:
            process.kill()
            pytest.fail(f"{said}\n{process.communicate()[1]}")
        started.append(Served(process, found[0]))
        return started[-1]

    yield run
    for each in started:
        if each.process.poll() is None:
            each.process.kill()
        each.process.communicate()


@pytest.fixture
def visit(browser) -> Iterator[Callable[[str], Seen]]:
    """`visit(address)`: the page as soon as effects are listed."""
    contexts = []

    def opened(address: str) -> Seen:
        contexts.append(browser.new_context(viewport={"width": 1280, "height": 800}))
        seen = Seen(contexts[-1].new_page())
        seen.page.on("pageerror", lambda error: seen.faults.append(str(error)))
        seen.page.add_init_script(WRITTEN)
        seen.page.on("console", lambda m: seen.faults.append(m.text))
        seen.page.on("request", lambda r: seen.hosts.add(_host(r.url)))
        seen.page.on("websocket", lambda s: seen.hosts.add(_host(s.url)))
        seen.page.goto(address)
        seen.page.locator(".candidates li button").first.wait_for()
        return seen

    yield opened
    for each in contexts:
        each.close()


def _host(url: str) -> str:
    """Of an address; of a blob the page that made it."""
    return urlsplit(url.removeprefix("blob:")).hostname or url[:40]
