"""The board without a browser: what a click does to its state, clicks during work, errors."""

from __future__ import annotations

import json
import re
import sys
import threading
from dataclasses import replace

import pytest
from explored import given, grown, judged, odd, screened

import ident
from helpers import ROBOTS
from ident import FitError, MechanismError
from ident.cli.lines import ShellRequest
from ident.effects.library import named
from ident.show.board import NAMED_MARK, VIEWS, Board, top
from ident.show.ladder import changed
from ident.text import percent

EXPLORATION = "ident.assess.exploration"
ELBOW = {"label": "viscous:elbow"}


@pytest.fixture
def board(tmp_path) -> Board:
    made = Board("arm", tmp_path / "out")
    made.begin(lambda progress: screened(), lambda what, share: None)
    return made


def present(board: Board) -> list[str]:
    return [row["label"] for row in board.state["effects"] if row["present"]]


def test_a_click_adds_and_another_removes(board):
    assert not board.state["undo"]
    board.act({"do": "add", **ELBOW})
    state = board.state
    assert present(board) == ["viscous:elbow"]
    assert (state["stale"], state["busy"], state["undo"]) == (False, False, True)
    assert state["joint"] == "elbow"
    assert [row[0] for row in state["ladder"]] == [
        "model",
        "nothing added",
        "+ viscous friction in elbow",
    ]
    assert "25.5\xa0%" in state["card"]
    board.act({"do": "remove", **ELBOW})
    assert present(board) == []
    board.act({"do": "back", "rung": 0})
    assert len(board.exploration.rungs) == 1
    board.act({"do": "undo"})
    assert len(board.exploration.rungs) == 3


def test_clicks_during_work_do_nothing_but_looks_do(board, monkeypatch):
    module, begun, go_on = sys.modules[EXPLORATION], threading.Event(), threading.Event()
    real = module.identify

    def slow(*args, **options):
        begun.set()
        assert go_on.wait(60)
        return real(*args, **options)

    monkeypatch.setattr(module, "identify", slow)
    first = threading.Thread(target=board.act, args=({"do": "add", **ELBOW},))
    first.start()
    assert begun.wait(60)
    board.act({"do": "add", "label": "coulomb:yaw"})
    board.act({"do": "back", "rung": 0})
    board.act({"do": "look", "view": "Numbers", "joint": "yaw"})
    assert board.state["view"] == "Numbers"
    assert board.state["busy"]
    go_on.set()
    first.join()
    assert [changed(rung) for rung in board.exploration.rungs] == [
        "nothing added",
        "+ viscous friction in elbow",
    ]


def test_a_change_while_falls_are_announced_wins(board, monkeypatch):
    module, begun = sys.modules[EXPLORATION], threading.Event()
    real = module.rows_of

    def announced(fit, effects, progress, earlier):
        if begun.is_set():
            return real(fit, effects, progress, earlier)
        begun.set()
        while True:
            progress("announcing", 0.0)

    monkeypatch.setattr(module, "rows_of", announced)
    first = threading.Thread(target=board.act, args=({"do": "add", **ELBOW},))
    first.start()
    assert begun.wait(60)
    while board.state["busy"]:
        pass
    assert board.state["stale"]
    board.act({"do": "add", "label": "coulomb:elbow"})
    first.join()
    assert set(present(board)) == {"viscous:elbow", "coulomb:elbow"}
    assert len(board.exploration.mechanism.effects) == 2
    assert board.exploration.candidates
    assert board.state["status"]["kind"] == "done"


def test_a_preview_that_fails_leaves_the_status_as_it_is(board):
    before = dict(board.state["status"])
    board.act({"do": "preview", "label": "viscous:nowhere"})
    assert board.state["preview"]["label"] == "viscous:nowhere"
    assert "error: " in str(board.state["preview"]["shown"])
    assert board.state["status"] == before


def test_a_candidate_of_another_model_is_not_previewed(board):
    board.state["stale"] = True
    board.act({"do": "preview", **ELBOW})
    assert "preview" not in board.state


def test_what_goes_wrong_is_one_line_and_changes_nothing(board):
    board.act({"do": "add", "label": "viscous:nowhere"})
    status = board.state["status"]
    assert status["kind"] == "bad"
    assert status["text"].startswith("error: ")
    assert "\n" not in status["text"]
    assert board.exploration is screened()
    assert not board.state["busy"]


def test_a_fault_is_said_and_the_page_lives_on(board, monkeypatch):
    def broken(*args: object, **options: object) -> None:
        raise ZeroDivisionError("by\nnought")

    monkeypatch.setattr(sys.modules[EXPLORATION], "identify", broken)
    board.act({"do": "add", **ELBOW})
    assert board.state["status"]["text"].startswith("error: a fault of ident, not of yours: ")
    monkeypatch.undo()
    board.act({"do": "add", **ELBOW})
    assert len(board.exploration.rungs) == 2


def test_a_state_that_is_no_json_is_an_error_that_is_seen(board, monkeypatch):
    module = sys.modules["ident.show.board"]
    monkeypatch.setattr(module, "effect_rows", lambda e: [{"label": object()}])
    board.act({"do": "add", **ELBOW})
    assert board.state["status"]["kind"] == "bad"
    assert "fault of ident" in board.state["status"]["text"]
    json.dumps(board.state)  # a page that connects now gets it


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("", "done", "saved into"),
        ("made", "done", "saved into"),
        ("../elsewhere", "bad", "is outside of"),
        (str(ROBOTS / "arm"), "bad", "is outside of"),
        ("\0", "bad", "error: "),
    ],
)
def test_saving_is_below_the_folder_given_and_nowhere_else(board, name, kind, words):
    board.act({"do": "save", "name": name})
    assert board.state["status"]["kind"] == kind
    assert words in board.state["status"]["text"]
    assert (board.folder / name / "fit.json").exists() if kind == "done" else True
    assert not (board.folder.parent / "elsewhere").exists()


