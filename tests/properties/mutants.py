"""Changes at random of what a run is given: of bytes, words, numbers, elements, columns, options.

A mutant is a function of (random numbers, folder of the base's files) that changes these files and
returns what it did in words; its name is in `MUTANTS`, by the file that it changes.
"""

from __future__ import annotations

import io
import json
import re
import sys
import tomllib
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import polars as pl
import tomlkit
from lxml import etree
from tomlkit.exceptions import TOMLKitError

import ident

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "formats"))
from formats import MJCF

Mutant = Callable[[Random, Path], str]
NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
WORD = re.compile(rb"[A-Za-z_]\w+")
VALUES = (
    "0", "-1", "1e308", "-1e308", "1e-308", "1e20", "1e9", "-7", "nan", "inf", "-inf", "", "abc",
    "1,5", "0x10", "1e400", "9" * 400, "1_000", "true", "[]", "{}", "null", '"', "--", "5%", "ℵ",
)  # fmt: skip
FACTORS = (-1.0, 1e-3, 1e3, 0.1, 10.0, 57.29577951308232, 0.5, 1.05, 1e12)


def urdf_of(folder: Path) -> Path:
    return next(folder.glob("*.urdf"))


# --- bytes and text ------------------------------------------------------------------------------


def _flip(random: Random, data: bytes) -> bytes:
    at = random.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :]


def _cut(random: Random, data: bytes) -> bytes:
    a, b = sorted(random.randrange(len(data)) for _ in range(2))
    return data[:a] + data[min(b, a + random.choice((1, 5, 80, len(data)))) :]


def _twice(random: Random, data: bytes) -> bytes:
    a = random.randrange(len(data))
    part = data[a : a + random.choice((1, 20, 500))]
    return data[:a] + part + data[a:]


def _noise(random: Random, data: bytes) -> bytes:
    at = random.randrange(len(data))
    return data[:at] + random.randbytes(random.choice((1, 4, 64))) + data[at:]


def _end(random: Random, data: bytes) -> bytes:
    return data[: random.randrange(len(data))]


def _lines(random: Random, data: bytes) -> bytes:
    lines = data.splitlines(keepends=True)
    i, j = (random.randrange(len(lines)) for _ in range(2))
    kind = random.randrange(4)
    if kind == 0:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 1:
        del lines[i]
    elif kind == 2:
        lines.insert(i, lines[j])
    else:
        lines[i] = lines[j]
    return b"".join(lines)


def _number(random: Random, data: bytes) -> bytes:
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    one = random.choice(found)
    if random.random() < 0.5:
        new = random.choice(VALUES).encode()
    else:
        new = repr(float(one[0]) * random.choice(FACTORS)).encode()
    return data[: one.start()] + new + data[one.end() :]


def _word(random: Random, data: bytes) -> bytes:
    found = list(WORD.finditer(data))
    one, other = random.choice(found), random.choice(found)
    new = random.choice((other[0], one[0][:-1], one[0].upper(), one[0] + b"_", b"", b"x" * 300))
    return data[: one.start()] + new + data[one.end() :]


def _structure(random: Random, data: bytes) -> bytes:
    """An element or attribute of XML, or a value of JSON or TOML, elsewhere or gone."""
    if data.lstrip()[:1] != b"<":
        form = json if data.lstrip()[:1] == b"{" else tomlkit
        content = json.loads(data) if form is json else tomllib.loads(data.decode())
        _shake(random, content)
        return form.dumps(content).encode()
    root = etree.fromstring(data)
    elements = [each for each in root.iter() if isinstance(each.tag, str) and each is not root]
    one, other = random.choice(elements), random.choice(elements)
    kind = random.randrange(5)
    if kind == 0:
        one.getparent().remove(one)
    elif kind == 1 and one.attrib:
        del one.attrib[random.choice(list(one.attrib))]
    elif kind == 2:
        other.append(etree.fromstring(etree.tostring(one)))
    elif kind == 3 and one.attrib:
        key = random.choice(list(one.attrib))
        one.set(key, random.choice([*other.attrib.values(), *VALUES]))
    else:
        other.tag, one.tag = one.tag, other.tag
    return etree.tostring(root)


