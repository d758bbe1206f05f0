"""Gathered fits, many logs one by one, snapshots, alarms and monitors as text and HTML.

The page of `monitor` has parameters with bands, reaction forces, errors and alarms over time.
"""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ident.assess.machine import assess_machine, explained_alone, typical_error
from ident.display import renders
from ident.effects.library import create as effect
from ident.effects.library import named
from ident.information.blocks import Error
from ident.information.evidence import ALPHA
from ident.mechanism import Mechanism
from ident.mechanism.parameters import DYNAMIC
from ident.request import PYTHON, Request, Step
from ident.show.card import Bar, Card, card_of
from ident.show.charts import MEASURED, RESIDUAL, Chart, Level, Line, Mark, Panel, pieces_of
from ident.show.diagnosis import sheet as diagnosis_sheet
from ident.show.diagnosis import short
from ident.show.fit import error_columns, summary
from ident.show.headline import error_words, remainder_sentence
from ident.show.html import ROWS, Block, Section, Sheet, paragraph, piece, report_page, table
from ident.show.motion import made_of
from ident.streams.charts import OFTEN
from ident.streams.gather import Gathered
from ident.streams.many_logs import Disagreement, LogComparison, Verdict, Verdicts
from ident.streams.monitor import Alarm, Monitor, ParameterChange, SuspectedCause
from ident.streams.online import Forces, Snapshot
from ident.text import listed, percent, rounded, shortlist, stamp

NAMED = 6  # logs in a sentence; more are counted
SHOWN = 6  # logs in one command
LAST = 2  # parameters in one line
TINY = 1e-12  # a smaller chance is printed as this
SIZED = 3  # rivals of a cause, below which all are printed with their sizes
YEAR_2000, YEAR_2100 = 946_684_800.0, 4_102_444_800.0  # times [s] since 1970 that are clock times
BLIND = 10.0  # times a change: a standard error beyond which it is not printed


# --- many logs -----------------------------------------------------------------------------------


@renders(LogComparison, "sentence")
def who_disagrees(x: LogComparison) -> str:
    """Return how many logs disagree, and at which rate logs that are alike would."""
    if (typical := typical_error(x)) is not None:
        return (
            f"no log disagrees with the others by more than what the model leaves in each, "
            f"{percent(typical)}, and that is much: see what it lacks first (ident diagnose)"
        )
    names = shortlist(x.odd, NAMED) if x.odd else "no log"
    whom = "each other" if len(x.used) == len(x.odd) == 2 else "the others"
    return (
        f"{names} {'disagree' if len(x.odd) > 1 else 'disagrees'} with {whom}; of 100 folders of "
        f"logs that are alike, {100 * ALPHA:g} or fewer would have one that seems to"
    )


def log_rows(x: LogComparison) -> list[list[str]]:
    """Return one row a log, the head first."""
    rows = [["log", "samples", "error", "own fit", "chance", "differs in"]]
    for log in x.logs:
        if log.left_out:
            rows.append([log.log, "–", "–", "–", "–", "left out"])
            continue
        odd = log.disagreement
        p = None if odd is None else odd.p_value
        chance = "–" if p is None else f"< {TINY:.0e}" if p < TINY else f"{p:.2g}"
        what = _difference(odd) if odd is not None and odd.clear else ""
        errors = percent(log.error), percent(log.own)
        rows.append([log.log, str(log.samples), *errors, chance, what])
    return rows


def _difference(odd: Disagreement) -> str:
    share = f"{100 * odd.share:.0f} %"
    if not explained_alone(odd):
        return f"no part of the model alone: {odd.parts[0]} explains {share}" if odd.parts else ""
    change = f"{'+' if odd.change > 0 else ''}{rounded(odd.change, odd.stderr)} {odd.unit}"
    several = "each of " if len(odd.parts) > 1 else ""
    return f"{odd.unknown} by {change}; {several}{', '.join(odd.parts)} explains {share}"


@renders(LogComparison, "sheet")
def log_sheet(x: LogComparison) -> Sheet:
    """Return the table, and who disagrees."""
    head = "log by log; chance: that a log like the others looks as odd"
    return Sheet(head, tables={"logs": log_rows(x)}, lines=[who_disagrees(x)], notes=x.notes)


