"""Commands of a model alone: `add`, `effects`, `view`, `simulate`, `excite`, `montecarlo`."""

from __future__ import annotations

import operator
import shlex
import sys
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ident.cli.app import command_line, conclude, notes, progress, result, wrote
from ident.cli.options import (
    CHARTS,
    LOGS,
    AllowCode,
    Jobs,
    MechanismPath,
    ModelOptions,
    MotionOptions,
    Paths,
    Plot,
    Scheduler,
    Seed,
    Texts,
    argument,
    finite,
    flag,
    interval,
    kinds_beginning,
    named,
    output_file,
    output_folder,
    setting,
    share,
    value,
    with_effect,
)
from ident.display import part
from ident.errors import IdentError, one_of


def add(
    mechanism: MechanismPath,
    effect: list[str] = argument(
        "One or several, as viscous:elbow, viscous for all driven joints, or "
        "file.py:function:elbow.",
        "EFFECT",
        default=...,
        autocompletion=kinds_beginning,
    ),
    allow_code: AllowCode = False,
) -> None:
    """Write effects into mechanism.toml.

    A bare URDF gets a mechanism.toml beside it.
    """
    from ident.mechanism import load
    from ident.mechanism.write import add_effects

    before = load(mechanism, allow_code=allow_code)
    after = before
    for x in effect:
        after = with_effect(after, x, allow_code=allow_code)
    new = [x for x in after.effects if x not in before.effects]
    path = add_effects(before, new)
    if before.toml is None:
        words = f"{mechanism} by itself stays as it is; the mechanism is now"
        notes([f"{words} {path}: ident diagnose {shlex.quote(str(path))} LOG"])
    labels, free = ([x.label for x in new], {x.label for x in before.effects})
    added = ", ".join(label for label in labels if label not in free)
    changes = [f"added {added}"] * bool(added)
    changes += [f"unknown again: {x}, which had a value" for x in labels if x in free]
    result(f"{path}: {'; '.join(changes)}")


def effects(
    kind: str | None = argument(
        "One of them, as viscous; else all.", "KIND", default=None, autocompletion=kinds_beginning
    ),
) -> None:
    """List the library of effects.

    Equation, unknowns and shapes with units, where an effect sits, and what a residual looks like
    when it is missing.
    """
    from ident.effects import KINDS, kind_of
    from ident.show.laws import described

    kinds = KINDS.values() if kind is None else [kind_of(kind)]
    result("\n\n".join(described(effect_class) for effect_class in kinds))


def view(
    model: MotionOptions,
    logs: Paths = argument("Without one the mechanism stands still.", "LOG", default=None),
    fit: Path | None = setting("Fit whose reactions and residuals are shown.", "FIT.json"),
    port: int = setting("Port of the page, on 127.0.0.1; 0: a free one.", "N", default=0),
    out: Path | None = setting("Write the page, and no server.", "FILE.html"),
) -> None:
    """Show the moving mechanism in 3-D, in a browser.

    With a fit, closures' reactions are arrows, joints are coloured by their residual, and charts of
    the torque follow the same cursor. The page is served on this machine alone, until Ctrl-C.
    """
    from ident.display import render
    from ident.fit.files import read_fit
    from ident.fit.identify import compare
    from ident.show.local import wait
    from ident.show.view import SUFFIXES

    output_file(out, SUFFIXES, logs or ())
    if fit is not None and not logs:
        raise IdentError(f"--fit {fit}: a fit can be shown with a motion only; give a LOG too")
    mechanism = model.load(logs)
    saved = None if fit is None else read_fit(fit, mechanism, allow_code=model.allow_code)
    mechanism = mechanism if saved is None else saved.mechanism
    with progress() as on_progress:
        if logs:
            # torques are needed only where a residual is shown
            motion = model.motion(mechanism, logs, on_progress, torques=saved is not None)
        if saved is not None:
            shown = render(compare(saved, motion=motion), "view")
        else:
            shown = render(mechanism, "view", motion.experiments if logs else ())
        if out is not None:
            shown.write(out)
    notes(shown.notes)
    if out is not None:
        count = shown.moments
        result(f"{out}: {count} moment{'s' * (count != 1)}; open it in a browser")
        return
    with shown.serve(port) as page, suppress(KeyboardInterrupt):
        result(f"{page.address}    (Ctrl-C ends it)")
        wait()


