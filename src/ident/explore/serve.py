"""An exploration as a page of one's own machine, at 127.0.0.1 and nowhere else."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ident.errors import IdentError
from ident.explore.exploration import Exploration

HOST = "127.0.0.1"


def serve(
    exploration: Exploration,
    *,
    port: int = 0,
    browser: bool = True,
    folder: str | Path | None = None,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Serves the page until interrupted (Ctrl-C).

    A page that is loaded again goes on where the last one was.

    Args:
        exploration: to start from.
        port: 0 for a free one.
        browser: whether to open the page.
        folder: that is proposed for saving.
        ready: called with the page's address.

    Raises:
        IdentError: if the port is taken, or Panel is not installed.
    """
    port = free_port(port)
    try:
        server = _server(exploration, port, folder)
    except OSError as error:
        raise _taken(port, error) from None
    address = f"http://{HOST}:{port}/"
    server.io_loop.asyncio_loop.set_exception_handler(_heard)
    if ready:
        ready(address)
    if browser:
        server.io_loop.call_later(0.2, webbrowser.open, address)
    with contextlib.suppress(KeyboardInterrupt):
        server.start()
        server.io_loop.start()
    server.stop()


def _heard(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """What goes wrong on the loop, but for what is written to a page that has been left."""
    from tornado.websocket import WebSocketClosedError

    if not isinstance(context.get("exception"), WebSocketClosedError):
        loop.default_exception_handler(context)


def _server(exploration: Exploration, port: int, folder: str | Path | None) -> Any:
    import panel

    from ident.explore.board import Board
    from ident.explore.parts import PAGE

    logging.getLogger("bokeh").setLevel(logging.ERROR)
    panel.config.raw_css = [PAGE]
    latest = [exploration]

    def page() -> Any:
        board = Board(latest[0], folder)
        board.changed = lambda found: latest.__setitem__(0, found)
        panel.state.onload(board.announced)  # a page left too early had not announced yet
        return board

    origins = [f"{HOST}:{port}", f"localhost:{port}"]
    title = f"ident: {exploration.mechanism.name}"
    return panel.io.server.get_server(
        {"/": page}, port=port, address=HOST, websocket_origin=origins, title={"/": title}
    )


def free_port(port: int) -> int:
    """The port asked for if it is free, or any that is.

    Raises:
        IdentError: if it is taken.
    """
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((HOST, port))
        except OSError as error:
            raise _taken(port, error) from None
        return int(tried.getsockname()[1])


def _taken(port: int, error: OSError) -> IdentError:
    return IdentError(
        f"--port {port}: {error.strerror or error}; name another port, or leave --port out for a "
        "free one"
    )
