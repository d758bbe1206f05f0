"""Pages for browsers on this machine alone: of `explore`, `view` and `monitor`.

Any web site in the same browser can send requests to a port of this machine, and by a name of its
own that resolves to 127.0.0.1 even read the answers. So a page is below a random path, which only
readers of the printed address know, and `Host` and `Origin` of every request and of every web
socket must be those of the page.
"""

from __future__ import annotations

import errno
import logging
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

from ident.errors import IdentError
from ident.show.charts import scripts
from ident.show.html import piece

HOST = "127.0.0.1"
# a page fetches nothing and talks to its own port alone, whatever the names in a log contain
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; form-action 'none'; base-uri 'none'"
)
TOKEN = 16  # random bytes of the path: 128 bits, which nobody guesses
REDRAWN = 1.0  # s between two states of a live page


def wait() -> None:
    """Wait for Ctrl-C, by sleeps: polars' handler of it restarts waits without an end."""
    while True:
        time.sleep(3600.0)


class Place:
    """A port that is taken, and the page that is served there until `stop()`; also a context.

    Attributes:
        port: on 127.0.0.1; address: of the page, with its token, to open in a browser.
    """

    def __init__(self, port: int = 0) -> None:
        """Take the port; 0 takes a free one. One that cannot be opened is an IdentError."""
        if not 0 <= port <= 65535:
            raise IdentError(f"port {port}: there is none; valid: 1 to 65535, or 0 for a free one")
        try:
            self.socket = socket.create_server((HOST, port))
        except OSError as error:
            why = "is taken" if error.errno == errno.EADDRINUSE else f"cannot be opened: {error}"
            raise IdentError(
                f"port {port}: {why} on {HOST}; give another one, or none for a free one"
            ) from None
        self.port: int = self.socket.getsockname()[1]
        self._token = secrets.token_urlsafe(TOKEN)
        self._shut: Callable[[], None] | None = None
        self.address = f"http://{HOST}:{self.port}/{self._token}/"

    def serve(self, page: str, talk: Callable[[Any], None]) -> Place:
        """Serve one page of HTML until `stop()`; each web socket talks in a thread of its own."""
        from websockets.exceptions import ConnectionClosed  # loaded only where a page is served
        from websockets.sync.server import serve

        hosts = {f"{HOST}:{self.port}", f"localhost:{self.port}"}
        policy = f"{POLICY}; connect-src {' '.join(f'ws://{host}' for host in sorted(hosts))}"

        def answer(connection: Any, request: Any) -> Any:
            named, origins, upgrade = map(request.headers.get_all, ("Host", "Origin", "Upgrade"))
            token, _, path = request.path.removeprefix("/").partition("/")
            if (
                not named
                or set(named) - hosts
                or set(origins) - {f"http://{host}" for host in hosts}
                or (upgrade and not origins)  # browsers name the origin of every web socket
                or not secrets.compare_digest(token.encode(), self._token.encode())
            ):
                return connection.respond(HTTPStatus.FORBIDDEN, "Open the printed address.\n")
            if upgrade:
                return None
            if path.partition("?")[0]:
                return connection.respond(HTTPStatus.NOT_FOUND, "There is one page only.\n")
            response = connection.respond(HTTPStatus.OK, page)
            del response.headers["Content-Type"]
            response.headers["Content-Type"] = "text/html; charset=utf-8"
            response.headers["Content-Security-Policy"] = policy
            return response

        def faulty(record: logging.LogRecord) -> bool:
            # browsers open connections ahead and close them unused, or leave without a word when a
            # page is loaded again: neither is a fault
            disconnected = record.exc_info and isinstance(record.exc_info[1], ConnectionClosed)
            return not disconnected and record.msg != "opening handshake failed"

        log = logging.getLogger("ident.page")
        log.addFilter(faulty)
        server = serve(talk, sock=self.socket, process_request=answer, close_timeout=1, logger=log)
        threading.Thread(target=server.serve_forever, name="ident page", daemon=True).start()
        self._shut = server.shutdown
        return self

    def stop(self) -> None:
        """Close the page; once is enough."""
        if self._shut:
            self._shut()
            self._shut = None

    def __enter__(self) -> Place:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __repr__(self) -> str:
        return self.address + " (ended)" * (self._shut is None)


class Readers:
    """Web sockets of open pages: each gets `first`, then what all are told; `heard` listens."""

    def __init__(
        self, first: Callable[[], str], heard: Callable[[str], None] = lambda text: None
    ) -> None:
        self.lock = threading.RLock()
        self._first, self._heard = first, heard
        self._sockets: set[Any] = set()

    def listen(self, socket: Any) -> None:
        """Talk with one page until it is closed."""
        with self.lock:
            self._sockets.add(socket)
            socket.send(self._first())
        try:
            for text in socket:
                self._heard(text)
        finally:
            self._sockets.discard(socket)

    def send(self, text: str) -> None:
        """Send a text to all pages."""
        from websockets.exceptions import ConnectionClosed

        with self.lock:
            for open_socket in list(self._sockets):
                try:
                    open_socket.send(text)
                except ConnectionClosed:
                    self._sockets.discard(open_socket)

    def close(self) -> None:
        """Close all pages."""
        for open_socket in list(self._sockets):
            open_socket.close()


@contextmanager
def live_page(title: str, port: int, state: Callable[[], str]) -> Iterator[str]:
    """Serve a page inside this context, which gives its address; it draws what `state` returns."""
    readers, ended = Readers(state), threading.Event()

    def send() -> None:
        last = ""
        while not ended.wait(REDRAWN):
            if (now := state()) != last:
                readers.send(last := now)

    with Place(port).serve(str(piece("live", title, scripts())), readers.listen) as page:
        threading.Thread(target=send, daemon=True).start()
        yield page.address
        ended.set()
        readers.send(state())
