"""Tensors of a `.pt` file as a log: what sim-to-real tools write with torch.save.

The file is a ZIP with a pickle that says which tensors there are, and their numbers beside it. The
pickle is read with four names alone (tensors, their storages, ordered dictionaries), each of which
is a function of this file; any other name is refused, and torch is not needed. Format: PyTorch
documentation, Serialization semantics.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ident.errors import LogError
from ident.files import check_size
from ident.log.table import RawTable, table_of_arrays

STORAGES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8",
    "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "i1", "ByteStorage": "u1",
    "BoolStorage": "?", "BFloat16Storage": "bfloat16",
}  # fmt: skip
PICKLE = "data.pkl"  # its name in the archive
DEEPEST = 8  # work: of dictionaries and lists in each other
MOST_COLUMNS = 500  # work: of one tensor


class _Refused(Exception):
    """A name that is none of a tensor's."""


class _Reader(pickle.Unpickler):
    """Reads tensors; calls nothing but what is in this file."""

    def __init__(self, content: bytes, archive: zipfile.ZipFile, root: str) -> None:
        super().__init__(io.BytesIO(content))
        self.archive, self.root = archive, root
        self.storages = dict[str, np.ndarray]()  # by key: many tensors may be of one

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in (
            ("torch._utils", "_rebuild_tensor_v2"), ("torch._utils", "_rebuild_parameter"),
        ):  # fmt: skip
            return _tensor if name == "_rebuild_tensor_v2" else _parameter
        if module in ("torch", "torch.storage") and name in STORAGES:
            return STORAGES[name]
        if (module, name) == ("collections", "OrderedDict"):
            return _dictionary
        kind = ", a kind of number that is not read here; save x.float()"
        why = kind if name.endswith("Storage") else ", which is no tensor, and is not run"
        raise _Refused(f"{module}.{name}{why}")

    def persistent_load(self, pid: Any) -> np.ndarray:
        _, kind, key, _, count = pid
        key = str(key)
        if kind not in STORAGES.values() or "/" in key:
            raise ValueError("a storage has no kind or no name")
        if f"{kind} {key}" not in self.storages:
            with self.archive.open(f"{self.root}data/{key}") as stream:
                self.storages[f"{kind} {key}"] = _numbers(stream.read(), kind)
        x = self.storages[f"{kind} {key}"]
        if len(x) < int(count):
            raise ValueError("a storage is shorter than it says")
        return x


def _numbers(content: bytes, kind: str) -> np.ndarray:
    """Return the numbers of a storage; those of bfloat16 are the upper halves of float32."""
    if kind != "bfloat16":
        return np.frombuffer(content, np.dtype(kind))
    return (np.frombuffer(content, "<u2").astype("<u4") << 16).view("<f4")


def _dictionary(*_: Any) -> dict[Any, Any]:
    return {}


def _parameter(data: Any, *_: Any) -> Any:
    return data


def _tensor(
    storage: np.ndarray, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> np.ndarray:
    """Return a tensor of a storage, without a copy; its elements must lie in it, and be no more
    than it has.
    """
    size, stride = tuple(map(int, size)), tuple(map(int, stride))
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    count = int(np.prod(size, dtype=float)) if size else 1
    good = offset >= 0 and min(stride, default=0) >= 0 and min(size, default=0) >= 0
    if not good or count > len(storage) or (count and last >= len(storage)):
        raise ValueError("a tensor lies outside its storage")
    steps = tuple(step * storage.itemsize for step in stride)
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps, writeable=False)


def read_torch(path: Path) -> RawTable:
    """Read the tensors of a `.pt` file: (n,) a column, (n, m) columns `name.0` to `name.m-1`.

    Raises:
        LogError: for anything but tensors, numbers and text, by name; for a damaged file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            check_size(path, sum(entry.file_size for entry in archive.infolist()))
            names = [name for name in archive.namelist() if name.endswith(PICKLE)]
            if not names:
                raise LogError(f"{path}: no file of torch.save; write it with torch.save(dict, …)")
            root = names[0].removesuffix(PICKLE)
            content = _Reader(archive.read(names[0]), archive, root).load()
    except _Refused as error:
        raise LogError(
            f"{path}: holds {error}; save tensors alone: torch.save({{name: tensor, …}}, path)"
        ) from None
    except zipfile.BadZipFile:
        raise LogError(
            f"{path}: is no ZIP, so a pickle of an old torch.save, which is not run; save it again "
            "with torch 1.6 or newer, or as .npz"
        ) from None
    except LogError:
        raise
    except Exception as error:  # a pickle that was not written by torch.save may fail anywhere
        raise LogError(
            f"{path}: a damaged file of torch.save ({type(error).__name__}); write it again"
        ) from None
    arrays = _named(content, "", 0, set())
    check_size(path, 8 * sum(float(x.size) for x in arrays.values()))
    return table_of_arrays(str(path), columns_of(str(path), arrays))


def _named(content: Any, name: str, depth: int, visited: set[int]) -> dict[str, np.ndarray]:
    """Return the arrays of nested dictionaries and lists, by their keys with dots between; one that
    is in several places, or in itself, at the first alone, as there may be no end of its places.
    """
    if isinstance(content, np.ndarray):
        return {name or "data": content}
    if depth > DEEPEST or not isinstance(content, Mapping | list | tuple) or id(content) in visited:
        return {}  # a number, a text: a setting, no signal
    visited.add(id(content))
    items = content.items() if isinstance(content, Mapping) else enumerate(content)
    arrays = dict[str, np.ndarray]()
    for key, value in items:
        arrays |= _named(value, f"{name}.{key}" if name else str(key), depth + 1, visited)
    return arrays


def columns_of(file: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return arrays (n,) as they are and (n, m) as m columns `name.0` …; n is that of most.

    Arrays with another number of rows, such as a vector of gains, are left out.
    """
    rows = [len(x) for x in arrays.values() if x.ndim in (1, 2)]
    if not rows:
        raise LogError(f"{file}: holds no array of samples; valid: (n,) or (n, joints)")
    n = max(rows, key=rows.count)
    n = max(rows) if rows.count(n) == 1 else n
    columns = dict[str, np.ndarray]()
    for name, x in arrays.items():
        if x.ndim == 1 and len(x) == n:
            columns[name] = x
        elif x.ndim == 2 and len(x) == n and x.shape[1] <= MOST_COLUMNS:
            columns |= {
                f"{name}.{i}" if x.shape[1] > 1 else name: x[:, i] for i in range(x.shape[1])
            }
    return columns
