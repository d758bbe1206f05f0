"""The reference of the Python API: every public name, and the classes that those return."""

from __future__ import annotations

import inspect
import re
import typing
from collections.abc import Callable, Iterator

import ident

GROUPS = {
    "From log to motion": ("load", "read_log", "complete", "absolute", "Mechanism", "Multipliers",
                           "Consistency", "Log", "Column", "Motion"),
    "Identify": ("identify", "Fit", "write_fit", "read_fit", "Saved"),
    "Compare": ("compare", "residual_of", "where", "Comparison", "Residual"),
    "Effects": ("effect", "effects", "user_effect", "read_user_effect", "Effect"),
    "Diagnosis": ("diagnose", "grow", "health", "Diagnosis", "History", "Health"),
    "Simulate": ("simulate", "integrate", "replay", "Noise", "PD", "ComputedTorque", "Torques",
                 "Run", "Replay"),
    "Plan and try": ("excite", "monte_carlo", "Limits", "Excitation", "MonteCarlo"),
    "Errors": ("IdentError", "LogError", "MechanismError", "MotionError", "FitError"),
}  # fmt: skip


DEPTH = 2  # levels of such classes
INNER = ("information", "equations")  # their classes are not needed to use the results


def reference() -> str:
    """Return the page in reStructuredText."""
    listed = [name for names in GROUPS.values() for name in names]
    rest = tuple(name for name in ident.__all__ if name not in listed)
    lines = [*_heading("Python reference", "="),
             "Shapes are in parentheses, units in brackets. ``import ident`` has all names down to "
             "`Further classes`_; :doc:`/python` has examples.", ""]  # fmt: skip
    for title, names in {**GROUPS, **({"More": rest} if rest else {})}.items():
        lines += _heading(title, "-")
        for name in (name for name in names if name in ident.__all__):
            lines += _entry("ident", name, getattr(ident, name))
    lines += _heading("Further classes", "-")
    lines += ["Attributes and return values of the classes above.", ""]
    for kind in within():
        lines += _entry(kind.__module__, kind.__qualname__, kind)
    return "\n".join(lines) + "\n"


def _heading(text: str, sign: str) -> list[str]:
    return [text, sign * len(text), ""]


def _entry(module: str, name: str, thing: object) -> list[str]:
    lines = [f".. py:currentmodule:: {module}", ""]
    if inspect.isclass(thing):
        role = "exception" if issubclass(thing, BaseException) else "class"
        lines += [f".. auto{role}:: {name}"]
        # of its base classes as well, such as `write`; not of Python's own
        own = ["   :members:", "   :inherited-members: object, dict, tuple"]
        lines += ["   :show-inheritance:"] if role == "exception" else own
    elif callable(thing):
        lines += [f".. autofunction:: {name}"]
    else:
        lines += [f".. py:data:: {name}", "", f"   A mapping of {len(thing)} kinds by name: "  # type: ignore[arg-type]
                  "see :doc:`/generated/library`."]  # fmt: skip
    return [*lines, ""]


def within() -> list[type]:
    """Return classes that public ones hold or return, directly or indirectly."""
    public = [getattr(ident, name) for name in ident.__all__]
    found: set[type] = set()
    level = [thing for thing in public if callable(thing)]
    for _ in range(DEPTH):
        level = [kind for thing in level for kind in _mentioned(thing) if kind not in public]
        found |= set(level)
    return sorted(found, key=lambda kind: kind.__name__.lower())


def _mentioned(thing: Callable) -> Iterator[type]:
    """Yield documented classes of ident in the annotations of attributes and return values."""
    hinted = [thing] if inspect.isclass(thing) else []
    returned = [] if inspect.isclass(thing) else [thing]
    if inspect.isclass(thing) and not issubclass(thing, BaseException):
        for name, member in vars(thing).items():
            if not name.startswith("_"):
                member = getattr(member, "fget", None) or getattr(member, "func", member)
                returned += [member] if inspect.isfunction(member) else []
    for each in hinted:
        for name, hint in _hints(each).items():
            if not name.startswith("_"):
                yield from _classes(hint)
    for each in returned:
        yield from _classes(_hints(each).get("return"))


def _hints(thing: object) -> dict[str, object]:
    try:
        return typing.get_type_hints(thing)
    except (NameError, TypeError):  # of names that only a type checker imports
        return {}


def _classes(hint: object) -> Iterator[type]:
    if inspect.isclass(hint) and _shown(hint):
        yield hint
    for part in typing.get_args(hint):
        yield from _classes(part)


def _shown(kind: type) -> bool:
    """Return whether it is a documented class for users, not one of the kernel."""
    package, _, rest = kind.__module__.partition(".")
    own = package == "ident" and rest.partition(".")[0] not in INNER
    return own and bool(kind.__doc__) and not kind.__name__.startswith("_")


LITERAL = re.compile(r"(`[^`]*`)")


def as_rst(lines: list[str]) -> list[str]:
    """Return a docstring in reStructuredText: `code` in two backticks, other signs escaped."""
    text = LITERAL.split("\n".join(lines))
    found = [
        f"`{part}`" if part.startswith("`") else re.sub(r"([\\*|]|_(?=\W|$))", r"\\\1", part)
        for part in text
    ]
    return "".join(found).split("\n")
