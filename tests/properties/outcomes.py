"""What becomes of a mutant, in the library and in a command; what must never become of one.

error      one line that names what is wrong
finding    a warning or note that the base has not
same       every parameter within six standard errors, or two per cent, of the base's
changed    other values that the data themselves cannot tell from true ones
traceback, slow, absurd      faults
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
from bases import Base, base
from mutants import MODELS, MUTANTS, drawn_model

import ident
from ident import Fit, IdentError
from ident.cli.app import main
from ident.fit.residual import residual_of

LIMIT = 20.0  # s of a processor, beyond which a mutant hangs
WAIT = 120  # s that are waited for it on a busy machine
APART = 0.2  # share of the commands that run in a process of their own
USELESS = 0.5  # relative error, held out, that must not be there without a finding
ABSURD = 1e3  # times the base's value, its prior or its error: no value without a finding
FAULTS = ("traceback", "slow", "absurd")
OUTCOMES = ("error", "finding", "same", "changed", *FAULTS)


@dataclass(frozen=True)
class Outcome:
    kind: str  # of the mutant
    what: str  # was done, in words
    verdict: str
    detail: str
    seconds: float


class Hung(BaseException):
    """More than WAIT seconds."""


def outcome_in_library(name: str, kind: str, seed: int, place: Path) -> Outcome:
    """Change a copy of a base at random, and let the library have it."""
    name = "four_bar" if kind == "mjcf" else name  # which is drawn in this format
    own, random = base(name, place), Random(seed)
    return _timed(name, kind, seed, lambda folder: _library(own, kind, random, folder), own)


def outcome_of_command(name: str, kind: str, seed: int, place: Path) -> Outcome:
    """The same for the command, in a process of its own."""
    name = "four_bar" if kind == "mjcf" else name
    own, random = base(name, place), Random(seed)
    return _timed(name, kind, seed, lambda folder: _command(own, kind, random, folder), own)


def _timed(name: str, kind: str, seed: int, run, own: Base) -> Outcome:
    with tempfile.TemporaryDirectory() as scrap:
        folder = Path(scrap) / name
        shutil.copytree(own.folder, folder)
        start = _processor_time()
        what, verdict, detail = run(folder)
        seconds = _processor_time() - start
    where = f"{name}/{kind} seed {seed}: {what}"
    return Outcome(kind, where, "slow" if seconds > LIMIT else verdict, detail, seconds)


def _processor_time() -> float:
    """Seconds of this process and of those that it waited for: others may use the machine too."""
    every = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in every)


# --- the library ---------------------------------------------------------------------------------


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    def hung(*_: object) -> None:
        raise Hung

    before = signal.signal(signal.SIGALRM, hung)
    signal.alarm(WAIT)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _library(own: Base, kind: str, random: Random, folder: Path) -> tuple[str, str, str]:
    if kind == "checkpoint":
        _interrupt(own, folder)
    what = MUTANTS[kind](random, folder)
    verb = _verb(kind, random)
    what += f" ({verb})"
    try:
        with _alarm(), warnings.catch_warnings():
            warnings.simplefilter("error")  # a warning of NumPy is a fault too
            return what, *_judged(own, kind, verb, random, folder)
    except IdentError as error:
        line = str(error)
        if len(line.splitlines()) != 1 or not line:
            return what, "traceback", f"a message of several lines: {line!r}"
        return what, "error", line
    except Hung:
        return what, "slow", f"more than {WAIT} s"
    except Exception as error:
        at = error.__traceback__
        while at is not None and at.tb_next is not None:
            at = at.tb_next
        place = f"{at.tb_frame.f_code.co_filename}:{at.tb_lineno}" if at else ""
        return what, "traceback", f"{type(error).__name__} in {place}: {error}"


def _verb(kind: str, random: Random) -> str:
    if kind == "fit.json":
        return "compare"
    if kind == "checkpoint":
        return "gather"
    if kind == "identified":
        return random.choice(("identify", "simulate"))
    verbs = ("identify",) * 14 + ("residual",) * 3 + ("gather", "online", "diagnose", "simulate")
    return random.choice(verbs)


def _log(folder: Path) -> Path:
    return next(folder.glob("run.*"))


def _interrupt(own: Base, folder: Path) -> None:
    """Leave a checkpoint behind."""
    from ident.streams import portions
    from ident.streams.portions import NAME, Checkpoint

    out, kept = folder / "out", Checkpoint.remove
    Checkpoint.remove = lambda self: None  # type: ignore[method-assign]
    often = portions.PORTIONS, portions.SECONDS
    portions.PORTIONS, portions.SECONDS = 0, 0.0
    try:
        ident.gather(ident.load(folder), folder / "run.csv", samples=128, checkpoint=out)
    finally:
        Checkpoint.remove = kept  # type: ignore[method-assign]
        portions.PORTIONS, portions.SECONDS = often
    assert (out / NAME).exists()


def _judged(own: Base, kind: str, verb: str, random: Random, folder: Path) -> tuple[str, str]:
    mechanism = ident.load(folder / MODELS.get(kind, ""))
    if kind == "code":
        effect = ident.read_user_effect(folder / "mine.py", "bump", allow_code=True)
        mechanism = mechanism + effect((mechanism.driven[0],))
    if verb == "compare":
        saved = ident.read_fit(folder / "fit.json", mechanism)
        compared = ident.compare(saved, motion=own.fit.motion)
        return ("same", "") if "nan" not in str(compared) else ("absurd", "nan in the table")
    if verb == "simulate":
        log, _ = ident.simulate(mechanism, ident.read_log(_log(folder), mechanism.columns))
        values = np.concatenate([x for x in log.columns.values()])
        return ("same", "") if np.isfinite(values).all() else ("absurd", "not finite")
    if verb == "gather":
        gathered = ident.gather(
            mechanism,
            _log(folder),
            samples=128,
            checkpoint=folder / "out" if kind == "checkpoint" else None,
        )
        return judged(own, kind, gathered.fit, gathered.fit.warnings)
    if verb == "online":
        log = ident.read_log(_log(folder), mechanism.columns)
        online = ident.Online(mechanism, warmup=1.5)
        for i in range(0, len(log.t), 50):
            part = slice(i, i + 50)
            online.update({"t": log.t[part], **{k: x[part] for k, x in log.columns.items()}})
        lines = str(online.snapshot()).splitlines()  # a note quotes a cell of the log
        absurd = [line for line in lines if "nan" in line and not line.startswith("note: ")]
        return ("absurd", absurd[0]) if absurd else ("same", "")
    options = _options(random) if kind == "options" else {}
    motion = ident.complete(mechanism, ident.read_log(_log(folder), mechanism.columns), **options)
    consistent = random.random() < 0.05
    fit = ident.identify(mechanism, motion, consistent=consistent)
    str(fit)
    if verb == "residual":
        str(residual_of(fit))
        assert residual_of(fit).where is not None
    if verb == "diagnose":
        str(ident.diagnose(fit))
    if consistent or options:
        return judged(own, kind, fit, [*fit.warnings, "an option"])
    return judged(own, kind, fit, fit.warnings)


def _options(random: Random) -> dict[str, object]:
    number = random.choice((-1.0, 0.0, 1e-9, 0.01, 0.5, 5.0, 40.0, 1e9, float("nan"), float("inf")))
    return {random.choice(("cutoff", "smoothing")): random.choice((number, None, "auto", "x"))}


@cache
def usual(own: Base, kind: str) -> frozenset[str]:
    """What is said of a base that is not changed."""
    said = own.fit.warnings
    if kind in MODELS:
        with tempfile.TemporaryDirectory() as scrap:
            folder = Path(scrap) / own.name
            shutil.copytree(own.folder, folder)
            if kind != "identified":
                drawn_model(kind, folder)
            mechanism = ident.load(folder / MODELS[kind])
            fit = ident.identify(mechanism, ident.complete(mechanism, own.log))
            said += (*fit.warnings, *mechanism.notes)
    return frozenset(map(_bare, said))


def judged(own: Base, kind: str, fit: Fit, said: Iterable[str]) -> tuple[str, str]:
    """Return the verdict on a fit, and why."""
    new = {_bare(each) for each in said} - usual(own, kind)
    before = {value.name: value for value in own.fit.parameters}
    off = ""
    for value in fit.parameters:
        reference = before.get(value.name)
        if not np.isfinite(value.value) or (value.identifiable and not value.stderr >= 0):
            return "absurd", f"{value.name} = {value.value} ± {value.stderr}"
        if reference is None or not (value.identifiable and reference.identifiable):
            continue
        error = float(np.hypot(value.stderr, reference.stderr))
        distance = abs(value.value - reference.value)
        size = max(abs(reference.value), abs(reference.prior or 0.0), reference.stderr)
        if distance > ABSURD * size and distance > 6 * error and not new:
            return "absurd", f"{value.name} = {value.value:.4g}, was {reference.value:.4g}"
        if distance > max(6 * error, 0.02 * abs(reference.value)):
            off = (
                f"{value.name} = {value.value:.4g} ± {value.stderr:.2g}, was {reference.value:.4g}"
            )
    for joint, each in fit.held_out.items():
        if each.relative is not None and not each.relative < USELESS and not new:
            return "absurd", f"held-out error of {joint}: {each.relative}"
    if new:
        return "finding", sorted(new)[0]
    return ("changed", off) if off else ("same", "")


def _bare(line: str) -> str:
    """A message without numbers."""
    return re.sub(r"[-+]?\d[\d.,e+-]*", "#", line)


# --- the command ---------------------------------------------------------------------------------


def _apart(words: list[str]) -> tuple[int, str, str]:
    """Status, standard output and standard error of `ident WORDS` in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "ident", *words], capture_output=True, text=True, timeout=WAIT,
        errors="replace", check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def _here(words: list[str]) -> tuple[int, str, str]:
    """The same in this process, without the second that imports take."""
    output, errors, before, status = io.StringIO(), io.StringIO(), sys.argv, 0
    sys.argv = ["ident", *words]
    try:
        with (
            _alarm(), warnings.catch_warnings(),
            contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors),
        ):  # fmt: skip
            warnings.simplefilter("always")
            main()
    except SystemExit as stop:
        status = int(stop.code or 0)
    except Exception:
        return 70, output.getvalue(), traceback.format_exc()
    finally:
        sys.argv = before
    return status, output.getvalue(), errors.getvalue()


