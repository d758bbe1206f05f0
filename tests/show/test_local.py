"""Pages of this machine answer nobody but the page itself: `explore` and `view` alike."""

from __future__ import annotations

import base64
import logging
import os
import socket
import urllib.request
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import connect

import ident
from helpers import ROBOTS
from ident.show.board import Board
from ident.show.local import Place


@pytest.fixture(scope="module", params=["explore", "view"])
def address(request, tmp_path_factory) -> Iterator[str]:
    if request.param == "explore":
        with Board("arm", tmp_path_factory.mktemp("out")).serve() as found:
            yield found
    else:
        with ident.load(ROBOTS / "arm").view().serve() as page:
            yield page.address


def status(address: str, path: str | None = None, websocket: bool = False, **headers: str) -> int:
    """Return the status that a request gets; a header of "" is not sent."""
    place = urlsplit(address)
    every = {"Host": place.netloc, "Origin": f"http://{place.netloc}"} | headers
    if websocket:
        every |= {
            "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode(),
        }  # fmt: skip
    lines = [f"GET {place.path if path is None else path} HTTP/1.1"]
    lines += [f"{name}: {value}" for name, value in every.items() if value]
    with socket.create_connection((place.hostname, place.port), timeout=20) as wire:
        wire.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        return int(wire.recv(100).split()[1])


def test_the_page_itself_is_answered(address):
    assert status(address) == status(address, Origin="") == 200
    assert status(address, websocket=True) == 101
    assert status(address.replace("127.0.0.1", "localhost")) == 200


@pytest.mark.parametrize("websocket", [False, True])
def test_nobody_else_is(address, websocket):
    port = urlsplit(address).port
    for path in ("/", "/x/", "//", urlsplit(address).path[:-3]):
        assert status(address, path, websocket) == 403
    for host in ("example.org", f"example.org:{port}", "127.0.0.1:1", "127.0.0.1"):
        assert status(address, None, websocket, Host=host) == 403
    for origin in ("http://example.org", "http://127.0.0.1:1", "null"):
        assert status(address, None, websocket, Origin=origin) == 403


def test_a_web_socket_names_its_origin(address):
    assert status(address, websocket=True, Origin="") == 403


def test_a_connection_that_is_closed_unused_is_no_fault(address, caplog, capfd):
    place = urlsplit(address)
    for _ in range(3):
        socket.create_connection((place.hostname, place.port), timeout=20).close()
    assert status(address) == 200
    assert not caplog.records
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.usefixtures("address")
def test_a_page_that_leaves_without_a_word_is_no_fault(caplog):
    log, left = logging.getLogger("ident.page"), ConnectionClosedError(None, None)
    log.error("unexpected internal error", exc_info=left)
    assert not caplog.records
    log.error("unexpected internal error", exc_info=ValueError("another"))
    assert len(caplog.records) == 1


def test_every_address_has_its_own_token():
    tokens = set()
    for _ in range(3):
        place = Place()
        tokens.add(urlsplit(place.address).path)
        place.socket.close()
    assert len(tokens) == 3


def test_a_port_that_is_taken_is_refused():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ident.IdentError, match=rf"port {port}: is taken .*; give another"):
            Place(port)
    with pytest.raises(ident.IdentError, match="valid: 1 to 65535"):
        Place(99999)


def test_a_page_may_talk_to_its_own_port_alone(address):
    with urllib.request.urlopen(address) as answer:
        policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    port = urlsplit(address).port
    (targets,) = [part for part in policy.split("; ") if part.startswith("connect-src")]
    assert targets.split()[1:] == [f"ws://127.0.0.1:{port}", f"ws://localhost:{port}"]


@pytest.mark.parametrize(
    "frame",
    ["", "{", "[]", "null", '{"do": 3}', '{"do": "fly"}', b"\xff\xfe", "[" * 100_000, '{"do": []}'],
)
def test_a_frame_that_no_page_sends_changes_nothing(frame, tmp_path, capfd, caplog):
    board = Board("arm", tmp_path)
    with board.serve() as found:
        place, before = urlsplit(found), dict(board.state)
        origin = f"http://{place.netloc}"
        with connect(found.replace("http", "ws"), origin=origin) as socket_of_page:
            socket_of_page.recv()
            socket_of_page.send(frame)
            socket_of_page.send('{"do": "look", "view": "Joint", "joint": ""}')
            socket_of_page.ping().wait(5)
        assert board.state == before
    assert "Traceback" not in capfd.readouterr().err + caplog.text
