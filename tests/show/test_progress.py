"""Progress: over the whole of each verb, in notebooks and terminals, and nothing elsewhere."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import nbformat
import pytest
from nbclient import NotebookClient

import ident
from ident.diagnosis import diagnose, grow
from ident.display import no_progress
from ident.fit import identify
from ident.show.progress import watched
from identification import motion_log, plant, robot

SCRIPT = """
import ident
mechanism = ident.load("robots/four_bar")
motion = ident.complete(mechanism, ident.read_log("robots/four_bar/run.csv"))
fit = ident.identify(mechanism, motion)
"""


@pytest.fixture(scope="module")
def planted():
    mechanism = robot("four_bar")
    case = plant(mechanism.with_effect("viscous:crank"), motion_log("four_bar", 100.0), seed=1)
    return mechanism, ident.complete(mechanism, case.log)


@pytest.mark.parametrize("verb", ["identify", "limits", "diagnose", "grow"])
def test_shares_are_of_the_whole_work(planted, verb):
    mechanism, motion = planted
    told: list[tuple[str, float]] = []
    report = {"progress": lambda what, share: told.append((what, share))}
    if verb == "limits":
        given = {"consistent": True, "validate": motion}
        identify(mechanism.with_effect("stribeck:crank"), motion, **given, **report)
    elif verb == "diagnose":
        diagnose(identify(mechanism, motion), **report)
    else:
        {"identify": identify, "grow": grow}[verb](mechanism, motion, **report)
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert 0 <= shares[0] < 0.5
    assert 0.8 < shares[-1] <= 1
    assert all(what for what, _ in told)


def test_a_script_whose_errors_go_into_a_file_prints_nothing(root):
    done = subprocess.run([sys.executable, "-c", SCRIPT], cwd=root, capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")


def test_a_script_in_a_terminal_shows_a_bar(root):
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=root, stderr=theirs, env=environment, check=True
    )
    os.close(theirs)
    seen = b""
    try:
        while chunk := os.read(ours, 65536):
            seen += chunk
    except OSError:  # the end, on Linux
        pass
    os.close(ours)
    assert b"completing run.csv" in seen
    assert "━".encode() in seen
    assert b"left" in seen


class Recorder(NotebookClient):
    """Keeps all that a kernel shows, also what it removes later."""

    def process_message(self, msg, cell, cell_index):
        self.shown = [*getattr(self, "shown", []), msg["content"].get("data", {})]
        return super().process_message(msg, cell, cell_index)


def test_a_notebook_shows_a_bar_and_keeps_none(root):
    hurry = "import ident.show.progress as shown\nshown.AFTER = shown.EVERY = 0.0\n"
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(hurry + SCRIPT)])
    client = Recorder(book, timeout=120, resources={"metadata": {"path": str(root)}})
    client.execute()
    bars = [data["text/html"] for data in client.shown if "<progress" in data.get("text/html", "")]
    assert any("equations of run.csv" in bar and " s left" in bar for bar in bars)
    assert {str(output.data) for output in book.cells[0].outputs} == {"{'text/plain': ''}"}


def test_progress_that_is_given_replaces_the_bar():
    seen = []
    verb = watched(lambda *, progress=None: seen.append(progress))
    verb(progress=no_progress)
    verb()
    assert seen == [no_progress, None]  # of a test nobody sees the standard error
