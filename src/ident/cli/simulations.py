"""Commands without a machine: `simulate`, `excite`, `montecarlo` and `demo`."""

from __future__ import annotations

import math
import secrets
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ident.cli.console import notes, progress, result, wrote
from ident.cli.options import (
    CHARTS,
    LOGS,
    AllowCode,
    Jobs,
    MechanismPath,
    Plot,
    Scheduler,
    Seed,
    Texts,
    With,
    argument,
    interval,
    mechanism_of,
    named,
    number,
    option,
    output_file,
    output_folder,
)
from ident.errors import IdentError, one_of

if TYPE_CHECKING:
    from ident.mechanism import Mechanism
    from ident.montecarlo import Estimator, MonteCarlo, Studies
    from ident.simulate import Noise
    from ident.simulate.drives import Drive

CONTROLS = ("none", "torque", "pd", "computed-torque")
BOUND = "VALUE|JOINT=VALUE"
UNNAMED = "picker"  # the folder in the commands of a demo whose files are not to stay


def simulate(
    mechanism: MechanismPath,
    motion: Annotated[
        Path | None,
        argument(
            "A log whose positions are the motion; with --forward, whose torques drive it.",
            "MOTION",
        ),
    ] = None,
    forward: Annotated[
        bool,
        option(
            "Integrate the motion that forces make; then MOTION may be left out.", None, "--forward"
        ),
    ] = False,
    fit: Annotated[Path | None, option("Parameters and effects of a fit.", "FIT.json")] = None,
    with_: With = None,
    set_: Annotated[
        Texts,
        option(
            "Give a parameter its value: rod.Izz=0.2, viscous.elbow.Fv=0.4.", "NAME=VALUE", "--set"
        ),
    ] = None,
    control: Annotated[
        str | None,
        option(
            "What drives it forward: none (default without MOTION), torque (default: MOTION's "
            "torques), or pd or computed-torque, which follow MOTION's positions.",
            "NAME",
        ),
    ] = None,
    gains: Annotated[
        Texts,
        option(
            "Of the controller, for all drives or as JOINT=KP,KD for one. Default: 5 Hz.", "KP,KD"
        ),
    ] = None,
    start: Annotated[
        Texts,
        option(
            "Where it begins: q.crank=0.3, v.crank=2. Default: as MOTION, else at rest.",
            "NAME=VALUE",
        ),
    ] = None,
    duration: Annotated[float | None, option("Default: MOTION's, else 10 s.", "S")] = None,
    rate: Annotated[
        float | None,
        option("Of the log's samples. Default: MOTION's, else 250 Hz.", "HZ"),
    ] = None,
    tolerance: Annotated[
        float | None, option("Relative error a step. Default: 1e-10.", "SIZE")
    ] = None,
    noise: Annotated[
        Texts,
        option(
            "White noise, its standard deviation: q=1e-5 in SI units, tau=2% of the column's.",
            "CHANNEL=LEVEL",
        ),
    ] = None,
    seed: Seed = 0,
    columns: Annotated[str, option("Which channels the log gets.", "LIST")] = "q,v,a,tau",
    joints: Annotated[
        str | None,
        option("Whose q, v and a it gets. Default: those in MOTION; forward, the drives.", "LIST"),
    ] = None,
    multipliers: Annotated[
        Path | None,
        option("Write the true multipliers here, a .csv, .parquet or .npz.", "FILE"),
    ] = None,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        option("Write a .csv, .parquet or .npz; else CSV to the screen.", "FILE"),
    ] = None,
) -> None:
    """A log of the model itself.

    On a given motion: the torques that it needs, exactly. With --forward: the motion that forces
    make, integrated, with dry friction that really sticks. Then noise.
    """
    from ident.fit.files import read_fit
    from ident.log import Log, read_log
    from ident.show.simulate import csv_text
    from ident.simulate import integrate
    from ident.simulate import simulate as simulate_

    own = {"--control": control, "--gains": gains, "--start": start, "--duration": duration}
    own |= {"--rate": rate, "--tolerance": tolerance}
    if not forward:
        for option, value in own.items():
            if value:
                raise IdentError(f"{option}: is of an integration; add --forward")
        if motion is None:
            raise typer.BadParameter(
                "Missing argument 'MOTION', whose torques are computed; or add --forward."
            )
    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    output_file(out, LOGS)
    output_file(multipliers, LOGS)
    values = dict(named(text, "--set", "viscous.elbow.Fv=0.4") for text in set_ or ())
    pi = None
    if fit is not None:
        saved = read_fit(fit, model)
        model, pi = saved.mechanism, saved.dynamic_parameters
        values = {**saved.point.values, **values}
    noises = [_noise(text) for text in noise or ()]
    channels = [part.strip() for part in columns.split(",")]
    names = None if joints is None else [part.strip() for part in joints.split(",")]
    if forward:
        drive = _drive(model, motion, control, gains)
        begin = dict(named(text, "--start", "q.crank=0.3") for text in start or ())
        with progress() as on_progress:
            run = integrate(
                model, drive, duration=duration, rate=rate, start=begin, values=values, pi=pi,
                noise=noises, seed=seed, columns=channels, joints=names, progress=on_progress,
                **({} if tolerance is None else {"tolerance": tolerance}),
            )  # fmt: skip
        log, t, forces = run.log, run.t, run.multipliers
        if out is None:
            notes(run.summary.splitlines())
        else:
            result(run)
    else:
        assert motion is not None
        given = read_log(motion, model.columns)
        log, prediction = simulate_(
            model, given, values=values, pi=pi, noise=noises, seed=seed, columns=channels,
            joints=names,
        )  # fmt: skip
        t, forces = prediction.t, prediction.multipliers
    notes(log.repairs)
    if out is None:
        result(csv_text(log).rstrip("\n"))
    else:
        log.write(out)
        wrote([out])
    if multipliers is not None:
        series = {name: forces[:, i] for i, name in enumerate(model.kinematics.multipliers)}
        Log.from_arrays(multipliers.name, t, series).write(multipliers)
        wrote([multipliers])