renders(LogComparison, "section")(lambda x: Section("Log by log", log_sheet(x).blocks()))


@renders(Gathered, "summary")
def gathered_summary(x: Gathered, request: Request = PYTHON) -> str:
    """Return the summary of the fit and, of several logs, the logs one by one."""
    of_fit = summary(x.fit, request)
    return f"{of_fit}\n\n{log_sheet(x.each).summary()}" if x.several else of_fit


@renders(Gathered, "text")
def gathered_text(x: Gathered) -> str:
    """Return the summary and the notes."""
    return "\n".join([gathered_summary(x), *(f"note: {note}" for note in x.notes)])


# --- many diagnoses ------------------------------------------------------------------------------


def verdict_rows(logs: Sequence[Verdict]) -> list[list[str]]:
    """Return one row a log, the head first."""
    rows = [["log", "samples", "verdict", "of", "error", "with it"]]
    for log in logs:
        if log.left_out:
            rows.append([log.log, "–", "left out", "", "", ""])
            continue
        verdict = log.verdict + (f": {' or '.join(log.named)}" if log.named else "")
        errors = (percent(log.error_before), percent(log.error_after)) if log.named else ("", "")
        rows.append([log.log, str(log.samples), verdict, log.joint, *errors])
    return rows


def _each_sheet(x: Verdicts) -> Sheet:
    return Sheet("each log by itself", tables={"logs": verdict_rows(x.logs)}, notes=x.notes)


def partly(logs: Sequence[Verdict]) -> str:
    """Return the verdicts of the logs that are done."""
    return Sheet(f"{len(logs)} logs by themselves", tables={"logs": verdict_rows(logs)}).summary()


@renders(Verdicts, "text")
def verdicts_text(x: Verdicts, request: Request = PYTHON) -> str:
    """Return each log's verdict, and the diagnosis of all logs together."""
    together = diagnosis_sheet(x.together, request).text()
    return f"{_each_sheet(x).summary()}\n\nall logs together\n{together}"


@renders(Verdicts, "short")
def short_verdicts(x: Verdicts, request: Request = PYTHON) -> str:
    """Return each log's verdict, and what to read first of all logs together."""
    together = short(x.together, request=request)
    return f"{_each_sheet(x).summary()}\n\nall logs together\n{together}"


renders(Verdicts, "section")(lambda x: Section("Log by log", _each_sheet(x).blocks()))
renders(Verdicts, "html")(lambda x: _each_sheet(x).html() + x.together._repr_html_())


# --- online --------------------------------------------------------------------------------------


@renders(Forces, "text")
def forces_text(x: Forces) -> str:
    """Return the multipliers of the last sample."""
    if not len(x):
        return "no multipliers"
    values = zip(x.names, x.values[-1], x.stderr[-1], x.units, strict=True)
    parts = [f"{name} = {rounded(v, error)} {unit}" for name, v, error, unit in values if v == v]
    return ", ".join(parts) or "no multiplier is determined"


@renders(Snapshot, "line")
def snapshot_line(x: Snapshot) -> str:
    """Return errors, the last identified parameters (of effects) and multipliers in a line."""
    errors = [f"{name} {percent(e.relative)}" for name, e in x.errors.items()]
    known = [str(value) for value in x.identified]
    more = [f"{len(known) - LAST} more parameters"] if len(known) > LAST else []
    parts = [f"error of {shortlist(errors)}"] if errors else []
    parts += [listed([*known[-LAST:], *more])] if known else []
    parts += [str(x.multipliers)] if x.multipliers is not None else []
    return f"t = {stamp(x.t)} s: {'; '.join(parts)}"


