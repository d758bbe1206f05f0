"""Tasks spread over processes: nothing is lost when one dies, and nothing else fails with it."""

from __future__ import annotations

import itertools
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from ident.errors import IdentError, LogError
from ident.pool import Done, spread


def plus_square(common, task):
    return common + task**2


def moody(common, task):
    if task == 1:
        raise LogError("run.csv: no\ncolumn 't'")
    if task == 2:
        raise ZeroDivisionError
    if task == 3:
        return threading.Lock()  # no process can send it
    return task


def dies_once(common, task):
    """Kills its process the first time that it meets one of its victims."""
    folder, victims = common
    before = Path(folder) / str(task)
    if task in victims and not before.exists():
        before.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def kills(common, task):
    """Marks how often it is called; one task kills every process that it meets."""
    folder, victim = common
    (Path(folder) / f"{task}-{time.monotonic_ns()}").touch()
    if task == victim:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def process(common, task):
    return os.getpid(), os.environ.get("OPENBLAS_NUM_THREADS")


def by_index(dones):
    return sorted(dones, key=lambda done: done.index)


@pytest.mark.parametrize("jobs", [1, 2, None])
def test_every_task_is_done_once(jobs):
    found = by_index(spread(plus_square, range(20), common=5, jobs=jobs))
    assert found == [Done(i, 5 + i**2) for i in range(20)]


def test_no_tasks():
    assert list(spread(plus_square, [], common=0)) == []
    assert list(spread(plus_square, iter(()), common=0, jobs=2)) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_task_ends_in_is_one_line(jobs):
    found = by_index(spread(moody, range(5), jobs=jobs))
    assert [done.error for done in found[:3]] == [
        None,
        "run.csv: no column 't'",
        "ZeroDivisionError",
    ]
    assert found[4] == Done(4, 4)
    if jobs == 2:
        assert "lock" in found[3].error


def test_one_process_is_this_one():
    (done,) = spread(process, [0], jobs=1)
    assert done.value[0] == os.getpid()


def test_other_processes_have_one_thread_of_linear_algebra():
    found = [done.value for done in spread(process, range(8), jobs=2)]
    assert os.getpid() not in {pid for pid, _ in found}
    assert len({pid for pid, _ in found}) <= 2
    assert {threads for _, threads in found} == {"1"}


def test_a_process_that_dies_loses_nothing(tmp_path):
    found = by_index(spread(dies_once, range(12), common=(str(tmp_path), {0, 5, 6}), jobs=2))
    assert found == [Done(i, i) for i in range(12)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "5", "6"]


def test_a_task_that_always_kills_is_given_up_and_nobody_else_is(tmp_path):
    found = by_index(spread(kills, range(9), common=(str(tmp_path), 4), jobs=3))
    assert [done.value for done in found] == [0, 1, 2, 3, None, 5, 6, 7, 8]
    assert found[4].error == "its process died each of the 3 times it was tried"
    assert len(list(tmp_path.glob("4-*"))) == 3


def test_tasks_are_taken_as_processes_become_free():
    """An endless supply: no more are asked for than can run."""
    asked = itertools.count()
    found = spread(plus_square, asked, common=0, jobs=2)
    assert {next(found).index for _ in range(10)} <= set(range(14))
    assert next(asked) <= 14
    found.close()
    assert len(list(spread(plus_square, range(3), common=0, jobs=2))) == 3


def test_what_is_common_is_read_once_a_process():
    array = np.arange(200_000.0)
    found = list(spread(where, range(10), common=array, jobs=2))
    assert len({done.value for done in found}) <= 2


def where(common, task):
    return os.getpid(), id(common)


def test_what_cannot_be_sent_says_so():
    with pytest.raises(IdentError, match=r"cannot be sent .* jobs=1"):
        spread(plus_square, range(3), common=threading.Lock(), jobs=2)


@pytest.mark.parametrize("jobs", [0, -1, 1.5, True, "2"])
def test_jobs_are_counted(jobs):
    with pytest.raises(IdentError, match="valid: a whole number"):
        spread(plus_square, range(3), common=0, jobs=jobs)


def test_jobs_or_a_scheduler():
    with pytest.raises(IdentError, match="one of the two"):
        spread(plus_square, range(3), common=0, jobs=2, scheduler="tcp://127.0.0.1:8786")
