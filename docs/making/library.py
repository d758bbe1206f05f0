"""The library of effects, one by one, with a picture of each signature."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ident.effects import KINDS, Unknown
from ident.show.laws import facts
from making.signatures import SHOWN, picture

PICTURES = "signatures"


def library(folder: Path) -> str:
    """A page in Markdown; its pictures are drawn into a folder below.

    Args:
        folder: of the page.
    """
    (folder / PICTURES).mkdir(parents=True, exist_ok=True)
    parts = [
        "# The library of effects",
        "What `ident effects KIND` prints, and what a residual looks like when the effect is "
        "missing: one motion, simulated with the effect and without, and the difference of the "
        "torques, with a little noise. [Effects](../effects.md) says how they are used, "
        "[the method](../method.md) how one that is missing is found.",
    ]
    for kind, each in KINDS.items():
        parts.append(f"(effect-{kind})=\n## {kind}")
        if kind in SHOWN:
            drawn = picture(kind)
            drawn.save(folder / PICTURES / f"{kind}.svg")
            parts.append(f"```{{image}} {PICTURES}/{kind}.svg\n:alt: {drawn.words}\n```")
        said = [("write", f"`{each.example().call}`")]
        said += [(h, "; ".join(map(_text, lines))) for h, lines in facts(each).items()]
        parts.append("\n".join(["| | |", "|---|---|", *(f"| {h} | {text} |" for h, text in said)]))
    return "\n\n".join(parts) + "\n"


def overview() -> str:
    """The library as a table in Markdown, for docs/effects.md."""
    rows = ["| effect | torque | unknowns | shapes | sits on |", "|---|---|---|---|---|"]
    for kind in KINDS.values():
        effect = kind.example()
        unknowns, shapes = map(_named, (effect.unknowns, effect.shapes))
        cells = [f"`{effect.call}`", kind.equation, unknowns, shapes, *facts(kind)["sits on"]]
        safe = (cell.replace("|", "\\|").replace("<", "\\<") for cell in cells)
        rows.append(f"| {' | '.join(safe)} |")
    return "\n".join(rows)


def _named(parameters: Sequence[Unknown]) -> str:
    """`k, b`; of more than five, the first and the last."""
    names = [each.name for each in parameters]
    return ", ".join(names if len(names) < 6 else [names[0], "…", names[-1]])


def _text(line: str) -> str:
    for sign in "\\*<|":
        line = line.replace(sign, f"\\{sign}")
    return line
