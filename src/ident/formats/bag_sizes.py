"""How large compressed parts of a bag become, known before they are unpacked.

A few kilobytes of zstandard unpack to gigabytes. A part that states its size in the header of its
only frame cannot become larger; any other part is unpacked in pieces, which are counted and thrown
away. `rosbags` then unpacks one chunk of an MCAP file, or one message, at a time.
"""

from __future__ import annotations

import io
import sqlite3
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from ident.errors import LogError
from ident.files import most_bytes

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

# work: bytes of one chunk or message; recorders begin a new chunk at 4 MB
LARGEST_CHUNK = 256_000_000
PIECE = 1 << 20  # work: bytes that are unpacked at a time
LZ4_RATIO = 255  # level: bytes from one byte of LZ4, at most
MAGIC, CHUNK = b"\x89MCAP0\r\n", 0x06  # of MCAP


def check_expansion(path: Path) -> None:
    """Refuse a bag, a folder or one file, with a part that would take too much memory.

    Raises:
        LogError: with the part's size; what is no bag passes, its reader says so.
    """
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if not file.is_file():
            continue
        with file.open("rb") as stream:
            if stream.read(len(MAGIC)) == MAGIC:
                for compression, data in _chunks(stream):
                    _check(file, "a chunk", compression, data, LARGEST_CHUNK)
            elif file.suffix == ".zstd":
                stream.seek(0)
                _count(file, "it", zstd.ZstdFile(stream), most_bytes())
        if file.suffix == ".db3":
            for data in _messages(file):
                if data[:4] == b"\x28\xb5\x2f\xfd":  # zstandard's
                    _check(file, "a message", "zstd", data, LARGEST_CHUNK)


def _chunks(stream: BinaryIO) -> Iterator[tuple[str, bytes]]:
    """Yield compression and content of the chunks of an MCAP file, as far as it is whole."""
    while len(head := stream.read(9)) == 9:
        operation, length = head[0], struct.unpack("<Q", head[1:])[0]
        if operation == CHUNK and length >= 40:
            fixed = stream.read(32)  # times, size, checksum, length of the next word
            name = stream.read(min(struct.unpack("<I", fixed[28:])[0], length - 40))
            data = stream.read(length - 32 - len(name))[8:]
            if name:
                yield name.decode(errors="replace"), data
        else:
            stream.seek(length, 1)


def _messages(file: Path) -> Iterator[bytes]:
    try:
        connection = sqlite3.connect(f"{file.resolve().as_uri()}?immutable=1", uri=True)
        try:
            yield from (row[0] for row in connection.execute("SELECT data FROM messages"))
        finally:
            connection.close()
    except sqlite3.Error:
        return


def _check(file: Path, what: str, compression: str, data: bytes, most: int) -> None:
    if compression == "zstd":
        try:
            claim = zstd.get_frame_info(data).decompressed_size
            if claim is not None and claim <= most and zstd.get_frame_size(data) == len(data):
                return  # it cannot become more
        except zstd.ZstdError:
            return  # its reader says that it is damaged
        _count(file, what, zstd.ZstdFile(io.BytesIO(data)), most)
    elif compression == "lz4" and LZ4_RATIO * len(data) > most:
        import lz4.frame  # rosbags has it

        _count(file, what, lz4.frame.LZ4FrameFile(io.BytesIO(data)), most)


def _count(file: Path, what: str, stream: Any, most: int) -> None:
    total = 0
    try:
        while piece := stream.read(PIECE):
            if (total := total + len(piece)) > most:
                raise LogError(
                    f"{file}: {what} unpacks to more than {most / 1e6:,.0f} MB; record it again "
                    "in chunks of some MB, or without compression"
                )
    except (zstd.ZstdError, EOFError, RuntimeError, OSError):
        return  # damaged: its reader says so
