"""CSV: what is tolerated, what is left out and said so, what is refused and where."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ident.errors import LogError
from ident.log import Log, read_log

ROWS = [f"{k / 100},{k * k},{-k}" for k in range(12)]  # line k + 2 of a file with a header


def text(*changed: tuple[int, str], header: str = "t,q.a,tau.a", rows: list[str] = ROWS) -> str:
    """Good rows, with those of the given index changed."""
    rows = list(rows)
    for index, row in changed:
        rows[index] = row
    return "\n".join([header, *rows]) + "\n"


GOOD = {
    "plain": text(),
    "no newline at the end": text().rstrip(),
    "byte order mark": "\ufeff" + text(),
    "comments before the header": "# a rig\n # of ours, 2026\n\n" + text(),
    "windows lines": text().replace("\n", "\r\n"),
    "old mac lines": text().replace("\n", "\r"),
    "semicolons": text().replace(",", ";"),
    "tabs": text().replace(",", "\t"),
    "blanks around names and cells": text().replace(",", " , "),
    "quoted names": text(header='"t","q.a","tau.a"'),
    "quoted cells": text((3, '"0.03","9","-3"')),
    "blank lines at the end": text() + "\n  \n\n",
    "exponents and signs": text((4, "+4e-2,1.6E1,-.4e+1")),
}


@pytest.mark.parametrize("content", GOOD.values(), ids=GOOD)
def test_these_read_alike(read: Callable[..., Log], content: str) -> None:
    log = read(content)
    k = np.arange(12)
    assert log.name == "run.csv"
    assert list(log.columns) == ["q.a", "tau.a"]
    np.testing.assert_array_equal(log.t, k / 100)
    np.testing.assert_array_equal(log.columns["q.a"], k * k)
    np.testing.assert_array_equal(log.columns["tau.a"], -k)
    assert log.repairs == ()


BAD = {
    "empty": ("", ("empty", "header line")),
    "blank": ("\n \n", ("empty", "header line")),
    "only comments": ("# a\n# b\n", ("empty", "header line")),
    "header only": ("t,q.a\n", ("line 1", "no rows")),
    "no header": ("\n".join(ROWS), ("line 1", "header should be", "q.<joint>")),
    "header of np.savetxt": ("# t,q.a,tau.a\n" + "\n".join(ROWS), ("line 2", "line 1", "'#'")),
    "png": (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", ("0x89", "line 1", "UTF-8")),
    "utf-16": (text().encode("utf-16"), ("line 1", "UTF-8")),
    "latin-1 header": (text(header="t,q,T[°C]").encode("latin-1"), ("0xb0", "line 1", "UTF-8")),
    "nul bytes": (text((5, "\0\0\0")), ("0x00", "line 7", "UTF-8")),
    "short row": (text((5, "0.05,25")), ("line 7", "2 cells", "header has 3")),
    "long row": (text((5, "0.05,25,-5,1")), ("line 7", "4 cells", "header has 3")),
    "cut off": (text((11, "0.11,12")), ("line 13", "cut off", "delete it")),
    "open quote": (text((5, '0.05,"25,-5')), ("line 7", "quote", "close it")),
    "open quote in header": (text(header='t,"q.a,tau.a'), ("line 1", "quote", "close it")),
    "stray quotes": (text((5, '0.05,2"5,-"5')), ("line 7",)),
    "doubled name": (text(header="t,q.a,q.a"), ("'q.a'", "own name")),
    "blanks between": (text().replace(",", " "), ("line 1", "separator", "';'", "tab")),
    "not a number": (text((5, "0.05,oops,-5")), ("'q.a'", "line 7", "'oops'", "empty")),
    "two numbers": (text((5, "0.05,1 2,-5")), ("'q.a'", "line 7", "'1 2'", "empty")),
    "hexadecimal": (text((5, "0.05,0x1A,-5")), ("'q.a'", "line 7", "'0x1A'", "empty")),
    "long cell": (text((5, f"0.05,{'x' * 999},-5")), ("'q.a'", "line 7", "xxx...")),
    "row of units": (text((0, "s,rad,Nm")), ("line 2", "'s'", "units", "delete")),
    "after a comment": ("#\n" + text((5, "0.05,oops,-5")), ("line 8", "'oops'")),
    "after a blank line": (text((4, ""), (5, "0.05,oops,-5")), ("line 7", "'oops'")),
    "infinite": (text((5, "0.05,-inf,-5")), ("'q.a'", "line 7", "-inf", "empty")),
    "overflowing": (text((5, "0.05,1e999,-5")), ("'q.a'", "line 7", "inf", "empty")),
    "infinite time": (text((5, "inf,25,-5")), ("'t'", "line 7", "inf")),
    "decimal comma": (
        text().replace(",", ";").replace(".0", ",0").replace("t,", "t."),
        ("'t'", "decimal comma", "decimal point"),
    ),
    "one decimal comma": (
        text((5, "0.05;2,5;-5"), rows=[row.replace(",", ";") for row in ROWS], header="t;q.a;x"),
        ("'q.a'", "line 7", "'2,5'", "decimal point"),
    ),
    "time is text": (
        text(rows=[f"12:00:{k:02},1,2" for k in range(12)]),
        ("'t'", "'12:00:00'", "seconds"),
    ),
}


@pytest.mark.parametrize(("content", "says"), BAD.values(), ids=BAD)
def test_these_are_refused(
    csv: Callable[..., Path],
    refused: Callable[..., str],
    content: str | bytes,
    says: tuple[str, ...],
) -> None:
    refused(csv(content), says)


@pytest.mark.parametrize(
    "cell", ["", " ", "nan", "NaN", "NAN", "-nan", "null", "NA", "N/A", "None", '""']
)
def test_empty_cells_are_nan(read: Callable[..., Log], cell: str) -> None:
    log = read(text((5, f"0.05,{cell},-5")))
    assert np.flatnonzero(np.isnan(log.columns["q.a"])).tolist() == [5]
    assert log.repairs == ()


def test_text_is_left_out_and_said_so(read: Callable[..., Log]) -> None:
    rows = [f"{k / 100},{'auto' if k % 2 else ''},{k}" for k in range(12)]
    log = read(text(header="t,mode,q.a", rows=rows))
    assert list(log.columns) == ["q.a"]
    assert log.repairs == ("column 'mode' holds text ('auto'), left out",)


def test_booleans_are_one_and_zero(read: Callable[..., Log]) -> None:
    rows = [f"{k / 100},{['true', 'False', ''][k % 3]}" for k in range(12)]
    log = read(text(header="t,contact", rows=rows))
    np.testing.assert_array_equal(log.columns["contact"], [1, 0, np.nan] * 4)


def test_empty_column_is_kept_and_said_so(read: Callable[..., Log]) -> None:
    log = read(text(header="t,q.a,none", rows=[f"{k / 100},1," for k in range(12)]))
    assert np.isnan(log.columns["none"]).all()
    assert log.repairs == ("column 'none' is empty",)


def test_unnamed_columns_are_left_out(read: Callable[..., Log]) -> None:
    rows = [f"{k},{k / 100},1," for k in range(12)]  # a data frame's index, a comma at the end
    log = read(text(header=",t,q.a,", rows=rows))
    assert list(log.columns) == ["q.a"]
    assert [repair.split(" has")[0] for repair in log.repairs] == ["column 1", "column 4"]


def test_blank_lines_between_rows_are_said(read: Callable[..., Log]) -> None:
    log = read(text((3, ""), (6, "")))
    assert log.t.size == 10
    assert log.repairs == ("2 blank lines left out, first at line 5",)


def test_many_rows_are_read_to_the_last_digit(csv: Callable[..., Path]) -> None:
    rng = np.random.default_rng(0)
    x = np.round(rng.normal(size=(5_000, 12)), 7).tolist()
    lines = [f"{k / 5000}," + ",".join(map(str, row)) for k, row in enumerate(x)]
    log = read_log(csv("t," + ",".join(f"q.j{j}" for j in range(12)) + "\n" + "\n".join(lines)))
    np.testing.assert_array_equal(np.column_stack(list(log.columns.values())), x)


@pytest.mark.parametrize("short", [(), (100,)])
@pytest.mark.parametrize("columns", [2, 3])
def test_a_cell_too_many_in_the_last_line_is_refused(
    tmp_path: Path, columns: int, short: tuple[int, ...]
) -> None:
    """Long texts are parsed before their lines are looked at; the parser drops an empty last cell,
    and a line that is a cell short makes the number of separators right."""
    names = ["t", "q.a", "tau.a"][:columns]
    rows = [",".join([f"{k / 100}", f"{k * k}", f"{-k}"][:columns]) for k in range(3000)]
    for k in short:
        rows[k] = rows[k].rpartition(",")[0]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([",".join(names), *rows]) + ",")
    with pytest.raises(LogError, match=f"line {short[0] + 2 if short else 3001} has"):
        read_log(path)
