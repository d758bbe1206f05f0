"""Another web site, another user and an old address against `explore` and `view`, in a browser."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from urllib.parse import urlsplit

import pytest

import ident
from helpers import ROBOTS
from ident.show.board import Board

# what the script of another site can try; what it could read or open
ATTACK = """async address => {
  const got = [], socket = address.replace("http", "ws");
  const within = promise => Promise.race([promise, new Promise(r => setTimeout(r, 4000, null))]);
  for (const mode of ["cors", "no-cors"]) {
    try {
      const answer = await fetch(address, {mode, credentials: "include"});
      if (answer.type != "opaque" && answer.ok) got.push("read " + (await answer.text()).length);
    } catch (error) { }
    try {
      const answer = await fetch(address, {mode, method: "POST", body: "{}"});
      if (answer.type != "opaque" && answer.ok) got.push("posted");
    } catch (error) { }
  }
  await within(new Promise(done => {
    const wire = new WebSocket(socket);
    wire.onopen = () => { got.push("socket"); done(); };
    wire.onerror = done;
  }));
  const frame = document.createElement("iframe");
  frame.src = address;
  document.body.append(frame);
  await within(new Promise(done => frame.onload = done));
  try { if (frame.contentDocument.body.innerText) got.push("frame"); } catch (error) { }
  return got;
}"""


class OtherSite(BaseHTTPRequestHandler):
    """Any page of another origin."""

    def do_GET(self) -> None:
        body = b"<!doctype html><title>other</title><p>another site</p>"
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def other_site() -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), OtherSite) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def serving(kind: str, folder, port: int = 0):
    """A context in which a page is served; what it yields has the address."""
    if kind == "explore":
        return Board("arm", folder).serve(port)
    return ident.load(ROBOTS / "arm").view().serve(port)


def address_of(served) -> str:
    return served if isinstance(served, str) else served.address


@pytest.fixture(scope="module", params=["explore", "view"])
def address(request, tmp_path_factory) -> Iterator[str]:
    with serving(request.param, tmp_path_factory.mktemp("out")) as served:
        yield address_of(served)


@pytest.fixture
def page(browser):
    context = browser.new_context()
    page = context.new_page()
    yield page
    context.close()


def test_the_browser_of_the_user_is_let_in(page, address):
    answer = page.goto(address, wait_until="commit")
    assert answer.status == 200
    assert page.locator("body").inner_text().strip() != "Open the printed address."
    read = page.evaluate(ATTACK, address)  # what it reads means that the attack below could
    alone = "connect-src 'none'" in page.content()  # then not even the page itself may read
    assert alone or read[0].startswith(("read", "socket"))  # its policy may leave it the socket


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_page_of_another_origin_reads_and_opens_nothing(page, address, other_site, host):
    """Even if it had the address with its token."""
    page.goto(other_site)
    assert page.evaluate(ATTACK, address.replace("127.0.0.1", host)) == []


def test_a_page_of_another_origin_that_guesses(page, address, other_site):
    page.goto(other_site)
    root = "http://{0.hostname}:{0.port}/".format(urlsplit(address))
    assert page.evaluate(ATTACK, root) == []


@pytest.mark.parametrize("path", ["", "x/", "index.html", "%2e%2e/", "AAAAAAAAAAAAAAAAAAAAAA/"])
def test_another_user_without_the_token_is_refused(page, address, path):
    root = "http://{0.hostname}:{0.port}/".format(urlsplit(address))
    assert page.goto(root + path).status == 403
    assert page.locator("body").inner_text().strip() == "Open the printed address."


@pytest.mark.parametrize("kind", ["explore", "view"])
def test_an_address_of_before_opens_nothing(page, kind, tmp_path):
    with serving(kind, tmp_path / "a") as served:
        old = address_of(served)
        port = urlsplit(old).port
    with serving(kind, tmp_path / "b", port) as served:
        assert urlsplit(address_of(served)).port == port
        assert address_of(served) != old
        assert page.goto(old).status == 403
        assert page.goto(address_of(served), wait_until="commit").status == 200
