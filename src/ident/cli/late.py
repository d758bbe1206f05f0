"""Commands that are imported when one of them is run: --version, --help and Tab need not wait."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

HELP = {"help_option_names": ["-h", "--help"]}
COMMANDS = {  # in which module of this package, and the first line of its docstring
    "check": ("identify", "What was understood, and what could be identified."),
    "identify": ("identify", "Parameters, effects and multipliers from logs."),
    "compare": ("identify", "Models against measurement, joint by joint."),
    "diagnose": ("diagnose", "Where the model fails, and which effect is missing."),
    "grow": ("diagnose", "Add the best effect, refit, and repeat until none is missing."),
    "add": ("model", "Write an effect into mechanism.toml."),
    "effects": ("model", "The library of effects."),
    "simulate": ("simulate", "A log of the model itself."),
    "excite": ("excite", "A periodic motion that tells most, inside all limits."),
    "explore": ("diagnose", "Add effects by hand, in a browser; watch the error fall."),
    "montecarlo": ("montecarlo", "What noise makes of the estimates: bias and spread."),
    "monitor": ("monitor", "Identify a machine while it runs; say when it changes."),
    "view": ("model", "The mechanism moving in 3-D, in a browser."),
    "demo": ("demo", "A hidden effect found, step by step, in half a minute."),
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
