"""`ident`: the commands, and what becomes of errors."""

from __future__ import annotations

import io
import os
import sys
import traceback
from typing import Annotated

import typer

import ident
from ident.cli import diagnosing, exciting, identifying, modelling, montecarlo, simulating
from ident.cli.console import fail
from ident.errors import IdentError

app = typer.Typer(
    name="ident",
    help="Find out what is true of a mechanism from logged data.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (
    identifying.check,
    identifying.identify,
    identifying.compare,
    diagnosing.diagnose,
    diagnosing.grow,
    modelling.add,
    modelling.effects,
    simulating.simulate,
    exciting.excite,
    montecarlo.montecarlo,
):
    app.command()(command)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ident {ident.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Find out what is true of a mechanism from logged data."""


def main() -> None:
    """Run a command; bad input is one line on standard error and status 1."""
    for stream in (sys.stdout, sys.stderr):  # a terminal that cannot show ² gets an escape
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        app()
    except IdentError as error:
        fail(error)
    except BrokenPipeError:  # the reader, `head` perhaps, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        fail(f"{error.filename or 'the system'}: {error.strerror or error}; check this path")
    except Exception as error:
        if "IDENT_TRACEBACK" in os.environ:
            raise
        *_, last = traceback.extract_tb(error.__traceback__)
        fail(
            f"a fault of ident, not of yours: {type(error).__name__} in {last.name}, "
            f"{last.filename}:{last.lineno}: {error}; IDENT_TRACEBACK=1 shows where it came from"
        )


if __name__ == "__main__":
    main()