def _drive(
    model: Mechanism, motion: Path | None, control: str | None, gains: Texts
) -> Drive | None:
    """Return what drives the mechanism forward.

    Raises:
        IdentError: for a control that is not there, or lacks the motion or goes without one.
    """
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
    log = read_log(motion, model.columns)
    if control == "torque":
        return Torques(log)
    return (PD if control == "pd" else ComputedTorque)(log, _gains(gains))


def _gains(
    texts: Texts,
) -> tuple[float, float] | Mapping[str, tuple[float, float]] | None:
    found: dict[str, tuple[float, float]] = {}
    for text in texts or ():
        joint, equals, pair = text.rpartition("=")
        try:
            Kp, Kd = (float(x) for x in pair.split(","))
        except ValueError:
            raise IdentError(f"--gains {text}: write KP,KD or JOINT=KP,KD, as 400,30") from None
        found[joint if equals else ""] = (Kp, Kd)
    if "" in found and len(found) > 1:
        raise IdentError("--gains: give one pair for all drives, or JOINT=KP,KD for each")
    return found.get("", found) or None


def _noise(text: str) -> Noise:
    from ident.simulate import Noise

    channel, equals, level = text.partition("=")
    try:
        if not equals or not channel:
            raise ValueError
        value = float(level.removesuffix("%"))
        if not 0 <= value < math.inf:
            raise ValueError
    except ValueError:
        raise IdentError(f"--noise {text}: write CHANNEL=LEVEL, as tau=2% or q=1e-5") from None
    relative = level.endswith("%")
    return Noise(channel.strip(), value / 100 if relative else value, relative)


