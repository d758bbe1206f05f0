"""`Board`, the page of `explore` with its state, and the verb `explore`.

The state is one JSON object: the page gets it whole when it connects, then the keys that change. A
change is shown in stages: errors and ladder, charts, then the falls that are announced anew.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ident.effects import Effect
from ident.errors import IdentError, MechanismError
from ident.log import Log
from ident.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.progress import Progress
from ident.show.charts import Chart, scripts
from ident.show.explore.contents import VIEWS, beside_verdict, contents, effect_rows, error_rows
from ident.show.explore.exploration import Exploration
from ident.show.html import table
from ident.show.local import Place

File = str | os.PathLike[str]
Logs = Log | File | Sequence[Log | File]
PAUSE = 0.1  # s between two reports of progress to the page
HEIGHT = 850  # of a notebook's frame [px]


class Stale(Exception):
    """Raised in work on a model that is not the present one any more."""


class Board:
    """Effects with the fall of error that each would bring; a click adds or removes one.

    Attributes:
        exploration: the models tried so far; None before the first one is fitted.
        state: what the page shows, by key.
    """

    def __init__(self, title: str, folder: File) -> None:
        """Begin with an empty page.

        Args:
            title: at the top of the page.
            folder: the page writes here and below, nowhere else.
        """
        self.exploration: Exploration | None = None
        self.folder = Path(folder).expanduser().resolve()
        self.state: dict[str, Any] = {
            "title": title, "status": {"kind": "busy", "text": "reading …", "share": 0.0},
            "busy": True, "undo": False, "effects": [], "note": "", "stale": False, "errors": "",
            "ladder": [], "views": VIEWS, "view": VIEWS[0], "joints": [], "joint": "", "shown": [],
            "folder": str(self.folder),
        }  # fmt: skip
        self._lock = threading.RLock()
        self._sockets: set[Any] = set()
        self._turn = 0  # number of changes, by which work for an earlier one knows that it is late
        self._address = ""

    def begin(self, make: Callable[[Progress], Exploration], progress: Progress) -> None:
        """Fit the first model, show it, and announce what every effect would do.

        Args:
            make: makes the first exploration.
            progress: called beside the page with (what is being done, share done).

        Raises:
            IdentError: what `make` raises, which the page shows too.
        """
        try:
            e = make(self._progress("reading", 0, progress))
        except Exception as error:
            self._say(_line(error), "bad")
            raise
        logs = ", ".join(experiment.name for experiment in e.fit.motion.experiments)
        joints, worst = list(e.fit.motion.independent), e.fit.residual.where[0].joint
        self._tell(title=f"{e.mechanism.name} on {logs}", joints=joints, joint=worst)
        self._show(e)
        self._draw()
        self._tell(busy=False)
        self._announce(0, beside=progress)

    def act(self, message: dict[str, Any]) -> None:
        """Do what a click asks for; a change during another one does nothing."""
        do, label = str(message["do"]), str(message.get("label", ""))
        with self._lock:
            if self.exploration is None or (self.state["busy"] and do != "look"):
                return
            self._turn += do != "look"
            before, turn = self.exploration, self._turn
            if do != "look":
                self._tell(busy=True)
                self._say(f"{do} {label} …", "busy")
        progress = self._progress(f"{do} {label}".strip(), turn)
        words = ""
        try:
            match do:
                case "look":
                    self._tell(view=str(message["view"]), joint=str(message["joint"]))
                case "add":
                    effect = before.effect(label)
                    self._show(before.with_effect(effect, progress))
                    self._tell(joint=self._joint_of(before, effect))
                case "refuse":
                    self._show(before.refuse(label))
                case "remove":
                    self._show(before.without(label, progress))
                case "back":
                    self._show(before.at(int(message["rung"])))
                case "undo":
                    self._show(before.undone)
                case "judge":
                    self._show(before.judged(progress))
                    self._tell(view="Verdict")
                case "save":
                    words = self._save(str(message["name"]).strip())
            self._draw()
        except Exception as error:  # a page lives on, whatever happened
            words = _line(error)
        finally:
            if do != "look":
                self._tell(busy=False)
        if do != "look" or words:
            self._announce(turn, words)

    @contextlib.contextmanager
    def serve(self, port: int = 0) -> Iterator[str]:
        """Serve the page on 127.0.0.1 inside this context, which gives its address.

        Raises:
            IdentError: if the port cannot be opened.
        """
        place = Place(port)
        page = resources.files("ident.show.explore").joinpath("page.html")
        html = page.read_text(encoding="utf-8").replace("<!-- charts -->", scripts())
        stop = place.serve(html, self._talk)
        try:
            yield place.address
        finally:
            stop()
            for socket in list(self._sockets):
                socket.close()

    def _repr_html_(self) -> str:
        """Serve the page as long as Python runs, and show it in a frame."""
        if not self._address:
            self._served = self.serve()  # ends when it is forgotten
            self._address = self._served.__enter__()
        frame = Markup(
            '<iframe src="{}" title="{}" style="width:100%;height:{}px;border:0"></iframe>'
        )
        return str(frame.format(self._address, self.state["title"], HEIGHT))

    def _talk(self, socket: Any) -> None:
        """Send the state to one page, and do what it asks for, until it is closed."""
        with self._lock:
            self._sockets.add(socket)
            socket.send(json.dumps(self.state))
        try:
            for text in socket:
                message = json.loads(text)
                threading.Thread(target=self.act, args=(message,), daemon=True).start()
        finally:
            self._sockets.discard(socket)

    def _tell(self, **changes: Any) -> None:
        """Change the state here and on all pages."""
        from websockets.exceptions import ConnectionClosed

        with self._lock:
            self.state |= changes
            text = json.dumps(changes) if self._sockets else ""
            for socket in list(self._sockets):
                with contextlib.suppress(ConnectionClosed):
                    socket.send(text)

    def _say(self, text: str, kind: str = "done", share: float = 0.0) -> None:
        """Show a line: `done`, `busy` with a share of the work done, or `bad`."""
        self._tell(status={"kind": kind, "text": text, "share": share})

    def _progress(self, words: str, turn: int, beside: Progress | None = None) -> Progress:
        """Return a progress function for the page; it ends work of an earlier turn."""
        last = 0.0

        def on_progress(what: str, share: float) -> None:
            nonlocal last
            if turn != self._turn:
                raise Stale
            if beside is not None:
                beside(what, share)
            if time.monotonic() - last > PAUSE:
                last = time.monotonic()
                self._say(f"{words}: {what} …", "busy", share)

        return on_progress

    def _show(self, e: Exploration) -> None:
        """Make an exploration the present one, and show all of it but the charts."""
        self.exploration = e
        changes: dict[str, Any] = {"stale": True, "note": "announced for another model …"}
        if (found := e.now.candidates) is not None:
            rows = effect_rows(e)
            note = f"{len(rows)} effects; held-out error of the joint without → with each"
            if beside_verdict(found, e.now.diagnosis):
                note += "; none of them is judged to be missing"
            changes = {"effects": rows, "stale": False, "note": note}
        errors = str(table(error_rows(e), "Held-out error"))
        self._tell(errors=errors, ladder=e.table(), undo=e.before is not None, **changes)

    def _draw(self) -> None:
        """Draw the view that is looked at, unless another one is asked for meanwhile."""

        def wanted() -> tuple[Any, str, str]:
            return self.exploration, self.state["view"], self.state["joint"]

        e, view, joint = drawn = wanted()
        if e is not None:
            shown = [_piece(each) for each in contents(e, view, joint)]
            if drawn == wanted():
                self._tell(shown=shown)

    def _announce(self, turn: int, words: str = "", beside: Progress | None = None) -> None:
        """Predict what every effect would do, unless the model changes again; then show `words`."""
        e = self.exploration
        assert e is not None
        try:
            if e.now.candidates is None:
                e = e.screened(self._progress("announcing falls", turn, beside))
                with self._lock:
                    if self._turn == turn:
                        self._show(e)
        except Stale:
            return
        except Exception as error:
            words = _line(error)
        words = words or _summary(e)
        if self._turn == turn:
            self._say(words, "bad" if words.startswith("error: ") else "done")

    def _joint_of(self, e: Exploration, effect: Effect | str) -> str:
        """Return the joint to look at: the effect's own, or the one whose error it lowers most."""
        own = () if isinstance(effect, str) else effect.joints
        mends = next(
            (x.joints for x in e.candidates if x.effect is effect), e.fit.motion.independent
        )
        return next((j for j in own if j in mends), (*mends, self.state["joint"])[0])

    def _save(self, name: str) -> str:
        """Write the present model into the folder, or one below it; return where."""
        folder = (self.folder / name).resolve()
        if not folder.is_relative_to(self.folder):
            raise IdentError(
                f"{name}: is outside of {self.folder}, the folder for saving; give a name below "
                "it, or start again with --out DIR"
            )
        assert self.exploration is not None
        files = (str(file.relative_to(folder)) for file in self.exploration.write(folder))
        return f"saved into {folder}: {', '.join(files)}"


