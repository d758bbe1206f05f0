"""What is done of a long run, in a file from which the same run goes on.

The file is replaced whole; it holds numbers only, and the digest of all that the run depends on:
the mechanism, the logs, the settings, the plan made from them, and the version of ident.
"""

from __future__ import annotations

import hashlib
import json
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numpy as np
import pinocchio as pin

import ident
from ident.equations.point import Point
from ident.errors import IdentError
from ident.files import whole
from ident.fit.accumulate import Cell
from ident.gather.packed import packed, packed_stretches, unpacked, unpacked_stretches
from ident.gather.plan import Plan
from ident.gather.shapes import Step
from ident.solve.stretch import Stretch

NAME = ".gathered.npz"
PORTIONS, SECONDS = 8, 20.0  # after so many portions and so much time the file is replaced


@dataclass(frozen=True, eq=False)
class State:
    """What is done.

    Attributes:
        passed: passes over all portions before this one.
        step: that led to the point at which this one is made.
        absorbed: portions of this pass, from the first; cells: theirs.
        broken: by name of a log, why it is left out.
        stretches: by log, what these portions have left of its stack.
    """

    passed: int
    step: Step
    absorbed: int = 0
    cells: Sequence[Cell] = ()
    broken: Mapping[str, str] = field(default_factory=dict)
    stretches: Mapping[int, Stretch] = field(default_factory=dict)


class Checkpoint:
    """The file of a run, replaced now and then.

    Args:
        folder: that it is in, made if it is not there.
        plan: of the run.

    Attributes:
        file: its path.
        other: whether the file that was found is of another run.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.file = folder / NAME
        self.key = digest(plan)
        self.other = False
        self._saved = (0, time.monotonic())

    def read(self) -> State | None:
        """What an interrupted run of the same key has done; None where there is none."""
        try:
            with self.file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
                told = json.loads(str(arrays["told"]))
                if told["key"] == self.key:
                    return _state(told, arrays)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            pass
        self.other = True
        return None

    def due(self, absorbed: int) -> bool:
        """Whether enough was done since the file was replaced."""
        portions, since = self._saved
        return absorbed - portions >= PORTIONS and time.monotonic() - since >= SECONDS

    def write(self, state: State) -> None:
        """Replaces the file.

        Raises:
            IdentError: if it cannot be written.
        """
        told = {
            "key": self.key,
            "passed": state.passed,
            "absorbed": state.absorbed,
            "broken": dict(state.broken),
            "loss": state.step.loss,
            "moves": state.step.moves,
            "sigma": state.step.sigma is not None,
        }
        points = {"point": state.step.point, "best": state.step.best}
        told |= {name: list(point.values) for name, point in points.items() if point}
        numbers = {
            f"{name}.{part}": np.asarray(values, dtype=float)
            for name, point in points.items() if point
            for part, values in (("pi", point.pi), ("values", [*point.values.values()]))
        }  # fmt: skip
        if state.step.sigma is not None:
            numbers["sigma"] = state.step.sigma
        numbers |= packed(state.cells) | packed_stretches(state.stretches)
        numbers["told"] = np.array(json.dumps(told))
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with whole(self.file) as stream:
                np.savez(stream, allow_pickle=False, **numbers)
        except OSError as error:
            raise IdentError(
                f"{self.file}: cannot be written ({error.strerror}); name a folder that you may "
                "write"
            ) from None
        self._saved = (state.absorbed, time.monotonic())

    def remove(self) -> None:
        """Takes the file away, when all is done."""
        self.file.unlink(missing_ok=True)


def _state(told: dict[str, Any], arrays: Any) -> State:
    point, best = (
        Point(
            arrays[f"{name}.pi"],
            dict(zip(told[name], map(float, arrays[f"{name}.values"]), strict=True)),
        )
        if name in told else None
        for name in ("point", "best")
    )  # fmt: skip
    assert point is not None
    sigma = arrays["sigma"] if told["sigma"] else None
    step = Step(point, best, told["loss"], sigma, told["moves"])
    return State(
        told["passed"], step, told["absorbed"], unpacked(arrays), told["broken"],
        unpacked_stretches(arrays),
    )  # fmt: skip


def digest(plan: Plan) -> str:
    """Of all that the cells of a plan depend on, but for the working point."""
    found = hashlib.sha256(version().encode())
    _feed(found, [getattr(plan, each.name) for each in fields(plan) if each.name != "point"])
    return found.hexdigest()


def version() -> str:
    """Of ident."""
    return str(ident.__version__)


def _feed(found: Any, thing: Any) -> None:
    """Adds a plan's nouns to a digest, the arrays and numbers in them by their bytes."""
    found.update(type(thing).__name__.encode())
    if isinstance(thing, np.ndarray):
        found.update(repr(thing.shape).encode() + np.ascontiguousarray(thing).tobytes())
    elif isinstance(thing, pin.Model):
        found.update(thing.saveToString().encode())
    elif is_dataclass(thing):
        _feed(found, [getattr(thing, each.name) for each in fields(thing)])
        code = getattr(thing, "file", None)  # of an effect of one's own
        if isinstance(code, Path):
            found.update(code.read_bytes())
        elif (own := getattr(thing, "function", None)) is not None:
            _feed(found, own)
    elif isinstance(thing, Mapping):
        _feed(found, [*thing.items()])
    elif isinstance(thing, list | tuple):
        for each in thing:
            _feed(found, each)
    elif isinstance(thing, pin.SE3):
        _feed(found, thing.homogeneous)
    elif isinstance(thing, FunctionType):
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        _feed(found, [thing.__code__, thing.__defaults__, thing.__kwdefaults__, cells])
    elif isinstance(thing, CodeType):
        _feed(found, [thing.co_code, thing.co_names, thing.co_consts])
    else:
        found.update(repr(thing).encode())