def _command(own: Base, kind: str, random: Random, folder: Path) -> tuple[str, str, str]:
    if kind == "checkpoint":
        _interrupt(own, folder)
    what = MUTANTS[kind](random, folder)
    log, fit = str(_log(folder)), str(folder / "fit.json")
    folder, where = folder / MODELS.get(kind, ""), folder
    verbs: list[list[str]] = [
        ["identify", str(folder), log],
        ["identify", str(folder), log, "--out", str(where / "new")],
        ["check", str(folder), log],
        ["compare", str(folder), log, "--fit", fit],
        ["simulate", str(folder), log, "--out", str(where / "made.csv")],
        ["identify", str(folder), log, "--stream", "--out", str(where / "out")],
        ["diagnose", str(folder), log],
        ["monitor", str(folder), log, "--every", "1"],
        ["view", str(folder), log, "--out", str(where / "view.html")],
    ]
    verb = verbs[3] if kind == "fit.json" else verbs[5] if kind == "checkpoint" else (
        random.choice(verbs)
    )  # fmt: skip
    if kind == "options":
        more = ("--cutoff", "--smoothing", "--spacing", "--basis", "--with", "--bound", "--lock",
                "--total-mass", "--every", "--noise", "--set", "--out", "--seed")  # fmt: skip
        texts = ("-1", "0", "nan", "1e9", "abc", "", "viscous:nobody", "auto", "tau=1%", "x=1:0",
                 "/dev/null", "linear", "..", "inf")  # fmt: skip
        verb = [*verb, random.choice(more), random.choice(texts)]
    if kind == "code":
        verb = ["identify", str(folder), log, "--allow-code", "--with",
                f"{where / 'mine.py'}:bump:{own.mechanism.driven[0]}"]  # fmt: skip
    what += " (" + " ".join(Path(word).name for word in verb) + ")"
    try:
        status, output, errors = (_apart if random.random() < APART else _here)(verb)
    except (subprocess.TimeoutExpired, Hung):
        return what, "slow", f"more than {WAIT} s"
    if "Traceback" in errors or "a fault of ident" in errors or "Warning:" in errors:
        return what, "traceback", errors.strip()[-400:]
    if status not in (0, 1, 2):
        return what, "traceback", f"status {status}: {errors[-300:]}"
    if status:
        lines = [line for line in errors.splitlines() if line.startswith("error: ")]
        if status == 1 and len(lines) != 1:
            return what, "traceback", f"no line of an error: {errors[-300:]}"
        return what, "error", (lines or [errors.strip()[-200:]])[0]
    if re.search(r"(?<![\w.])(nan|inf)(?![\w.])", output):
        return what, "absurd", re.findall(r".*(?<![\w.])(?:nan|inf)(?![\w.]).*", output)[0]
    new = {_bare(line) for line in errors.splitlines() if line.startswith("note: ")} - {
        "note: " + each for each in usual(own, kind)
    }
    if verb[0] == "identify" and (where / "new" / "fit.json").exists():
        written = json.loads((where / "new" / "fit.json").read_text())
        if any(value["value"] is None for value in written["parameters"]):
            return what, "absurd", "fit.json holds numbers that are not finite"
    return what, "finding" if new else "same", sorted(new)[0] if new else ""