def _shake(random: Random, content: object) -> None:
    """Change one value of a tree of JSON."""
    while True:
        items = content if isinstance(content, dict) else dict(enumerate(content))  # type: ignore[call-overload]
        if not items:
            return
        key = random.choice(list(items))
        inner = items[key]
        if isinstance(inner, dict | list) and inner and random.random() < 0.85:
            content = inner
            continue
        new = [None, True, -1, 0, 1e300, float("nan"), "", "abc", [], {}, [1, 2], 10**400, inner]
        if random.random() < 0.3 and isinstance(content, dict):
            del content[key]
        else:
            content[key] = random.choice(new)  # type: ignore[index]
        return


TEXTS = {"flip": _flip, "cut": _cut, "twice": _twice, "noise": _noise, "end": _end,
         "lines": _lines, "number": _number, "word": _word, "structure": _structure}  # fmt: skip
ANY = tuple(TEXTS)
MODELS = {"mjcf": "drawn", "identified": "out/identified"}  # folders by kind


NOTHING_LEFT = (  # of the kind that is to be changed, after the last change
    ValueError, OverflowError, TypeError, IndexError, RecursionError, etree.XMLSyntaxError,
    TOMLKitError,
)  # fmt: skip


def _of_file(pick: Callable[[Path], Path], *kinds: str) -> Mutant:
    def mutant(random: Random, folder: Path) -> str:
        path, kind = pick(folder), random.choice(kinds)
        for _ in range(random.choice((1, 1, 1, 2, 4))):
            data = path.read_bytes()
            try:
                path.write_bytes(TEXTS[kind](random, data) if data else data)
            except NOTHING_LEFT:
                break
        return kind

    return mutant


# --- logs ----------------------------------------------------------------------------------------


Series = dict[str, np.ndarray]


