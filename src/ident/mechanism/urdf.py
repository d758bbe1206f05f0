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
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

from lxml import etree

from ident.errors import MechanismError, one_of
from ident.mechanism.toml import HUGE

TYPES = ("fixed", "revolute", "continuous", "prismatic", "planar")
FLOATING = (
    "an orientation cannot be written as one column a coordinate; state it as three prismatic and "
    "three revolute joints with massless links between them"
)
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # as C++ reads it, too
PRODUCTS = ("ixy", "ixz", "iyz")


def parse_xml(data: bytes, where: str) -> etree._Element:
    """Return the root element of an XML text; nothing in it is expanded or fetched."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise MechanismError(
            f"{where}: has a document type or entities, which are refused; remove <!DOCTYPE …>"
        )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        text = str(error).replace("\n", " ").partition(" (<string>")[0] or "empty file"
        raise MechanismError(
            f"{where}: is no well-formed XML: {text}; mend or export it again"
        ) from None
    if root.getroottree().docinfo.internalDTD is not None:
        raise MechanismError(f"{where}: has a document type, which is refused; remove it")
    return root


def parse_urdf(data: bytes, where: str) -> etree._Element:
    """Return the checked `<robot>` element of a URDF's text, comments included."""
    robot = parse_xml(data, where)
    if robot.tag != "robot":
        refuse(
            robot, where, f"the root element is <{robot.tag}>; a URDF's is <robot> (a MuJoCo model "
            "is named .xml, an SDF .sdf)",
        )  # fmt: skip
    if not robot.get("name"):
        robot.set("name", "robot")
    _check_names(robot, where)
    _check_tree(robot, where)
    for joint in robot.findall("joint"):
        _check_joint(joint, where)
    for link in robot.findall("link"):
        _check_inertial(link, where)
    return robot


def numbers(element: etree._Element, key: str, default: str, count: int, where: str) -> list[float]:
    """Return the `count` finite numbers of an attribute; a MechanismError shows its text."""
    text = element.get(key, default)
    values = [float(word) for word in text.split() if NUMBER.fullmatch(word)]
    most = HUGE if element.tag != "limit" else math.inf  # a limit may be as large
    good = len(values) == len(text.split()) and all(abs(value) < most for value in values)
    if len(values) != count or not good:
        need = "a finite number" if count == 1 else f"{count} finite numbers"
        refuse(element, where, f'<{element.tag} {key}="{text}">: {need} expected')
    return values


def refuse(element: etree._Element, where: str, message: str) -> NoReturn:
    """Raise MechanismError with the line of an element."""
    raise MechanismError(f"{where}:{element.sourceline}: {message}")


def _check_names(robot: etree._Element, where: str) -> None:
    for tag in ("link", "joint"):
        first: dict[str, int] = {}
        for element in robot.findall(tag):
            name = element.get("name")
            if not name:
                refuse(element, where, f'a <{tag}> has no name; write name="…"')
            if name in first:
                refuse(
                    element, where, f"a second {tag} is named '{name}', the first is in line "
                    f"{first[name]}; names must differ",
                )  # fmt: skip
            first[name] = element.sourceline
    if robot.find("link") is None:
        raise MechanismError(f"{where}: has no <link>; a mechanism needs at least two and a joint")


def _check_tree(robot: etree._Element, where: str) -> None:
    links = [link.get("name") for link in robot.findall("link")]
    parent_of: dict[str, str] = {}
    for joint in robot.findall("joint"):
        name, ends = joint.get("name"), {}
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if not link:
                refuse(joint, where, f"joint '{name}' has no <{end} link=…>")
            if link not in links and not (end == "parent" and link == "world"):
                refuse(
                    joint, where, f"joint '{name}' has the {end} '{link}', which is no link; "
                    f"{one_of(link, links)}",
                )  # fmt: skip
            ends[end] = link
        if ends["child"] in parent_of:
            refuse(
                joint, where, f"link '{ends['child']}' is the child of two joints; a URDF is a "
                "tree: close the loop by a [[closure]] in mechanism.toml",
            )  # fmt: skip
        parent_of[ends["child"]] = ends["parent"]
    roots = [name for name in dict.fromkeys([*parent_of.values(), *links]) if name not in parent_of]
    if parent_of and not set(roots) & set(parent_of.values()):
        raise MechanismError(
            f"{where}: every joint's parent is another joint's child, so the links form a ring; "
            "one link must be the ground, and the loop closed by a [[closure]]"
        )
    connected: set[str | None] = set(roots[:1])
    while more := {child for child, parent in parent_of.items() if parent in connected} - connected:
        connected |= more
    separate = [name for name in links if name not in connected]
    if separate:
        raise MechanismError(
            f"{where}: no joint leads from the root '{roots[0]}' to link '{separate[0]}'"
            + (f" and {len(separate) - 1} more" if len(separate) > 1 else "")
            + "; connect it by a joint (type fixed, if it does not move) or remove it"
        )


