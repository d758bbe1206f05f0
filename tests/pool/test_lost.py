"""A scheduler that goes away in the middle of the work: one line, soon."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("distributed")

from ident.errors import IdentError
from ident.pool import spread
from workers import cluster


def slow(common, task):
    time.sleep(common if task else 0.0)
    return task


def test_a_scheduler_that_goes_away_is_said_in_one_line(tmp_path, capfd):
    with cluster(tmp_path) as found:
        found.start("one")
        found.wait_for(1)
        done = spread(slow, range(5), common=30.0, scheduler=found.address)
        assert next(done).value == 0
        found.processes[0].kill()
        start = time.monotonic()
        with pytest.raises(IdentError, match="stopped answering; start it") as error:
            list(done)
        assert time.monotonic() - start < 60.0
        assert "\n" not in str(error.value)
    assert "Traceback" not in capfd.readouterr().err
