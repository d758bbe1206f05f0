"""Multipliers in a time basis: portions have no seam between them."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import ident
from ident.information.band import Stretch
from ident.information.reduction import Chunk
from ident.streams.checkpoint import Checkpoint, _packed, _unpacked
from ident.streams.gather import gather

ROBOTS = Path(__file__).resolve().parents[2] / "robots"
LOG = ROBOTS / "slider_crank" / "run.csv"


@pytest.fixture(autouse=True)
def short_portions(monkeypatch):
    monkeypatch.setattr(sys.modules["ident.streams.logs"], "STRIDE", 64)


def crank(basis="linear", spacing=0.005):
    mechanism = ident.load(LOG.parent)
    return replace(mechanism, multipliers=ident.Multipliers(basis, spacing))


@pytest.mark.parametrize(
    ("basis", "spacing", "cutoff"),
    [("linear", 0.005, None), ("cubic", 0.01, None), ("linear", 0.04, 60.0), ("cubic", 0.04, 60.0)],
)
def test_portions_give_the_fit_of_the_whole_log(basis, spacing, cutoff):
    mechanism = crank(basis, spacing)
    motion = ident.complete(mechanism, LOG, cutoff=cutoff)
    batch = ident.identify(mechanism, motion, estimator="least-squares")
    found = gather(mechanism, LOG, cutoff=cutoff, samples=330)
    assert found.worked > 3
    fit = found.fit
    np.testing.assert_allclose(fit.estimate.solution.x, batch.estimate.solution.x, rtol=1e-9)
    assert fit.estimate.triangle.rows == batch.estimate.triangle.rows
    np.testing.assert_allclose(
        np.sqrt(np.diag(fit.covariance)), np.sqrt(np.diag(batch.covariance)), rtol=1e-6
    )
    assert fit.held_out["theta"].rms == pytest.approx(batch.held_out["theta"].rms, rel=1e-3)


def test_the_table_of_multipliers_is_that_of_the_whole_log(tmp_path):
    mechanism = crank()
    batch = ident.identify(mechanism, ident.complete(mechanism, LOG), estimator="least-squares")
    gather(mechanism, LOG, samples=330).write(tmp_path)
    table = pl.read_csv(tmp_path / "multipliers.csv")
    t, values = batch.multipliers[0]
    np.testing.assert_allclose(table["t"].to_numpy(), t, atol=1e-12)
    np.testing.assert_allclose(table.to_numpy()[:, 1:], values, atol=1e-9 * np.abs(values).max())


def test_several_logs_have_stacks_of_their_own(tmp_path):
    mechanism = crank()
    log = ident.read_log(LOG)
    for number, part in enumerate((slice(0, 900), slice(900, None))):
        columns = {name: x[part] for name, x in log.columns.items()}
        ident.Log.from_arrays(f"{number}", log.t[part], columns).write(tmp_path / f"{number}.csv")
    paths = [tmp_path / "0.csv", tmp_path / "1.csv"]
    batch = ident.identify(mechanism, ident.complete(mechanism, paths), estimator="least-squares")
    found = gather(mechanism, paths, samples=400).fit
    np.testing.assert_allclose(found.estimate.solution.x, batch.estimate.solution.x, rtol=1e-9)


def test_an_interrupted_run_goes_on_with_its_stretches(tmp_path, monkeypatch):
    mechanism = crank()
    whole = gather(mechanism, LOG, samples=330).fit
    kept = {}

    def remember(self, state):
        kept.setdefault("state", state)
        write(self, state)

    write = Checkpoint.write
    monkeypatch.setattr(Checkpoint, "write", remember)
    monkeypatch.setattr(Checkpoint, "due", lambda self, absorbed: absorbed == 2)
    gather(mechanism, LOG, samples=330, checkpoint=tmp_path)
    assert set(kept["state"].stretches) == {0}
    again = gather(mechanism, LOG, samples=330, checkpoint=tmp_path)
    assert again.resumed == 2
    np.testing.assert_allclose(again.fit.estimate.solution.x, whole.estimate.solution.x, rtol=1e-12)


def test_a_stretch_is_the_same_after_it_was_kept():
    rng = np.random.default_rng(0)

    first = np.sort(rng.integers(0, 20, 200))
    chunk = Chunk(
        first, rng.standard_normal((200, 2, 3)), rng.standard_normal((200, 4)),
        rng.standard_normal(200),
    )  # fmt: skip
    stretch = Stretch.of(chunk)
    numbers = []
    text = json.dumps(_packed({3: stretch}, numbers))
    again = _unpacked(json.loads(text), np.concatenate(numbers))[3]
    assert [f.rows for f in again.closed()] == [f.rows for f in stretch.closed()]
    np.testing.assert_array_equal(again.closed()[0].R, stretch.closed()[0].R)


def test_a_consistent_fit_of_what_is_not_linear_is_refused():
    mechanism = crank("free").with_effect("coulomb:theta").with_effect("stribeck:theta")
    with pytest.raises(ident.FitError, match="'stribeck:theta' is not linear"):
        gather(mechanism, LOG, consistent=True)
