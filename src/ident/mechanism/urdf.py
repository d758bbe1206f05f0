"""A URDF's text parsed safely, checked with each fault named by its line, and changed in place.

XML from strangers may carry entity bombs and references to other files, so a document type is
refused before anything is expanded. A parser that writes a document again loses quotes, blanks
within tags, the declaration and ends of lines; here lxml says what an element is, and spans where
it is in the text.
"""

from __future__ import annotations

import codecs
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from lxml import etree

from ident.errors import MechanismError, one_of

TYPES = ("fixed", "revolute", "continuous", "prismatic", "planar")
FLOATING = (
    "an orientation cannot be written as one column a coordinate; state it as three prismatic and "
    "three revolute joints with massless links between them"
)


def parse_xml(data: bytes, where: str) -> etree._Element:
    """Return the root element of an XML text; nothing in it is expanded or fetched.

    Raises:
        MechanismError: if it has a document type, or is not well-formed.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise MechanismError(
            f"{where}: has a document type or entities, which are refused; remove <!DOCTYPE …>"
        )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        text = str(error).replace("\n", " ") or "empty file"
        text = text.partition(" (<string>")[0]
        raise MechanismError(
            f"{where}: is no well-formed XML: {text}; mend or export it again"
        ) from None
    if root.getroottree().docinfo.internalDTD is not None:
        raise MechanismError(f"{where}: has a document type, which is refused; remove it")
    return root


def parse_urdf(data: bytes, where: str) -> etree._Element:
    """Return the checked `<robot>` element of a URDF's text, comments included.

    Raises:
        MechanismError: naming file, line, what is wrong and what would be valid.
    """
    robot = parse_xml(data, where)
    if robot.tag != "robot":
        raise MechanismError(
            f"{where}:{robot.sourceline}: the root element is <{robot.tag}>; a URDF's is <robot> "
            "(a MuJoCo model is named .xml, an SDF .sdf)"
        )
    if not robot.get("name"):
        robot.set("name", "robot")
    _check_names(robot, where)
    _check_tree(robot, where)
    for joint in robot.findall("joint"):
        _check_joint(joint, where)
    for link in robot.findall("link"):
        _check_inertial(link, where)
    return robot


def _check_names(robot: etree._Element, where: str) -> None:
    for tag in ("link", "joint"):
        elements = robot.findall(tag)
        for element in elements:
            if not element.get("name"):
                raise MechanismError(
                    f'{where}:{element.sourceline}: a <{tag}> has no name; write name="…"'
                )
        seen: dict[str, int] = {}
        for element in elements:
            name = element.get("name")
            if name in seen:
                raise MechanismError(
                    f"{where}:{element.sourceline}: a second {tag} is named '{name}', the first is "
                    f"in line {seen[name]}; names must differ"
                )
            seen[name] = element.sourceline
    if not robot.findall("link"):
        raise MechanismError(f"{where}: has no <link>; a mechanism needs at least two and a joint")


def _check_tree(robot: etree._Element, where: str) -> None:
    links = [link.get("name") for link in robot.findall("link")]
    parents: dict[str, list[str]] = {}
    child_of: Counter[str] = Counter()
    for joint in robot.findall("joint"):
        ends = {}
        for end in ("parent", "child"):
            element = joint.find(end)
            name = None if element is None else element.get("link")
            line = joint.sourceline
            if not name:
                raise MechanismError(
                    f"{where}:{line}: joint '{joint.get('name')}' has no <{end} link=…>"
                )
            if name not in links and not (end == "parent" and name == "world"):
                raise MechanismError(
                    f"{where}:{line}: joint '{joint.get('name')}' has the {end} '{name}', "
                    f"which is no link; {one_of(name, links)}"
                )
            ends[end] = name
        child_of[ends["child"]] += 1
        if child_of[ends["child"]] > 1:
            raise MechanismError(
                f"{where}:{joint.sourceline}: link '{ends['child']}' is the child of two joints; "
                "a URDF is a tree: close the loop by a [[closure]] in mechanism.toml"
            )
        parents.setdefault(ends["parent"], []).append(ends["child"])
    roots = [name for name in dict.fromkeys([*parents, *links]) if child_of[name] == 0]
    if parents and not any(name in parents for name in roots):
        raise MechanismError(
            f"{where}: every joint's parent is another joint's child, so the links form a ring; "
            "one link must be the ground, and the loop closed by a [[closure]]"
        )
    reached, front = set(roots[:1]), roots[:1]
    while front:
        front = [child for link in front for child in parents.get(link, []) if child not in reached]
        reached.update(front)
    lost = [name for name in links if name not in reached]
    if lost:
        raise MechanismError(
            f"{where}: no joint leads from the root '{roots[0]}' to link '{lost[0]}'"
            + (f" and {len(lost) - 1} more" if len(lost) > 1 else "")
            + "; connect it by a joint (type fixed, if it does not move) or remove it"
        )


NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # as C++ reads it, too
HUGE = 1e30  # beyond, products overflow; only limits may be as large


def numbers(element: etree._Element, key: str, default: str, count: int, where: str) -> list[float]:
    """Return the `count` finite numbers of an attribute; a MechanismError shows its text."""
    text = element.get(key, default)
    values = [float(word) for word in text.split() if NUMBER.fullmatch(word)]
    most = HUGE if element.tag != "limit" else math.inf
    good = len(values) == len(text.split()) and all(abs(value) < most for value in values)
    if len(values) != count or not good:
        need = "a finite number" if count == 1 else f"{count} finite numbers"
        raise MechanismError(
            f'{where}:{element.sourceline}: <{element.tag} {key}="{text}">: {need} expected'
        )
    return values


def _check_joint(joint: etree._Element, where: str) -> None:
    name, kind, line = joint.get("name"), joint.get("type") or "", joint.sourceline
    if kind == "floating":
        raise MechanismError(f"{where}:{line}: joint '{name}' is of type floating: {FLOATING}")
    if kind not in TYPES:
        raise MechanismError(
            f"{where}:{line}: joint '{name}' is of type '{kind}'; {one_of(kind, TYPES)}"
        )
    for origin in joint.findall("origin"):
        numbers(origin, "xyz", "0 0 0", 3, where)
        numbers(origin, "rpy", "0 0 0", 3, where)
    axis = joint.find("axis")
    if kind != "fixed" and axis is not None:
        length = math.hypot(*numbers(axis, "xyz", "1 0 0", 3, where))
        if length < 1e-9:
            raise MechanismError(
                f"{where}:{axis.sourceline}: joint '{name}' has the axis 0 0 0; give a direction"
            )
    limit = joint.find("limit")
    if limit is not None:
        for key in ("effort", "velocity"):
            numbers(limit, key, "0", 1, where)
        lower = numbers(limit, "lower", "0", 1, where)[0]
        upper = numbers(limit, "upper", "0", 1, where)[0]
        if lower > upper:
            raise MechanismError(
                f"{where}:{limit.sourceline}: joint '{name}' has lower {lower:g} above upper "
                f"{upper:g}; swap them"
            )
    mimic = joint.find("mimic")
    if mimic is not None:
        numbers(mimic, "multiplier", "1", 1, where)
        numbers(mimic, "offset", "0", 1, where)
        if kind not in ("revolute", "continuous", "prismatic"):
            raise MechanismError(f"{where}:{line}: joint '{name}' of type {kind} cannot mimic")


def _check_inertial(link: etree._Element, where: str) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    name = link.get("name")
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    for element, tag in ((mass, "mass"), (inertia, "inertia")):
        if element is None:
            raise MechanismError(
                f"{where}:{inertial.sourceline}: the <inertial> of link '{name}' has no <{tag}>"
            )
    for origin in inertial.findall("origin"):
        numbers(origin, "xyz", "0 0 0", 3, where)
        numbers(origin, "rpy", "0 0 0", 3, where)
    for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
        numbers(inertia, key, "0" if key in ("ixy", "ixz", "iyz") else "", 1, where)
    value = numbers(mass, "value", "", 1, where)[0]
    if value < 0:
        raise MechanismError(
            f"{where}:{mass.sourceline}: link '{name}' has the mass {value:g} kg; it must be ≥ 0"
        )


# --- numbers changed in place --------------------------------------------------------------------

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
    """The place of one element; a tag that closes itself has inside = outside = end.

    Attributes:
        start: of its first tag.
        inside: behind its first tag.
        outside: of its last tag.
        end: behind its last tag.
        attributes: start and end of each value, without its quotes.
    """

    start: int
    inside: int
    outside: int
    end: int
    attributes: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class Change:
    """Bytes from `start` to `end` that become `new`."""

    start: int
    end: int
    new: bytes


def ascii_bytes(data: bytes) -> tuple[bytes, str | None]:
    """Return the text with tags in ASCII bytes, and the encoding it must go back to, if any."""
    for mark, encoding in WIDE:
        if data.startswith(mark):
            return data.decode(encoding).encode(), encoding
    return data, None


def spans_of(root: etree._Element, text: bytes, where: str) -> dict[etree._Element, Span]:
    """Return where every element of a document without a document type is in its text.

    Args:
        root: the text, parsed.
        text: from `ascii_bytes`.
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
    """Return the text with every change made; none may overlap another."""
    pieces, at = [], 0
    for change in sorted(changes, key=lambda c: c.start):
        pieces += [text[at : change.start], change.new]
        at = change.end
    return b"".join([*pieces, text[at:]])


