"""A real scheduler and workers: what dies is done again, and what is wrong is said."""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
from pathlib import Path

import pytest

pytest.importorskip("distributed")

from ident.errors import IdentError, LogError
from ident.pool import Done, spread, versions
from workers import cluster, until


def plus_square(common, task):
    return common + task**2


def moody(common, task):
    if task == 1:
        raise LogError("run.csv: no\ncolumn 't'")
    if task == 2:
        return threading.Lock()  # no process can send it
    return task


def waits_once(common, task):
    """The first time that task 0 is tried, it says by whom and waits for its end."""
    mark = Path(common) / "pid"
    if task == 0 and not mark.exists():
        mark.with_suffix(".part").write_text(str(os.getpid()))
        mark.with_suffix(".part").rename(mark)
        signal.pause()
    return task


def kills(common, task):
    if task == common:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """A scheduler with two workers, which a nanny starts anew when they die."""
    with cluster(tmp_path_factory.mktemp("dask")) as found:
        found.start("two", "--nworkers", "2")
        found.wait_for(2)
        yield found


def by_index(dones):
    return sorted(dones, key=lambda done: done.index)


def test_every_task_is_done_once(started):
    found = by_index(spread(plus_square, range(20), common=5, scheduler=started.address))
    assert found == [Done(i, 5 + i**2) for i in range(20)]
    assert list(spread(plus_square, [], scheduler=started.address)) == []


def test_what_dask_logs_of_a_lost_connection_is_not_printed(started, capfd):
    log = logging.getLogger("distributed.client")
    before = log.level
    done = spread(plus_square, range(3), common=5, scheduler=started.address)
    first = next(done)
    log.error("Traceback (most recent call last):")
    assert len([first, *done]) == 3
    assert "Traceback" not in capfd.readouterr().err
    assert log.level == before


def test_what_a_task_ends_in_is_one_line(started):
    found = by_index(spread(moody, range(4), scheduler=started.address))
    assert found[1].error == "run.csv: no column 't'"
    assert "pickle" in found[2].error
    assert [found[0], found[3]] == [Done(0, 0), Done(3, 3)]


def test_a_worker_that_is_killed_at_work_loses_nothing(started, tmp_path):
    found = spread(waits_once, range(6), common=str(tmp_path), scheduler=started.address)
    first = next(found)  # of the other worker: this one waits
    until((tmp_path / "pid").exists)
    os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)
    assert by_index([first, *found]) == [Done(i, i) for i in range(6)]


def test_a_task_that_kills_every_worker_is_given_up_and_nobody_else_is(started):
    found = by_index(spread(kills, range(5), common=3, scheduler=started.address))
    assert [done.value for done in found] == [0, 1, 2, None, 4]
    assert found[3].error == "its process died each of the 4 times it was tried"


def test_what_is_left_is_ended_with_the_iterator(started):
    found = spread(plus_square, iter(range(10**9)), common=0, scheduler=started.address)
    assert next(found).error is None
    found.close()
    assert len(list(spread(plus_square, range(3), common=0, scheduler=started.address))) == 3


def test_a_scheduler_without_workers_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("ident.pool.ANSWER", 1)
    with cluster(tmp_path) as found, pytest.raises(IdentError, match="has no workers; start some"):
        list(spread(plus_square, range(3), common=0, scheduler=found.address))


def test_an_address_where_nobody_answers(monkeypatch):
    monkeypatch.setattr("ident.pool.ANSWER", 1)
    with socket.socket() as taken:  # and does not listen
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(IdentError, match=r"does not answer .* tcp://host:8786"):
            list(spread(plus_square, range(3), scheduler=address))
    with pytest.raises(IdentError, match=r"scheduler nonsense: does not answer"):
        list(spread(plus_square, range(3), scheduler="nonsense"))


def test_a_worker_with_another_version_is_refused(started, monkeypatch):
    other = {"ident": "7.7", "Python": "3.11"}
    monkeypatch.setattr("ident.pool.versions", lambda: other)
    with pytest.raises(IdentError, match=r"has ident .*, here it is 7\.7; install the same"):
        list(spread(plus_square, range(3), scheduler=started.address))
    monkeypatch.undo()
    assert len(list(spread(plus_square, range(3), common=0, scheduler=started.address))) == 3


@pytest.mark.parametrize("library", ["NumPy", "Pinocchio", "CasADi"])
def test_a_worker_with_another_numerical_library_is_refused(started, monkeypatch, library):
    other = {**versions(), library: "0.1"}
    monkeypatch.setattr("ident.pool.versions", lambda: other)
    with pytest.raises(
        IdentError, match=rf"has {library} [\d.]+, here it is 0\.1; install the same"
    ):
        list(spread(plus_square, range(3), scheduler=started.address))