@renders(Snapshot, "sheet")
def snapshot_sheet(x: Snapshot) -> Sheet:
    """Return tables of parameters and errors, and notes."""
    head, cells = error_columns(x)
    rows = [["parameter", "value", *head, "prior", "unit", ""]]
    for v in x.identified:
        state, value = "held" * (v.name in x.held), rounded(v.value, v.stderr)
        rows.append([v.name, value, *cells(v), f"{v.prior:.5g}", v.unit, state])
    errors = [["error", "all", "rms", "unit"]]
    errors += [[n, percent(e.relative), f"{e.rms:.4g}", e.unit] for n, e in x.errors.items()]
    title = (
        f"at t = {stamp(x.t)} s: {x.samples} samples, {x.rows:.6g} equations a coordinate, "
        f"{x.rank} base parameters, condition number {x.condition_number:.3g}; lag "
        f"{1e3 * x.lag:.3g} ms"
    )
    known = {"parameters": rows} if len(rows) > 1 else {}
    facts = {} if known else {"parameters": "none is determined by itself"}
    if x.multipliers is not None:
        facts["multipliers"] = str(x.multipliers)
    return Sheet(title, facts=facts, tables={**known, "errors": errors}, notes=x.notes)


# --- monitor -------------------------------------------------------------------------------------


@renders(ParameterChange, "text")
def change_text(x: ParameterChange) -> str:
    """Return `Fc +0.31 ± 0.01 N m`."""
    change = rounded(x.change, x.stderr)
    return f"{x.name} {'' if change.startswith('-') else '+'}{change} {x.unit}".rstrip()


@renders(SuspectedCause, "text")
def cause_text(x: SuspectedCause) -> str:
    """Return the cause and the changes of its parameters that are known."""
    known = [step for step in x.steps if step.stderr is not None]
    # what the motion does not determine by itself has an error without bound
    sure = [step for step in known if (step.stderr or 0.0) < BLIND * abs(step.change)]
    return f"{x.label}: {', '.join(map(str, sure or known or x.steps))}"


def moment(t: float) -> str:
    """Return a time [s] to 10 ms, or local date and clock where it counts from 1970."""
    if not YEAR_2000 < t < YEAR_2100:
        return f"{t:.2f} s"
    return datetime.fromtimestamp(t).astimezone().strftime("%d %b %Y, %H:%M:%S")


@renders(Alarm, "headline")
def headline(x: Alarm) -> str:
    """Return the alarm in one line."""
    onset = moment(x.onset)
    since = f"before the log began ({onset} or earlier)" if x.from_start else f"since {onset}"
    if not x.suspects or x.best is None:
        near = f"; nearest, but no explanation: {x.best.label}" if x.best else ""
        return f"changed {since}, cannot tell what{near}"
    if x.verdict == "named":
        words = _sentence(cause_nouns(x.best))
        return f"changed {since}. {words}: {_sizes(x.best)}"
    few = len(x.rivals) < SIZED
    which = map(str, (x.best, *x.rivals)) if few else x.suspects
    return f"changed {since}. One of {('; ' if few else ', ').join(which)}"


def _sizes(x: SuspectedCause) -> str:
    """Return a cause with the changes of its parameters; of a load the mass stands for all."""
    masses = [step.name for step in x.steps if step.name.rpartition(".")[2] == "m"]
    loads = set(DYNAMIC[1:]) if masses else set()
    return str(replace(x, steps=tuple(
        step for step in x.steps if step.name.rpartition(".")[2] not in loads
    )))  # fmt: skip


def cause_nouns(x: SuspectedCause) -> str:
    """Return a cause in words: `a load on hand and dry friction in elbow`."""
    nouns = []
    for label in x.label.split(" + "):
        kind, _, joints = label.partition(":")
        cause = effect(kind, joints)
        load = f"a load on {cause.loaded_link}" if cause.loaded_link else ""
        nouns.append(load or named([cause]).removesuffix(f" ({kind})"))  # its label follows
    return listed(nouns)


def _sentence(words: str) -> str:
    """Return words with a capital at the beginning."""
    return words[:1].upper() + words[1:]


@renders(Alarm, "sheet")
def alarm_sheet(x: Alarm) -> Sheet:
    """Return the headline and what it does not say."""
    causes = []
    for cause in (x.best, *x.rivals) if x.best else ():
        causes.append(f"  {cause}, explains {100 * cause.explains:.0f} %")
        forces = [f"{name} by {v:.2g}" for name, v in cause.reactions.items() if v > 0]
        if forces:
            causes.append(f"    it would change the reaction {', '.join(forces)} rms")
    facts = {
        "sure": f"at {moment(x.detected)} by {x.seen_by}, evidence {x.evidence:.1f} of "
        f"{x.threshold:.1f}",
        "named": f"at {moment(x.named)}",
        "errors over their normal size": ", ".join(f"{n} {v:.3g}" for n, v in x.errors.items()),
    }
    return Sheet(headline(x), facts=facts, lines=causes)


