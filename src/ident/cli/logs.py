"""Commands on logs: `check`, `identify`, `compare`, `diagnose`, `grow` and `explore`."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ident.cli.app import conclude, go_on_by_resuming, notes, progress, result, wrote
from ident.cli.lines import ShellRequest, partly_done
from ident.cli.options import (
    CHARTS,
    DIAGNOSIS_FILES,
    FIT_FILES,
    Cutoff,
    DecisionOptions,
    FitOptions,
    GoodEnough,
    Jobs,
    Json,
    LogPaths,
    MotionOptions,
    Paths,
    Plot,
    Scheduler,
    Texts,
    argument,
    flag,
    interval,
    many,
    named,
    option,
    output_file,
    output_folder,
    read_logs,
    setting,
)
from ident.display import Progress, part
from ident.errors import FitError, IdentError, one_of
from ident.files import write_all
from ident.request import Step

if TYPE_CHECKING:
    from ident.diagnosis import Diagnosis
    from ident.diagnosis.grow import Step as Rung
    from ident.fit import Fit
    from ident.information.blocks import Error
    from ident.mechanism import Mechanism
    from ident.streams.gather import Gathered
    from ident.streams.many_logs import Verdicts

    ErrorsAndNoise = tuple[Mapping[str, Error], Mapping[str, float]]  # errors and noise by joint

MOST_IN_MEMORY = 1_000_000  # work: samples of all logs that are read at once
MOST_SHOWN = 6  # shown: logs in one command
Verbose = Annotated[bool, option("All candidates, and all reasons.", None, "--verbose")]


def check(
    model: FitOptions,
    logs: Paths = argument("Logs to be checked.", "LOG", default=None),
    verbose: Verbose = False,
    json: Json = False,
    write: Path | None = setting("Write mechanism.toml and URDF of what was understood.", "DIR"),
) -> None:
    """Show what was understood, and what could be identified.

    Joints, closures, degrees of freedom; of logs their columns, and what looks wrong in them. With
    --verbose also what smoothing left of each channel, and base parameters.
    """
    from ident.assess.check import check_logs
    from ident.show.motion import check_json, check_text

    mechanism = model.load(logs)
    motion = None
    if write is not None:
        from ident.mechanism.write import understood_files

        contents = understood_files(mechanism)
        output_folder(write, [*contents], [model.mechanism, mechanism.urdf, mechanism.toml])
        wrote(write_all(write, contents))
    with progress() as on_progress:
        if logs:
            try:
                motion = model.motion(mechanism, logs, on_progress, torques=False)
            except IdentError:
                _suggest_columns(mechanism, logs[0])
                raise
        log_check = check_logs(mechanism, motion)
        if json:
            conclude(check_json(log_check, mechanism, motion))
        else:
            request = model.request(logs)
            conclude(check_text(log_check, mechanism, motion, request, verbose=verbose))


def _suggest_columns(mechanism: Mechanism, path: Path) -> None:
    """Write the entries of [log] that the names of a log's columns suggest, if it has other ones
    than the mechanism's.
    """
    from ident.log.mapping import suggested_entries
    from ident.log.read import log_file

    if not path.is_file():
        return
    with suppress(IdentError):
        taken = {source.column for source in mechanism.columns.values()}
        columns = [name for name in log_file(path, None).table().columns if name not in taken]
        columns += mechanism.columns
        joints = [mechanism.joint(name).name for name in mechanism.driven]
        if not mechanism.closures:
            joints = [joint.name for joint in mechanism.joints]
        if lines := suggested_entries(columns, joints, mechanism.measured):
            place = mechanism.toml or mechanism.urdf.with_name("mechanism.toml")
            head = [] if mechanism.toml else [f'urdf = "{mechanism.urdf.name}"', ""]
            result(f"{path.name} has other names; in {place}, if the order is right:\n")
            result("\n".join([*head, *lines]) + "\n")


def identify(
    model: FitOptions,
    logs: LogPaths,
    validate: Paths = setting("Report errors on this log; nothing is fitted to it.", "LOG"),
    reactions: Path | None = setting("Known reactions to compare the multipliers with.", "LOG"),
    consistent: bool = flag("Only bodies, friction and stiffness that can exist.", "--consistent"),
    bound: Texts = setting("Keep a parameter there; implies --consistent.", "NAME=LOW:HIGH"),
    total_mass: float | None = setting("Mass of all moving bodies; implies --consistent.", "KG"),
    refine: bool = flag("Iterate the likelihood of motion and torques.", "--refine"),
    stream: bool = flag(
        "Read logs in portions, as those of a million samples are anyway. With --out, a run that "
        "was interrupted goes on.",
        "--stream",
    ),
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    good_enough: GoodEnough = None,
    verbose: Verbose = False,
    json: Json = False,
    out: Path | None = setting("Write fit, report and identified model into this folder.", "DIR"),
) -> None:
    """Identify parameters, effects and multipliers from logs.

    Values come with their standard errors, and with the error of the torque that they predict. With
    a folder, every log is also compared with the others, and invalid ones are left out. Where
    MECHANISM is the folder of an earlier fit, what has changed since is named first; both are then
    filtered alike, unless --cutoff is given.
    """
    from ident.log.read import expanded, likely_rows
    from ident.mechanism import Consistency

    of_fit = ["--consistent"] * consistent + ["--refine"] * refine + ["--stream"] * stream
    of_fit += [word for limit in bound or () for word in ("--bound", limit)]
    of_fit += [] if total_mass is None else ["--total-mass", f"{total_mass:g}"]
    request = model.request(
        logs, out=out, good_enough=good_enough, validate=validate, of_fit=of_fit
    )
    mechanism = model.load(logs)
    remedy = (
        "is no bound; write NAME=LOW:HIGH, such as rod.m=0.4:0.6, or one of the two, rod.m=0.4:"
    )
    bounds = named(bound, "--bound", remedy, interval)
    limits = Consistency(bounds, total_mass) if bound or total_mass is not None else consistent
    model, since = model.as_fitted(mechanism)
    since = None if model.mechanism.name == "identified" else since
    used = [model.mechanism, *logs, *(validate or ()), reactions]
    output_folder(out, [*FIT_FILES, "logs.csv"], used)
    long = sum(map(likely_rows, logs)) > MOST_IN_MEMORY
    gathered: Gathered | None = None
    if model.poses and stream:
        raise IdentError("--poses: rows have no order to be read in portions in; omit --stream")
    if (stream or long or many(logs, jobs, scheduler)) and not model.poses:
        from ident.streams.gather import gather

        if refine:
            raise IdentError(
                "--refine: needs all samples at once; leave it out, or identify from one shorter "
                "log without --stream, --jobs and --scheduler"
            )
        if long and not stream:
            notes([f"more than {MOST_IN_MEMORY} samples: read in portions (--stream)"])
        with progress() as on_progress:
            gathered = gather(
                mechanism,
                logs,
                **model.treatment,
                validate=validate or (),
                consistent=limits,
                checkpoint=out,
                scheduler=scheduler,
                jobs=1 if jobs is None and len(expanded(logs)) == 1 else jobs,
                progress=on_progress,
            )
        fit = gathered.fit
    else:
        from ident.fit.identify import identify as identify_

        with progress() as on_progress:
            motion = model.motion(mechanism, logs, part(on_progress, 0.0, 0.2))
            treatment, show = model.filtered_at(motion.band.cutoff), part(on_progress, 0.2, 0.3)
            fit = identify_(
                mechanism,
                motion,
                consistent=limits,
                validate=treatment.motion(mechanism, validate, show) if validate else None,
                estimator="likelihood" if refine else "auto",
                progress=part(on_progress, 0.3, 1.0),
            )
    fit = fit if since is None else fit.since(since)
    gathered = gathered and replace(gathered, fit=fit)
    _show(fit, gathered, reactions, request, json=json, verbose=verbose)
    if good_enough is not None:
        sets: dict[str, ErrorsAndNoise] = {"": (fit.held_out or fit.train, fit.noise)}
        sets |= {f" of {log}": (e, fit.noise_on(log)) for log, e in fit.validation.items()}
        _judge(sets, good_enough)


def _judge(sets: Mapping[str, ErrorsAndNoise], percent: float) -> None:
    """End with status 3 where an error is above a threshold of one's own and above noise."""
    from ident.assess.errors import too_large

    above = {of: too_large(*pair, percent / 100) for of, pair in sets.items()}
    if loud := [f"{', '.join(joints)}{of}" for of, joints in above.items() if joints]:
        notes([f"status 3: {'; '.join(loud)} above --good-enough {percent:g} %"])
        sys.exit(3)