def set_attributes(text: bytes, span: Span, values: Mapping[str, str]) -> list[Change]:
    """Return the changes that set attributes; new ones come behind the others."""
    changes = [
        Change(*span.attributes[name], value.encode())
        for name, value in values.items()
        if name in span.attributes
    ]
    new = "".join(f' {n}="{value}"' for n, value in values.items() if n not in span.attributes)
    at = span.start + len(text[span.start : span.inside - 1].removesuffix(b"/").rstrip())
    return [*changes, Change(at, at, new.encode())] if new else changes


def first_child(text: bytes, span: Span, lines: list[str]) -> Change:
    """Return the change that inserts an element's first child, indented as what is around it.

    Args:
        text: of the document.
        span: of the element, which may be one that closes itself.
        lines: of XML, indented by two blanks a level; written on one line where the text is.
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
    """Return the lines, each on a new one after `before`, or all on one where that is empty."""
    bare = [line.lstrip() for line in lines]
    if not before:
        return "".join(bare).encode()
    levels = [(len(line) - len(text)) // 2 for line, text in zip(lines, bare, strict=True)]
    return b"".join(before + n * step + t.encode() for n, t in zip(levels, bare, strict=True))


def removal(text: bytes, span: Span) -> Change:
    """Return the change that removes an element, and the line that it had for itself."""
    start = text.rfind(b"\n", 0, span.start)
    alone = start >= 0 and not text[start : span.start].strip()
    if alone and BLANK_LINE.match(text, span.end):
        start -= text[start - 1 : start] == b"\r"
        return Change(start, span.end, b"")
    return Change(span.start, span.end, b"")
