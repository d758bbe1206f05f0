"""What `ident effects` and the page of the library say of a kind, from the kind itself."""

from __future__ import annotations

import inspect
import textwrap

from ident.effects.base import Effect, Unknown
from ident.effects.library import KINDS
from ident.errors import MechanismError, one_of

SITS = {
    "joint": "any joint, a closure's own as well",
    "driven": "a driven joint",
    "mechanism": "the whole mechanism",
    "link": "a moving link",
    "closure": "a closure",
    "place": "<joint>.<x|y|z>, <closure>.<a|b>.<x|y|z> or <closure>.length",
}
WIDTH, INDENT = 96, 17


def example(kind: type[Effect]) -> Effect:
    """An effect of a kind, to be asked for what depends on its settings."""
    return kind(tuple(f"joint{i + 1}" for i in range(kind.arity)))


def kind_called(name: str) -> type[Effect]:
    """The kind of the library called `name`.

    Raises:
        MechanismError: if there is none, with the nearest name.
    """
    if name not in KINDS:
        raise MechanismError(f"there is no effect '{name}'; {one_of(name, KINDS)}")
    return KINDS[name]


def facts(kind: type[Effect]) -> dict[str, list[str]]:
    """All that can be said of a kind, lines by heading, nothing for what it does not have."""
    effect = example(kind)
    shapes = []
    for shape in effect.shapes:
        how = "both are tried" if shape.discrete else _plain(inspect.getdoc(kind.bounds))
        shapes.append(f"{_said(shape)}; searched: {how}")
    found = {
        "what": [_plain(inspect.getdoc(kind))],
        "torque": [kind.equation],
        "unknowns": [_said(unknown) for unknown in effect.unknowns],
        "shapes": shapes,
        "settings": [f"{name} = {value:g} by default" for name, value in kind.settings.items()],
        "sits on": [SITS[kind.sits] if kind.arity < 2 else f"{kind.arity} driven joints"],
        "needs": [f"{each} at the same joint" for each in kind.needs]
        + [f"the log's column {name.replace('joint1', '<joint>')}" for name in effect.reads()],
        "when missing": [kind.signature],
        "confused with": [", ".join(kind.confused_with) or "nothing"],
        "contained in": [", ".join(kind.nested_in)] if kind.nested_in else [],
        "source": [kind.source],
    }
    return {heading: lines for heading, lines in found.items() if lines}


def described(kind: type[Effect]) -> str:
    """A kind in words, as a terminal shows it."""
    lines = [example(kind).call]
    for heading, said in facts(kind).items():
        for i, line in enumerate(said):
            first = f"  {heading if i == 0 else '':<{INDENT - 2}}"
            lines += textwrap.wrap(
                line, WIDTH, initial_indent=first, subsequent_indent=" " * INDENT
            )
    return "\n".join(lines)


def table() -> str:
    """The library as a table in Markdown."""
    rows = ["| effect | torque | unknowns | shapes | sits on |", "|---|---|---|---|---|"]
    for kind in KINDS.values():
        effect, said = example(kind), facts(kind)
        cells = [
            f"`{effect.call}`",
            kind.equation,
            _names(effect.unknowns) if len(effect.unknowns) < 8 else "ten parameters of a body",
            _names(effect.shapes),
            *said["sits on"],
        ]
        safe = (cell.replace("|", "\\|").replace("<", "\\<") for cell in cells)
        rows.append(f"| {' | '.join(safe)} |")
    return "\n".join(rows)


def _names(parameters: tuple[Unknown, ...]) -> str:
    return ", ".join(each.name for each in parameters)


def _said(parameter: Unknown) -> str:
    turning, sliding = parameter.units
    unit = turning if turning == sliding else f"{turning} | {sliding}"
    sign = ", not negative" if parameter.nonnegative else ""
    return f"{parameter.name} [{unit}] {parameter.meaning}{sign}"


def _plain(doc: str | None) -> str:
    """The first paragraph of a docstring, to stand within a sentence."""
    text = " ".join((doc or "").split("\n\n")[0].split()).rstrip(".")
    return text[:1].lower() + text[1:]