def _show(
    fit: Fit,
    gathered: Gathered | None,
    reactions: Path | None,
    request: ShellRequest,
    *,
    json: bool,
    verbose: bool,
) -> None:
    from ident.fit.files import fit_json, write_fit
    from ident.log import read_log
    from ident.show.fit import summary

    known = None if reactions is None else fit.compare_multipliers(read_log(reactions))
    written: list[Path] = []
    if out := request.folder:
        written = (
            gathered.write(out, known, request)
            if gathered
            else write_fit(fit, out, known, request=request)
        )
    outcome: object = ""
    if json:
        outcome = fit_json(fit)
    else:
        if gathered:
            from ident.show.streams import gathered_summary  # slow to import

            outcome = gathered_summary(gathered, request)
        else:
            outcome = summary(fit, request)
        outcome = f"{outcome}\n\n{known}" if known else outcome
    remarks = [*(gathered.notes if gathered else fit.warnings)]
    with suppress(IdentError):
        remarks += [str(fit.unexcited)] if fit.unexcited else []
    conclude(outcome, written, remarks, verbose=verbose)


@dataclass(frozen=True)
class ComparedOptions(MotionOptions):
    """The mechanism, and the treatment of logs, by default that of the fit."""

    cutoff: Cutoff = "fit"


def compare(
    model: ComparedOptions,
    logs: LogPaths,
    fit: list[Path] = setting("A fit; give several to compare them.", "FIT.json", default=...),
    plot: Plot = None,
    good_enough: GoodEnough = None,
    verbose: Verbose = False,
    json: Json = False,
    out: Path | None = setting("Write report.html and compare.json into this folder.", "DIR"),
    simulated: bool = flag(
        "Integrate the motion too; --plot draws it, --out adds it to the report.", "--simulate"
    ),
    window: float | None = setting("Time between the restarts of --simulate. Default: 0.5", "S"),
) -> None:
    """Compare models with measurements, joint by joint.

    Errors, the parts of the sum, and where each model fails: in which joint, when, and on
    which signals what is left depends.
    """
    from ident.assess.comparison import errors_that_count
    from ident.files import write_all
    from ident.fit.files import read_fit
    from ident.fit.identify import compare as compare_
    from ident.show.comparison import comparison_files, comparison_json, comparison_sheet

    request = model.request(logs, out=out, good_enough=good_enough)
    if window is not None and not simulated:
        raise IdentError("--window: applies to --simulate only; add that")
    mechanism = model.load(logs)
    saved = [read_fit(path, mechanism, allow_code=model.allow_code) for path in fit]
    request = _go_on_with(request, mechanism, saved[-1].mechanism, fit)
    output_file(plot, CHARTS, [*logs, *fit])
    output_folder(out, ("report.html", "compare.json"), [*logs, *fit])
    replayed = None
    with progress() as on_progress:
        if model.cutoff == "fit":
            model = model.filtered_at(saved[0].cutoff)
        end = 0.4 if simulated else 1.0
        motion = model.motion(mechanism, logs, part(on_progress, 0.0, 0.2))
        comparison = compare_(*saved, motion=motion, progress=part(on_progress, 0.2, end))
        if simulated:
            from ident.simulate.replay import WINDOW, replay

            show = part(on_progress, end, 1.0)
            replayed = replay(*saved, motion=motion, window=window or WINDOW, progress=show)
    written: list[Path] = []
    if plot is not None:
        (replayed or comparison).plot().save(plot)
        written.append(plot)
    if out is not None:
        written += write_all(out, comparison_files(comparison, replayed, request))
    outcome: object = comparison_json(comparison, replayed)
    if not json:
        texts = [
            comparison_sheet(comparison, request).text(),
            *([str(replayed)] if replayed else []),
        ]
        outcome = "\n\n".join(texts)
    conclude(outcome, written, motion.notes, verbose=verbose)
    if good_enough is not None:
        residual = [*comparison.residuals.values()][-1]
        floor = residual.noise
        _judge({"": (errors_that_count(comparison, residual.name)[1], floor)}, good_enough)


