"""The page: a widget that adds effects by a click, in Jupyter or served.

All heavy work runs in threads, one change at a time; what is shown is set on the event loop. A
change is shown in stages: errors and ladder, charts, then what is announced anew.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import panel
import param
from markupsafe import Markup

from ident.errors import IdentError
from ident.progress import Progress
from ident.show.charts import Chart, source
from ident.show.explore.exploration import Exploration, ladder_rows
from ident.show.explore.views import VIEWS, beside_verdict, contents, effect_list, error_rows
from ident.show.html import table


def _text(name: str) -> str:
    return resources.files("ident.show.explore").joinpath(name).read_text(encoding="utf-8")


CSS, PAGE, CHOICE = _text("parts.css"), _text("page.css"), _text("choice.css")
FOLD = _text("fold.css")  # of rows whose parts stand one below the other where it is narrow


class LiveChart(panel.custom.JSComponent):
    """A chart that can be zoomed, drawn in the browser as in reports."""

    data = param.String()
    words = param.String()

    _esm: ClassVar[Any] = (
        f"const api = {json.dumps(source('bokeh-api.min.js'))};\n"
        + source("charts.js")
        + _text("chart.js")
    )


class Candidates(panel.custom.JSComponent):
    """Effects with a button each; a click sends {"label", "present"}."""

    rows = param.List()
    said = param.String()
    stale = param.Boolean()
    locked = param.Boolean()

    _esm: ClassVar[Any] = _text("candidates.js")
    _stylesheets: ClassVar[Any] = [CSS]


class Ladder(panel.custom.JSComponent):
    """Rungs as rows, the head first; a click on an earlier one sends {"rung"}."""

    rows = param.List()
    locked = param.Boolean()

    _esm: ClassVar[Any] = _text("ladder.js")
    _stylesheets: ClassVar[Any] = [CSS]


class Status(panel.custom.JSComponent):
    """A title and one line that is read out: `kind` is done, busy or bad."""

    title = param.String()
    said = param.String()
    kind = param.String("done")
    share = param.Number(0.0)

    _esm: ClassVar[Any] = _text("status.js")
    _stylesheets: ClassVar[Any] = [CSS]


LEFT, MIDDLE = 400, 285  # pixels of the effects and of the table of errors


class Controls:
    """Widgets by name, and `layout`, in which they stand."""

    def __init__(self, e: Exploration, folder: str | Path | None) -> None:
        motion, name = e.fit.motion, e.mechanism.name
        logs = ", ".join(experiment.name for experiment in motion.experiments)
        self.status = Status(title=f"{name} on {logs}", sizing_mode="stretch_width")
        self.candidates = Candidates(width=LEFT)
        self.ladder = Ladder(sizing_mode="stretch_width")
        self.errors = panel.pane.HTML(stylesheets=[CSS], width=MIDDLE)
        self.joint = panel.widgets.Select(
            label="Joint", options=list(motion.independent), value=e.fit.residual.where[0].joint,
            width=170, stylesheets=[CHOICE],
        )  # fmt: skip
        self.view = panel.widgets.RadioButtonGroup(
            label="View", options=list(VIEWS), value=VIEWS[0], stylesheets=[CHOICE]
        )
        self.undo = panel.widgets.Button(label="Undo", width=70)
        self.judge = panel.widgets.Button(label="Judge it", width=90)
        self.save = panel.widgets.Button(label="Save", width=70)
        self.folder = panel.widgets.TextInput(
            label="Folder to save into", value=str(folder or f"{name}_explored"), width=230
        )
        self.shown = panel.Column(sizing_mode="stretch_width")
        self.layout = self._laid_out()

    def say(self, words: str, kind: str = "done", share: float = 0.0) -> None:
        """In the line of status: `done`, `busy` with a share of it done, or `bad`."""
        self.status.param.update(said=words, kind=kind, share=share)

    def lock(self, busy: bool, first: bool) -> None:
        """While a change is worked out, nothing else can be changed; at first nothing is undone."""
        self.candidates.locked = self.ladder.locked = busy
        self.judge.disabled = self.save.disabled = busy
        self.undo.disabled = busy or first

    def fill(self, e: Exploration) -> None:
        """Everything but the pictures."""
        rungs = e.rungs
        before = rungs[-2] if len(rungs) > 1 else rungs[-1]
        self.errors.object = str(table(error_rows(rungs[0], before, e.now), "Held-out error"))
        self.ladder.rows = ladder_rows(rungs)
        if e.now.candidates is None:
            self.candidates.param.update(stale=True, said="announced for another model …")
        else:
            rows = effect_list(e.now.candidates, e.now.diagnosis)
            said = f"{len(rows)} effects; fall of the held-out squares ± standard error"
            if beside_verdict(e.now.candidates, e.now.diagnosis):
                said += "; none of them is judged to be missing"
            self.candidates.param.update(rows=rows, stale=False, said=said)

    def show(self, pieces: Sequence[Chart | Markup]) -> None:
        """Put charts and HTML in the place of those shown."""
        self.shown[:] = [_pane(piece) for piece in pieces]

    def _laid_out(self) -> Any:
        wide = {"sizing_mode": "stretch_width"}
        folded = {**wide, "stylesheets": [FOLD]}
        bar = panel.Row(self.undo, self.judge, self.folder, self.save)
        top = panel.Row(self.errors, self.ladder, **folded)
        look = panel.Row(self.view, self.joint, **folded)
        right = panel.Column(top, look, self.shown, **wide)
        head = panel.Row(self.status, bar, **folded)
        return panel.Column(head, panel.Row(self.candidates, right, **folded), **wide)


T = TypeVar("T")
Verb = Callable[[Exploration, Progress], Exploration]
PAUSE = 0.1  # s between two looks at what work says of itself


def _pane(piece: Chart | Markup) -> Any:
    if isinstance(piece, Markup):
        return panel.pane.HTML(str(piece), stylesheets=[CSS], sizing_mode="stretch_width")
    live = piece.live()
    return LiveChart(
        data=live.data(), words=piece.words, height=live.height, sizing_mode="stretch_width"
    )


class Stale(Exception):
    """What is being announced is of a model that has been left."""


class Board(panel.viewable.Viewer):
    """Effects with the fall of error that each would bring; a click adds or removes one.

    Attributes:
        exploration: what has been tried by hand so far.
        changed: called with the exploration whenever there is a new one.
    """

    def __init__(self, exploration: Exploration, folder: str | Path | None = None) -> None:
        super().__init__()
        self.exploration = exploration
        self.changed: Callable[[Exploration], None] = lambda found: None
        self.controls = c = Controls(exploration, folder)
        self._busy = False
        self._turn = 0  # of changes, by which work for an earlier one knows that it is late
        self._drawn = exploration, str(c.view.value), str(c.joint.value)
        self._wire()
        c.fill(exploration)
        c.show(contents(*self._drawn))
        c.lock(False, exploration.before is None)
        c.say(_summary(exploration))

    def __panel__(self) -> Any:
        return self.controls.layout

    async def toggle(self, label: str, present: bool) -> None:
        """Add an effect, or remove it."""
        if present:
            await self._change(f"without {label}", lambda e, p: e.without(label, p))
        else:
            joint = self._joint_of(label)
            await self._change(f"with {label}", lambda e, p: _added(e, label, p), joint)

    async def back(self, rung: int) -> None:
        """Go back to an earlier rung of the ladder."""
        await self._change("going back", lambda e, p: e.at(rung))

    async def undone(self) -> None:
        """Undo the last change."""
        await self._change("undoing", lambda e, p: e.undone)

    async def judged(self) -> None:
        """Diagnose the present model."""
        await self._change("judging", lambda e, p: e.judged(p))
        if self.exploration.now.diagnosis is not None:
            self.controls.view.value = "Verdict"

    async def saved(self) -> None:
        """Write the present model into the folder that is named."""
        written = str(self.controls.folder.value_input or self.controls.folder.value or "").strip()
        if self._busy:
            return
        if not written:
            self.controls.say("error: no folder is named; write one to save into", "bad")
            return
        folder = Path(written).expanduser()
        self._lock(True)
        try:
            files = await asyncio.to_thread(self.exploration.write, folder)
            names = ", ".join(str(file.relative_to(folder)) for file in files)
            self.controls.say(f"saved into {folder.resolve()}: {names}")
        except Exception as error:
            self.controls.say(_line(error), "bad")
        finally:
            self._lock(False)

    async def redrawn(self) -> None:
        """Draw what is looked at, unless it is shown already or left before it is drawn."""
        wanted = self._wanted()
        if wanted == self._drawn:
            return
        picture = await asyncio.to_thread(contents, *wanted)
        if wanted == self._wanted():
            self._drawn = wanted
            self.controls.show(picture)

    async def announced(self, wrong: str = "") -> None:
        """Predict what every effect would do; given up as soon as the model changes again."""
        mine, turn = self.exploration, self._turn

        def screened(on_progress: Progress) -> Exploration:
            def checked(what: str, share: float) -> None:
                if self._turn != turn:
                    raise Stale
                on_progress(what, share)

            return mine.screened(checked)

        if mine.now.candidates is None:
            try:
                found = await self._working("announcing falls", screened)
            except Stale:
                return
            except Exception as error:
                self.controls.say(_line(error), "bad")
                return
            if self._turn != turn:
                return
            self._is(found)
            self._drawn = found, *self._drawn[1:]  # the same model
        self.controls.say(*((wrong, "bad") if wrong else (_summary(self.exploration),)))

    async def _change(self, words: str, verb: Verb, joint: str | None = None) -> None:
        """One change; a click during one does nothing."""
        if self._busy:
            return
        self._lock(True)
        self._turn += 1
        before, wrong = self.exploration, ""
        try:
            self._is(await self._working(words, lambda p: verb(before, p)))
            wanted = self.exploration, str(self.controls.view.value), joint or self._wanted()[2]
            picture = await asyncio.to_thread(contents, *wanted)
            self._drawn = wanted
            self.controls.show(picture)
            self.controls.joint.value = wanted[2]
        except Exception as error:  # a page must live on, whatever happened
            wrong = _line(error)
        finally:
            self._lock(False)
        if wrong:
            self.controls.say(wrong, "bad")
        else:
            await self.redrawn()  # where another view has been asked for meanwhile
        await self.announced(wrong)

    async def _working(self, words: str, work: Callable[[Progress], T]) -> T:
        """Run work in a thread, and show its progress."""
        state: tuple[str, float] = words, 0.0

        def on_progress(what: str, share: float) -> None:
            nonlocal state
            state = f"{words}: {what}", share

        task = asyncio.ensure_future(asyncio.to_thread(work, on_progress))
        while not task.done():
            self.controls.say(f"{state[0]} …", "busy", state[1])
            await asyncio.wait([task], timeout=PAUSE)
        return task.result()

    def _is(self, found: Exploration) -> None:
        self.exploration = found
        self.changed(found)
        self.controls.fill(found)

    def _wanted(self) -> tuple[Exploration, str, str]:
        return self.exploration, str(self.controls.view.value), str(self.controls.joint.value)

    def _joint_of(self, label: str) -> str | None:
        """Return the joint to look at: the effect's own, or the one whose error it lowers most."""
        for x in self.exploration.candidates:
            if x.label == label and x.joints:
                return next((j for j in x.joints if j in x.effect.joints), x.joints[0])
        return None

    def _lock(self, busy: bool) -> None:
        self._busy = busy
        self.controls.lock(busy, self.exploration.before is None)

    def _wire(self) -> None:
        c = self.controls

        def calls(verb: Callable[[], Awaitable[None]]) -> Callable[[Any], Awaitable[None]]:
            async def handle(event: Any) -> None:
                await verb()

            return handle

        async def effect(event: Any) -> None:
            await self.toggle(str(event.data["label"]), bool(event.data["present"]))

        async def rung(event: Any) -> None:
            await self.back(int(event.data["rung"]))

        c.candidates.on_msg(effect)
        c.ladder.on_msg(rung)
        c.undo.on_click(calls(self.undone))
        c.judge.on_click(calls(self.judged))
        c.save.on_click(calls(self.saved))
        c.view.param.watch(calls(self.redrawn), "value")
        c.joint.param.watch(calls(self.redrawn), "value")


def _added(e: Exploration, label: str, progress: Progress) -> Exploration:
    """Return the exploration with the effect that is listed under a label."""
    effects = (x.effect for x in e.candidates if x.label == label and not x.present)
    return e.with_effect(next(effects, label), progress)


def _summary(e: Exploration) -> str:
    best = next((x for x in e.candidates if x.sure and not x.present), None)
    if best is None:
        return "No effect lowers the error by more than chance would; judge it to be sure."
    return (
        f"The largest fall is announced for {best.label}. A fall is no proof of a cause: judge it "
        "to weigh what speaks for it."
    )


def _line(error: Exception) -> str:
    words = " ".join(str(error).split())
    if isinstance(error, IdentError | OSError):
        return f"error: {words}"
    return f"error: a fault of ident, not of yours: {type(error).__name__}: {words}"