if TYPE_CHECKING:
    from ident.excite import Excitation
    from ident.mechanism import Mechanism
    from ident.simulate.integrate import Drive

CONTROLS = ("none", "torque", "pd", "computed-torque")
BOUND = "VALUE|JOINT=VALUE"


def simulate(
    model: ModelOptions,
    motion: Path | None = argument("A log: its positions, or torques.", "MOTION", default=None),
    forward: bool = flag("Integrate the motion that forces make.", "--forward"),
    fit: Path | None = setting("Parameters and effects of a fit.", "FIT.json"),
    set_: Texts = setting("A parameter's value: viscous.elbow.Fv=0.4.", "NAME=VALUE", "--set"),
    control: str | None = setting(
        "Drive of --forward: none (default without MOTION), torque (default: MOTION's "
        "torques), or pd or computed-torque, which follow MOTION's positions.",
        "NAME",
    ),
    gains: Texts = setting("Of the controller; or JOINT=KP,KD. Default: 5 Hz.", "KP,KD"),
    start: Texts = setting("q.crank=0.3, v.crank=2. Default: as MOTION, or rest.", "NAME=VALUE"),
    duration: float | None = setting("Default: MOTION's, else 10 s.", "S"),
    rate: float | None = setting("Samples a second. Default: MOTION's, else 250 Hz.", "HZ"),
    tolerance: float | None = setting("Relative error a step. Default: 1e-10.", "SIZE"),
    noise: Texts = setting("Standard deviation: q=1e-5 in SI units, tau=2%.", "CHANNEL=LEVEL"),
    seed: Seed = 0,
    columns: str = setting("Channels of the log.", "LIST", default="q,v,a,tau"),
    joints: str | None = setting("Joints of the log. Default: of MOTION, or drives.", "LIST"),
    multipliers: Path | None = setting("Write the true multipliers here.", "FILE"),
    out: Path | None = setting("Write a .csv, .parquet or .npz; else CSV to the screen.", "FILE"),
) -> None:
    """Simulate a log of the model itself.

    On a given motion: the torques that it needs, exactly. With --forward: the motion that forces
    make, integrated, with dry friction that really sticks. Then noise.
    """
    from ident.fit.files import read_fit
    from ident.log import Log, read_log
    from ident.simulate import Noise, integrate
    from ident.simulate import simulate as simulate_

    if not forward:
        options = {"--control": control, "--gains": gains, "--start": start, "--duration": duration}
        options |= {"--rate": rate, "--tolerance": tolerance}
        if given := [option for option, value in options.items() if value]:
            raise IdentError(f"{given[0]}: is of an integration; add --forward")
        if motion is None:
            raise typer.BadParameter(
                "Missing argument 'MOTION', whose torques are computed; or add --forward."
            )
    mechanism = model.load()
    output_file(out, LOGS, [motion])
    output_file(multipliers, LOGS, [motion, out])
    values = named(set_, "--set", "write NAME=NUMBER, as viscous.elbow.Fv=0.4", finite)
    levels, pi = named(noise, "--noise", "write CHANNEL=LEVEL, as tau=2% or q=1e-5", share), None
    if fit is not None:
        saved = read_fit(fit, mechanism, allow_code=model.allow_code)
        known = (*replace(model, with_=None).load().effects, *saved.mechanism.effects)
        more = [e for e in mechanism.effects if e.label not in {item.label for item in known}]
        mechanism, pi = reduce(operator.add, more, saved.mechanism), saved.dynamic_parameters
        values = {**saved.point.values, **values}
    common: dict[str, Any] = {
        "values": values,
        "pi": pi,
        "noise": [Noise(channel, *level) for channel, level in levels.items()],
        "seed": seed,
        "columns": [item.strip() for item in columns.split(",")],
        "joints": None if joints is None else [item.strip() for item in joints.split(",")],
    }
    if forward:
        if tolerance is not None:
            common["tolerance"] = tolerance
        begin = named(start, "--start", "write NAME=NUMBER, as q.crank=0.3", finite)
        drive = _drive(mechanism, motion, control, gains)
        common |= {"duration": duration, "rate": rate, "start": begin}
        with progress() as on_progress:
            run = integrate(mechanism, drive, progress=on_progress, **common)
        log, t, forces = run.log, run.t, run.multipliers
    else:
        assert motion is not None
        log, prediction = simulate_(mechanism, read_log(motion, mechanism.sources), **common)
        t, forces = prediction.t, prediction.multipliers
    if out is not None:
        log.write(out)
        wrote([out])
    if multipliers is not None:
        series = {name: forces[:, i] for i, name in enumerate(mechanism.kinematics.multipliers)}
        Log.from_arrays(multipliers.name, t, series).write(multipliers)
        wrote([multipliers])
    if forward and out is None:
        notes(run.summary.splitlines())
    notes(log.repairs)
    if out is None:
        result(log.polars().write_csv().rstrip("\n"))
    elif forward:
        result(run)