def _go_on_with(
    request: ShellRequest, given: Mechanism, fitted: Mechanism, fits: Sequence[Path]
) -> ShellRequest:
    """Return the request with the effects of a fit, a kind of all drives by its name alone; without
    a mechanism, so that nothing is offered, where options cannot describe the model.
    """
    from ident.effects import KINDS
    from ident.mechanism.load import has_identified

    labels = {effect.label for effect in given.effects}
    extra = {effect.label: effect.kind for effect in fitted.effects if effect.label not in labels}
    if fitted.locked != given.locked or not KINDS.keys() >= {*extra.values()}:
        return replace(request, mechanism="")
    whole_kinds = {k for k in extra.values() if all(f"{k}:{j}" in extra for j in fitted.driven)}
    drives = {f"{kind}:{joint}" for kind in whole_kinds for joint in fitted.driven}
    names = dict.fromkeys(kind if label in drives else label for label, kind in extra.items())
    words = [word for name in names for word in ("--with", name)]
    home = fits[0] if fits[0].is_dir() else fits[0].parent
    known = str(home) * (len(fits) == 1 and has_identified(home))
    return replace(request, options=(*words, *request.options), fit=known)


def diagnose(
    model: FitOptions,
    logs: LogPaths,
    rule: DecisionOptions,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    fail_on: Texts = setting("End with status 3 where this is the verdict.", "VERDICT"),
    verbose: Verbose = False,
    json: Json = False,
    out: Path | None = setting("Write diagnosis.json, report.html, laws and curves there.", "DIR"),
) -> None:
    """Find where the model fails, and which effect is missing.

    Every effect of the library at every place is judged by errors held out in time. The verdict is
    missing, unexplained, undecided or nothing; the exit status is 0 for each of them, unless
    --fail-on names it. With a folder, each log is also diagnosed by itself, on many processes or
    machines; --fail-on then looks at every log and at all of them together.
    """
    from ident.assess.experiment import next_experiment
    from ident.diagnosis import Diagnosis
    from ident.diagnosis.diagnosis import VERDICTS
    from ident.display import render

    for name in fail_on or ():
        if name not in VERDICTS:
            raise typer.BadParameter(f"--fail-on {name}: is no verdict; {one_of(name, VERDICTS)}")
    decision = rule.given
    request = model.request(logs, out=out)
    mechanism = model.load(logs)
    model, since = model.as_fitted(mechanism)
    output_folder(out, [*DIAGNOSIS_FILES, "logs.csv"], logs)
    outcome: Diagnosis | Verdicts
    shown: object
    with progress() as on_progress:
        if many(logs, jobs, scheduler) and not model.poses:
            from ident.files import write_all
            from ident.streams.many_logs import Verdict, diagnose_each, table_of

            done: list[Verdict] = []
            try:
                outcome = diagnose_each(
                    mechanism, logs, jobs=jobs, scheduler=scheduler, done=done,
                    progress=on_progress, **model.treatment, **decision,
                )  # fmt: skip
            except KeyboardInterrupt:
                if out is not None and done:
                    wrote(write_all(out, {"logs.csv": table_of(done).write_csv().encode()}))
                if done:
                    from ident.show.streams import partly
                    from ident.streams.logs import log_paths

                    rest = log_paths(logs, scheduler)[len(done) :]
                    count = f"{len(rest)} of {len(done) + len(rest)} logs are left"
                    how_on = "only the diagnosis of all logs together is missing"
                    if rest:
                        how_on = f"{count}; go on with: {partly_done(request, rest, MOST_SHOWN)}"
                    rows = table_of(done).to_dicts()
                    conclude({"each": rows} if json else partly(done), remarks=[how_on])
                raise
            remarks = outcome.notes
        else:
            from ident.diagnosis import diagnose as diagnose_
            from ident.fit import identify
            from ident.mechanism.load import has_identified

            motion = model.motion(mechanism, logs, part(on_progress, 0.0, 0.05))
            second, third = part(on_progress, 0.05, 0.1), part(on_progress, 0.1, 1.0)
            fit = identify(mechanism, motion, estimator="least-squares", progress=second)
            if model.mechanism.name == "identified" and since is not None:
                fit = fit.since(since)  # what it left in its own log
            try:
                outcome = diagnose_(fit, progress=third, **decision)
                remarks = outcome.notes
                if not model.lock and has_identified(model.mechanism):
                    from ident.show.comparison import fitted_anew

                    with suppress(FitError):  # only a note depends on it
                        anew = [fitted_anew(fit.since(since), request)] if since else []
                        remarks = (*anew, *remarks)
                on_progress("planning the next experiment", 1.0)
            except KeyboardInterrupt:  # the fit is done
                if out is not None:
                    from ident.fit.files import write_fit

                    wrote(write_fit(fit, out, request=request))
                    look = request.line(Step("compare"))
                    notes([f"{out} has the fit that was diagnosed; where it fails: {look}"])
                raise
        written = [] if out is None else outcome.write(out, request)
        if json:
            shown = outcome.json()
        elif verbose and isinstance(outcome, Diagnosis):
            shown = render(outcome, "sheet", request=request).text()
        else:
            shown = render(outcome, "text" if verbose else "short", request=request)
    conclude(shown, written, remarks, verbose=verbose)
    unsearched = getattr(outcome, "unsearched", ())
    lost = [f"the laws of {', '.join(unsearched)}"] * bool(unsearched)
    if isinstance(outcome, Diagnosis):  # none of many logs
        lost += ["the next experiment"] * next_experiment(outcome).interrupted
    if lost:
        notes([f"interrupted before {' and '.join(lost)}; everything else is complete"])
        sys.exit(130)
    if bad := sorted(outcome.verdicts & set(fail_on or ())):
        notes([f"status 3, since --fail-on is {', '.join(bad)}"])
        sys.exit(3)


