"""`Board`, the page of `explore` with its state, and the verb `explore`.

The state is one JSON object: the page gets it whole when it connects, then the keys that change. A
change is shown in stages: errors and ladder, charts, then the falls that are announced anew.
"""

from __future__ import annotations

import contextlib
import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextvars import copy_context
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ident.assess.errors import noise_errors
from ident.assess.exploration import Exploration, File, Logs, PredictedGain, fit_of
from ident.diagnosis.found_curves import FoundCurve
from ident.diagnosis.result import Law
from ident.display import Progress, no_progress, part
from ident.effects import Effect
from ident.effects.formula import Formula
from ident.effects.library import effect_noun, named
from ident.errors import IdentError, MechanismError
from ident.files import json_line
from ident.fit.identify import Comparison
from ident.mechanism import Mechanism
from ident.motion import Motion
from ident.request import PYTHON, Request, Step
from ident.show.card import Bar, Card, bars_of
from ident.show.charts import Chart, pieces_of, scripts
from ident.show.diagnosis import card, sheet
from ident.show.fit import value_tables
from ident.show.html import items, paragraph, piece, table
from ident.show.ladder import changed, plot_rungs
from ident.show.laws import law_words
from ident.show.local import Place, Readers
from ident.show.residual import compared, errors_of_fit, failure_text, plot_joint, plot_maps
from ident.text import shortlist

ASKED = ("look", "preview", "add", "refuse", "remove", "back", "undo", "judge", "save")
POINTS = 1500  # of a line on the page
VIEWS = ("Joint", "Ladder", "Numbers", "Verdict")
GROUPS = (
    "Found in these data, of no effect's form: accept or refuse",
    "Would lower the error",
    "In the model",  # this and what follows is folded
    "Would change little, or no more than chance",
    "Cannot be seen in this data",
)
NAMED_MARK = "judged to be missing"  # the mark of what a diagnosis names, to be added together
NOT_JUDGED = (
    "A falling error is no proof of a cause: `Judge it` weighs every effect against chance, and "
    "offers a curve or a formula where no effect has the right form."
)


def top(e: Exploration, request: Request = PYTHON) -> Card:
    """Return the card of the present model: its verdict, or what is known before it is judged."""
    if e.diagnosis is not None:
        return card(e.diagnosis, _added(e), request)
    errors, logs = e.now.errors, ", ".join(e.fit.motion.names)
    before = e.rungs[-2].errors if e.rungs[1:] else {}
    bars = bars_of(before, errors, e.fit.noise)
    worst = max(bars, key=lambda bar: bar.sizes[1])
    line = f"{e.mechanism.name} on {logs}: not judged yet; the error is largest in {worst.joint}, "
    line += Bar("", worst.after or worst.before).words
    known = e.summary if e.candidates else f"Effects are being compared. {NOT_JUDGED}"
    if not e.offered and (x := e.first) is not None and x.before and x.after:
        ends = Bar("", x.before, x.after).words.replace(" → ", " to ")
        known = f"The first candidate is {named([x.effect])}, which would bring the error of "
        known += (
            f"{x.joints[0]} from {ends}, as far as can be said before it is fitted. {NOT_JUDGED}"
        )
    change = "before the last change → now" * bool(before)
    step = Step("diagnose", tuple(effect.label for effect in _added(e)))
    then = "judge it here, or diagnose it by this command."
    return Card(line, known, bars, request.line(step), then, change=change, step=step)


def _added(e: Exploration) -> list[Effect]:
    """Return the effects that a command has to add to the mechanism as it is given."""
    given = fit_of(e.rungs[0]).mechanism.effects
    return [effect for effect in e.mechanism.effects if effect not in given]


def confirmed(e: Exploration) -> str:
    """Return what the last change has done to the errors, the largest change first."""
    before, now = (rung.errors for rung in e.rungs[-2:])
    bars = [Bar(j, before[j], x) for j, x in now.items() if not x.unmeasured]
    bars.sort(key=lambda bar: -abs(bar.sizes[1] - bar.sizes[0]))
    return f"{changed(e.now)}: {shortlist([f'{bar.joint} {bar.words}' for bar in bars], 2)}."