def excite(
    mechanism: MechanismPath,
    with_: With = None,
    separate: Annotated[
        tuple[str, str] | None,
        option("Tell these two best apart, as coulomb:crank coulomb:rocker.", "EFFECT EFFECT"),
    ] = None,
    duration: Annotated[float, option("Length of the whole log.", "S")] = 30.0,
    periods: Annotated[int, option("How often the motion is repeated.", "N")] = 3,
    rate: Annotated[float, option("Samples a second.", "HZ")] = 100.0,
    harmonics: Annotated[int, option("Harmonics of the Fourier series.", "N")] = 5,
    range_: Annotated[
        Texts, option("Range in place of the URDF's.", "JOINT=LOWER:UPPER", "--range")
    ] = None,
    speed: Annotated[Texts, option("Largest speed of all drives or of one joint.", BOUND)] = None,
    acceleration: Annotated[
        Texts, option("Largest acceleration; a URDF has no such limit.", BOUND)
    ] = None,
    torque: Annotated[Texts, option("Largest torque of a drive.", BOUND)] = None,
    reserve: Annotated[
        str, option("Share of the torque left to what is not modelled.", "SHARE")
    ] = "20%",
    singular: Annotated[
        float, option("Times its value at the start that ‖K⁺‖ may reach.", "X")
    ] = 3.0,
    noise: Annotated[
        Texts, option("Expected noise of a torque. Default: 1 % of its limit.", "JOINT=VALUE")
    ] = None,
    balance: Annotated[float, option("Weight of the condition number beside log det.", "W")] = 0.5,
    tries: Annotated[int, option("Searches; the best one counts.", "N")] = 4,
    seed: Annotated[int, option("Seed of the searches.", "N", min=0)] = 0,
    allow_code: AllowCode = False,
    plot: Plot = None,
    out: Annotated[
        Path | None, option("Write the motion, a .csv, .parquet or .npz.", "FILE")
    ] = None,
) -> None:
    """A periodic motion that tells most, inside all limits.

    What it uses of the limits, and the standard errors to be expected of a log of it.
    """
    from ident.excite import Limits
    from ident.excite import excite as excite_

    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    output_file(out, LOGS)
    output_file(plot, CHARTS)
    remedy = "write JOINT=LOWER:UPPER, as elbow=-1:1.5"
    limits = Limits(
        range=dict(interval(text, "--range", remedy, ends=True) for text in range_ or ()),
        speed=_limit("--speed", speed),
        acceleration=_limit("--acceleration", acceleration),
        torque=_limit("--torque", torque),
        reserve=number(reserve.removesuffix("%"), "--reserve", "write a share, as 20% or 0.2")
        / (100 if reserve.endswith("%") else 1),
        singular=singular,
    )
    with progress() as on_progress:
        found = excite_(
            model, duration=duration, periods=periods, rate=rate, harmonics=harmonics,
            limits=limits, separate=separate,
            noise=dict(named(text, "--noise", "elbow=1.5") for text in noise or ()),
            balance=balance, tries=tries, seed=seed, progress=on_progress,
        )  # fmt: skip
    result(found)
    if out is not None:
        found.write(out)
        wrote([out])
    if plot is not None:
        found.plot().save(plot)
        wrote([plot])


def _limit(given: str, texts: Texts) -> float | dict[str, float] | None:
    """Return one number for all drives, or numbers by joint."""
    bare = [text for text in texts or () if "=" not in text]
    if not texts:
        return None
    if bare and len(texts) > 1:
        raise IdentError(
            f"{given} {' '.join(texts)}: give one number for all drives, or JOINT=NUMBER for each"
        )
    if bare:
        return number(bare[0], given, "is no number; write 1.5 or elbow=1.5")
    return dict(named(text, given, "elbow=1.5") for text in texts)


