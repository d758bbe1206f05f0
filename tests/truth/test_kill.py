"""A folder of logs on a real Dask cluster, of which a worker is killed at work."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from polars.testing import assert_frame_equal

pytest.importorskip("distributed")

from folders import arm, log_of, written

import ident
from workers import cluster

LOGS = 8


@pytest.fixture(scope="module")
def mechanism():
    return arm()


@pytest.fixture(scope="module")
def folder(mechanism, tmp_path_factory) -> Path:
    """Logs, and one that is none."""
    logs = {f"run_{i}.csv": log_of(mechanism, i) for i in range(LOGS)}
    found = written(tmp_path_factory.mktemp("logs"), logs)
    (found / "run_2b.csv").write_text("t,q.yaw\n0,1\n")
    return found


def test_a_worker_killed_at_work_loses_no_log(mechanism, folder, tmp_path):
    with cluster(tmp_path) as started:
        victim = started.start("victim", "--no-nanny")
        started.start("other", "--no-nanny")
        started.wait_for(2)
        seen = []

        def told(what, share):
            if what != "equations":
                return
            seen.append(share)
            if victim.poll() is None:
                victim.send_signal(signal.SIGSTOP)  # so that it keeps the next task that it gets
                if started.busy("victim"):
                    victim.send_signal(signal.SIGKILL)
                    assert victim.wait() == -signal.SIGKILL

        found = ident.gather(mechanism, folder, scheduler=started.address, progress=told)
    alone = ident.gather(mechanism, folder, jobs=1)
    assert victim.returncode == -signal.SIGKILL
    assert len(seen) == LOGS
    for each in (found, alone):
        assert list(each.broken) == ["run_2b.csv"]
        assert [log.log for log in each.each.logs if not log.left_out] == [
            f"run_{i}.csv" for i in range(LOGS)
        ]
    a, b = found.fit.estimate, alone.fit.estimate
    np.testing.assert_allclose(a.solution.x, b.solution.x, rtol=1e-9)
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-9)
    np.testing.assert_allclose(found.fit.covariance, alone.fit.covariance, rtol=1e-9)
    assert_frame_equal(found.each.table, alone.each.table, rel_tol=1e-6)