def effect_rows(e: Exploration) -> list[dict[str, Any]]:
    """Return one row an effect, group by group, the best first; a `set` shares a button."""
    d = e.diagnosis
    marks = {} if d is None else {effect.label: "as likely" for effect in d.rivals}
    marks |= {} if d is None else {effect.label: NAMED_MARK for effect in d.group}
    rows = [*map(_offer, e.offered), *(_effect_row(x, marks) for x in e.candidates)]
    return sorted(rows, key=lambda row: (GROUPS.index(row["group"]), row["mark"] != NAMED_MARK))


def _row(effect: Effect, group: int, share: float, **more: Any) -> dict[str, Any]:
    """Return what the page shows of an effect, `share` of the error being what it takes away."""
    return {
        "label": effect.label, "plain": effect_noun(effect), "set": "", "present": group == 2,
        "offered": group == 0,
        "mark": "", "sure": True, "why": "", "share": min(max(share, 0.0), 1.0),
        "group": GROUPS[group], **more,
    }  # fmt: skip


def _offer(x: Law | FoundCurve) -> dict[str, Any]:
    """Return the row of a law or a curve, which can be accepted or refused."""
    if isinstance(x, FoundCurve):
        share = 1 - math.sqrt(x.ratio)
        fall, mark = f"{100 * share:.0f} % less", "curve"
    else:
        bar = Bar(x.joint, x.before[x.joint], x.after[x.joint])
        share, fall, mark = 1 - bar.sizes[1] / (bar.sizes[0] or 1.0), bar.words, "law"
    return _row(x.effect, 0, share, mark=mark, fall=fall, about=law_words(x))


def _effect_row(x: PredictedGain, marks: dict[str, str]) -> dict[str, Any]:
    change, fall = "not linear" if x.present else "", 0.0
    if x.before is not None and x.after is not None:
        other = "" if {*x.joints[:1]} <= {*x.effect.joints} else f" in {x.joints[0]}"
        change = f"≈ {Bar('', x.before, x.after).words}{other}"  # all else is refitted when added
        fall = 1 - x.after.rms / max(x.before.rms, 1e-300)
    about = x.effect.equation if isinstance(x.effect, Formula) else type(x.effect).summary()
    mark = "in the model" if x.present else marks.get(x.label, "")
    is_named = mark == NAMED_MARK
    group = 2 if x.present else 1 if x.sure or is_named else 4 if x.fall is None else 3
    return _row(
        x.effect, group, fall, set=NAMED_MARK if is_named else x.effect.kind, mark=mark,
        sure=x.sure or is_named, fall=change, about=about, why=x.why, joint="".join(x.joints[:1]),
    )  # fmt: skip


def contents(e: Exploration, view: str, joint: str) -> list[Chart | Markup]:
    """Return the charts and HTML of one of `VIEWS`, that of an independent joint among them."""
    if view == "Joint":
        return _joint(e, joint)
    if view == "Ladder":
        return [plot_rungs(e.rungs, noise_errors(e.fit))]
    if view == "Numbers":
        tables = [table(rows, title) for title, rows in value_tables(e.fit).items()]
        return [*tables, items(e.fit.warnings)]
    return [paragraph(NOT_JUDGED)] if e.diagnosis is None else [*sheet(e.diagnosis).blocks()]


