"""viser's page and server: the only file that imports viser.

Its browser part comes with the package, so nothing is fetched. It is bound to this machine alone;
its offer to share the page through a server elsewhere is refused.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from typing import Any

from rich import get_console

from ident.errors import IdentError

HOST = "127.0.0.1"


def open_page(title: str, port: int = 0) -> Any:
    """A viser server on this machine alone.

    Args:
        title: of its panel.
        port: 0 takes a free one.

    Raises:
        IdentError: if viser is not installed, or the port cannot be had.
    """
    try:
        import viser
    except ImportError:
        raise IdentError(
            "the 3-D view needs the package viser, which is not installed; pip install viser"
        ) from None

    class Page(viser.ViserServer):  # type: ignore[misc, unused-ignore]
        def request_share_url(self, verbose: bool = True) -> str | None:
            return None  # it would open a tunnel to the outside

    port = _free(port)
    # it announces itself on standard output, where only results belong; and a port of the
    # environment would take the place of the one asked for
    with _quiet(), _without("_VISER_PORT_OVERRIDE"):
        page = Page(host=HOST, port=port, label=title, verbose=False)
    if page.get_port() != port:  # it takes the next one when somebody was faster
        close_page(page)
        raise _taken(port)
    page.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return page


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without what viser announces through rich, in notebooks too."""
    console = get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def close_page(page: Any) -> None:
    """End the server of `open_page`."""
    with _quiet():
        page.stop()


def _free(port: int) -> int:
    if not 0 <= port <= 65535:
        raise IdentError(f"port {port}: there is none; valid: 1 to 65535, or 0 for a free one")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as trial:
        if os.name == "posix":  # elsewhere it would let two programs share a port
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, port))
        except PermissionError:
            raise IdentError(
                f"port {port}: needs an administrator; give one of 1024 to 65535, or none"
            ) from None
        except OSError:
            raise _taken(port) from None
        return int(trial.getsockname()[1])


def _taken(port: int) -> IdentError:
    return IdentError(
        f"port {port}: is taken on {HOST}; give another one, or none, and a free one is taken"
    )


@contextlib.contextmanager
def _without(name: str) -> Any:
    value = os.environ.pop(name, None)
    try:
        yield
    finally:
        if value is not None:
            os.environ[name] = value
