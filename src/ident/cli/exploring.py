"""`explore`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ident.cli.arguments import (
    Absolute,
    AllowCode,
    Basis,
    Cutoff,
    LogPaths,
    MechanismPath,
    Smoothing,
    Spacing,
    With,
    cutoff_of,
    mechanism_of,
    motion_of,
)
from ident.cli.console import notes, progress, result
from ident.explore import Exploration
from ident.explore.needed import check_panel
from ident.explore.serve import free_port, serve


def explore(
    mechanism: MechanismPath,
    logs: LogPaths,
    with_: With = None,
    basis: Basis = None,
    spacing: Spacing = None,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="Of the page; 0 is a free one.")
    ] = 0,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Say the address, and open no browser.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The folder that the page proposes for saving."),
    ] = None,
) -> None:
    """Add effects by hand, in a browser; watch the error fall.

    Serves a page on 127.0.0.1 until Ctrl-C. It lists every effect of the library with the fall of
    the held-out error that it would bring; a click adds it and refits everything.
    """
    check_panel()
    port = free_port(port)
    model = mechanism_of(
        mechanism, with_, allow_code=allow_code, basis=basis, spacing=spacing, absolute=absolute
    )
    with progress() as told:
        motion = motion_of(model, logs, cutoff_of(cutoff), told, smoothing=smoothing)
        found = Exploration.of(model, motion, told).screened(told)
    notes(found.fit.warnings)

    def ready(address: str) -> None:
        result(f"{model.name}: {address}")
        sys.stdout.flush()  # a reader at the other end of a pipe waits for it
        notes(["the page lives until Ctrl-C"])

    serve(found, port=port, browser=not no_browser, folder=out, ready=ready)
