"""A log in pieces is the log: the same values, repairs and refusals as in one reading."""

import datetime
import gc
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import polars as pl
import pytest

from ident.errors import LogError
from ident.log import Column, Log, pieces, read_log
from ident.log.pieces import open_log
from ident.log.read import likely_rows

ROWS = 3 * pieces.STRIDE + 77


@pytest.fixture(autouse=True)
def blocks(monkeypatch):
    """Texts are looked at in many blocks, as long ones are, and Parquet files in many groups."""
    monkeypatch.setattr(pieces, "BLOCK", 4096)
    monkeypatch.setattr(pieces, "GROUP", 1024)


@pytest.fixture
def made() -> Log:
    random = np.random.default_rng(0)
    columns = {name: random.normal(size=ROWS) for name in ("q.a", "v.a", "tau.a")}
    columns["tau.a"][5:900:7] = np.nan
    return Log.from_arrays("made", np.arange(ROWS) * 0.001, columns)


CUTS = (
    (0, ROWS), (0, 11), (1024, 2048), (1000, 2050), (2047, 2060), (2000, 3100), (ROWS - 15, ROWS),
)  # fmt: skip


def same(path, columns=None):
    whole, log = read_log(path, columns), open_log(path, columns)
    assert log.rows == len(whole.t)
    assert log.sha256 == whole.sha256
    assert set(log.columns) == {"t", *whole.columns}
    for first, stop in CUTS:
        piece = log.piece(first, stop)
        np.testing.assert_array_equal(piece.t, whole.t[first:stop])
        for name, x in whole.columns.items():
            np.testing.assert_array_equal(piece.columns[name], x[first:stop])
    return log


@pytest.mark.parametrize("suffix", ["csv", "parquet", "npz"])
def test_pieces_are_the_log(made, suffix, tmp_path):
    made.write(tmp_path / f"run.{suffix}")
    same(tmp_path / f"run.{suffix}")
    assert likely_rows(tmp_path / f"run.{suffix}") == pytest.approx(ROWS, rel=0.05)


