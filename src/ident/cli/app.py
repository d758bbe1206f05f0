"""`ident`: the commands, and what becomes of errors."""

from __future__ import annotations

import io
import os
import shlex
import sys
import traceback
from typing import Annotated

import typer

import ident
from ident.cli.console import fail
from ident.cli.late import HELP, Commands
from ident.errors import IdentError
from ident.progress import running

app = typer.Typer(
    name="ident",
    cls=Commands,
    help="Find out what is true of a mechanism from logged data.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=HELP,
)


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
    running.set(shlex.join(["ident", *sys.argv[1:]]))  # for reports
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