def _drive(
    mechanism: Mechanism, motion: Path | None, control: str | None, gains: Texts
) -> Drive | None:
    """Return what drives the mechanism forward; a control that lacks the motion is an error."""
    from ident.log import read_log
    from ident.simulate import PD, ComputedTorque, Torques

    control = control or ("none" if motion is None else "torque")
    if control not in CONTROLS:
        raise IdentError(f"--control {control}: {one_of(control, CONTROLS)}")
    if gains and control in ("none", "torque"):
        raise IdentError(f"--gains: --control {control} has none; valid with pd, computed-torque")
    if control == "none":
        if motion is not None:
            raise IdentError("--control none: goes without MOTION; leave that out, or use torque")
        return None
    if motion is None:
        raise IdentError(f"--control {control}: needs a MOTION, the log that it plays or follows")
    log = read_log(motion, mechanism.sources)
    if control == "torque":
        return Torques(log)

    def pair(text: str) -> tuple[float, float]:
        Kp, Kd = map(float, text.split(","))
        return Kp, Kd

    pairs = named(gains, "--gains", "write KP,KD or JOINT=KP,KD, as 400,30", pair, bare="pair")
    return (PD if control == "pd" else ComputedTorque)(log, pairs.get("", pairs) or None)


def excite(
    model: ModelOptions,
    separate: tuple[str, str] | None = setting("Separate these two best.", "EFFECT EFFECT"),
    duration: float = setting("Length of the whole log.", "S", default=30.0),
    periods: int = setting("How often the motion is repeated.", "N", default=3),
    rate: float = setting("Samples a second.", "HZ", default=100.0),
    harmonics: int = setting("Harmonics of the Fourier series.", "N", default=5),
    poses: int | None = setting("Plan so many poses at rest, for gravity, not a motion.", "N"),
    around: Paths = setting(
        "Begin in the middle of this log's motion, and keep its range and speed where the URDF has "
        "none.",
        "LOG",
    ),
    as_logged: bool = flag(
        "Joints that --range and --speed do not name keep those of the log --around.", "--as-logged"
    ),
    range_: Texts = setting("Range in place of the URDF's.", "JOINT=LOWER:UPPER", "--range"),
    speed: Texts = setting("Largest speed of all drives or of one joint.", BOUND),
    acceleration: Texts = setting("Largest acceleration; a URDF has no such limit.", BOUND),
    torque: Texts = setting("Largest torque of a drive.", BOUND),
    reserve: str = setting("Torque left to what is not modelled.", "SHARE", default="20%"),
    singular: float = setting("Largest ‖K⁺‖ over that at the start.", "X", default=3.0),
    noise: Texts = setting(
        "Expected noise of a torque. Default: the error that the fit left, where MECHANISM is the "
        "folder of one, else 1 % of the torque's limit.",
        "JOINT=VALUE",
    ),
    balance: float = setting("Weight of the condition number beside log det.", "W", default=0.5),
    tries: int = setting("Searches begun; the best one is finished.", "N", default=4),
    seed: int = setting("Seed of the searches.", "N", default=0, min=0),
    plot: Plot = None,
    out: Path | None = setting(
        "Write the motion, a .csv, .parquet or .npz: one within seconds, then better ones.", "FILE"
    ),
) -> None:
    """Plan a periodic motion that determines most, within limits.

    What it uses of the limits, and the standard errors to be expected of a log of it. Ctrl-C ends
    the search and keeps the best motion so far.
    """
    from ident.cli.lines import place_of
    from ident.excite import Limits
    from ident.excite import excite as excite_
    from ident.excite.trajectory import moved_joints
    from ident.fit.files import read_fit, unfiltered_errors

    if as_logged and not around:
        raise IdentError("--as-logged: as in which log? give it with --around LOG")
    mechanism = model.load(logs=around or [])  # without a log, hands are held
    output_file(out, LOGS)
    output_file(plot, CHARTS)
    motion = None
    if around:  # torques are not asked for
        motion = MotionOptions(model.mechanism).motion(mechanism, around, torques=False)
    remaining, values = {}, {}
    if fitted := (model.mechanism / "fit.json").is_file():  # of `identify`, or of `grow`
        of_drives = unfiltered_errors(model.mechanism).items()
        remaining = {name: x for name, x in of_drives if name in moved_joints(mechanism)}
        saved = read_fit(model.mechanism, mechanism, allow_code=model.allow_code)
        values = dict(saved.point.values)
    limits = Limits(
        range=named(range_, "--range", "write JOINT=LOWER:UPPER, as elbow=-1:1.5", interval),
        speed=_limit("--speed", speed),
        acceleration=_limit("--acceleration", acceleration),
        torque=_limit("--torque", torque),
        reserve=value(reserve, "--reserve", "write a share, as 20% or 0.2", share)[0],
        singular=singular,
    )
    if poses is not None:
        from ident.excite import excite_poses

        bands = named(noise, "--noise", "write NAME=NUMBER, as elbow=1.5", finite)
        plan = excite_poses(mechanism, poses, limits=limits, noise=bands, seed=seed)
        if out is not None:
            plan.write(out)
        hold = "hold each, average q and tau over it, one row a pose; ident identify MECHANISM LOG"
        conclude(plan, filter(None, [out]), [f"collisions are not checked; {hold} --poses"])
        return
    written = list[Path]()

    def better(excitation: Excitation) -> None:
        if out is None:
            return
        excitation.write(out)
        if not written:
            written.append(out)
            wrote([out])
            until = "until the search ends, or Ctrl-C"
            notes([f"it keeps all limits; better motions replace it {until}"])

    with progress() as on_progress:
        excitation = excite_(
            mechanism,
            duration=duration,
            periods=periods,
            rate=rate,
            harmonics=harmonics,
            limits=limits,
            separate=separate,
            noise=remaining | named(noise, "--noise", "write NAME=NUMBER, as elbow=1.5", finite),
            values=values,
            around=motion,
            as_logged=as_logged,
            balance=balance,
            tries=tries,
            seed=seed,
            better=better,
            progress=on_progress,
        )
    if out is None and not excitation.finished:  # no seed repeats it
        free = (Path(f"{excitation.name}_excited{i or ''}.csv") for i in count())
        out = next(path for path in free if not path.exists())
    look = "no file was written: repeat the command with --out next.csv"
    if out is not None:
        excitation.write(out)
        look = f"look at it: ident view {place_of(mechanism.toml, mechanism.urdf)} {out}"
    if plot is not None:
        excitation.plot().save(plot)
    of = "values and friction of the fit" if fitted else "masses of the file"
    remarks = [f"planned with the {of}; collisions are not checked; {look}"]
    conclude(excitation, filter(None, (out, plot)), remarks)
    if not excitation.finished:
        notes([f"interrupted: {out} has the best motion so far"])
        sys.exit(130)


