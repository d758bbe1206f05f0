"""Pages to follow from top to bottom: files are written, commands run, outputs compared."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"`([\w./]+\.(?:urdf|toml|py))`:\s*\Z")  # what names the box below it
WALKS = ("tutorial.md", "own_mechanism.md")


def steps(page: Path) -> list[tuple[str, str, str]]:
    """("file", its path, content) and ("run", command, expected output) in the page's order."""
    text, found = page.read_text(encoding="utf-8"), []
    for box in FENCE.finditer(text):
        named = FILE.search(text[: box.start()])
        if named:
            found.append(("file", named[1], box[2]))
        elif box[1] == "sh":
            lines = [line for line in box[2].splitlines() if line.split()[0] in ("ident", "cat")]
            found += [("run", line, "") for line in lines]
        elif box[1] == "text" and text[: box.start()].endswith("```\n"):
            _, command, _ = found.pop()
            found.append(("run", command, box[2]))
    return found


def pattern(expected: str) -> str:
    """… stands for the rest of a line, or, alone, for any lines; spaces may be more or fewer."""
    parts = []
    for line in expected.splitlines():
        if line.strip() == "…":
            parts.append(r"(?:.*\n)*?")
        else:
            words = (r"[^\n]*?".join(map(re.escape, word.split("…"))) for word in line.split())
            parts.append(r" *" + r" +".join(words) + r" *\n")
    return "".join(parts)


@pytest.mark.parametrize("name", WALKS)
def test_a_page_can_be_followed(name, tmp_path, monkeypatch, spoken):
    monkeypatch.chdir(tmp_path)
    for kind, what, then in steps(DOCS / name):
        if kind == "file":
            Path(what).parent.mkdir(exist_ok=True)
            Path(what).write_text(then, encoding="utf-8")
            continue
        program, *words = shlex.split(what)
        if program == "cat":
            out = Path(words[0]).read_text(encoding="utf-8")
        else:
            status, out, err = spoken(*words)
            assert status == 0, (what, err)
        if then:
            assert re.fullmatch(pattern(then), out), f"{what}\n{out}"


def test_pages_are_walked():
    for name in WALKS:
        kinds = [kind for kind, _, then in steps(DOCS / name) if then]
        assert len(kinds) >= 4


@pytest.mark.parametrize(
    ("expected", "out", "fits"),
    [
        ("a … c\n", "a b c\n", True),
        ("a\n…\n", "a\nb\nc\n", True),
        ("a\n…\n", "b\nc\n", False),
        ("a 1.…\n", "a   1.23\n", True),
    ],
)
def test_what_an_ellipsis_stands_for(expected, out, fits):
    assert bool(re.fullmatch(pattern(expected), out)) is fits
