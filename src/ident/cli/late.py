"""Commands that are imported when one of them is run: --version, --help and Tab need not wait."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

HELP = {"help_option_names": ["-h", "--help"]}
COMMANDS = {  # in which module of this package, and the first line of its docstring
    "check": ("identifying", "What was understood, and what could be identified."),
    "identify": ("identifying", "Parameters, effects and multipliers from logs."),
    "compare": ("identifying", "Models against measurement, joint by joint."),
    "diagnose": ("diagnosing", "Where the model fails, and which effect is missing."),
    "grow": ("diagnosing", "Add the best effect, refit, and repeat until none is missing."),
    "add": ("modelling", "Write an effect into mechanism.toml."),
    "effects": ("modelling", "The library of effects."),
    "simulate": ("simulating", "A log of the model itself."),
    "excite": ("exciting", "A periodic motion that tells most, inside all limits."),
    "explore": ("exploring", "Add effects by hand, in a browser; watch the error fall."),
    "montecarlo": ("montecarlo", "What noise makes of the estimates: bias and spread."),
    "monitor": ("monitoring", "Identify a machine while it runs; say when it changes."),
    "view": ("viewing", "The mechanism moving in 3-D, in a browser."),
    "demo": ("demonstrating", "A hidden effect found, step by step, in half a minute."),
}


@cache
def command_of(name: str) -> Any:
    """The command itself, with its arguments and options."""
    function = getattr(import_module(f"ident.cli.{COMMANDS[name][0]}"), name)
    alone = typer.Typer(
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings=HELP,
    )
    alone.command(name)(function)
    return typer.main.get_command(alone)


class Late(TyperCommand):
    """Stands for a command until it is run, or its own help or options are asked for."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **more: Any) -> Any:
        """The context of the command that it stands for."""
        return command_of(str(self.name)).make_context(info_name, args, *rest, **more)


class Commands(TyperGroup):
    """All of them by name."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for name, (_, line) in COMMANDS.items():
            self.add_command(Late(name, help=line, rich_markup_mode=None))