@renders(Monitor, "sheet")
def monitor_sheet(x: Monitor) -> Sheet:
    """Return what the monitor rests on, watches and has raised."""
    alone = (s.effects[0].kind for s in x.watched.suspects if len(s.effects) == 1)
    kinds = ", ".join(f"{kind} ({count})" for kind, count in Counter(alone).items())
    title = (
        f"monitor of {x.watched.mechanism.name}: {x.design.normal.triangle.rows} rows of normal "
        f"running, intervals of {x.seconds:g} s"
    )
    facts = {
        "false alarms": f"{x.false_alarms_per_hour:g} an hour at most, while the machine runs as "
        f"it did then; on normal running drawn again {x.drawn} where {OFTEN:g} were allowed",
        "watches": f"{kinds} (number of places)",
        "alarms": f"{len(x.alarms)}, evidence {x.evidence:.1f} of {x.threshold:.1f}",
    }
    return Sheet(title, facts=facts)


MOST_MOMENTS = 1000  # moments of a curve; beyond, every second one is forgotten
BESIDE_HEADLINE = 2  # shown: parameters that are seen beside the headline
PANELS = 8  # parameters that have a chart; all are in the tables
FORCES = 6  # multipliers that have one
NOTHING_LEFT = 0.02  # shown: of the squares beyond noise, below which a cause explains all of it
SHARE = 1.96  # standard errors on either side of a band
SETTLED = 10.0  # times its median: a standard error above, at the beginning, is not drawn


class ThinnedSeries:
    """Values over time (t [s], values) in bounded memory, evenly thinned as they come."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, np.ndarray]] = []
        self._every = self._seen = 0

    def add(self, t: float, values: np.ndarray) -> None:
        """Take the values (k,) of a later moment t [s]."""
        self._seen += 1
        if self._every and self._seen % self._every:
            return
        self.rows.append((t, values))
        if len(self.rows) > MOST_MOMENTS:
            self.rows, self._every = self.rows[::2], 2 * max(self._every, 1)

    @property
    def series(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) and values (n, k)."""
        t, values = zip(*self.rows, strict=True)
        return np.array(t), np.array(values)


