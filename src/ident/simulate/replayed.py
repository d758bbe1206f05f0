"""The nouns of `replay`: simulated and measured motion side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ident.files import write_all
from ident.residual.error import Error
from ident.show.charts import Chart
from ident.show.html import Shown
from ident.simulate.replay_report import plot_replay, replay_html, replay_json
from ident.tables import percent, table

LEAVES = 0.05  # of a joint's travel: farther away, the simulation has left the measurement


@dataclass(frozen=True, eq=False)
class Replayed:
    """One model on one log with n samples.

    Attributes:
        t: (n,) [s]; joints: the logged ones, with their units.
        measured: (n, j), NaN where there is none.
        simulated: (n, j), at a restart the end of the window before; NaN where there is none.
        starts: samples at which a window begins.
        since, free: a run without restarts, from this sample on, (≤ n, j).
        failures: why windows could not be integrated to their end.
    """

    name: str
    t: np.ndarray
    joints: tuple[str, ...]
    units: tuple[str, ...]
    measured: np.ndarray
    simulated: np.ndarray
    starts: tuple[int, ...]
    since: int
    free: np.ndarray
    failures: tuple[str, ...] = ()

    @property
    def travel(self) -> np.ndarray:
        """(j,) of the measured motion."""
        return np.nanmax(self.measured, axis=0) - np.nanmin(self.measured, axis=0)

    @property
    def errors(self) -> dict[str, Error]:
        """By joint: rms of simulated − measured, and that over the rms of the measured way from
        each window's start.
        """
        begin = np.searchsorted(self.starts, np.arange(len(self.t)), side="left") - 1
        way = self.measured - self.measured[np.array(self.starts)[np.maximum(begin, 0)]]
        off = self.simulated - self.measured
        found = {}
        for j, (joint, unit) in enumerate(zip(self.joints, self.units, strict=True)):
            known = np.isfinite(off[:, j])
            rms = float(np.sqrt(np.mean(off[known, j] ** 2))) if known.any() else np.nan
            size = float(np.sqrt(np.mean(way[known, j] ** 2))) if known.any() else 0.0
            found[joint] = Error(rms, rms / size if size > 0 else None, unit)
        return found

    @property
    def within(self) -> dict[str, float | None]:
        """By joint: seconds without restart until it is 5 % of its travel away; None: never."""
        n = len(self.free)
        off = np.abs(self.free - self.measured[self.since : self.since + n])
        found: dict[str, float | None] = {}
        for j, joint in enumerate(self.joints):
            away = np.flatnonzero(off[:, j] > LEAVES * self.travel[j])
            found[joint] = float(self.t[self.since + away[0]] - self.t[self.since]) if len(
                away) else None  # fmt: skip
        return found

    @property
    def lasted(self) -> float:
        """Length [s] of the run without restarts."""
        return float(self.t[self.since + max(len(self.free) - 1, 0)] - self.t[self.since])


@dataclass(frozen=True, eq=False)
class Replay(Shown):
    """Models' simulated motion against the measured one. Made by `ident.replay`.

    Attributes:
        runs: by model, one an experiment.
        window: [s] from one restart to the next.
    """

    runs: Mapping[str, tuple[Replayed, ...]]
    window: float

    def rows(self) -> list[list[str]]:
        """The table that is printed."""
        rows = [["", "rms", "of the way", "without restarts within 5 % for"]]
        for model, logs in self.runs.items():
            for run in logs:
                title = " ".join(
                    ([model] if len(self.runs) > 1 else []) + ([run.name] if len(logs) > 1 else [])
                )
                rows += [[title, "", "", ""]] if title else []
                for joint, error in run.errors.items():
                    left = run.within[joint]
                    stays = f"{left:.3g} s" if left is not None else f"all {run.lasted:.3g} s"
                    rms = "–" if np.isnan(error.rms) else f"{error.rms:.3g} {error.unit}"
                    rows.append([joint, rms, percent(error.relative), stays])
        return rows

    @property
    def notes(self) -> tuple[str, ...]:
        """What could not be integrated."""
        return tuple(
            f"{run.name}: some windows could not be integrated to their end: {why}"
            for logs in self.runs.values()
            for run in logs
            for why in run.failures
        )

    def __str__(self) -> str:
        count = sum(len(run.starts) for run in next(iter(self.runs.values())))
        head = (
            f"simulated against measured motion: {count} windows of {self.window:g} s, each from "
            "the measured state"
        )
        return "\n".join([head, *table(self.rows()), *(f"  note: {x}" for x in self.notes)])

    __repr__ = __str__

    def plot(self, experiment: int = 0) -> Chart:
        """Measured and simulated coordinate of every logged joint, with differences below.

        Args:
            experiment: its number, from 0.
        """
        return plot_replay(self, experiment)

    def save(self, path: str | Path) -> None:
        """The plot of the first experiment as .png, .svg, .pdf or .html, whole or not at all.

        Args:
            path: of the file, whose suffix decides.

        Raises:
            FitError: for another suffix.
        """
        self.plot().save(path)

    def write(self, folder: str | Path) -> list[Path]:
        """replay.html, with all pictures in it, and replay.json.

        Raises:
            IdentError: if the folder cannot be written; then no file of it has changed.
        """
        files = {"replay.html": replay_html(self), "replay.json": replay_json(self)}
        return write_all(Path(folder), files)
