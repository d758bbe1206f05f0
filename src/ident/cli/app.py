"""`ident`: the commands, and what becomes of errors."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

import ident
from ident.cli import identifying, modelling
from ident.cli.console import errors
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
    modelling.add,
    modelling.effects,
    modelling.simulate,
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
    try:
        app()
    except IdentError as error:
        errors.print(f"error: {' '.join(str(error).split())}", markup=False)
        sys.exit(1)
    except BrokenPipeError:
        sys.exit(1)


if __name__ == "__main__":
    main()
