"""The command `export`: a machine for a simulator or a controller."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.cli.app import conclude, notes, progress
from ident.cli.options import (
    CHARTS,
    GoodEnough,
    Json,
    ModelOptions,
    Plot,
    Texts,
    finite,
    flag,
    named,
    output_file,
    setting,
    value,
)
from ident.display import render
from ident.errors import IdentError
from ident.files import write_all

if TYPE_CHECKING:
    from ident.fit.files import Saved
    from ident.mechanism import Mechanism


def export(
    model: ModelOptions,
    to: str = setting(
        "mjcf, urdf, sdf, drake, usd, c, fmu, or of another package.", "TARGET", default=...
    ),
    like: Path | None = setting(
        "Change this file of yours in place of a new one: only numbers that differ.", "FILE"
    ),
    step: float | None = setting("Of the simulator. Default: 1 ms, or that of --like.", "S"),
    fit: Path | None = setting("A fit, of the mechanism that is given.", "FIT.json"),
    physical: bool = flag("Keep physical values, not fitted to the target's laws.", "--physical"),
    log: Path | None = setting("Over its motion losses are measured. Default: nominal.", "LOG"),
    replay: Path | None = setting("Run the file under this log's torques or commands.", "LOG"),
    window: float | None = setting("Restart the replay so often. Default: 0.5 s.", "S"),
    without: Texts = setting("Leave an effect out, as payload:tool.", "EFFECT"),
    set_: Texts = setting(
        "A parameter's value: coulomb.elbow.Fc=0.4, or =50% of what it is.", "NAME=VALUE", "--set"
    ),
    float_: bool = flag("Single precision, of c and fmu.", "--float"),
    fmi: int | None = setting("Version of the FMU, 2 or 3. Default: 3.", "N"),
    gravity: str | None = setting("Another one [m/s²]: 0,0,-1.62.", "X,Y,Z"),
    good_enough: GoodEnough = None,
    json: Json = False,
    plot: Plot = None,
    report: Path | None = setting("Page of the replay, with the moving machine.", "FILE.html"),
    out: Path | None = setting("Default: the mechanism's name, in this folder.", "FILE"),
) -> None:
    """Write it for a simulator or controller; prove it by replay.

    MECHANISM may be a fit.json, or the folder of an identification. What the target cannot hold is
    listed with its size; with --replay the file is run in its simulator beside ident's own model.
    """
    from ident.export import export as export_
    from ident.export.export import joints_above

    mechanism, saved = _read(model, fit)
    output_file(plot, CHARTS)
    if plot is not None and replay is None:
        raise IdentError(f"--plot {plot}: shows the replay; add --replay LOG")
    output_file(report, (".html",))
    if report is not None and replay is None:
        raise IdentError(f"--report {report}: shows the replay; add --replay LOG")
    if good_enough is not None and replay is None:
        raise IdentError("--good-enough: judges the replay; add --replay LOG")
    settings: dict[str, Any] = {}
    if float_:
        settings["real"] = "float"
    if fmi is not None:
        settings["fmi"] = fmi
    remedy = "write NAME=NUMBER, as coulomb.elbow.Fc=0.4 or coulomb.elbow.Fc=50%"
    changes = named(set_, "--set", remedy, _value_or_share)
    values = {name: x for name, (x, is_share) in changes.items() if not is_share}
    shares = {name: x for name, (x, is_share) in changes.items() if is_share}
    if window is not None:
        settings["window"] = window
    with progress() as on_progress:
        made = export_(
            saved or mechanism, to, out=out, like=like, step=step, log=replay or log,
            replayed=replay is not None, values=values, shares=shares, without=without or (),
            gravity=_vector(gravity), fitted=not physical, progress=on_progress, **settings,
        )  # fmt: skip
    written = made.write()
    if plot is not None and made.replays is not None:
        made.replays.plot().save(plot)
        written.append(plot)
    if report is not None:
        written += write_all(report.parent, {report.name: render(made, "report")})
    remarks = [*made.notes, *(made.replays.notes if made.replays else ())]
    conclude(render(made, "json") if json else made, written, remarks)
    if good_enough is None or made.replays is None:
        return
    above = joints_above(made.replays, made.simulator, good_enough / 100)
    if above:
        loud = ", ".join(f"{name} {100 * share:.3g} %" for name, share in above.items())
        notes([f"status 3: {loud} above --good-enough {good_enough:g} %"])
        sys.exit(3)


def _value_or_share(text: str) -> tuple[float, bool]:
    """Return the number of a text, and whether it is a share of the present value: `50%`."""
    if text.endswith("%"):
        return finite(text[:-1]) / 100, True
    return finite(text), False


def _vector(text: str | None) -> list[float] | None:
    """Return the numbers of --gravity."""
    if text is None:
        return None
    return [value(x, "--gravity", "write three numbers, as 0,0,-1.62") for x in text.split(",")]


def _read(model: ModelOptions, fit: Path | None) -> tuple[Mechanism, Saved | None]:
    """Return the mechanism, and the fit that is in its folder or was given."""
    from ident.fit.files import read_fit

    path = model.mechanism
    home = path if path.is_dir() else path.parent
    if path.suffix == ".json" or (path.is_dir() and (path / "fit.json").is_file() and fit is None):
        fit = fit or (path / "fit.json" if path.is_dir() else path)
        own_folder = home if (home / "mechanism.toml").is_file() else home / "identified"
        if not own_folder.is_dir():
            raise IdentError(
                f"{path}: no identified/ beside it, so its mechanism is not known; write ident "
                f"export MECHANISM --fit {path}"
            )
        model = replace(model, mechanism=own_folder)
    mechanism = model.load()
    if fit is None:
        return mechanism, None
    return mechanism, read_fit(fit, mechanism, allow_code=model.allow_code)
