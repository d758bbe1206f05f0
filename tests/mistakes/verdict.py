"""Judges what `ident` says of a case: error, finding, right answer, or silently wrong."""

from __future__ import annotations

import re
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from kinds import Mistake
from subjects import Case, positions_only

import ident
from ident import Fit, Mechanism
from ident.errors import IdentError

OFF = 6.0  # standard errors by which a base parameter may be off, …
MATTERS = 0.01  # … where that is so much of a joint's torque
CAUSES = {  # codes of findings that blame something
    "sign", "scale", "swapped", "delay", "position sign", "position scale", "position swapped",
    "magnitude", "gravity", "time", "axis", "another run", "wrench", "joints swapped",
}  # fmt: skip
WEAK = ("note ", "held ", "excitation ", "short runs ", "rest on priors ")
OUTCOMES = ("error", "named", "doubt", "right", "wrong name", "silent")


@dataclass(frozen=True)
class Verdict:
    """What was said of a case.

    Attributes:
        outcome: `error`; `named`, a finding points at the mistake; `doubt`, a finding says that
            the result is not to be trusted, without the cause; `right`, parameters within their
            errors; `wrong name`, something else is blamed; `silent`, wrong without a word.
        said: the findings that a clean log does not have.
        off: largest distance of a base parameter [standard errors] that matters.
    """

    outcome: str
    said: tuple[str, ...]
    off: float
    seconds: float


def written(case: Case, folder: Path) -> Path:
    """The case's log as a file."""
    folder.mkdir(parents=True, exist_ok=True)
    names = list(case.columns)
    table = np.column_stack([case.columns[n] for n in names])
    lines = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in table]
    file = folder / "run.csv"
    file.write_text("\n".join([",".join(names), *lines]) + "\n")
    return file


def fitted(case: Case, folder: Path) -> tuple[Mechanism, Fit]:
    """The fit of a case from its files, as the command makes it."""
    mechanism = case.subject.load(folder)
    return mechanism, ident.identify(mechanism, ident.complete(mechanism, written(case, folder)))


def sentences(fit: Fit) -> dict[str, str]:
    """What a fit says, by code and words without numbers."""
    found = {f"note {re.sub(r'[-+0-9.e]+', '#', x)}": x for x in fit.motion.notes}
    for each in fit.all_findings:
        if each.code != "note":
            found[f"{each.code} {' '.join(each.where)}"] = str(each)
    return found


def distance(case: Case, mechanism: Mechanism, fit: Fit) -> float:
    """The largest distance [standard errors] of a base parameter from the truth that matters."""
    base, x = fit.estimate.base, np.array([case.values.get(n, 0.0) for n in fit.columns.names])
    if not base.rank:
        return 0.0
    truth = x[base.independent] + base.K @ x[base.dependent]
    error = fit.estimate.solution.beta - truth
    totals = fit.information.totals
    size = np.array([
        np.linalg.norm(t.R[:, base.independent], axis=0) / max(t.rhs_norm(), 1e-300) for t in totals
    ]).max(axis=0)  # fmt: skip
    stderr = np.sqrt(np.diag(fit.covariance))
    off = np.abs(error) / np.maximum(stderr, 1e-300)
    return float(off[np.abs(error) * size > MATTERS].max(initial=0.0))


_USUAL: dict[tuple[str, bool], dict[str, str]] = {}


def usual_of(case: Case, mistake: Mistake, folder: Path) -> dict[str, str]:
    """What a clean log says."""
    key = case.subject.name, mistake.rates
    if key not in _USUAL:
        _USUAL[key] = sentences(fitted(case if mistake.rates else positions_only(case), folder)[1])
    return _USUAL[key]


def judge(case: Case, mistake: Mistake, folder: Path) -> Verdict:
    """Make the mistake, and read what `ident` says of it."""
    start = time.perf_counter()
    known = usual_of(case, mistake, folder / case.subject.name / "clean")
    wrong = mistake.of(case)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            mechanism, fit = fitted(wrong, folder / case.subject.name / "wrong")
        except IdentError as error:
            return Verdict("error", (str(error),), np.inf, time.perf_counter() - start)
        new = {key: text for key, text in sentences(fit).items() if key not in known}
    named = [  # a poor fit or a torque of another shape lists what to check, and names nothing
        text for key, text in new.items()
        if re.search(mistake.names, text) and not key.startswith(("poor fit", "unlike"))
    ]  # fmt: skip
    blamed = [key for key in new if any(key.startswith(f"{code} ") for code in CAUSES)]
    doubt = [key for key in new if not key.startswith(WEAK)]
    off = distance(wrong, mechanism, fit)
    if blamed and not named:
        outcome = "wrong name"
    elif off < OFF and not doubt:
        outcome = "right"
    elif named:
        outcome = "named"
    elif doubt:
        outcome = "doubt"
    else:
        outcome = "right" if off < OFF else "silent"
    return Verdict(outcome, tuple(new.values()), off, time.perf_counter() - start)