def explore(mechanism: Mechanism, log: Motion | Logs) -> Board:
    """Effects added and removed by a click, while the error falls.

    Args:
        mechanism: to start from.
        log: one or several, or their files, or the completed motion.

    Returns:
        A board, which Jupyter shows as a page served on this machine; its `exploration` holds the
        models that were tried.

    Raises:
        MechanismError: if it is given no mechanism.
        IdentError: for a log that does not fit the mechanism.
    """
    if not isinstance(mechanism, Mechanism):
        raise MechanismError(
            f"explore needs a mechanism, given: {type(mechanism).__name__}; write "
            "ident.explore(ident.load(folder), log)"
        )
    motion = log if isinstance(log, Motion) else complete(mechanism, log)
    board = Board(mechanism.name, f"{mechanism.name}_explored")
    board.begin(lambda p: Exploration.of(mechanism, motion, p), lambda what, share: None)
    return board


def _piece(piece: Chart | Markup) -> dict[str, Any]:
    if isinstance(piece, Markup):
        return {"html": str(piece)}
    live = piece.live()
    return {"chart": live.data(), "words": piece.words, "height": live.height}


def _summary(e: Exploration) -> str:
    best = next((x for x in e.candidates if x.sure and not x.present), None)
    if best is None:
        return "No effect lowers the error by more than chance would; judge it to be sure."
    return (
        f"The first candidate is {best.label}. A falling error is no proof of a cause: judge it to "
        "weigh what speaks for it."
    )


def _line(error: Exception) -> str:
    words = " ".join(str(error).split())
    if isinstance(error, IdentError | OSError):
        return f"error: {words}"
    return f"error: a fault of ident, not of yours: {type(error).__name__}: {words}"