def _joint(e: Exploration, joint: str) -> list[Chart | Markup]:
    """Return torque of one joint with the last two models, and its residual against signals."""
    last = [fit_of(rung).residual for rung in e.rungs[-2:]]
    models = Comparison(dict(zip(("before", "now")[-len(last) :], last, strict=True)), {})
    text = paragraph(failure_text(e.fit.residual.failure(joint), counted=errors_of_fit(e.fit)))
    return [text, plot_joint(models, joint).thinned(POINTS), plot_maps(compared(e.fit), joint)]


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

    def __init__(self, title: str, folder: File, request: Request = PYTHON) -> None:
        """Begin with an empty page, which writes into `folder` and below, nowhere else."""
        self._request = request
        self.exploration: Exploration | None = None
        self.folder = Path(folder).expanduser().resolve()
        self.state: dict[str, Any] = {
            "title": title, "status": {"kind": "busy", "text": "reading …", "share": 0.0},
            "busy": True, "undo": False, "effects": [], "note": "", "stale": False,
            "card": piece("card", Card(f"{title}: the first model is being fitted")),
            "ladder": [], "views": VIEWS, "view": VIEWS[0], "joints": [], "joint": "", "shown": [],
            "folder": str(self.folder), "open": GROUPS[:2],
        }  # fmt: skip
        self._readers = Readers(lambda: json_line(self.state), self._hear)
        self._lock = self._readers.lock
        self._previewed = ""  # the effect that is previewed
        self._context = copy_context()
        self._turn = 0  # number of changes, by which work for an earlier one knows that it is late
        self._address = ""

    def begin(self, make: Callable[[Progress], Exploration], progress: Progress) -> None:
        """Fit the first model, show it or what goes wrong, and announce what effects would do."""
        try:
            e = make(self._progress("reading", 0, part(progress, 0.0, 0.4)))
            logs = ", ".join(e.fit.motion.names)
            joints, worst = list(e.fit.motion.independent), e.fit.residual.where[0].joint
            self._change_state(title=f"{e.mechanism.name} on {logs}", joints=joints, joint=worst)
            self._show(e)
            self._draw()
        except Exception as error:
            self._say(_line(error), "bad")
            raise
        self._change_state(busy=False)
        self._announce(0, progress_outside=part(progress, 0.4, 1.0))

    def act(self, message: dict[str, Any]) -> None:
        """Do what a click asks for, or preview what it would do; a change during another one does
        nothing.
        """
        do, label = str(message["do"]), str(message.get("label", ""))
        changes = do not in ("look", "preview")
        with self._lock:
            before = self.exploration
            if before is None or (self.state["busy"] and do != "look"):
                return
            if do == "preview" and self.state["stale"]:
                return  # the label is of another model
            self._turn += changes
            if do != "look":
                self._previewed = label if do == "preview" else ""
            turn = self._turn
            if changes:
                self._change_state(busy=True)
                self._say(f"{do} {label} …", "busy")
        words = ""
        try:
            words = self._do(before, do, label, message, turn)
        except Stale:
            return
        except Exception as error:  # a page lives on, whatever happened
            words = _line(error)
        finally:
            if changes:
                self._change_state(busy=False)
        if changes:
            self._announce(turn, words)
        elif words:
            self._change_state(preview={"label": label, "shown": pieces_of([paragraph(words)])})

    def _do(
        self, e: Exploration, do: str, label: str, message: dict[str, Any], turn: int
    ) -> str:  # fmt: skip
        """Do it, and return what is said of it, if not what is announced next."""
        progress, words = self._progress(f"{do} {label}".strip(), turn), ""
        match do:
            case "look":
                self._change_state(view=str(message["view"]), joint=str(message["joint"]))
            case "preview":
                if label:
                    self._preview(e, label, turn)
                return ""
            case "add":
                effects = [e.effect(part) for part in label.split("\n")]
                after = e.with_effect(effects, progress)
                self._show(after)
                self._change_state(joint=self._joint_of(e, effects[0]))
                words = confirmed(after)
            case "refuse":
                self._show(e.refuse(label))
            case "remove":
                after = e.without(label, progress)
                self._show(after)
                words = confirmed(after)
            case "back":
                self._show(e.at(int(message["rung"])))
            case "undo":
                self._show(e.undone)
            case "judge":
                self._show(e.judged(progress))
                self._change_state(view="Verdict")
            case "save":
                words = self._save(str(message["name"]).strip())
        self._draw()
        return words

    @contextlib.contextmanager
    def serve(self, port: int | Place = 0) -> Iterator[str]:
        """Serve the page inside this context, which gives its address, at a port of 127.0.0.1, 0
        for a free one, or at a place that is taken already.
        """
        place = port if isinstance(port, Place) else Place(port)
        try:
            with place.serve(str(piece("explore", scripts())), self._readers.listen):
                yield place.address
        finally:
            self._readers.close()

    def _repr_html_(self) -> str:
        """Serve the page as long as Python runs, and show it in a frame."""
        if not self._address:
            self._served = self.serve()  # ends when it is forgotten
            self._address = self._served.__enter__()
        return str(piece("document", None, self.state["title"], HEIGHT, self._address))

    def _hear(self, text: str | bytes) -> None:
        """Do what a page asks for, in a thread of its own; what no page of ours says is ignored."""
        if (message := _message_of(text)) is None:
            return
        of_command = self._context.copy().run  # commands to be copied are like this one
        threading.Thread(target=of_command, args=(self.act, message), daemon=True).start()

    def _change_state(self, **changes: Any) -> None:
        """Change the state here and on all pages; what is no JSON raises and changes nothing."""
        text = json_line(changes)
        with self._lock:
            self.state |= changes
            self._readers.send(text)

    def _say(self, text: str, kind: str = "done", share: float = 0.0) -> None:
        """Show a line: `done`, `busy` with a share of the work done, or `bad`."""
        self._change_state(status={"kind": kind, "text": text, "share": share})

    def _progress(
        self, words: str, turn: int, progress_outside: Progress | None = None
    ) -> Progress:
        """Return a progress function for the page; it ends work of an earlier turn."""
        last = 0.0

        def on_progress(what: str, share: float) -> None:
            nonlocal last
            if turn != self._turn:
                raise Stale
            if progress_outside is not None:
                progress_outside(what, share)
            if time.monotonic() - last > PAUSE:
                last = time.monotonic()
                self._say(f"{words}: {what} …", "busy", share)

        return on_progress

    def _show(self, e: Exploration) -> None:
        """Make an exploration the present one, and show all of it but the charts."""
        self.exploration = e
        changes: dict[str, Any] = {"stale": True, "note": "announced for another model …"}
        if e.candidates:
            rows = effect_rows(e)
            note = f"{len(rows)} effects; held-out error of the joint without → with each"
            changes = {"effects": rows, "stale": False, "note": note}
        self._change_state(
            card=piece("card", top(e, self._request)),
            ladder=e.table(),
            undo=e.before is not None,
            **changes,
        )

    def _draw(self) -> None:
        """Draw the view that is looked at, unless another one is asked for meanwhile."""
        e, view, joint = self.exploration, self.state["view"], self.state["joint"]
        if e is not None:
            shown = pieces_of(contents(e, view, joint))
            if (e, view, joint) == (self.exploration, self.state["view"], self.state["joint"]):
                self._change_state(shown=shown)

    def _preview(self, e: Exploration, label: str, turn: int) -> None:
        """Draw the residual as it would be with an effect, unless anything else is asked for."""

        def on_progress(what: str, share: float) -> None:
            if (turn, label) != (self._turn, self._previewed):
                raise Stale

        effects = [e.effect(effect) for effect in label.split("\n")]
        after, joint = e.with_effect(effects, on_progress).fit, self._joint_of(e, effects[0])
        name = named(effect for effect in effects if isinstance(effect, Effect))
        models = {"as it is": e.fit.residual, f"with {name}": after.residual}
        chart = plot_joint(Comparison(models, {}), joint).thinned(POINTS)
        self._change_state(preview={"label": label, "shown": pieces_of([chart])})

    def _announce(
        self, turn: int, words: str = "", progress_outside: Progress | None = None
    ) -> None:
        """Predict what every effect would do, unless the model changes again; then show `words`."""
        e = self.exploration
        assert e is not None
        try:
            if not e.candidates:
                e = e.screened(self._progress("announcing falls", turn, progress_outside))
                with self._lock:
                    if self._turn == turn:
                        self._show(e)
        except Stale:
            return
        except Exception as error:
            words = _line(error)
        words = f"{words} {e.summary}" if words.endswith(".") else words or e.summary
        if self._turn == turn:
            self._say(words, "bad" if words.startswith("error: ") else "done")

    def _joint_of(self, e: Exploration, effect: Effect | str) -> str:
        """Return the joint to look at: the effect's own, or the one whose error it lowers most."""
        joints = () if isinstance(effect, str) else effect.joints
        lowered = [x.joints for x in e.candidates if x.effect is effect]
        best = lowered[0] if lowered else e.fit.motion.independent
        return next((j for j in joints if j in best), (*best, self.state["joint"])[0])

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


def explore(mechanism: Mechanism, log: Motion | Logs, *, progress: Progress | None = None) -> Board:
    """Effects added and removed by a click, while the error falls.

    Args:
        mechanism: to start from.
        log: one or several, or their files, or the completed motion.
        progress: called with (what is being done, share done).

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
    board = Board(mechanism.name, f"{mechanism.name}_explored")
    board.begin(lambda p: Exploration.of(mechanism, log, p), progress or no_progress)
    return board


def _message_of(text: str | bytes) -> dict[str, Any] | None:
    """Return what a page asks for; None for what is no JSON object with a word to do."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    asks = isinstance(message, dict) and message.get("do") in ASKED
    return message if asks else None


def _line(error: Exception) -> str:
    words = " ".join(str(error).split())
    if isinstance(error, IdentError | OSError):
        return f"error: {words}"
    return f"error: a fault of ident, not of yours: {type(error).__name__}: {words}"
