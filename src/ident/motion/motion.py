"""The motion of all coordinates in an experiment, and the forces applied to the mechanism."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from markupsafe import Markup

from ident.display import render
from ident.errors import MotionError
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion.channels import Smoothed
from ident.motion.clock import runs
from ident.motion.smooth import Smooth
from ident.show.html import Shown, definitions, folded, items, strong, table
from ident.show.view3d import View


@dataclass(frozen=True, eq=False)
class Experiment:
    """One log's motion on a uniform clock.

    With n samples, J named joints and d independent coordinates:

    Attributes:
        name: the log's.
        t: (n,) [s], uniform.
        q, v, a: (n, nq), (n, nv), (n, nv) of the model.
        y, yd, ydd: (n, J) coordinate, rate and acceleration of the mechanism's joints.
        tau: (n, driven) measured torques, in the order of `mechanism.driven`.
        wrench: (n, nv) generalised forces of measured external wrenches, or None.
        pinv: (n, nv, m + d), the pseudo-inverse of [J; W_u]; None for a tree.
        leverage: (n, J, d), ẏ_j for unit rate of each independent coordinate; None for a tree.
        usable: (n,), false where a sample takes no part, with the reason in `Motion.notes`.
        still: (J,) speed below which a joint counts as standing still [rad/s | m/s].
        extra: the log's other columns on this clock.
        logged: names of the joints from whose coordinates the motion was completed.
        independent: names of the joints to which `leverage` refers.
        noise: standard deviation of white noise in the logged channels, by column.
        smooth: the splines behind the motion; None where the log was taken as it is.
        channels: what was done to each channel of the motion.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    y: np.ndarray
    yd: np.ndarray
    ydd: np.ndarray
    tau: np.ndarray
    wrench: np.ndarray | None
    pinv: np.ndarray | None
    leverage: np.ndarray | None
    usable: np.ndarray
    still: np.ndarray
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    logged: tuple[str, ...] = ()
    independent: tuple[str, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    smooth: Smooth | None = None
    channels: tuple[Smoothed, ...] = ()

    def __len__(self) -> int:
        return len(self.t)

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return (len(self.t) - 1) / float(self.t[-1] - self.t[0])

    def thinned(self, every: int) -> Experiment:
        """One sample of `every`, for what is smooth."""
        return self if every == 1 else self.at_samples(slice(None, None, every))

    def at_samples(self, index: slice | np.ndarray) -> Experiment:
        """Some samples only."""
        cut: dict[str, Any] = {
            each.name: value[index]
            for each in fields(self)
            if each.name != "still"
            and isinstance(value := getattr(self, each.name), np.ndarray)
            and len(value) == len(self)  # not yet completed ones are empty
        }
        return replace(self, **cut, extra={name: x[index] for name, x in self.extra.items()})

    def segments(self) -> Iterator[slice]:
        """Runs of usable samples; nothing is filtered or differentiated across their ends."""
        yield from runs(self.usable)


@dataclass(frozen=True)
class Band:
    """What the log's spectrum says.

    Attributes:
        motion: frequency below which 99.9 % of the velocities' power lies [Hz].
        noise: largest share of noise found in a channel that the regression uses.
        cutoff: of the zero-phase filter on all columns [Hz]; None: nothing to filter.
    """

    motion: float
    noise: float
    cutoff: float | None


@dataclass(frozen=True, eq=False)
class Motion(Shown):
    """Experiments of one mechanism, completed through its closures.

    Attributes:
        experiments: one a log.
        independent: names of the joints in whose coordinates errors are compared.
        band: what the spectra say, over all logs.
        closure_error: largest |Φ| left [m | rad].
        notes: what was repaired, derived or left out, in words.
        logs: as they were read, under ident's column names.
        mechanism: that moves; None where a motion was made up without one.
    """

    experiments: tuple[Experiment, ...]
    independent: tuple[str, ...]
    band: Band
    closure_error: float
    notes: tuple[str, ...] = ()
    logs: tuple[Log, ...] = ()
    mechanism: Mechanism | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the logs."""
        return tuple(experiment.name for experiment in self.experiments)

    @property
    def samples(self) -> int:
        """Over all experiments."""
        return sum(len(experiment) for experiment in self.experiments)

    def view(self) -> View:
        """The mechanism moving in 3-D: a recording in a notebook, `.serve()` a page with controls.

        Raises:
            MotionError: for a motion that was made up without a mechanism.
        """
        if self.mechanism is None:
            raise MotionError(
                "this motion knows no mechanism to show; one of ident.complete(mechanism, log) does"
            )
        return render(self.mechanism, "view", self.experiments)

    def __str__(self) -> str:
        return "\n".join([self.summary, *(f"  note: {note}" for note in self.notes)])

    @property
    def rows(self) -> list[list[str]]:
        """The logs as a table: name, samples, duration, rate, samples left out; the head first."""
        rows = [["log", "samples", "duration", "rate", "left out"]]
        for e in self.experiments:
            out = int(len(e) - e.usable.sum())
            time = f"{e.t[-1] - e.t[0]:.4g} s"
            rows.append([e.name, str(len(e)), time, f"{e.rate:.4g} Hz", str(out) if out else "–"])
        return rows

    @property
    def summary(self) -> str:
        """Logs, independent coordinates, bandwidth and filter, without the notes."""
        lines = [f"motion: {len(self.experiments)} experiment(s), {self.samples} samples"]
        for e in self.experiments:
            lines.append(
                f"  {e.name}: {len(e)} samples, {e.t[-1] - e.t[0]:.3g} s at {e.rate:.4g} Hz"
            )
        lines.append(f"  independent: {', '.join(self.independent)}")
        cut = "none" if self.band.cutoff is None else f"{self.band.cutoff:.3g} Hz"
        lines.append(f"  bandwidth of the motion: {self.band.motion:.3g} Hz; filter: {cut}")
        if self.closure_error > 0:
            lines.append(f"  closure error: {self.closure_error:.2g}")
        return "\n".join(lines)

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        cut = "none" if self.band.cutoff is None else f"{self.band.cutoff:.3g} Hz"
        said = {
            "Compared in": ", ".join(self.independent),
            "Bandwidth of the motion": f"{self.band.motion:.3g} Hz",
            "Zero-phase filter": cut,
            "Closure error": f"{self.closure_error:.2g}" if self.closure_error > 0 else "",
        }
        notes = folded("Repaired, derived or left out", items(self.notes)) if self.notes else ""
        title = f"Motion of {self.samples} samples"
        return strong(title), table(self.rows, "Logs"), definitions(said), Markup(notes)
