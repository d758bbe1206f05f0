"""A mechanism's file as a URDF: its own text, or what is written from a MuJoCo model or an SDF."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

from ident.description.check_urdf import numbers, parse_urdf, parse_xml
from ident.description.document import Source
from ident.description.mjcf import read_mjcf
from ident.description.sdf import read_sdf
from ident.errors import MechanismError

__all__ = ["LARGEST", "numbers", "parse_urdf", "read_source", "read_urdf", "urdf_bytes"]

LARGEST = 50_000_000  # bytes
READERS = {"mujoco": read_mjcf, "mujocoinclude": read_mjcf, "sdf": read_sdf}


def read_source(path: Path) -> Source:
    """What a file says: of a MuJoCo model or an SDF its bodies, joints and loops.

    Raises:
        MechanismError: if it cannot be read, is larger than any URDF, or says what has no
            counterpart here.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MechanismError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > LARGEST:
        raise MechanismError(f"{path}: {len(data)} bytes; a URDF has at most {LARGEST}")
    return source_of(data, path)


def source_of(data: bytes, path: Path) -> Source:
    """As `read_source`, of the file's content."""
    if path.suffix.lower() == ".urdf":
        return Source(data)
    root = parse_xml(data, str(path))
    reader = READERS.get(str(root.tag))
    return Source(data) if reader is None else reader(path, data)


def urdf_bytes(path: Path) -> bytes:
    """The URDF's text: the file's own, unchecked, or one written from another format.

    Raises:
        MechanismError: as `read_source`.
    """
    return read_source(path).urdf


def read_urdf(path: Path) -> etree._Element:
    """The checked `<robot>` element of a mechanism's file, comments kept.

    Raises:
        MechanismError: naming file, line, what is wrong and what would be valid.
    """
    return parse_urdf(urdf_bytes(path), str(path))
