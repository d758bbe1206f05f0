"""Where the elements of an XML text stand, so that numbers in it change and nothing else does.

A parser that writes a document again loses what it does not keep: quotes, blanks within tags, the
declaration, ends of lines. Here lxml says what an element is, and these spans where it stands.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from lxml import etree

from ident.errors import MechanismError

TOKEN = re.compile(
    rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>"
    rb"|<(?P<close>/?)(?P<name>[^\s/>\"']+)(?P<rest>(?:[^\"'>]+|\"[^\"]*\"|'[^']*')*+)>",
    re.DOTALL,
)
ATTRIBUTE = re.compile(rb"([^\s=/\"'<>]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
BLANK_LINE = re.compile(rb"[ \t]*\r?\n")
WIDE = (  # encodings in which a letter is not its ASCII byte, by how a file of theirs begins
    (codecs.BOM_UTF32_LE, "utf-32-le"), (b"<\0\0\0", "utf-32-le"), (b"\0\0\0<", "utf-32-be"),
    (codecs.BOM_UTF32_BE, "utf-32-be"), (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"), (b"<\0", "utf-16-le"), (b"\0<", "utf-16-be"),
)  # fmt: skip


@dataclass(frozen=True)
class Span:
    """One element: `start` of its first tag, `inside` after that, `outside` before its last tag,
    `end` after that. A tag that closes itself has inside = outside = end.
    """

    start: int
    inside: int
    outside: int
    end: int
    attributes: Mapping[str, tuple[int, int]]  # where each value stands, without its quotes


@dataclass(frozen=True)
class Change:
    """Bytes from `start` to `end` that become `new`."""

    start: int
    end: int
    new: bytes


def ascii_bytes(data: bytes) -> tuple[bytes, str | None]:
    """The text with every tag in ASCII bytes, and the encoding it must go back to, if any."""
    for mark, encoding in WIDE:
        if data.startswith(mark):
            return data.decode(encoding).encode(), encoding
    return data, None


def spans_of(root: etree._Element, text: bytes, where: str) -> dict[etree._Element, Span]:
    """Where every element of a document without a document type stands in its text.

    Args:
        root: the text, parsed.
        text: as `ascii_bytes` gives it.
        where: names the file in messages.

    Raises:
        MechanismError: if text and elements do not agree, in an encoding whose tags are not ASCII.
    """
    elements = [element for element in root.iter() if isinstance(element.tag, str)]
    found = _scan(text)
    if len(found) != len(elements):
        raise MechanismError(
            f"{where}: its encoding cannot be written into; save it as UTF-8 and load it again"
        )
    return dict(zip(elements, found, strict=True))


def _scan(text: bytes) -> list[Span]:
    found: list[Span | None] = []
    opened: list[tuple[int, re.Match[bytes]]] = []
    for token in TOKEN.finditer(text):
        if token["name"] is None:
            continue
        if token["close"]:
            if opened:
                index, first = opened.pop()
                found[index] = _span(first, token.start(), token.end())
        elif token["rest"].endswith(b"/"):
            found.append(_span(token, token.end(), token.end()))
        else:
            opened.append((len(found), token))
            found.append(None)
    return [span for span in found if span is not None]


def _span(first: re.Match[bytes], outside: int, end: int) -> Span:
    at = first.start("rest")
    attributes = {}
    for each in ATTRIBUTE.finditer(first["rest"]):
        begin, stop = each.span(2 if each[2] is not None else 3)
        attributes[each[1].decode("latin-1")] = (at + begin, at + stop)
    return Span(first.start(), first.end(), outside, end, attributes)


def changed(text: bytes, changes: Iterable[Change]) -> bytes:
    """The text with every change made; none may overlap another."""
    pieces, at = [], 0
    for change in sorted(changes, key=lambda c: c.start):
        pieces += [text[at : change.start], change.new]
        at = change.end
    return b"".join([*pieces, text[at:]])


def set_attributes(text: bytes, span: Span, values: Mapping[str, str]) -> list[Change]:
    """Attributes' new values; those that are not there come behind the others."""
    changes = [
        Change(*span.attributes[name], value.encode())
        for name, value in values.items()
        if name in span.attributes
    ]
    new = "".join(f' {n}="{value}"' for n, value in values.items() if n not in span.attributes)
    at = span.start + len(text[span.start : span.inside - 1].removesuffix(b"/").rstrip())
    return [*changes, Change(at, at, new.encode())] if new else changes


def first_child(text: bytes, span: Span, lines: list[str]) -> Change:
    """Lines of XML that become an element's first child, indented as what is around them.

    Args:
        text: of the document.
        span: of the element, which may be one that closes itself.
        lines: indented by two blanks a level; what stands on one line stays on one.
    """
    end = b"\r\n" if b"\r\n" in text else b"\n"
    outer = text[text.rfind(b"\n", 0, span.start) + 1 : span.start]
    step = b"\t" if outer.startswith(b"\t") else b"  "
    if span.inside < span.end:
        content = text[span.inside : span.outside]
        blank = content[: len(content) - len(content.lstrip())]
        inner = blank.rpartition(b"\n")[2] if content.strip() else outer + step
        added = _indented(lines, end + inner if b"\n" in blank else b"", step)
        return Change(span.inside, span.inside, added)
    alone = not outer.strip() and b"\n" in text[: span.start]
    added = _indented(lines, end + outer + step if alone else b"", step)
    tag = text[span.start : span.end - 2].rstrip()
    last = (end + outer if alone else b"") + b"</" + tag[1:].split(None, 1)[0] + b">"
    return Change(span.start + len(tag), span.end, b">" + added + last)


def _indented(lines: list[str], before: bytes, step: bytes) -> bytes:
    """The lines, each on a new one after `before`, or all on one where that is empty."""
    bare = [line.lstrip() for line in lines]
    if not before:
        return "".join(bare).encode()
    levels = [(len(line) - len(text)) // 2 for line, text in zip(lines, bare, strict=True)]
    return b"".join(before + n * step + t.encode() for n, t in zip(levels, bare, strict=True))


def removal(text: bytes, span: Span) -> Change:
    """The element gone, and with it the line that it had for itself."""
    start = text.rfind(b"\n", 0, span.start)
    alone = start >= 0 and not text[start : span.start].strip()
    if alone and BLANK_LINE.match(text, span.end):
        start -= text[start - 1 : start] == b"\r"
        return Change(start, span.end, b"")
    return Change(span.start, span.end, b"")