def montecarlo(
    mechanism: MechanismPath,
    log: Annotated[
        Path,
        argument("Without noise, best of a simulation; or a folder of such logs.", "LOG"),
    ],
    snr: Annotated[
        str, option("Signal-to-noise ratios of every channel, in dB.", "LIST")
    ] = "60,50,40,30",
    runs: Annotated[int, option("Draws of the noise at each.", "N")] = 100,
    estimator: Annotated[
        Texts,
        option(
            "paper, default, least-squares, likelihood or consistent; may be repeated. "
            "Default: paper and default.",
            "NAME",
        ),
    ] = None,
    spacing: Annotated[
        float | None,
        option("Of the paper's hats. Default: the mechanism's time basis, else 5 samples.", "S"),
    ] = None,
    truth: Annotated[
        Texts,
        option("A true value, as rod.Ixx=0.004. Default: that of the log as it is.", "NAME=VALUE"),
    ] = None,
    reactions: Annotated[
        Path | None,
        option("The true multipliers. Default: those of the log as it is.", "LOG"),
    ] = None,
    wrench: Annotated[bool, option("Noise on external wrenches too.", None, "--wrench")] = False,
    seed: Seed = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    with_: With = None,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        option("Write table, all runs, picture and report there.", "DIR"),
    ] = None,
) -> None:
    """What noise makes of the estimates: bias and spread.

    The same log is identified with ever new noise, which shows whether standard errors are honest.
    Estimators meet the same noise and stand side by side, the paper's method among them.
    """
    from ident.log.read import is_folder_of_logs, logs_in
    from ident.montecarlo import Studies, monte_carlo, monte_carlo_each
    from ident.montecarlo.trial import USUAL

    output_folder(out)
    model = mechanism_of(mechanism, with_, allow_code=allow_code)
    ratios, tried = _ratios(snr), _estimators(estimator or ["paper", "default"], spacing)
    known = dict(named(text, "--truth", "rod.Ixx=0.004") for text in truth or ())
    channels = (*USUAL, "wrench") if wrench else USUAL
    found: MonteCarlo | Studies
    with progress() as on_progress:
        if is_folder_of_logs(log):
            if reactions is not None:
                raise IdentError(f"--reactions {reactions}: are of one log, and {log} is a folder")
            found = monte_carlo_each(
                model, logs_in(log), snr=ratios, runs=runs, estimators=tried, truth=known,
                channels=channels, seed=seed, jobs=jobs, scheduler=scheduler, progress=on_progress,
            )  # fmt: skip
            notes(found.notes)
        else:
            found = monte_carlo(
                model, log, snr=ratios, runs=runs, estimators=tried, truth=known,
                reactions=reactions, channels=channels, seed=seed, jobs=jobs, scheduler=scheduler,
                progress=on_progress,
            )  # fmt: skip
    result(found)
    if out is not None:
        wrote(found.write(out))
    for study in found.studies.values() if isinstance(found, Studies) else (found,):
        if study.samples.is_empty():
            raise IdentError(
                f"every run ended in an error, the first: {study.failures['error'][0]}"
            )


def _ratios(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise IdentError(f"--snr {text}: write numbers of dB with commas, as 60,40,30") from None


def _estimators(names: list[str], spacing: float | None) -> list[str | Estimator]:
    """Return estimators by name, the paper's with its spacing."""
    from ident.montecarlo import paper

    if spacing is not None and "paper" not in names:
        raise IdentError(
            f"--spacing {spacing:g}: is of the paper's hats; add --estimator paper, or leave it out"
        )
    return [paper(spacing) if name == "paper" else name for name in names]


def demo(
    seed: Annotated[
        int | None,
        option("Which machine; a new one each time by default.", "N", min=0),
    ] = None,
    puzzle: Annotated[
        bool,
        option(
            "Only make the machine and its log in --out, for you to find out.", None, "--puzzle"
        ),
    ] = False,
    out: Annotated[
        Path | None,
        option("Keep mechanism, log, fits and reports in this new folder.", "DIR"),
    ] = None,
) -> None:
    """A hidden effect found, step by step, in half a minute.

    A machine is simulated that has something its model lacks. Check, identify, compare, diagnose
    and add find out what, and say which command does each step.
    """
    from ident.show.demo import make_puzzle, show_puzzle, show_story

    seed = secrets.randbelow(1000) if seed is None else seed
    if puzzle:
        if out is None:
            raise IdentError("--puzzle: needs a folder to put it into; add --out DIR")
        show_puzzle(make_puzzle(out, seed=seed))
        return
    if out is not None:
        show_story(make_puzzle(out, seed=seed), str(out), progress, keep=True)
        notes([f"wrote {out}; open {out / 'diagnosis' / 'report.html'}"])
        return
    with tempfile.TemporaryDirectory() as folder:
        show_story(make_puzzle(Path(folder) / UNNAMED, seed=seed), UNNAMED, progress, keep=False)
