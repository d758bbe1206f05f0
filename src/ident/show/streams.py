"""Gathered fits, many logs one by one, snapshots, alarms and monitors as text and HTML."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from ident.diagnosis import Diagnosis
from ident.display import renders
from ident.show.fit import summary
from ident.show.html import Section
from ident.show.sheet import Sheet
from ident.streams.diagnose_each import Verdicts
from ident.streams.gather import Gathered
from ident.streams.many_logs import RATE, Disagreement, LogComparison
from ident.streams.monitor import Alarm, Cause, Monitor, ParameterChange
from ident.streams.online import Forces, Snapshot
from ident.text import percent, rounded, some

NAMED = 6  # logs in a sentence; more are counted
SHOWN = 6  # parameters in one line
POOR = 0.05  # of the torque: a model that leaves more hides differences between logs
MOSTLY = 0.9  # of a log's difference, that a part must explain to be named
TINY = 1e-12  # a smaller chance is printed as this
BLIND = 10.0  # times a change: a standard error beyond which it is not printed


# --- many logs -----------------------------------------------------------------------------------


@renders(LogComparison, "sentence")
def who_disagrees(x: LogComparison) -> str:
    """Return how many logs disagree, and at which rate logs that are alike would."""
    own = [each.own for each in x.used if each.own is not None]
    typical = float(np.median(own)) if own else 0.0
    if not x.odd and typical > POOR:
        return (
            f"no log disagrees with the others by more than what the model leaves in each, "
            f"{percent(typical)}, and that is much: see what it lacks first (ident diagnose)"
        )
    names = some(x.odd, NAMED) if x.odd else "no log"
    whom = "each other" if len(x.used) == len(x.odd) == 2 else "the others"
    return (
        f"{names} {'disagree' if len(x.odd) > 1 else 'disagrees'} with {whom}; of 100 folders of "
        f"logs that are alike, {100 * RATE:g} or fewer would have one that seems to"
    )


def log_rows(x: LogComparison) -> list[list[str]]:
    """Return one row a log, the head first."""
    rows = [["log", "samples", "error", "own fit", "chance", "differs in"]]
    for each in x.logs:
        if each.left_out:
            rows.append([each.log, "–", "–", "–", "–", "left out"])
            continue
        odd = each.disagreement
        p = None if odd is None else odd.p_value
        chance = "–" if p is None else f"< {TINY:.0e}" if p < TINY else f"{p:.2g}"
        what = _difference(odd) if odd is not None and odd.clear else ""
        errors = percent(each.error), percent(each.own)
        rows.append([each.log, str(each.samples), *errors, chance, what])
    return rows


def _difference(odd: Disagreement) -> str:
    share = f"{100 * odd.share:.0f} %"
    if odd.share < MOSTLY:
        return f"no part of the model alone: {odd.parts[0]} explains {share}" if odd.parts else ""
    change = f"{'+' if odd.change > 0 else ''}{rounded(odd.change, odd.stderr)} {odd.unit}"
    several = "each of " if len(odd.parts) > 1 else ""
    return f"{odd.unknown} by {change}; {several}{', '.join(odd.parts)} explains {share}"


@renders(LogComparison, "sheet")
def log_sheet(x: LogComparison) -> Sheet:
    """Return the table, and who disagrees."""
    head = "log by log; chance: that a log like the others looks as odd"
    return Sheet(head, tables={"logs": log_rows(x)}, lines=[who_disagrees(x)], notes=x.notes)


@renders(LogComparison, "section")
def log_section(x: LogComparison) -> Section:
    """Return the table, and below it who disagrees."""
    return Section("Log by log", log_sheet(x).blocks())


@renders(Gathered, "summary")
def gathered_summary(x: Gathered) -> str:
    """Return the summary of the fit and, of several logs, the logs one by one."""
    return f"{summary(x.fit)}\n\n{log_sheet(x.each).summary()}" if x.several else summary(x.fit)


@renders(Gathered, "text")
def gathered_text(x: Gathered) -> str:
    """Return the summary and the notes."""
    return "\n".join([gathered_summary(x), *(f"note: {note}" for note in x.notes)])


# --- many diagnoses ------------------------------------------------------------------------------


def verdict_rows(x: Verdicts) -> list[list[str]]:
    """Return one row a log, the head first."""
    rows = [["log", "samples", "verdict", "of", "error", "with it"]]
    for each in x.logs:
        if each.left_out:
            rows.append([each.log, "–", "left out", "", "", ""])
            continue
        verdict = each.verdict + (f": {' or '.join(each.named)}" if each.named else "")
        errors = (percent(each.error_before), percent(each.error_after)) if each.named else ("", "")
        rows.append([each.log, str(each.samples), verdict, each.joint, *errors])
    return rows


def _each_sheet(x: Verdicts) -> Sheet:
    return Sheet("each log by itself", tables={"logs": verdict_rows(x)}, notes=x.notes)


@renders(Verdicts, "text")
def verdicts_text(x: Verdicts, together: Callable[[Diagnosis], str] = str) -> str:
    """Return each log's verdict, and the diagnosis of all logs together."""
    return f"{_each_sheet(x).summary()}\n\nall logs together\n{together(x.together)}"


