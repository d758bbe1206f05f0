"""Several logs are judged as one is: what is missing in all of them, and on which rows."""

import numpy as np

import ident
from ident import Log, Noise
from identification import motion_log, plant, robot

NOISE = (Noise("tau", 0.005, relative=True), Noise("q", 1e-5))


def logs(mechanism, values, count=2):
    """Logs of different lengths of one machine."""
    made = [
        plant(mechanism, motion_log("arm", 100.0, 8.0 - i), values, noise=NOISE, seed=1).log
        for i in range(count)
    ]
    return [Log.from_arrays(f"log {i}", x.t, dict(x.columns)) for i, x in enumerate(made)]


def test_a_length_that_is_wrong_is_named_on_several_logs():
    bent = robot("arm").with_effect("geometry:elbow.x")
    found = logs(bent, {"geometry.elbow.x.Delta": 0.02})
    fit = ident.identify(robot("arm"), ident.complete(robot("arm"), found))
    diagnosis = ident.diagnose(fit)
    labels = [each.effect.label for each in diagnosis.candidates[:2]]
    assert diagnosis.verdict == "missing"
    assert "geometry:elbow.x" in labels


def test_a_validation_log_at_another_cutoff_is_noted():
    first, second = logs(robot("arm"), {})
    motion = ident.complete(robot("arm"), first, cutoff=8.0)
    codes = []
    for cutoff in (8.0, 4.0):
        other = ident.complete(robot("arm"), second, cutoff=cutoff)
        fit = ident.identify(robot("arm"), motion, validate=other)
        codes.append([finding.code for finding in fit.findings])
    assert "another cut-off" not in codes[0]
    assert "another cut-off" in codes[1]
    assert np.isfinite([e.rms for e in fit.validation["log 1"].values()]).all()
