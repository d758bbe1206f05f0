"""What README.md and docs/ say is run: Python, commands and TOML."""

from __future__ import annotations

import re
import shlex
import shutil
import sys
import tomllib
from pathlib import Path

import matplotlib
import pytest
import typer

from ident.cli.app import app, main

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ROBOTS = sorted((ROOT / "robots").glob("*/README.md"))
ROWS = 1000  # samples of a log that commands of the pages need in order to run
RUNS = re.compile(r"(?<=--runs )\d+")  # of a simulation study, of which two show that it runs
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path, language: str) -> list[tuple[int, str]]:
    """(line of the fence, content) of every block in a language."""
    text = page.read_text(encoding="utf-8")
    return [
        (text.count("\n", 0, found.start()) + 1, found[2])
        for found in FENCE.finditer(text)
        if found[1] == language
    ]


def commands(page: Path) -> list[tuple[str, ...]]:
    """Arguments of every `ident …`, in sh blocks and in lines that are indented as code."""
    if page in ROBOTS:
        lines = [line for line in page.read_text().splitlines() if line.startswith("    ident ")]
    else:
        lines = [line for _, block in blocks(page, "sh") for line in block.splitlines()]
    lines = [RUNS.sub("2", line) for line in lines]
    parts = [shlex.split(part, comments=True) for line in lines for part in line.split("&&")]
    return [tuple(words[1:]) for words in parts if words and Path(words[0]).name == "ident"]


def named(items: list[tuple[Path, tuple[str, ...]]]) -> list:
    return [
        pytest.param(*item, id=f"{item[0].parent.name}/{item[0].name}: {' '.join(item[1])}")
        for item in items
    ]


ALL = [(page, words) for page in [*PAGES, *ROBOTS] for words in commands(page)]
SHIPPED = [item for item in ALL if any(word.startswith("robots/") for word in item[1])]


def short(page: Path) -> str:
    """Of the page, in a test's name."""
    return str(page.relative_to(ROOT))


@pytest.fixture
def checkout(tmp_path, monkeypatch) -> Path:
    """A folder to write in that has the robots of the checkout."""
    shutil.copytree(ROOT / "robots", tmp_path / "robots")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=short)
def test_python_runs(page, checkout):
    """One namespace a page; a failure names the page's own line."""
    matplotlib.use("Agg")
    names: dict[str, object] = {"__name__": page.stem}
    for line, block in blocks(page, "python"):
        exec(compile("\n" * line + block, str(page), "exec"), names)


def test_the_pages_have_what_is_tested_here():
    assert {p.name for p in PAGES if blocks(p, "python")} >= {
        "README.md",
        "consistency.md",
        "effects.md",
        "excitation.md",
        "large_logs.md",
        "look.md",
        "monitoring.md",
        "python.md",
        "simulation.md",
        "statistics.md",
        "tutorial.md",
    }
    assert {words[0] for _, words in ALL} >= {"check", "identify", "compare", "simulate"}
    assert len([page for page, _ in ALL if page in ROBOTS]) >= len(ROBOTS)


def test_the_library_is_the_table_of_its_page(monkeypatch):
    """Made by `overview` of docs/making/library.py: paste what it returns where this fails."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    from making.library import overview

    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert page.partition("<!-- library -->\n")[2].partition("\n<!-- end -->")[0] == overview()


@pytest.mark.parametrize(("page", "words"), named(ALL))
def test_commands_parse(page, words):
    """Command, options and their types; no file is looked at."""
    group = typer.main.get_command(app)
    command = group.commands[words[0]]  # type: ignore[attr-defined]
    command.make_context(words[0], list(words[1:]))


@pytest.mark.parametrize("page", dict.fromkeys(page for page, _ in SHIPPED), ids=short)
def test_commands_on_shipped_robots_run(page, checkout, monkeypatch, capsys):
    """In the page's order, since one may read what another wrote; on logs of ROWS samples."""
    for log in (checkout / "robots").glob("*/*.csv"):
        log.write_text("".join(log.read_text().splitlines(keepends=True)[: ROWS + 1]))
    for words in [words for where, words in SHIPPED if where == page]:
        monkeypatch.setattr(sys, "argv", ["ident", *words])
        assert status() == 0, (words, capsys.readouterr().err)
        assert capsys.readouterr().out or "--out" in words, words


def status() -> int:
    """How the command in sys.argv ends."""
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.mark.parametrize("page", PAGES, ids=short)
def test_toml_and_links_are_whole(page):
    """TOML parses, and relative links lead somewhere."""
    for _, block in blocks(page, "toml"):
        tomllib.loads(block)
    for target in re.findall(r"\]\((?!https?:)([^)#\s]+)", page.read_text(encoding="utf-8")):
        made = target.startswith("generated/")  # with the site, whose own test follows its links
        assert made or (page.parent / target).exists(), target


@pytest.mark.parametrize("page", [*PAGES, *ROBOTS], ids=lambda page: page.name)
def test_a_page_names_no_place_of_the_machine_that_wrote_it(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"/site-packages/|/(?:root|home)/", text)
    assert f"{ROOT}/" not in text
