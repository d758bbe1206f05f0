"""The verb `explore`, and the page served on 127.0.0.1 and nowhere else."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import logging
import os
import webbrowser
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.errors import IdentError, MechanismError
from ident.log import Log
from ident.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.show.explore.exploration import Exploration
from ident.show.port import HOST, free_port, refused

if TYPE_CHECKING:
    from ident.show.explore.page import Board

File = str | os.PathLike[str]
Logs = Log | File | Sequence[Log | File]


def check_panel() -> None:
    """Refuse, before long work, what could not be shown.

    Raises:
        IdentError: if Panel is not installed.
    """
    try:
        import panel  # noqa: F401
    except ImportError:
        raise IdentError("explore needs Panel, which is not installed: pip install panel") from None


@cache
def load_in_jupyter() -> None:
    """Put Panel's scripts into the notebook, once, so that nothing comes from a network."""
    import panel

    try:
        from IPython.core.getipython import get_ipython
    except ImportError:
        return
    if hasattr(get_ipython(), "kernel"):
        panel.extension(inline=True)


def without_network(board: Board) -> Board:
    """Return the board with the styles inline that Panel would fetch in a notebook."""
    from bokeh.models import ImportedStyleSheet
    from panel.io.resources import CDN_DIST, DIST_DIR

    def inside(viewable: Any, root: Any) -> None:
        for sheet in root.select({"type": ImportedStyleSheet}):
            file = DIST_DIR / sheet.url.removeprefix(CDN_DIST).partition("?")[0]
            if sheet.url.startswith(CDN_DIST) and file.is_file():
                data = base64.b64encode(file.read_bytes()).decode()
                sheet.url = f"data:text/css;base64,{data}"

    layout = board.controls.layout
    layout._preprocessing_hooks = [*layout._preprocessing_hooks, inside]
    return board


def serve(
    exploration: Exploration,
    *,
    port: int = 0,
    browser: bool = True,
    folder: str | Path | None = None,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Serve the page until interrupted (Ctrl-C); loaded again it goes on where the last one was.

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
        raise refused(port, error) from None
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
    """Report errors of the loop, but not of writing to a closed page."""
    from tornado.websocket import WebSocketClosedError

    if not isinstance(context.get("exception"), WebSocketClosedError):
        loop.default_exception_handler(context)


def _server(exploration: Exploration, port: int, folder: str | Path | None) -> Any:
    import panel

    from ident.show.explore.page import PAGE, Board

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


def explore(mechanism: Mechanism, log: Motion | Logs) -> Board:
    """Effects added and removed by a click, while the error falls.

    Args:
        mechanism: to start from.
        log: one or several, or their files, or the completed motion.

    Returns:
        A widget, which Jupyter shows as it is; `widget.exploration` is what was found by hand.

    Raises:
        MechanismError: if it is given no mechanism.
        IdentError: for a log that does not fit the mechanism, or if Panel is not installed.
    """
    if not isinstance(mechanism, Mechanism):
        raise MechanismError(
            f"explore needs a mechanism, given: {type(mechanism).__name__}; write "
            "ident.explore(ident.load(folder), log)"
        )
    check_panel()
    motion = log if isinstance(log, Motion) else complete(mechanism, log)
    load_in_jupyter()
    from ident.show.explore.page import Board

    return without_network(Board(Exploration.of(mechanism, motion).screened()))