def _check_joint(joint: etree._Element, where: str) -> None:
    name, kind = joint.get("name"), joint.get("type") or ""
    if kind == "floating":
        refuse(joint, where, f"joint '{name}' is of type floating: {FLOATING}")
    if kind not in TYPES:
        refuse(joint, where, f"joint '{name}' is of type '{kind}'; {one_of(kind, TYPES)}")
    _check_origins(joint, where)
    axis = joint.find("axis")
    xyz = [1.0] if kind == "fixed" or axis is None else numbers(axis, "xyz", "1 0 0", 3, where)
    if math.hypot(*xyz) < 1e-9:
        refuse(axis, where, f"joint '{name}' has the axis 0 0 0; give a direction")
    limit = joint.find("limit")
    if limit is not None:
        lower, upper, *_ = (
            numbers(limit, key, "0", 1, where)[0]
            for key in ("lower", "upper", "effort", "velocity")
        )
        if lower > upper:
            refuse(
                limit, where, f"joint '{name}' has lower {lower:g} above upper {upper:g}; swap them"
            )
    mimic = joint.find("mimic")
    if mimic is not None:
        numbers(mimic, "multiplier", "1", 1, where)
        numbers(mimic, "offset", "0", 1, where)
        if kind not in ("revolute", "continuous", "prismatic"):
            refuse(joint, where, f"joint '{name}' of type {kind} cannot mimic")


def _check_origins(element: etree._Element, where: str) -> None:
    for origin in element.findall("origin"):
        numbers(origin, "xyz", "0 0 0", 3, where)
        numbers(origin, "rpy", "0 0 0", 3, where)


def _check_inertial(link: etree._Element, where: str) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    name, mass, inertia = link.get("name"), inertial.find("mass"), inertial.find("inertia")
    for element, tag in ((mass, "mass"), (inertia, "inertia")):
        if element is None:
            refuse(inertial, where, f"the <inertial> of link '{name}' has no <{tag}>")
    _check_origins(inertial, where)
    for key in ("ixx", "iyy", "izz", *PRODUCTS):
        numbers(inertia, key, "0" if key in PRODUCTS else "", 1, where)
    value = numbers(mass, "value", "", 1, where)[0]
    if value < 0:
        refuse(mass, where, f"link '{name}' has the mass {value:g} kg; it must be ≥ 0")


# --- numbers changed in place --------------------------------------------------------------------