class MonitorHistory:
    """Snapshots, reaction forces and `alarms` of a running machine, as charts and as a report.

    `silent` states why there are no alarms; empty where the machine is watched.
    """

    def __init__(self, mechanism: Mechanism, silent: str, request: Request = PYTHON) -> None:
        self._mechanism, self._silent, self._request = mechanism, silent, request
        self._parameters, self._errors, self._forces = (ThinnedSeries() for _ in range(3))
        self.alarms: list[Alarm] = []
        self._lock = threading.RLock()  # a page is drawn while samples come
        self._last: Snapshot | None = None
        self._of_normal: Mapping[str, Error] = {}
        self._usual: Mapping[str, Error] = {}
        self._last_forces: Forces | None = None

    def add(
        self,
        snapshot: Snapshot,
        forces: Forces | None,
        of_normal: Mapping[str, Error] | None = None,
        usual: Mapping[str, Error] | None = None,
    ) -> None:
        """Take a snapshot, the multipliers of the samples since the one before, and by joint the
        present errors of the model of normal running and its usual ones, if the machine is watched.
        """
        with self._lock:
            self._of_normal, self._usual = of_normal or {}, usual or {}
            self._last = snapshot
            both = [(v.value, v.stderr) for v in snapshot.parameters]
            self._parameters.add(snapshot.t, np.array(both, float).reshape(-1, 2))
            errors = [(self._of_normal or snapshot.errors).get(joint) for joint in snapshot.errors]
            self._errors.add(snapshot.t, np.array([e and e.relative for e in errors], float))
            self.add_forces(forces)

    def add_forces(self, forces: Forces | None) -> None:
        """Take the multipliers of further samples."""
        if forces is None or not len(forces):
            return
        with self._lock:
            self._last_forces = forces
            for t, value, stderr in zip(forces.t, forces.values, forces.stderr, strict=True):
                self._forces.add(float(t), np.stack([value, stderr], axis=1))

    @property
    def card(self) -> Card:
        """How it is: alarms first, then the error by joint."""
        if self._last is None:
            return Card(f"{self._mechanism.name}: no sample yet")
        head = f"{self._mechanism.name} at t = {stamp(self._last.t)} s: "
        a = assess_machine(
            self._mechanism.name, self._last, self.alarms, watched=not self._silent,
            like=bool(self._request.like), acceptable=self._request.acceptable,
        )  # fmt: skip
        if self.alarms:  # its own model is fitted to the changed machine
            count = f"{n} alarms, the last" if (n := len(self.alarms)) > 1 else "1 alarm"
            noise = self._last.noise
            normal = [self._bar(n, e, noise.get(n)) for n, e in self._of_normal.items()]
            bars = tuple(normal) or tuple(map(Bar.of, a.errors))  # not those of the refitted model
            change = "in normal running → now" * bool(normal)
            line = f"{head}{count}: {self.alarms[-1].headline}. {self._left()}."
            known = self._request.line(Step("diagnose")).partition(" --")[0]
            if "/identified " in known:  # its bodies are known
                then = "find the cause with all its values, with the bodies of normal running known"
                return Card(line, "", bars, known, f"{then}.", change)
            fitted = replace(self._request, logs=self._request.like, folder="")
            command = fitted.line(Step("identify")) if self._request.like else ""
            then = "identify normal running, then diagnose this log with the folder identified/ "
            return Card(line, "", bars, command, f"{then}that this writes.", change)
        size = f"; {error_words(a)}" if a.now else ""
        remainder = f" {words}." if a.now and (words := remainder_sentence(a)) else ""
        line = f"{head}{self._silent or 'no alarm'}{size}.{remainder}"
        then = ""
        if a.good_enough.fits or not a.good_enough.joints:
            then = "give logs of normal running (`--like`): a change then raises an alarm."
            if not self._silent:
                then = "nothing has to be done: the machine runs as it did in normal running."
        top = card_of(a, self._request, line=line, then=then)
        return replace(top, command="") if then else top

    def next_text(self) -> str:
        """Return what to do next, for a terminal."""
        top = self.card
        return "\n".join(Card("", command=top.command, then=top.then).text())

    def _left(self) -> str:
        """Return what is left of the change with the likeliest cause of the last alarm."""
        best = self.alarms[-1].best
        if best is None:
            return "Left: all that is new"
        rest = max(0.0, 1.0 - best.explains)
        return (
            f"Left with it: {percent(rest)} of what is new"
            if rest > NOTHING_LEFT
            else "Left with it: noise"
        )

    def _bar(self, joint: str, now: Error, noise: float | None) -> Bar:
        """Return the error of the model of normal running now, beside the usual one."""
        usual = self._usual.get(joint)
        if not usual or not now.relative:
            return Bar(joint, now, noise=noise)
        return Bar(joint, usual, now, noise)

    @property
    def sections(self) -> tuple[Section, ...]:
        """Alarms, parameters, reaction forces and errors."""
        result = self._last
        if result is None:
            return ()
        rows = [["alarm", "sure at", "named at"]]
        rows += [[x.headline, moment(x.detected), moment(x.named)] for x in self.alarms]
        known = self._identified(result)
        forces: dict[str, tuple[int, str]] = {}
        if (x := self._last_forces) is not None:
            forces = dict(zip(x.names, enumerate(x.units), strict=True))
        over_time = self._charts("Parameters", self._parameters, known, PANELS)
        count = sum(len(item.rows) for item in over_time)
        now = [paragraph(f"{count} of these have a chart.")] * (0 < count < len(known))
        reactions = self._charts("Reaction forces λ", self._forces, forces, FORCES)
        return (
            Section("Alarms", [table(rows, "Alarms", tied=False)] if rows[1:] else []),
            Section("Parameters over time", over_time),
            Section("Reaction forces", reactions),
            Section("Error of the predicted torque", [self._error_chart(result)]),
            Section("Now", [*now, *snapshot_sheet(result).blocks()]),
        )

    def _identified(self, result: Snapshot) -> dict[str, tuple[int, str]]:
        """Return place and unit of identified parameters, those that have changed first."""
        bodies = set(self._mechanism.bodies.names)
        labels = [part for x in self.alarms for label in x.suspects for part in label.split(" + ")]
        suspects = [label.removeprefix("payload:") for label in labels]
        changed = tuple(f"{suspect.replace(':', '.', 1)}." for suspect in suspects)
        order = sorted(
            result.identified, key=lambda v: (not v.name.startswith(changed), v.name in bodies)
        )
        names = {v.name: (i, v.unit) for i, v in enumerate(result.parameters)}
        return {v.name: names[v.name] for v in order}

    def _error_chart(self, result: Snapshot) -> Chart:
        """Draw the error of each joint over time, of the model of normal running if any."""
        t, errors = self._errors.series
        lines = (
            Line(t, 100 * errors[:, u], joint, u, dotted=len(t) < 3)
            for u, joint in enumerate(result.errors)
        )
        panel = Panel((*lines, *self._marks(t)), "t [s]", "error [%]", height=3.0)
        whose = " of the model of normal running" * bool(self._of_normal)
        words = f"Error of the torque{whose} over time"
        return Chart(words, ((panel,),), True, clock="log")

    def _marks(self, t: np.ndarray) -> list[Level]:
        """Return an upright line at each alarm among times t (n,) [s]."""
        return [
            Level(x.onset, True, f"alarm: {(x.suspects or ('changed',))[0]}", RESIDUAL)
            for x in self.alarms
            if len(t) and t[0] <= x.onset <= t[-1]
        ]

    def _charts(
        self,
        words: str,
        curve: ThinnedSeries,
        known: dict[str, tuple[int, str]],
        most: int,
        rows: int = ROWS,
    ) -> tuple[Chart, ...]:
        """Draw the first `most` names that are determined, with bands of 95 %, a panel each, so
        many `rows` in a chart.
        """
        if not curve.rows:
            return ()
        t, values = curve.series
        drawn = [name for name, (i, _) in known.items() if np.isfinite(values[:, i, 0]).any()]
        panels: list[tuple[Panel, ...]] = []
        for name in drawn[:most]:
            i, unit = known[name]
            value, half = values[:, i, 0], SHARE * values[:, i, 1]
            if len(result := half[np.isfinite(half)]):  # before it is known, it is not drawn
                late = np.arange(len(t)) >= (half <= SETTLED * np.median(result)).argmax()
                value, half = np.where(late, value, np.nan), np.where(late, half, np.nan)
            marks: tuple[Mark, ...] = (
                Line(t, value - half, "95 % interval", MEASURED, 1.6),
                Line(t, value + half, "95 % interval", MEASURED, 1.6),
                Line(t, value, "value", 0, 2.2, dotted=len(t) < 3),
                *self._marks(t),
            )
            panels.append((Panel(marks, "t [s]", f"{name}\n[{unit}]", height=2.4),))
        title = f"{words} over time, with intervals of 95 %"
        return Chart(title, tuple(panels), True, clock="log").pieces(rows) if panels else ()

    def report(self) -> bytes:
        """Return report.html."""
        logs = [Path(name) for name in (*self._request.logs, *self._request.like)]
        files = [log for log in logs if log.is_file()]
        went_in = made_of(self._mechanism, None, files, self._request.command)
        front: list[Block] = []
        if (result := self._last) is not None:
            known = self._identified(result)
            front = [self._error_chart(result)]
            front += self._charts("Parameters", self._parameters, known, BESIDE_HEADLINE, 1)
        title = f"{self._mechanism.name}: monitor"
        return report_page(title, self.card, (*self.sections, went_in), front)

    def live(self) -> str:
        """Return what the live page shows now, as JSON."""
        with self._lock:
            card, sections = self.card, self.sections
        blocks: list[Block] = [Markup("<header>{}</header>").format(piece("card", card))]
        for section in sections:
            if section.blocks:
                blocks += [Markup("<h2>{}</h2>").format(section.title), *section.blocks]
        return json.dumps(pieces_of(blocks))
