"""Pieces of HTML, made by the macros of `html/report.jinja`; words are escaped."""

from __future__ import annotations

import re
from functools import cache
from importlib import resources
from typing import Any

from markupsafe import Markup, escape

SHORT = 32  # characters of a cell that stays on one line
NUMBER = re.compile(r"[-−+≈<–]? ?\d")  # the beginning of one
POWER = re.compile(r"[-+\d.]*\de[-+]\d+")  # one that a browser would break at its last sign
TIED = r'<span class="tied">\g<0></span>'
CODE = re.compile(r"`([^`]*)`|(?<![\w-])--[a-z][\w-]*")  # or an option, which it would break too


def _whole(words: str) -> Markup:
    """Return words that a page does not break at their hyphens and slashes, but between them."""
    return Markup(
        re.sub(
            r"\S+",
            lambda word: word[0] if word[0].isalnum() else f"<span>{word[0]}</span>",
            str(escape(words)),
        )
    )


def _code(words: str) -> Markup:
    """Return words with what stands between backticks as code, and options on one line."""

    def marked(found: re.Match[str]) -> str:
        own = found[1]
        return found.expand(TIED) if own is None else f"<code>{_whole(Markup(own))}</code>"

    return Markup(CODE.sub(marked, str(escape(words))))


def _tied(cell: str) -> Markup:
    """Return a cell in which numbers, and all words of a short one, stay on one line."""
    tied = re.sub(" " if len(cell) <= SHORT else r"(?<=\d) ", "\u00a0", cell)
    return Markup(POWER.sub(TIED, str(escape(tied))))


@cache
def _macros() -> Any:
    from jinja2 import Environment

    def text_of(name: str) -> str:
        return resources.files("ident.show.html").joinpath(name).read_text(encoding="utf-8")

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.globals["text_of"] = lambda name: Markup(text_of(name))
    environment.filters |= {
        "code": _code,
        "whole": _whole,
        "tied": _tied,
        "worded": lambda rows: [
            not any(map(NUMBER.match, x)) for x in zip(*rows[1:], strict=False)
        ],
        "slug": lambda title: re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-"),
    }
    return environment.from_string(text_of("report.jinja")).module


def piece(macro: str, *content: Any, **options: Any) -> Markup:
    """Return what a macro of the template makes of a content."""
    return Markup(getattr(_macros(), macro)(*content, **options))
