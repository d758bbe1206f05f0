"""The command reference, from the application itself."""

from __future__ import annotations

import re
from typing import Any

import typer

from ident.cli.app import app

COMMON = """\
`ident --version`, `ident --help` and `ident COMMAND --help` print help. `ident
--install-completion` installs completion of commands, options and effects in bash, zsh, fish
and PowerShell; `ident --show-completion` prints the script. `EFFECT` is `kind:joint`,
`kind` alone for every driven joint, or `file.py:function:joint`; see [the library](library.md).

Results go to standard output, notes and progress to standard error. Exit status: 0 done, 1 the
input is bad (one line `error: …`), 2 wrong usage; as usual 130 after Ctrl-C and 141 where the
reader of standard output has gone. Files are written before results are printed, completely or not
at all; one that is an input of the command is refused."""


def commands() -> str:
    """A page in Markdown: every command with its usage, arguments and options."""
    group: Any = typer.main.get_command(app)
    with group.make_context("ident", [], resilient_parsing=True) as context:
        parts = ["# Commands", _prose(group.help or ""), COMMON]
        for name in group.list_commands(context):
            parts.append(_command(group.get_command(context, name), name, context))
    return "\n\n".join(parts) + "\n"


def _command(late: Any, name: str, parent: Any) -> str:
    with late.make_context(name, [], parent=parent, resilient_parsing=True) as context:
        command = context.command
        usage = command.get_usage(context).removeprefix("Usage: ").strip()
        records = [each.get_help_record(context) for each in command.get_params(context)]
    rows = [_row(*record) for record in records if record and "--help" not in record[0]]
    table = "\n".join(["| | |", "|---|---|", *rows])
    head = f"(command-{name})=\n## ident {name}"
    return "\n\n".join([head, f"```text\n{usage}\n```", _prose(command.help or ""), table])


def _row(written: str, meaning: str) -> str:
    """A line of the table: how it is written, and what it means."""
    written = re.sub(r" <.*>$", "", written)  # types, which the meaning says better
    meaning = meaning.replace("[required]", "")
    return f"| `{_cell(written)}` | {_cell(_escaped(meaning))} |"


def _prose(text: str) -> str:
    return "\n\n".join(" ".join(each.split()) for each in _escaped(text).split("\n\n"))


def _escaped(text: str) -> str:
    for sign in "<*[":
        text = text.replace(sign, f"\\{sign}")
    return text


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