@pytest.mark.parametrize("line_break", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_whatever_text_a_logger_writes(csv, made, line_break, separator):
    lines = ["# of a logger", "", separator.join(["t", "q.a", '"note"', "on"])]
    for i in range(ROWS):
        cells = [f"{made.t[i]:.3f}", f"{made.columns['q.a'][i]!r}", '"text"', ["true", ""][i % 2]]
        lines += [separator.join(cells), *(["  "] if i % 500 == 3 else [])]
    text = "\ufeff" + line_break.join(lines).replace("np.float64(", "").replace(")", "")
    log = same(csv(text))
    assert "note" not in log.columns


def test_columns_are_renamed_and_scaled(csv, made):
    rows = "\n".join(f"{1000 * t},{q}" for t, q in zip(made.t, made.columns["q.a"], strict=True))
    path = csv(f"stamp_ms,angle\n{rows}")
    same(path, {"t": Column("stamp_ms", 0.001), "q.a": Column("angle", 2.0, 1.0)})


def test_stamps_count_from_the_files_first_one(made, tmp_path):
    start = datetime.datetime(2024, 5, 1)
    stamps = [start + datetime.timedelta(milliseconds=i) for i in range(ROWS)]
    pl.DataFrame({"t": stamps, "q.a": made.columns["q.a"]}).write_parquet(tmp_path / "run.parquet")
    same(tmp_path / "run.parquet")


@pytest.mark.parametrize("line", ["3.0", "3.0,1,1", "3.0,x", "3.0,inf", '3.0,"1', "3.0,é", "x,1"])
def test_a_piece_refuses_what_the_reader_refuses_in_the_same_words(csv, made, line):
    lines = [f"{t},{q}" for t, q in zip(made.t, made.columns["q.a"], strict=True)]
    lines[2500] = line
    path = csv("t,q.a\n\n" + "\n".join(lines))
    with pytest.raises(LogError) as whole:
        read_log(path)
    with pytest.raises(LogError) as piece:
        open_log(path).piece(1024, ROWS)
    assert str(piece.value) == str(whole.value)


@pytest.mark.parametrize("bad", [b"\0", b"\xff"])
def test_a_byte_that_is_no_text_is_refused_by_its_line(csv, made, bad):
    lines = [f"{t},{q}".encode() for t, q in zip(made.t, made.columns["q.a"], strict=True)]
    lines[2000] = b"2.0," + bad
    path = csv(b"t,q.a\n" + b"\n".join(lines))
    with pytest.raises(LogError) as whole:
        read_log(path)
    with pytest.raises(LogError) as opened:
        open_log(path)
    assert str(opened.value) == str(whole.value)


def test_a_row_of_a_binary_file_is_named_by_its_number_in_the_file(made, tmp_path):
    q = made.columns["q.a"].copy()
    q[2345] = np.inf
    pl.DataFrame({"t": made.t, "q.a": q}).write_parquet(tmp_path / "run.parquet")
    with pytest.raises(LogError, match="index 2345"):
        open_log(tmp_path / "run.parquet").piece(2048, 3000)


def test_a_column_is_numbers_everywhere_or_nowhere(csv, made):
    lines = [f"{t},{i if i < 2000 else 'off'}" for i, t in enumerate(made.t)]
    log = open_log(csv("t,state\n" + "\n".join(lines)))
    with pytest.raises(LogError, match="'state' holds numbers in some rows and text in others"):
        log.piece(2048, 3000)


@pytest.mark.parametrize("text", ["", "\n\n", "t,q.a\n", "1,2\n3,4\n"])
def test_a_file_without_rows_or_header_is_refused_as_by_the_reader(csv, text):
    path = csv(text)
    with pytest.raises(LogError) as whole:
        read_log(path)
    with pytest.raises(LogError) as opened:
        open_log(path)
    assert str(opened.value) == str(whole.value)


def test_a_path_is_refused_as_by_the_reader(tmp_path):
    for path in (tmp_path, tmp_path / "none.csv", tmp_path / "run.xls"):
        with pytest.raises(LogError) as whole:
            read_log(path)
        with pytest.raises(LogError) as opened:
            open_log(path)
        assert str(opened.value) == str(whole.value)
        assert likely_rows(path) == 0


def test_a_damaged_archive_is_closed_again(tmp_path):
    """A zip whose end is cut off: whoever reads it says so, and its file is not left open."""
    whole = tmp_path / "whole.npz"
    np.savez(whole, t=np.arange(100.0))
    path = tmp_path / "run.npz"
    path.write_bytes(whole.read_bytes()[:-30])
    assert likely_rows(path) == 0
    gc.collect()  # a file left open warns here, and warnings are errors


def test_threads_that_read_two_parquet_files_get_the_rows_of_theirs(tmp_path):
    logs = []
    for number in range(2):
        t = np.arange(ROWS) * 0.001
        Log.from_arrays("made", t, {"q.a": t + 1000.0 * number}).write(
            tmp_path / f"{number}.parquet"
        )
        logs.append(open_log(tmp_path / f"{number}.parquet"))

    def wrong(number: int) -> int:
        starts = range(0, ROWS - 300, 97)
        pieces_of_log = ((first, logs[number].piece(first, first + 300)) for first in starts)
        offset = 1000.0 * number
        return sum(abs(x.columns["q.a"][0] - 0.001 * a - offset) > 1e-9 for a, x in pieces_of_log)

    with ThreadPoolExecutor(4) as threads:
        assert sum(threads.map(wrong, [0, 1, 0, 1])) == 0


def test_a_parquet_file_that_is_replaced_is_read_anew(tmp_path):
    path, t = tmp_path / "run.parquet", np.arange(ROWS) * 0.001
    Log.from_arrays("made", t, {"q.a": t}).write(path)
    log, state = open_log(path), path.stat()
    log.piece(0, 100)
    Log.from_arrays("made", t, {"q.a": t + 1.0}).write(tmp_path / "other.parquet")
    (tmp_path / "other.parquet").replace(path)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert log.piece(0, 100).columns["q.a"][0] == 1.0
