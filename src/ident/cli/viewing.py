"""`view`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ident.cli.arguments import (
    Absolute,
    AllowCode,
    MechanismPath,
    Smoothing,
    mechanism_of,
    motion_of,
    output_file,
)
from ident.cli.console import notes, progress, result
from ident.display import render
from ident.errors import IdentError
from ident.fit.saved import read_fit
from ident.residual.predict import predict
from ident.show.view3d.record import kept
from ident.show.view3d.view import SUFFIXES


def view(
    mechanism: MechanismPath,
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG", help="Experiments to watch; without one it stands still."),
    ] = None,
    fit: Annotated[
        Path | None,
        typer.Option(metavar="FIT.json", help="Whose reactions and residuals are shown."),
    ] = None,
    port: Annotated[
        int, typer.Option(metavar="N", help="Of the page, on 127.0.0.1; 0: a free one.")
    ] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Write a page that plays by itself, and no server."),
    ] = None,
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
) -> None:
    """The mechanism moving in 3-D, in a browser.

    With a fit, closures' reactions are arrows and joints are coloured by their residual. The page
    is served on this machine alone, until Ctrl-C.
    """
    output_file(out, SUFFIXES)
    if fit is not None and not logs:
        raise IdentError(f"--fit {fit}: a fit says nothing without a motion; give a LOG too")
    model = mechanism_of(mechanism, allow_code=allow_code, absolute=absolute)
    saved = None if fit is None else read_fit(fit, model)
    model = model if saved is None else saved.mechanism
    experiments: Sequence[Any] = ()
    predictions: Sequence[Any] = ()
    with progress() as told:
        if logs:
            # torques are needed only where a residual is shown
            motion = motion_of(model, logs, "auto", told, saved is not None, smoothing)
            experiments = motion.experiments
            if saved is not None:
                predictions = predict(model, motion, saved.point)
        shown = render(model, "view", experiments, predictions)
        notes(shown.notes)
        if out is not None:
            told(f"recording {out.name}", 0.5)
            shown.write(out)
    if out is not None:
        count = sum(len(film) for film in kept(shown.films))
        result(f"{out}: {count} moment{'s' * (count != 1)}; open it in a browser")
        return
    with shown.serve(port) as page:
        result(f"{page.address}    (Ctrl-C ends it)")
        sys.stdout.flush()
        try:
            page.wait()
        except KeyboardInterrupt:
            return
