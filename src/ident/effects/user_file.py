"""Effects of one's own in Python files: `my_effects.py:bump:elbow`, `file = "my_effects.py"`."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path

from ident.effects.user import UserEffect, said
from ident.effects.user_kind import user_effect
from ident.errors import MechanismError, one_of
from ident.files import module_of


def parse_user(text: str) -> tuple[Path, str, tuple[str, ...]] | None:
    """`file.py:function:joint[,joint]` as (file, function, joints); None for anything else.

    Raises:
        MechanismError: if the function or a joint is missing.
    """
    stem, python, rest = text.partition(".py:")
    if not python and not text.endswith(".py"):
        return None
    name, _, joints = rest.partition(":")
    names = tuple(part.strip() for part in joints.split(","))
    if not name or not all(names):
        file = text if text.endswith(".py") else f"{stem}.py"
        raise MechanismError(
            f"effect '{text}': write file, function and joint: {file}:{name or 'function'}:joint"
        )
    return Path(f"{stem}.py"), name, names


def read_user_effect(
    file: Path, name: str, *, allow_code: bool, where: str = ""
) -> type[UserEffect]:
    """The kind of effect that a Python file's function `name` describes; runs the file.

    Args:
        file: to be run.
        name: of the function, and of the kind.
        allow_code: whether it may be run.
        where: begins the message of an error.

    Raises:
        MechanismError: if it may not or cannot be run, or has no such function.
    """
    before = f"{where}: " if where else ""
    if not allow_code:
        raise MechanismError(
            f"{before}effect '{name}' would run {file}; pass --allow-code (allow_code=True) if you "
            "trust it"
        )
    if not file.is_file():
        raise MechanismError(f"{before}effect '{name}': no such file: {file}; check the path")
    try:
        module = module_of(file)
    except (Exception, SystemExit) as error:  # it is the user's code
        raise MechanismError(f"{before}{file} fails: {said(error)}; mend it") from None
    functions = _functions(vars(module), module.__name__)
    if name not in functions:
        raise MechanismError(f"{before}{file} has no function '{name}'; {one_of(name, functions)}")
    return user_effect(name, functions[name], file)


def _functions(names: Mapping[str, object], module: str) -> dict:
    """Functions that a module defines itself."""
    return {
        key: each
        for key, each in names.items()
        if inspect.isfunction(each) and each.__module__ == module
    }