def grow(
    model: FitOptions,
    logs: LogPaths,
    rule: DecisionOptions,
    validate: Paths = setting("Show errors on this log too; nothing is fitted to it.", "LOG"),
    resume: bool = flag("Go on where an interrupted run with the same --out was.", "--resume"),
    verbose: Verbose = False,
    json: Json = False,
    out: Path | None = setting("Write the grown mechanism, its fit and its report there.", "DIR"),
) -> None:
    """Add the best effect, refit, and repeat until none is missing.

    Prints what was gained, and the ladder of held-out errors that leads there.
    """
    from ident.diagnosis import grow as grow_
    from ident.files import write_all
    from ident.show.ladder import details, model_files, refuse_own, rungs, short_of

    decision = rule.given
    steps: list[Rung] = []
    request = model.request(logs, out=out, validate=validate)
    mechanism = model.load(logs)
    if resume and out is None:
        raise IdentError("--resume: goes on in the folder of --out; give the one of that run")
    if out is not None:
        refuse_own(mechanism, out)
    output_folder(out, [*FIT_FILES, *DIAGNOSIS_FILES], [*logs, *(validate or ())])
    with progress() as on_progress:
        motion = model.motion(mechanism, logs, part(on_progress, 0.0, 0.04))
        treatment, show = model.filtered_at(motion.band.cutoff), part(on_progress, 0.04, 0.05)
        try:
            history = grow_(
                mechanism,
                motion,
                progress=part(on_progress, 0.05, 1.0),
                step=steps.append,
                checkpoint=out,
                resume=resume,
                validate=treatment.motion(mechanism, validate, show) if validate else None,
                **decision,
            )
            written = [] if out is None else history.write(out, request)
        except KeyboardInterrupt:
            fits = [step.fit for step in steps if step.fit]
            if steps and not json:
                result(rungs(steps, motion.independent))
            if out is not None and fits:
                wrote(write_all(out, model_files(fits[-1])))
                if not resume:
                    go_on_by_resuming()
            if out is None:
                notes(["with --out DIR a run that is interrupted keeps its rounds and can go on"])
            raise
    text = (details if verbose else short_of)(history, request)
    conclude(history.json() if json else text, written, history.fit.warnings, verbose=verbose)


