"""A sample that no closure can follow is left out; those beside it are not."""

import numpy as np

import ident
from helpers import ROBOTS
from ident import Online


def test_a_jump_within_a_block_loses_only_that_sample():
    folder = ROBOTS / "five_bar"
    mechanism = ident.load(folder).with_effect("viscous")
    log = ident.read_log(folder / "run.csv")
    online = Online(mechanism, like=ident.complete(mechanism, log), latency=0.05)
    for i, t in enumerate(log.t):
        sample = {"t": t, **{name: x[i] for name, x in log.columns.items()}}
        if i == 500:
            sample["q.left"] += 50.0
        online.update(sample)
    found = online.snapshot()
    assert found.samples == len(log.t)
    assert any("left out" in note for note in found.notes)
    assert np.isfinite(found["viscous.left.Fv"].value)
