"""What stands on the page, and how an exploration is put there; it decides nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import panel

from ident.explore.exploration import Exploration
from ident.explore.parts import CHOICE, CSS, FOLD, Candidates, Ladder, Status
from ident.explore.rows import beside_verdict, rows_of
from ident.explore.tables import error_rows, ladder_rows
from ident.explore.views import VIEWS, Drawn
from ident.show.html import table

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
            rows = rows_of(e.now.candidates, e.now.diagnosis)
            said = f"{len(rows)} effects; fall of the held-out squares ± standard error"
            if beside_verdict(e.now.candidates, e.now.diagnosis):
                said += "; none of them is judged to be missing"
            self.candidates.param.update(rows=rows, stale=False, said=said)

    def show(self, picture: Drawn) -> None:
        """In the place of pictures."""
        self.shown[:] = picture.panes()

    def _laid_out(self) -> Any:
        wide = {"sizing_mode": "stretch_width"}
        folded = {**wide, "stylesheets": [FOLD]}
        bar = panel.Row(self.undo, self.judge, self.folder, self.save)
        top = panel.Row(self.errors, self.ladder, **folded)
        look = panel.Row(self.view, self.joint, **folded)
        right = panel.Column(top, look, self.shown, **wide)
        head = panel.Row(self.status, bar, **folded)
        return panel.Column(head, panel.Row(self.candidates, right, **folded), **wide)
