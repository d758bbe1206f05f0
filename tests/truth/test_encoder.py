"""Positions alone from an encoder of 14 bits, 2 % of noise on torques; the benchmark, few runs."""

import importlib.util

import numpy as np
import pytest

import ident


@pytest.mark.parametrize("name", ["five_bar", "arm3"])
def test_base_parameters_are_within_three_percent_and_intervals_cover(name, root, tmp_path):
    spec = importlib.util.spec_from_file_location("encoder", root / "benchmarks" / "encoder.py")
    encoder = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(encoder)
    model = encoder.mechanism(name, tmp_path)
    planted = {n: encoder.FRICTION[name][e.kind] for e in model.effects for n in e.names}
    exact, _ = ident.simulate(model, encoder.motion(name, 1), values=planted)
    covered = []
    for seed in (100, 101, 102):
        fit = ident.identify(model, ident.complete(model, encoder.logged(model, exact, seed)))
        beta, scale = encoder.truth(fit, planted)
        error = fit.estimate.solution.beta - beta
        assert np.abs(error / scale).max() < 0.03
        covered.append(np.abs(error) <= 1.96 * np.sqrt(np.diag(fit.covariance)))
    assert np.mean(covered) > 0.85