@renders(Verdicts, "short")
def verdicts_short(x: Verdicts) -> str:
    """Return the same with what to read first of all logs together."""
    return verdicts_text(x, lambda d: d.short)


@renders(Verdicts, "section")
def verdicts_section(x: Verdicts) -> Section:
    """Return the section of a report."""
    return Section("Log by log", _each_sheet(x).blocks())


@renders(Verdicts, "html")
def verdicts_html(x: Verdicts) -> str:
    """Return the tables, and the diagnosis of all logs together."""
    return _each_sheet(x).html() + x.together._repr_html_()


# --- online --------------------------------------------------------------------------------------


@renders(Forces, "text")
def forces_text(x: Forces) -> str:
    """Return the multipliers of the last sample."""
    if not len(x):
        return "no multipliers"
    each = zip(x.names, x.values[-1], x.stderr[-1], x.units, strict=True)
    parts = [f"{name} = {rounded(v, error)} {unit}" for name, v, error, unit in each if v == v]
    return ", ".join(parts) or "no multiplier is determined"


@renders(Snapshot, "line")
def snapshot_line(x: Snapshot) -> str:
    """Return what is identified, the multipliers and the errors, in one line."""
    known = x.identified
    parts = [str(value) for value in known[:SHOWN]]
    parts += [f"… ({len(known) - SHOWN} more)"] if len(known) > SHOWN else []
    parts += [str(x.multipliers)] if x.multipliers is not None else []
    parts += [f"error of {name} {percent(e.relative)}" for name, e in x.errors.items()]
    return f"t = {x.t:.6g} s: {', '.join(parts)}; lag {1e3 * x.lag:.3g} ms"


@renders(Snapshot, "sheet")
def snapshot_sheet(x: Snapshot) -> Sheet:
    """Return tables of parameters and errors, and notes."""
    rows = [["parameter", "value", "prior", "unit", ""]]
    for v in x.identified:
        state = "held" if v.name in x.held else ""
        rows.append([v.name, rounded(v.value, v.stderr), f"{v.prior:.5g}", v.unit, state])
    errors = [["error", "all", "ahead", "rms", "unit"]]
    for name, e in x.errors.items():
        ahead = percent(x.ahead[name].relative if name in x.ahead else None)
        errors.append([name, percent(e.relative), ahead, f"{e.rms:.4g}", e.unit])
    title = (
        f"at t = {x.t:.6g} s: {x.samples} samples, {x.rows:.6g} equations a coordinate, "
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


@renders(Cause, "text")
def cause_text(x: Cause) -> str:
    """Return the cause and the changes of its parameters that are known."""
    known = [step for step in x.steps if step.stderr is not None]
    # what the motion does not determine by itself has an error without bound
    sure = [step for step in known if (step.stderr or 0.0) < BLIND * abs(step.change)]
    return f"{x.label}: {', '.join(map(str, sure or known or x.steps))}"


@renders(Alarm, "headline")
def headline(x: Alarm) -> str:
    """Return the alarm in one line."""
    since = f"since {x.onset:.2f} s"
    if not x.suspects or x.best is None:
        near = f"; nearest, but no explanation: {x.best.label}" if x.best else ""
        return f"{since} something has changed, cannot tell what{near}"
    if x.verdict == "named":
        return f"{since} changed: {x.best}"
    return f"{since} changed: one of {', '.join(x.suspects)}"


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
        "sure": f"at {x.detected:.2f} s by {x.seen_by}, evidence {x.evidence:.1f} of "
        f"{x.threshold:.1f}",
        "named": f"at {x.named:.2f} s",
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
        f"it did then; on normal running drawn again {x.calibration.alarms} where "
        f"{x.calibration.stated:g} were allowed",
        "watches": f"{kinds} (number of places)",
        "alarms": f"{len(x.alarms)}, evidence {x.evidence:.1f} of {x.threshold:.1f}",
    }
    return Sheet(title, facts=facts)
