"""`simulate`, of a given motion or of given forces."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ident.cli.console import notes, progress, result, wrote
from ident.cli.options import (
    LOGS,
    AllowCode,
    MechanismPath,
    Seed,
    Texts,
    With,
    argument,
    mechanism_of,
    named,
    option,
    output_file,
)
from ident.errors import IdentError, one_of

if TYPE_CHECKING:
    from ident.mechanism import Mechanism
    from ident.simulate import Noise
    from ident.simulate.drives import Drive

CONTROLS = ("none", "torque", "pd", "computed-torque")


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
