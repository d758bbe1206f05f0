"""The library of effects as `ident effects` and its page show it."""

from __future__ import annotations

import textwrap

from ident.effects import Effect, Unknown

SITS = {
    "joint": "any joint, a closure's own as well",
    "driven": "a driven joint",
    "mechanism": "the whole mechanism",
    "link": "a moving link",
    "closure": "a closure",
    "place": "<joint>.<x|y|z>, <closure>.<a|b>.<x|y|z> or <closure>.length",
}
WIDTH, INDENT = 96, 17


def facts(kind: type[Effect]) -> dict[str, list[str]]:
    """Return the description of a kind, lines by heading, without headings that have none."""
    effect = kind.example()
    how = {True: "a few values are tried", False: "from several starting values"}
    shapes = [f"{_parameter(x)}; searched: {how[x.discrete]}" for x in effect.shapes]
    lines = {
        "what": [kind.summary()],
        "torque": [kind.equation],
        "unknowns": [_parameter(unknown) for unknown in effect.unknowns],
        "shapes": shapes,
        "settings": [f"{name} = {value:g} by default" for name, value in kind.settings.items()],
        "sits on": [SITS[kind.sits] if effect.arity < 2 else f"{effect.arity} driven joints"],
        "signals": [", ".join(kind.signals)] if kind.signals else [],
        "needs": [f"{each} at the same joint" for each in kind.needs]
        + [f"the log's column {name.replace('joint1', '<joint>')}" for name in effect.reads()],
        "when missing": [kind.signature],
        "confused with": [", ".join(kind.confused_with) or "nothing"],
        "contained in": [", ".join(kind.nested_in)] if kind.nested_in else [],
        "source": [kind.source],
    }
    return {heading: each for heading, each in lines.items() if each}


def described(kind: type[Effect]) -> str:
    """Return the text of a kind for a terminal."""
    lines = [kind.example().call]
    for heading, each in facts(kind).items():
        for i, line in enumerate(each):
            first = f"  {heading if i == 0 else '':<{INDENT - 2}}"
            lines += textwrap.wrap(
                line, WIDTH, initial_indent=first, subsequent_indent=" " * INDENT
            )
    return "\n".join(lines)


def _parameter(parameter: Unknown) -> str:
    rotational, linear = parameter.units
    unit = rotational if rotational == linear else f"{rotational} | {linear}"
    sign = ", not negative" if parameter.nonnegative else ""
    return f"{parameter.name} [{unit}] {parameter.meaning}{sign}"