TOKEN = re.compile(
    r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>"
    r"|<(?P<close>/?)(?P<name>[^\s/>\"']+)(?P<rest>(?:[^\"'>]+|\"[^\"]*\"|'[^']*')*+)>",
    re.DOTALL,
)
ATTRIBUTE = re.compile(r"([^\s=/\"'<>]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
BLANK_LINE = re.compile(r"[ \t]*\r?\n")
WIDE = {  # decoded so that the mark, too, is written again
    codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be",
}  # fmt: skip


@dataclass(frozen=True)
class Span:
    """The place of one element in the text; a tag that closes itself has inside = outside = end."""

    start: int  # of its first tag
    inside: int  # behind its first tag
    outside: int  # of its last tag
    end: int  # behind its last tag


class UrdfText:
    """A URDF in which attributes and elements change, and no other byte does.

    Attributes:
        robot: the checked root element, by whose elements changes are asked for.

    Raises:
        MechanismError: if it is no URDF, or in an encoding that cannot be written into.
    """

    def __init__(self, data: bytes, where: str) -> None:
        self.robot = parse_urdf(data, where)
        encoding = self.robot.getroottree().docinfo.encoding or "utf-8"
        self.encoding = next((WIDE[mark] for mark in WIDE if data.startswith(mark)), encoding)
        elements = [each for each in self.robot.iter() if isinstance(each.tag, str)]
        try:
            self.text = data.decode(self.encoding)
            spans = _spans(self.text) if self.text.encode(self.encoding) == data else []
        except (LookupError, UnicodeError):
            spans = []
        if len(spans) != len(elements):
            raise MechanismError(
                f"{where}: its encoding cannot be written into; save it as UTF-8 and load it again"
            )
        self.spans = dict(zip(elements, spans, strict=True))
        self.changes: list[tuple[int, int, str]] = []  # start, end, and what is there instead

    def encoded(self) -> bytes:
        """Return the text with every change made."""
        pieces, at = [], 0
        for start, end, new in sorted(self.changes, key=lambda change: change[0]):
            pieces += [self.text[at:start], new]
            at = end
        return "".join([*pieces, self.text[at:]]).encode(self.encoding)

    def set(self, element: etree._Element, values: Mapping[str, str]) -> None:
        """Set attributes; new ones come behind the others."""
        span, rest = self.spans[element], dict(values)
        for match in ATTRIBUTE.finditer(self.text, span.start, span.inside):
            if match[1] in rest:
                self.changes.append(
                    (*match.span(2 if match[2] is not None else 3), rest.pop(match[1]))
                )
        tag = self.text[span.start : span.inside - 1].removesuffix("/").rstrip()
        at = span.start + len(tag)
        if rest:
            self.changes.append((at, at, "".join(f' {n}="{x}"' for n, x in rest.items())))

    def insert(self, element: etree._Element, lines: list[str]) -> None:
        """Insert an element's first child, indented as what is around it.

        Args:
            element: which may be one that closes itself.
            lines: of XML, indented by two blanks a level; written on one line where the text is.
        """
        text, span = self.text, self.spans[element]
        end = "\r\n" if "\r\n" in text else "\n"
        outer = text[text.rfind("\n", 0, span.start) + 1 : span.start]
        step = "\t" if outer.startswith("\t") else "  "
        if span.inside < span.end:
            content = text[span.inside : span.outside]
            blank = content[: len(content) - len(content.lstrip())]
            inner = blank.rpartition("\n")[2] if content.strip() else outer + step
            added = _indented(lines, end + inner if "\n" in blank else "", step)
            self.changes.append((span.inside, span.inside, added))
            return
        alone = not outer.strip() and "\n" in text[: span.start]
        added = _indented(lines, end + outer + step if alone else "", step)
        tag = text[span.start : span.end - 2].rstrip()
        last = (end + outer if alone else "") + "</" + tag[1:].split(None, 1)[0] + ">"
        self.changes.append((span.start + len(tag), span.end, ">" + added + last))

    def remove(self, element: etree._Element) -> None:
        """Remove an element, and the line that it had for itself."""
        text, span = self.text, self.spans[element]
        start = text.rfind("\n", 0, span.start)
        if start >= 0 and not text[start : span.start].strip() and BLANK_LINE.match(text, span.end):
            start -= text[start - 1 : start] == "\r"
        else:
            start = span.start
        self.changes.append((start, span.end, ""))


def _spans(text: str) -> list[Span]:
    spans: dict[int, Span] = {}
    opened: list[re.Match[str]] = []
    for token in TOKEN.finditer(text):
        if token["name"] is None:
            continue
        if token["close"]:
            if opened:
                first = opened.pop()
                spans[first.start()] = Span(first.start(), first.end(), token.start(), token.end())
        elif token["rest"].endswith("/"):
            spans[token.start()] = Span(token.start(), token.end(), token.end(), token.end())
        else:
            opened.append(token)
    return [spans[start] for start in sorted(spans)]


def _indented(lines: list[str], before: str, step: str) -> str:
    if not before:
        return "".join(line.lstrip() for line in lines)
    levels = [(len(line) - len(line.lstrip())) // 2 for line in lines]
    return "".join(before + n * step + x.lstrip() for n, x in zip(levels, lines, strict=True))
