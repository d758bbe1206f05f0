"""A file with the progress of a long run, from which the same run goes on after it was killed.

The file is replaced whole. It holds JSON and one vector of numbers, and a digest of all that the
run depends on: the mechanism, the logs, the settings, the plan made from them, and ident's version.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np
import pinocchio as pin

from ident.errors import IdentError, line_of
from ident.files import atomic_write, regular
from ident.information.blocks import Block
from ident.information.triangle import Triangle
from ident.log.storage import check_claims
from ident.streams.portions import Plan
from ident.version import version

NAME = ".gathered.npz"
PORTIONS, SECONDS = 8, 20.0  # after so many portions and so much time the file is replaced


@dataclass(frozen=True, eq=False)
class Progress:
    """Progress of a run."""

    absorbed: int  # portions, from the first
    blocks: Sequence[Block]  # their sum
    broken: Mapping[str, str]  # reason by name of a log


NOUNS = {c.__name__: c for c in (Progress, Block, Triangle)}


class Checkpoint:
    """The file of a run, replaced now and then.

    Attributes:
        file: its path.
        unused: why the file that was found is not used; empty where it is, or there is none.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.file = folder / NAME
        self.key = digest(plan)
        self.unused = ""
        self._saved = (0, time.monotonic())

    def read(self) -> Progress | None:
        """Return the progress of an interrupted run of the same key; None where there is none."""
        try:
            with regular(self.file).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                check_claims(arrays, self.file)
                text = json.loads(str(arrays["text"]))
                if text["key"] == self.key:
                    result = _unpacked(text["progress"], arrays["numbers"])
                    assert isinstance(result, Progress)
                    return result
                self.unused = "of another mechanism, log, settings or version"
        except FileNotFoundError:
            pass
        except Exception as error:  # damaged bytes make readers fail in any way
            self.unused = f"broken ({line_of(error)})"
        return None

    def due(self, absorbed: int) -> bool:
        """Whether enough was done since the file was replaced."""
        portions, since = self._saved
        return absorbed - portions >= PORTIONS and time.monotonic() - since >= SECONDS

    def write(self, progress: Progress) -> None:
        """Replace the file."""
        numbers: list[np.ndarray] = [np.empty(0)]
        text = json.dumps({"key": self.key, "progress": _packed(progress, numbers)})
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(self.file) as stream:
                np.savez(stream, allow_pickle=False, text=text, numbers=np.concatenate(numbers))
        except OSError as error:
            raise IdentError(
                f"{self.file}: cannot be written ({error.strerror}); name a folder that you may "
                "write"
            ) from None
        self._saved = (progress.absorbed, time.monotonic())

    def remove(self) -> None:
        """Remove the file, when all is done."""
        self.file.unlink(missing_ok=True)


def _packed(thing: Any, numbers: list[np.ndarray]) -> Any:
    """Return a noun as JSON; its arrays, named by shape and type, are appended to `numbers`."""
    if isinstance(thing, np.ndarray):
        numbers.append(thing.ravel().astype(float))
        return {"shape": thing.shape, "type": thing.dtype.str}
    if isinstance(thing, Mapping):
        return {"pairs": [[key, _packed(each, numbers)] for key, each in thing.items()]}
    if (name := type(thing).__name__) in NOUNS:
        values = [_packed(getattr(thing, each.name), numbers) for each in fields(thing)]
        return {"noun": name, "values": values}
    if isinstance(thing, list | tuple):
        return [_packed(each, numbers) for each in thing]
    return thing.item() if isinstance(thing, np.generic) else thing


def _unpacked(text: Any, numbers: np.ndarray) -> Any:
    """Return what `_packed` made JSON and numbers of."""
    at = 0

    def unpack(text: Any) -> Any:
        nonlocal at
        if isinstance(text, list):
            return tuple(map(unpack, text))
        if not isinstance(text, dict):
            return text
        if "noun" in text:
            return NOUNS[text["noun"]](*map(unpack, text["values"]))
        if "pairs" in text:
            return {key: unpack(each) for key, each in text["pairs"]}
        size = int(np.prod(text["shape"]))
        array = numbers[at : at + size].astype(text["type"]).reshape(text["shape"])
        array.flags.writeable = False
        at += size
        return array

    return unpack(text)


def digest(plan: Plan) -> str:
    """Digest all that the triangles of a plan depend on."""
    result = hashlib.sha256(version().encode())
    _feed(result, plan)
    return result.hexdigest()


def _feed(result: Any, thing: Any) -> None:
    """Add a plan's nouns to a digest, the arrays and numbers in them by their bytes."""
    result.update(type(thing).__name__.encode())
    if isinstance(thing, np.ndarray):
        result.update(repr(thing.shape).encode() + np.ascontiguousarray(thing).tobytes())
    elif isinstance(thing, pin.Model):
        result.update(thing.saveToString().encode())
    elif is_dataclass(thing):
        _feed(result, [getattr(thing, each.name) for each in fields(thing)])
        code = getattr(thing, "file", None)  # of a user's effect
        if isinstance(code, Path):
            result.update(code.read_bytes())
        elif (own := getattr(thing, "function", None)) is not None:
            _feed(result, own)
    elif isinstance(thing, Mapping):
        _feed(result, [*thing.items()])
    elif isinstance(thing, list | tuple):
        for each in thing:
            _feed(result, each)
    elif isinstance(thing, pin.SE3):
        _feed(result, thing.homogeneous)
    elif isinstance(thing, partial):
        _feed(result, [thing.func, thing.args, thing.keywords])
    elif isinstance(thing, FunctionType):
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        _feed(result, [thing.__code__, thing.__defaults__, thing.__kwdefaults__, cells])
    elif isinstance(thing, CodeType):
        _feed(result, [thing.co_code, thing.co_names, thing.co_consts])
    else:
        result.update(repr(thing).encode())
