"""The widget without a browser: stages, clicks during work, errors in words."""

from __future__ import annotations

import asyncio
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from explored import given, screened

import ident
from helpers import ROBOTS
from ident import FitError, MechanismError

pytest.importorskip("panel")

from ident.show.explore.page import Board
from ident.show.explore.views import VIEWS


def run(work):
    """Run a coroutine beside the loop that a browser of other tests keeps in this thread."""
    with ThreadPoolExecutor() as threads:
        return threads.submit(asyncio.run, work).result()


def labels(board: Board, present: bool) -> list[str]:
    return [row["label"] for row in board.controls.candidates.rows if row["present"] is present]


def test_a_click_adds_and_another_removes():
    board = Board(screened())
    assert board.controls.undo.disabled
    run(board.toggle("viscous:elbow", False))
    c = board.controls
    assert labels(board, True) == ["viscous:elbow"]
    assert c.candidates.stale is False
    assert c.candidates.locked is False
    assert c.joint.value == "elbow"
    assert [row[0] for row in c.ladder.rows] == ["model", "as given", "+ viscous:elbow"]
    assert "25.3\xa0%" in c.errors.object
    assert not c.undo.disabled
    run(board.toggle("viscous:elbow", True))
    assert labels(board, True) == []
    run(board.back(0))
    assert len(board.exploration.rungs) == 1
    run(board.undone())
    assert len(board.exploration.rungs) == 3


def test_clicks_during_work_do_nothing():
    board = Board(screened())

    async def hurried() -> None:
        first = asyncio.ensure_future(board.toggle("viscous:elbow", False))
        await asyncio.sleep(0)
        assert board.controls.candidates.locked
        await asyncio.gather(board.toggle("coulomb:yaw", False), board.undone(), board.back(0))
        await first

    run(hurried())
    assert [rung.name for rung in board.exploration.rungs] == ["as given", "+ viscous:elbow"]


def test_a_change_while_falls_are_announced_wins():
    board = Board(screened())

    async def impatient() -> None:
        first = asyncio.ensure_future(board.toggle("viscous:elbow", False))
        while board._busy or len(board.exploration.rungs) == 1:
            await asyncio.sleep(0.01)
        assert board.controls.candidates.stale
        await board.toggle("coulomb:elbow", False)
        await first

    run(impatient())
    assert [x.label for x in board.exploration.mechanism.effects] == [
        "viscous:elbow",
        "coulomb:elbow",
    ]
    assert board.exploration.candidates
    assert set(labels(board, True)) == {"viscous:elbow", "coulomb:elbow"}
    assert board.controls.status.kind == "done"


def test_the_loop_stays_alive_during_work():
    board, ticks = Board(screened()), []

    async def watched() -> None:
        task = asyncio.ensure_future(board.toggle("viscous:yaw", False))
        while not task.done():
            ticks.append(time.perf_counter())
            await asyncio.sleep(0.02)

    run(watched())
    assert len(ticks) > 5


def test_what_goes_wrong_is_one_line_and_changes_nothing():
    board = Board(screened())
    run(board.toggle("viscous:nowhere", False))
    assert board.controls.status.kind == "bad"
    assert board.controls.status.said.startswith("error: ")
    assert "\n" not in board.controls.status.said
    assert board.exploration is screened()
    assert not board.controls.candidates.locked


def test_a_fault_is_said_and_the_page_lives_on(monkeypatch):
    board = Board(screened())

    def broken(*args: object) -> None:
        raise ZeroDivisionError("by\nnought")

    monkeypatch.setattr(sys.modules["ident.show.explore.exploration"], "identify", broken)
    run(board.toggle("viscous:elbow", False))
    assert board.controls.status.said.startswith("error: a fault of ident, not of yours: ")
    monkeypatch.undo()
    run(board.toggle("viscous:elbow", False))
    assert len(board.exploration.rungs) == 2


@pytest.mark.parametrize(
    ("folder", "kind", "words"),
    [
        ("", "bad", "no folder"),
        (str(ROBOTS / "arm"), "bad", "name another folder"),
        ("/proc/nothing/here", "bad", "error: "),
        ("made", "done", "saved into"),
    ],
)
def test_saving_says_what_came_of_it(folder, kind, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    board = Board(screened(), folder or "x")
    board.controls.folder.value = board.controls.folder.value_input = folder
    run(board.saved())
    assert board.controls.status.kind == kind
    assert words in board.controls.status.said
    assert (tmp_path / "made" / "fit.json").exists() is (folder == "made")


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_can_be_looked_at(view):
    board = Board(screened())

    async def looked() -> None:
        board.controls.view.value = view
        while board._drawn[1] != view:
            await asyncio.sleep(0.01)

    run(asyncio.wait_for(looked(), 60))
    assert len(board.controls.shown) >= 1


def test_judged_it_says_the_verdict():
    board = Board(screened())

    async def judged() -> None:
        await board.judged()
        while board._drawn[1] != "Verdict":
            await asyncio.sleep(0.01)

    run(asyncio.wait_for(judged(), 120))
    assert "missing" in board.controls.shown[0].object
    marked = [row["mark"] for row in board.controls.candidates.rows if row["mark"]]
    assert "judged to be missing" in marked


def test_explore_takes_logs_files_and_motions():
    mechanism, file = ident.load(ROBOTS / "arm"), ROBOTS / "arm" / "run.csv"
    for log in (file, [ident.read_log(file)], given().fit.motion):
        assert ident.explore(mechanism, log).exploration.candidates
    with pytest.raises(MechanismError, match="explore needs a mechanism, given: str"):
        ident.explore("arm", file)


def test_without_panel_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "panel", None)
    with pytest.raises(ident.IdentError, match="pip install"):
        ident.explore(ident.load(ROBOTS / "arm"), ROBOTS / "arm" / "run.csv")


def test_a_motion_that_cannot_be_fitted_is_refused():
    mechanism = ident.load(ROBOTS / "arm")
    with pytest.raises(FitError, match="needs a motion"):
        ident.Exploration.of(mechanism, ident.read_log(ROBOTS / "arm" / "run.csv"))