def _change(random: Random, columns: Series) -> str:
    """Change the values of a log's columns in place."""
    names = list(columns)
    name = random.choice(names)
    x = columns[name] = columns[name].astype(float)
    n, t = len(x), columns.get("t", np.arange(len(x)) / 100)
    a = random.randrange(n)
    b = min(n, a + random.choice((1, 3, 30, n // 3)))
    kind = random.choice((
        "cell", "scale", "nan", "zero", "hold", "swap", "late", "drift", "clip", "steps", "drop",
        "shuffle", "backward", "rename", "remove", "far", "jitter", "same stamps", "huge gap",
        "cells empty", "rate", "short", "spikes", "constant", "noise", "copy", "infinite", "begin",
    ))  # fmt: skip
    rng = np.random.default_rng(random.randrange(1 << 30))
    if kind == "cell":
        value = random.choice((1e20, -1e20, 1e308, 100.0, -1.0, 1e-300, float("nan"), 1e6))
        x[a] = value
        return f"{kind} {name}[{a}] = {value:g}"
    if kind == "scale":
        factor = random.choice(FACTORS)
        columns[name] = factor * x
        return f"{kind} {name} × {factor:g}"
    if kind in ("nan", "zero", "infinite"):
        x[a:b] = {"nan": np.nan, "zero": 0.0, "infinite": np.inf}[kind]
    elif kind == "hold":
        x[a:b] = x[a]
    elif kind == "swap":
        other = random.choice(names)
        columns[name], columns[other] = columns[other], columns[name]
        return f"{kind} {name} and {other}"
    elif kind == "late":
        columns[name] = np.roll(x, random.choice((1, 3, 10, 50)))
    elif kind == "drift":
        columns[name] = x + np.linspace(0, random.choice((1e-3, 0.1, 10.0)), n)
    elif kind == "clip":
        columns[name] = np.clip(x, *np.quantile(x[np.isfinite(x)], (0.2, 0.8)))
    elif kind == "steps":
        step = np.ptp(x) / random.choice((2, 8, 64))
        columns[name] = step * np.round(x / (step or 1.0))
    elif kind in ("drop", "huge gap"):
        keep = np.ones(n, dtype=bool)
        keep[a : a + (b - a if kind == "drop" else n - a - 12)] = False
        for each in names:
            columns[each] = columns[each][keep]
    elif kind == "shuffle":
        order = rng.permutation(n) if random.random() < 0.5 else np.arange(n)[::-1]
        for each in names:
            columns[each] = columns[each][order]
    elif kind == "backward":
        columns[name] = x[::-1]
    elif kind == "rename":
        columns[random.choice((name + "_", name.upper(), "tau.x", "q.", " ", "a.b.c"))] = (
            columns.pop(name)
        )
    elif kind == "remove":
        del columns[name]
    elif kind == "far":
        columns["t"] = t + random.choice((1e3, 1e9, 1e16, -50.0))
    elif kind == "jitter":
        step = float(np.median(np.diff(t)))
        columns["t"] = np.sort(t + step * random.choice((0.1, 3)) * rng.normal(size=n))
    elif kind == "same stamps":
        t = columns["t"] = t.astype(float)
        t[a:b] = t[a]
    elif kind == "cells empty":
        for each in names:
            if each != "t":
                holes = rng.random(n) < random.choice((0.1, 0.5, 0.9))
                columns[each] = np.where(holes, np.nan, columns[each])
    elif kind == "rate":
        x[np.arange(n) % random.choice((2, 7, 40)) > 0] = np.nan
    elif kind == "short":
        count = random.choice((0, 1, 9, 10, 15, 40, 90))
        for each in names:
            columns[each] = columns[each][:count]
    elif kind == "spikes":
        at = rng.integers(0, n, 20)
        x[at] += rng.normal(size=20) * (np.std(x) or 1.0) * random.choice((1, 10, 100))
    elif kind == "constant":
        columns[name] = np.full(n, x[0])
    elif kind == "noise":
        columns[name] = x + rng.normal(size=n) * (np.std(x) or 1.0) * random.choice((0.01, 0.3, 3))
    elif kind == "copy":
        columns[name] = columns[random.choice(names)].copy()
    elif kind == "begin":
        keep = n // random.choice((2, 3, 5))
        for each in names:
            columns[each] = columns[each][keep:]
    return f"{kind} {name} {a}:{b}"


def values(random: Random, folder: Path) -> str:
    """Values of the log, which stays a readable file."""
    table = pl.read_csv(folder / "run.csv")
    columns = {name: table[name].to_numpy() for name in table.columns}
    words = []
    for _ in range(random.choice((1, 1, 2))):
        if columns and min(map(len, columns.values())) > 12:
            words.append(_change(random, columns))
    pl.DataFrame(columns).fill_nan(None).write_csv(folder / "run.csv")
    return ", ".join(words)


def types(random: Random, folder: Path) -> str:
    """Columns of other types and shapes, in an archive or a Parquet file."""
    table = pl.read_csv(folder / "run.csv")
    (folder / "run.csv").unlink()
    name = random.choice(table.columns)
    x = table[name].to_numpy()
    if random.random() < 0.5:
        kind = random.choice((
            "2-D", "c16", "i8", "O", "?", "U20", ">f8", "f4", "f2", "M8[ns]", "0-D", "short", "S8",
            "empty", "u1", "records", "m8[us]",
        ))  # fmt: skip
        arrays = {each: table[each].to_numpy() for each in table.columns}
        special = {
            "2-D": lambda: np.stack([x, x]), "0-D": lambda: np.array(1.0), "short": lambda: x[:7],
            "empty": lambda: x[:0], "records": lambda: np.zeros(len(x), dtype=[("a", "f8")]),
        }  # fmt: skip
        make = special.get(kind, lambda: (1e9 * x).astype("i8").astype(kind)
                           if kind[0] in "Mm" else x.astype(kind))  # fmt: skip
        with np.errstate(all="ignore"):
            arrays[name] = make()
        np.savez(folder / "run.npz", **arrays, allow_pickle=kind == "O")
    else:
        kind = random.choice((
            "Int64", "String", "Boolean", "Datetime", "Null", "List", "Struct", "Float32",
            "Categorical", "Duration", "Binary", "Date", "Decimal",
        ))  # fmt: skip
        c = pl.col(name)
        made = {
            "List": lambda: table.with_columns(c.implode().over("t", mapping_strategy="join")),
            "Struct": lambda: table.with_columns(pl.struct(c).alias(name)),
            "Null": lambda: table.with_columns(pl.lit(None).alias(name)),
            "Categorical": lambda: table.with_columns(c.cast(pl.String).cast(pl.Categorical)),
            "Binary": lambda: table.with_columns(c.cast(pl.String).cast(pl.Binary)),
            "Boolean": lambda: table.with_columns(c > 0),
            "String": lambda: table.with_columns(c.cast(pl.String)),
            "Decimal": lambda: table.with_columns(c.cast(pl.Decimal(30, 12))),
            "Float32": lambda: table.with_columns(c.cast(pl.Float32)),
        }.get(
            kind,
            lambda: table.with_columns(
                (1000 * c).cast(pl.Int64).cast(getattr(pl, kind), strict=False).alias(name)
            ),
        )()
        made.write_parquet(folder / "run.parquet")
    return f"{name} as {kind}"


def table(random: Random, folder: Path) -> str:
    """The same numbers, written as other programs and hands write them."""
    path = folder / "run.csv"
    lines = path.read_text().splitlines()
    kind = random.choice((
        "semicolons", "decimal commas", "tabs", "mark", "utf-16", "crlf", "cr", "quotes",
        "comments", "units", "header again", "blank lines", "trailing commas", "column twice",
        "no header", "spaces", "words for nothing", "index", "last row cut", "row too long", "nul",
        "dates", "long line", "latin", "row too short", "header twice", "two tables", "empty",
    ))  # fmt: skip
    head, rows = lines[0], lines[1:]
    at = random.randrange(len(rows))
    change: dict[str, Callable[[], object]] = {
        "semicolons": lambda: [each.replace(",", ";") for each in lines],
        "decimal commas": lambda: [x.replace(",", ";").replace(".", ",") for x in lines],
        "tabs": lambda: [each.replace(",", "\t") for each in lines],
        "quotes": lambda: [",".join(f'"{x}"' for x in each.split(",")) for each in lines],
        "comments": lambda: ["# recorded on Monday", *lines[:at], "# paused", *lines[at:]],
        "units": lambda: [head, ",".join("rad" for _ in head.split(",")), *rows],
        "header again": lambda: [head, *rows[:at], head, *rows[at:]],
        "header twice": lambda: [head, head, *rows],
        "two tables": lambda: [*lines, "", head, *rows],
        "blank lines": lambda: [x for each in lines for x in (each, "")],
        "trailing commas": lambda: [f"{each}," for each in lines],
        "column twice": lambda: [f"{each},{each.split(',')[1]}" for each in lines],
        "no header": lambda: rows,
        "spaces": lambda: [each.replace(",", " , ") for each in lines],
        "words for nothing": lambda: [
            head,
            *(
                each.replace(each.split(",")[1], random.choice(("NaN", "-", "#N/A", "null", "nil")))
                if random.random() < 0.1
                else each
                for each in rows
            ),
        ],
        "index": lambda: [f",{head}", *(f"{i},{each}" for i, each in enumerate(rows))],
        "last row cut": lambda: [*lines[:-1], lines[-1][: len(lines[-1]) // 2]],
        "row too long": lambda: [head, *rows[:at], f"{rows[at]},1,2", *rows[at + 1 :]],
        "row too short": lambda: [head, *rows[:at], rows[at].rpartition(",")[0], *rows[at + 1 :]],
        "dates": lambda: [head, *(f"2024-01-01T00:00:{each}" for each in rows)],
        "long line": lambda: [head, *rows[:at], "9" * 10**6, *rows[at:]],
        "empty": list,
    }
    text = "\n".join(change.get(kind, lambda: lines)()) + "\n"  # type: ignore[arg-type]
    if kind in ("crlf", "cr"):
        text = text.replace("\n", "\r\n" if kind == "crlf" else "\r")
    data = text.encode({"utf-16": "utf-16", "mark": "utf-8-sig"}.get(kind, "utf-8"))
    if kind in ("nul", "latin"):
        middle = len(data) // 2
        data = (
            data[:middle] + (bytes(3) if kind == "nul" else "é".encode("latin-1")) + data[middle:]
        )
    path.write_bytes(data)
    return kind


def archive(random: Random, folder: Path) -> str:
    """An .npz whose members are not what they should be."""
    columns = pl.read_csv(folder / "run.csv")
    (folder / "run.csv").unlink()
    kind = random.choice((
        "twice", "no suffix", "folder", "text", "pickle", "claims", "fortran", "version", "empty",
        "inner", "path", "stored",
    ))  # fmt: skip
    name = random.choice(columns.columns)
    members = {}
    for each in columns.columns:
        stream = io.BytesIO()
        np.lib.format.write_array(stream, columns[each].to_numpy())
        members[f"{each}.npy"] = stream.getvalue()
    own = members[f"{name}.npy"]
    other: dict[str, dict[str, bytes]] = {
        "no suffix": {name: own}, "folder": {f"{name}.npy/": b""},
        "text": {f"{name}.npy": b"1,2,3\n"}, "claims": {
            f"{name}.npy": own.replace(b"'shape': (", b"'shape': (9", 1)},
        "fortran": {f"{name}.npy": own.replace(b"False", b"True ", 1)},
        "version": {f"{name}.npy": own[:6] + b"\x09\x00" + own[8:]},
        "empty": {f"{name}.npy": b""}, "inner": {f"{name}.npz": own},
        "path": {f"../../{name}.npy": own},
    }  # fmt: skip
    if kind == "pickle":
        stream = io.BytesIO()
        np.save(stream, np.array([{"a": 1}, None], dtype=object))
        other[kind] = {f"{name}.npy": stream.getvalue()}
    if kind in other:
        del members[f"{name}.npy"]
        members |= other[kind]
    with zipfile.ZipFile(folder / "run.npz", "w") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a name that is there twice
        for each, data in members.items():
            file.writestr(each, data)
        if kind == "twice":
            file.writestr(f"{name}.npy", own)
    return f"{kind} {name}"


DRAWN = {"mjcf": ("four_bar.xml", MJCF)}


def drawn_model(kind: str, folder: Path) -> Path:
    """Write the four-bar as a model of another format, with friction; return its file."""
    name, text = DRAWN[kind]
    (folder / "drawn").mkdir()
    effects = "".join(
        f'\n[[effect]]\nkind = "{each}"\njoint = "crank"\n' for each in ("viscous", "coulomb")
    )
    (folder / "drawn" / "mechanism.toml").write_text(
        f'urdf = "{name}"\n[joints]\npassive = ["coupler", "rocker"]\n{effects}'
    )
    (folder / "drawn" / name).write_text(text)
    return folder / "drawn" / name


def _model(kind: str) -> Mutant:
    return lambda random, folder: _of_file(lambda f: drawn_model(kind, f), *ANY)(random, folder)


def identified(random: Random, folder: Path) -> str:
    """A file of the folder that `--out` writes, in which everything is known."""
    path = random.choice(sorted((folder / "out" / "identified").iterdir()))
    return f"{path.name} {_of_file(lambda f: path, *ANY)(random, folder)}"


CODE = """import casadi as ca
import numpy as np


def bump(s, w=(0.1, 0.01, 1.0)):
    \"\"\"A bump.\"\"\"
    return {"A [N m]": ca.exp(-(((s.q - 0.3) / w) ** 2)), "B": s.v * ca.fabs(s.v)}
"""


def code(random: Random, folder: Path) -> str:
    """The file of an effect of one's own."""
    path = folder / "mine.py"
    path.write_text(CODE)
    wrong = (
        "return None", "return {}", "return 5", 'return {"A": "x"}', 'return {"A": float("nan")}',
        'return {"A": 1 / 0}', 'raise KeyError("no")', "raise SystemExit(3)", 'return {"": s.q}',
        'return {"A": s.q, "A ": s.q}', 'return {5: s.q}', 'return {"A": ca.log(s.q - 100)}',
        'return {"A": ca.DM.zeros(3, 3)}', 'return {"A": np.sin(0.3)}', 'return {"A": s.nothing}',
        'return {"A": 0 * s.q}', 'return {"A": 1e300 * s.q * 1e300}', 'return {"A": s.q[5]}',
        'return {"A": 1 / s.v}', 'return {"A [": s.q}', 'print("hello"); return {"A": s.q}',
        'return {"A": ca.sqrt(s.v)}', 'return [("A", s.q)]', 'return {"A": s.a, "B": s.a}',
    )  # fmt: skip
    if random.random() < 0.6:
        line = random.choice(wrong)
        path.write_text(CODE[: CODE.index("    return")] + f"    {line}\n")
        return line
    if random.random() < 0.3:
        shape = random.choice(("w=1", "w=()", "w=(1, 2)", "w=(5, 0, 1)", "w=(0.1, 1, 0)", "*w",
                               "w=('a', 'b', 'c')", "w", "w=(0, 0, 0)", "**w",
                               "w=(0.1, 0, nan)"))  # fmt: skip
        path.write_text(CODE.replace("w=(0.1, 0.01, 1.0)", shape))
        return shape
    return _of_file(lambda f: f / "mine.py", "flip", "cut", "twice", "lines", "number", "word")(
        random, folder
    )


def _as(suffix: str) -> Mutant:
    """Bytes of the log in another format."""

    def mutant(random: Random, folder: Path) -> str:
        log = ident.read_log(folder / "run.csv")
        log.write(folder / f"run{suffix}")
        (folder / "run.csv").unlink()
        kinds = ("flip", "cut", "twice", "noise", "end")
        return _of_file(lambda f: f / f"run{suffix}", *kinds)(random, folder)

    return mutant


def checkpoint(random: Random, folder: Path) -> str:
    """Bytes of the file from which an interrupted run goes on."""
    return _of_file(lambda f: f / "out" / ".gathered.npz", "flip", "cut", "noise", "end")(
        random, folder
    )


def nothing(random: Random, folder: Path) -> str:
    """No file; options are drawn for every mutant, and more of them here."""
    return "options"


MUTANTS: dict[str, Mutant] = {
    "urdf": _of_file(urdf_of, *ANY),
    "toml": _of_file(lambda f: f / "mechanism.toml", *ANY),
    "mjcf": _model("mjcf"),
    "identified": identified,
    "code": code,
    "csv": _of_file(lambda f: f / "run.csv", *ANY[:-1]),
    "values": values,
    "types": types,
    "table": table,
    "archive": archive,
    "npz": _as(".npz"),
    "parquet": _as(".parquet"),
    "fit.json": _of_file(lambda f: f / "fit.json", *ANY),
    "checkpoint": checkpoint,
    "options": nothing,
}
# of a hundred mutants, how many
SHARES = {"urdf": 12, "toml": 12, "csv": 8, "values": 24, "types": 5, "npz": 3, "parquet": 3,
          "fit.json": 6, "checkpoint": 3, "options": 5, "mjcf": 6, "identified": 3,
          "code": 3, "table": 5, "archive": 2}  # fmt: skip