def explore(
    model: FitOptions,
    logs: LogPaths,
    port: int = setting("Port of the page; 0 is a free one.", "N", default=0, min=0, max=65535),
    no_browser: bool = flag("Print the address and open no browser.", "--no-browser"),
    out: Path | None = setting("The page saves here and below, nowhere else.", "DIR"),
) -> None:
    """Add effects by hand, in a browser; watch the error fall.

    Serves a page on 127.0.0.1 until Ctrl-C, at the address that is printed. It lists every effect
    of the library with the fall of the held-out error that it would bring; a click adds it and
    refits everything.
    """
    from ident.show.local import Place, wait

    mechanism = model.load(logs)
    # a log that cannot be read has no page
    given, place = read_logs(mechanism, logs, model.poses or None), Place(port)
    result(f"{mechanism.name}: {place.address}")  # before what takes a second to import
    from ident.assess.exploration import Exploration
    from ident.show.board import Board

    board = Board(mechanism.name, out or f"{mechanism.name}_explored", model.request(logs, out=out))
    with board.serve(place) as address:
        if not no_browser:
            webbrowser.open(address)
        with progress() as on_progress:

            def first(page: Progress) -> Exploration:
                motion = model.motion(mechanism, given, part(page, 0.0, 0.6))
                return Exploration.of(mechanism, motion, part(page, 0.6, 1.0))

            board.begin(first, on_progress)
        assert board.exploration is not None
        notes([*board.exploration.fit.warnings, "the page is available until Ctrl-C"])
        with suppress(KeyboardInterrupt):
            wait()
