"""An XML file of the user, changed attribute by attribute: no other byte is touched.

Expat says where every tag begins; attributes are changed in the text of the tag itself.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from ident.errors import IdentError

ATTRIBUTE = r"(?s)(\s{name}\s*=\s*)(\"[^\"]*\"|'[^']*')"
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass(eq=False)
class Element:
    """An element of the file with the place of its first tag."""

    tag: str
    attributes: dict[str, str]
    start: int  # byte of its first tag's <
    end: int = 0  # byte behind its first tag's >
    close: int = 0  # byte of its last tag's <; that of the first one of an empty element
    empty: bool = False  # written as <tag/>
    line: int = 0
    parent: Element | None = field(default=None, repr=False)
    children: list[Element] = field(default_factory=list, repr=False)

    def find(self, tag: str) -> Element | None:
        """Return the first child of a tag."""
        return next((child for child in self.children if child.tag == tag), None)

    def iter(self, tag: str) -> list[Element]:
        """Return all elements of a tag at or below this one, in the order of the file."""
        own_element = [self] if self.tag == tag else []
        return own_element + [item for child in self.children for item in child.iter(tag)]


class XmlEdit:
    """A file with changes that are to be made in it."""

    def __init__(self, data: bytes, where: str) -> None:
        self.data, self.where = data, where
        self.changes: list[tuple[int, int, bytes]] = []  # from, to, new bytes
        self._new: dict[tuple[int, str], str] = {}  # attributes by tag's start and name
        self._inserted: dict[int, list[bytes]] = {}
        self.root = self._parsed()

    def _parsed(self) -> Element:
        parser = expat.ParserCreate()
        stack: list[Element] = []
        root: list[Element] = []
        data = self.data

        def opened(tag: str, attributes: dict[str, str]) -> None:
            at = parser.CurrentByteIndex
            element = Element(tag, dict(attributes), at, line=parser.CurrentLineNumber)
            element.end = _tag_end(data, at)
            element.empty = data[element.end - 2 : element.end] == b"/>"
            if stack:
                element.parent = stack[-1]
                stack[-1].children.append(element)
            else:
                root.append(element)
            stack.append(element)

        def closed(tag: str) -> None:
            element = stack.pop()
            element.close = element.start if element.empty else parser.CurrentByteIndex

        parser.StartElementHandler, parser.EndElementHandler = opened, closed
        try:
            parser.Parse(data, True)
        except expat.ExpatError as error:
            raise IdentError(f"{self.where}: is no valid XML: {error}; correct it") from None
        return root[0]

    def set(self, element: Element, name: str, value: str) -> None:
        """Give an attribute a value, unless the numbers of its text are the same."""
        old = element.attributes.get(name)
        if old is not None and (old == value or _same(old, value)):
            return
        self._new[(element.start, name)] = value
        element.attributes[name] = value

    def remove(self, element: Element, name: str) -> None:
        """Take an attribute away."""
        if name in element.attributes:
            self._new[(element.start, name)] = "\0"
            del element.attributes[name]

    def insert(
        self, parent: Element, tag: str, attributes: dict[str, str], last: bool = False
    ) -> None:
        """Add an empty element as the first (or last) child of another one, on its own line."""
        text = " ".join([tag, *(f"{name}={quoteattr(x)}" for name, x in attributes.items())])
        self.insert_text(parent, f"<{text}/>", last)

    def insert_text(self, parent: Element, text: str, last: bool = False) -> None:
        """Add the text of an element in the same way."""
        self._inserted.setdefault(parent.start * 2 + last, []).append(text.encode())

    def result(self) -> bytes:
        """Return the bytes of the changed file."""
        changes: list[tuple[int, int, bytes]] = []
        newline = b"\r\n" if b"\r\n" in self.data else b"\n"
        for element in _all(self.root):
            new = {n: x for (at, n), x in self._new.items() if at == element.start}
            first = self._inserted.get(element.start * 2, [])
            last = self._inserted.get(element.start * 2 + 1, [])
            if not (new or first or last):
                continue
            tag = self.data[element.start : element.end]
            for name, value in new.items():
                tag = _with_attribute(tag, name, value)
            indent = self._indent(element)
            step = self._step(element, indent)
            lines = b"".join(newline + indent + step + item for item in [*first, *last])
            if element.empty and lines:
                tag = tag[:-2].rstrip() + b">" + lines + newline + indent
                tag += b"</" + element.tag.encode() + b">"
                changes.append((element.start, element.end, tag))
                continue
            changes.append((element.start, element.end, tag))
            if first:
                text = b"".join(newline + indent + step + entry_ for entry_ in first)
                changes.append((element.end, element.end, text))
            if last:
                at = element.close
                before = len(self.data[:at].rstrip(b" \t"))
                lone = self.data[before - 1 : before] == b"\n"
                if lone:
                    text = b"".join(indent + step + each + newline for each in last)
                    changes.append((before, before, text))
                else:
                    text = b"".join(newline + indent + step + each for each in last)
                    changes.append((at, at, text + newline + indent))
        out, at = [], 0
        for start, end, text in sorted(changes, key=lambda change: (change[0], change[1])):
            out += [self.data[at:start], text]
            at = end
        return b"".join([*out, self.data[at:]])

    def _indent(self, element: Element) -> bytes:
        begin = self.data.rfind(b"\n", 0, element.start) + 1
        blank = self.data[begin : element.start]
        return blank if not blank.strip() else blank[: len(blank) - len(blank.lstrip())]

    def _step(self, element: Element, indent: bytes) -> bytes:
        if element.children:
            inner = self._indent(element.children[0])
            if inner.startswith(indent) and len(inner) > len(indent):
                return inner[len(indent) :]
        return b"\t" if indent.startswith(b"\t") else b"  "


def _all(element: Element) -> list[Element]:
    return [element] + [item for child in element.children for item in _all(child)]


def _tag_end(data: bytes, start: int) -> int:
    """Return the byte behind the > of a tag, which may stand within quotes before."""
    quote, at = 0, start
    while at < len(data):
        now = data[at]
        if quote:
            quote = 0 if now == quote else quote
        elif now in b"\"'":
            quote = now
        elif now == ord(">"):
            return at + 1
        at += 1
    return at


def _with_attribute(tag: bytes, name: str, value: str) -> bytes:
    text = tag.decode("utf-8", "surrogateescape")
    pattern = ATTRIBUTE.format(name=re.escape(name))
    if value == "\0":
        return re.sub(pattern, "", text, count=1).encode("utf-8", "surrogateescape")
    if result := re.search(pattern, text):
        quote = result[2][0]
        body = quoteattr(value)[1:-1]
        new = text[: result.start(2)] + quote + body + quote + text[result.end(2) :]
    else:
        end = -2 if text.endswith("/>") else -1
        head = text[:end].rstrip()
        new = f"{head} {name}={quoteattr(value)}{text[len(head) : len(text) + end]}{text[end:]}"
    return new.encode("utf-8", "surrogateescape")


def _same(old: str, new: str) -> bool:
    """Return whether two texts are the same numbers."""
    try:
        a, b = ([float(x) for x in text.split()] for text in (old, new))
    except ValueError:
        return False
    return a == b