def _limit(given: str, texts: Texts) -> float | dict[str, float] | None:
    """Return one number for all drives, or numbers by joint."""
    bounds = named(texts, given, "is no number; write 1.5 or elbow=1.5", finite, bare="number")
    return bounds.get("", bounds or None)


def montecarlo(
    model: ModelOptions,
    log: Path = argument("Without noise; or a folder of such logs.", "LOG", default=...),
    snr: str = setting("Signal-to-noise ratios, in dB.", "LIST", default="60,50,40,30"),
    runs: int = setting("Draws of the noise at each.", "N", default=100),
    estimator: Texts = setting(
        "paper, default, least-squares, likelihood or consistent; may be repeated. Default: paper "
        "and default.",
        "NAME",
    ),
    spacing: float | None = setting("Knots of `paper`. Default: as the basis, or 5 samples.", "S"),
    truth: Texts = setting("As rod.Ixx=0.004. Default: of the log as it is.", "NAME=VALUE"),
    reactions: Path | None = setting("True multipliers. Default: of the log as it is.", "LOG"),
    wrench: bool = flag("Noise on external wrenches too.", "--wrench"),
    misread: bool = flag("Errors of the calibration too, from their priors.", "--misread"),
    seed: Seed = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    out: Path | None = setting("Write table, all runs, picture and report there.", "DIR"),
) -> None:
    """Study what noise does to the estimates: bias and spread.

    The same log is identified with ever new noise, which shows whether standard errors are honest.
    Estimators meet the same noise and stand side by side, the paper's method among them.
    """
    from ident.log.read import is_folder_of_logs, logs_in
    from ident.montecarlo import USUAL, monte_carlo, paper

    names = estimator or ["paper", "default"]
    if spacing is not None and "paper" not in names:
        raise IdentError(
            f"--spacing {spacing:g}: is of the paper's hats; add --estimator paper, or leave it out"
        )
    output_folder(out, ("runs.csv", "multiplier_errors.csv"), [log, reactions])
    mechanism = model.load()
    remedy = "write numbers of dB with commas, as 60,40,30"
    common: dict[str, Any] = {
        "snr": value(snr, "--snr", remedy, lambda text: [*map(float, text.split(","))]),
        "runs": runs,
        "estimators": [paper(spacing) if name == "paper" else name for name in names],
        "truth": named(truth, "--truth", "write NAME=NUMBER, as rod.Ixx=0.004", finite),
        "channels": (*USUAL, "wrench") if wrench else USUAL,
        "misread": misread,
        "seed": seed,
        "jobs": jobs,
        "scheduler": scheduler,
    }
    several = is_folder_of_logs(log)
    if several and reactions is not None:
        raise IdentError(f"--reactions {reactions}: are of one log, and {log} is a folder")
    logs = logs_in(log) if several else [log]
    studies, broken = [], list[str]()
    for i, path in enumerate(logs):
        try:
            with progress() as show:
                of_log = part(show, i / len(logs), (i + 1) / len(logs))
                study = monte_carlo(mechanism, path, reactions=reactions, progress=of_log, **common)
        except IdentError as error:
            if not several:
                raise
            broken.append(f"{path.name}: left out: {error}")
            continue
        folder = out and (out / path.name if several else out)
        request = model.request(logs, out=folder)
        conclude(study, study.write(folder, request) if folder else [])
        if study.runs < runs:
            text = f"interrupted: {study.runs} of {runs} runs are done"
            text += f"{' and kept' * (out is not None)}; the same seed repeats them"
            again = f"; all of them, these too, with: {command_line()}" if command_line() else ""
            notes([f"{text}{again}"])
            sys.exit(130)
        studies.append(study)
    if not studies:
        raise IdentError(f"none of {len(logs)} logs can be used: {broken[0]}")
    notes(broken)
    for study in studies:
        if study.samples.is_empty():
            first = study.failures["error"][0]
            raise IdentError(f"every run ended in an error, the first: {first}")
