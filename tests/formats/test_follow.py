"""Lines of a file that grows: every whole one, each bad one by its number."""

import math
import os
import threading

import numpy as np
import pytest

from ident import LogError
from ident.log.pieces import follow

GOOD = "t,q.a,tau.a\n0,1,2\n0.1,1.5,2.5\n"


def read(path, **options):
    return list(follow(path, **options))


def values(parts):
    return [row for part in parts for row in zip(*part.columns.values(), strict=True)]


def numbers(parts):
    return [int(number) for part in parts for number in part.numbers]


def test_samples_under_the_headers_names(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text(GOOD)
    (lines,) = read(file)
    assert numbers([lines]) == [2, 3]
    assert {name: x[0] for name, x in lines.columns.items()} == {"t": 0.0, "q.a": 1.0, "tau.a": 2.0}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("# logged by hand\r\n\r\nt;q\r\n0;1\r\n", [(0.0, 1.0)]),
        ("\ufefft\tq\n0\t1", [(0.0, 1.0)]),
        ('"t","q"\n0,true\n1,false\n', [(0.0, 1.0), (1.0, 0.0)]),
        ("t,q\n\n0,1\n\n", [(0.0, 1.0)]),
    ],
    ids=["semicolons", "tabs", "quotes", "blank lines"],
)
def test_the_dialects_that_logs_have(tmp_path, text, found):
    file = tmp_path / "a.csv"
    file.write_bytes(text.encode())
    assert values(read(file)) == found


def test_bad_lines_are_said_and_left_out(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("t,q\n0,1\n0.1\n0.2,3,4\nt,q\n0.3,,\n0.4,x\n0.5,2\n0.6")
    lines, rest = read(file)  # a line without an end, at the end
    assert dict(lines.bad + rest.bad) == {
        3: "1 cells, the header has 2 (cut off?)",
        4: "3 cells, the header has 2",
        5: "no numbers",
        6: "3 cells, the header has 2",
        9: "1 cells, the header has 2 (cut off?)",
    }
    assert numbers([lines]) == [2, 7, 8]
    np.testing.assert_array_equal(lines.columns["q"], [1.0, math.nan, 2.0])


@pytest.mark.parametrize(
    ("text", "said"),
    [("", "the file is empty"), ("0,1\n2,3\n", "holds numbers"), ("t,q\xff\0\n", "is not text")],
)
def test_what_is_no_csv_file(tmp_path, text, said):
    file = tmp_path / "a.csv"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(LogError, match=said):
        read(file)


def test_a_file_that_is_not_there(tmp_path):
    (tmp_path / "run.csv").write_text(GOOD)
    with pytest.raises(LogError, match=r"did you mean .*run\.csv.*standard input"):
        read(tmp_path / "rum.csv")


def test_a_growing_file_line_by_line(tmp_path):
    """Half a line is no line; the rest of it makes it one."""
    file = tmp_path / "a.csv"
    file.write_text("t,q\n0,1\n0.1,")
    done, found = threading.Event(), []
    with file.open("a") as end:
        for line in follow(file, grow=True, stop=done.is_set):
            found.append(line)
            if line.numbers[-1] == 2:
                end.write("5\n0.2,6\n0.")
            elif line.numbers[-1] == 4:
                end.write("3,7\n")
            elif line.numbers[-1] == 5:
                done.set()
            end.flush()
    assert values(found) == [(0.0, 1.0), (0.1, 5.0), (0.2, 6.0), (0.3, 7.0)]


def test_a_file_that_becomes_shorter(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text(GOOD)
    lines = follow(file, grow=True)
    assert numbers([next(lines)]) == [2, 3]
    os.truncate(file, 5)
    with pytest.raises(LogError, match="has become shorter"):
        next(lines)


def test_it_stops_when_asked(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text(GOOD)
    asked = iter([False] * 5 + [True] * 5)
    assert len(values(follow(file, grow=True, stop=lambda: next(asked)))) == 2