def test_the_mechanisms_own_folder_is_refused():
    board = Board("arm", ROBOTS / "arm")
    board.begin(lambda progress: screened(), lambda what, share: None)
    board.act({"do": "save", "name": ""})
    assert "name another folder" in board.state["status"]["text"]


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_can_be_looked_at(board, view):
    board.state["shown"] = []
    board.act({"do": "look", "view": view, "joint": "elbow"})
    assert board.state["shown"]


def test_judged_it_says_the_verdict(board, monkeypatch):
    module, found = sys.modules[EXPLORATION], judged().diagnosis
    monkeypatch.setattr(module, "diagnose", lambda fit, progress: found)
    board.act({"do": "judge"})
    assert board.state["view"] == "Verdict"
    assert "Missing: " in board.state["card"]
    assert any("issing" in piece["html"] for piece in board.state["shown"])
    rows = [row for row in board.state["effects"] if row["mark"] == NAMED_MARK]
    assert rows == board.state["effects"][: len(rows)]  # first, and one line with one button
    assert len({row["set"] for row in rows}) == 1
    named = board.exploration.diagnosis.group
    assert {row["label"] for row in rows} == {effect.label for effect in named}


def test_the_command_of_the_verdict_has_what_was_added():
    e = replace(grown("viscous:elbow"), diagnosis=judged().diagnosis)
    assert " viscous:elbow " in top(e, ShellRequest("arm", ("run.csv",))).command


def test_before_a_verdict_the_card_says_what_is_known_so_far(tmp_path):
    assert "being fitted" in Board("arm", tmp_path).state["card"]
    request = ShellRequest("arm", ("run.csv",))
    early, e = top(given(), request), screened()
    known = top(e, request)
    assert "largest in wrist" in early.line
    assert (early.line, early.bars, early.command) == (known.line, known.bars, known.command)
    assert known.command == "ident diagnose arm run.csv"
    first = e.candidates[0]
    assert f"first candidate is {named([first.effect])}, " in known.sure
    ends = f"from {percent(first.before.relative)} to {percent(first.after.relative)},"
    assert f"bring the error of {first.joints[0]} {ends}" in known.sure
    after = top(grown("viscous:elbow"), request)
    assert after.command.endswith("--with viscous:elbow")
    assert all(bar.after for bar in after.bars)


def test_what_cannot_be_begun_is_shown_and_raised(tmp_path):
    board = Board("arm", tmp_path)

    def make(progress):
        raise FitError("no equations")

    with pytest.raises(FitError):
        board.begin(make, lambda what, share: None)
    assert board.state["status"] == {"kind": "bad", "text": "error: no equations", "share": 0.0}


def test_explore_takes_logs_files_and_motions():
    mechanism, file = ident.load(ROBOTS / "arm"), ROBOTS / "arm" / "run.csv"
    for log in ([file], given().fit.motion):
        assert ident.explore(mechanism, log).exploration.candidates
    with pytest.raises(MechanismError, match="explore needs a mechanism, given: str"):
        ident.explore("arm", file)


def test_laws_and_curves_are_offered_accepted_and_refused(tmp_path):
    board = Board("arm", tmp_path / "out")
    board.begin(lambda progress: odd(), lambda what, share: None)
    law = odd().offered[0]
    rows = {row["label"]: row for row in board.state["effects"] if row.get("offered")}
    assert list(rows) == [law.effect.label, "curve:elbow:q"]
    assert "accept it" in board.state["status"]["text"]
    assert "k/(1 + ((q - q0)/x0)**2)" in rows[law.effect.label]["about"]
    assert "magnetic spring" in rows[law.effect.label]["about"]
    assert "%" in rows[law.effect.label]["fall"]
    board.act({"do": "refuse", "label": "curve:elbow:q"})
    assert [row["label"] for row in board.state["effects"] if row.get("offered")] == [
        law.effect.label
    ]
    board.act({"do": "refuse", "label": "curve:elbow:q"})
    assert "is not offered" in board.state["status"]["text"]
    board.act({"do": "add", "label": law.effect.label})
    assert law.effect.label in present(board)
    e = board.exploration
    assert e.now.errors["elbow"].rms < 0.1 * e.rungs[0].errors["elbow"].rms
    assert "curve:elbow:q" in e.refused
    board.act({"do": "save", "name": "grown"})
    folder = tmp_path / "out" / "grown"
    assert (folder / "law_elbow.py").exists(), board.state["status"]
    again = ident.load(folder, allow_code=True)
    assert "law:elbow" in [effect.label for effect in again.effects]
    board.act({"do": "back", "rung": 0})
    assert [x.effect.label for x in board.exploration.offered] == [law.effect.label]


def test_a_notebook_shows_the_page_in_a_frame(board):
    """Which is served as long as Python runs; tests/notebooks execute notebooks."""
    shown = board._repr_html_()
    assert shown == board._repr_html_()  # one page
    assert re.search(r'<iframe src="http://127\.0\.0\.1:\d+/[^/"]+/"', shown)
