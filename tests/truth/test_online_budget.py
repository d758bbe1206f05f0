"""± of a stream: noise and calibration, as `identify` has them of the same samples."""

from dataclasses import replace

import numpy as np
import pytest
from streaming import given

import ident
from ident import Noise, Online
from ident.fit.calibration_rows import SAMPLES, STRETCHES
from ident.mechanism.calibration import Calibration
from ident.streams.excerpt import SampleExcerpt
from identification import motion_log, plant, robot

SAME = 1e-6  # of a value or an error: rounding of triangles that are merged in another order


def made(name, seconds=4.0, calibration=None, seed=0):
    """A mechanism whose sensors may be off by the defaults, and a noisy log of it."""
    mechanism = robot(name).with_effect("viscous").with_effect("coulomb")
    noise = [Noise("tau", 0.01, relative=True)]
    case = plant(mechanism, motion_log(name, 200.0, seconds), noise=noise, seed=seed)
    return replace(case.mechanism, calibration=calibration or Calibration()), case.log


def streamed(mechanism, log, motion, **options):
    online = Online(mechanism, like=motion, **options)
    for part in given(log, "blocks"):
        online.update(part)
    return online


@pytest.mark.parametrize("cutoff", [None, 12.0], ids=["all rows", "filtered"])
@pytest.mark.parametrize("name", ["arm", "five_bar"])
def test_budget_of_identify(name, cutoff):
    mechanism, log = made(name)
    motion = ident.complete(mechanism, log, cutoff=cutoff)
    fit = ident.identify(mechanism, motion, estimator="least-squares")
    last = streamed(mechanism, log, motion).finish()
    pairs = [(v, fit[v.name]) for v in last.parameters if v.identifiable]
    pairs += list(zip(last.base_parameters, fit.base_parameters, strict=True))
    for value, of_fit in pairs:
        assert value.name == of_fit.name
        for field in ("value", "stderr", "stderr_noise", "as_logged"):
            expected, error = getattr(of_fit, field), of_fit.stderr
            assert getattr(value, field) == pytest.approx(expected, rel=SAME, abs=SAME * error)
        assert value.stderr > value.stderr_noise
    name = last.identified[0].name
    shares, expected = last.shares(name), fit.shares(name)
    assert shares == pytest.approx(expected, rel=1e-4, abs=1e-6)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_exact_calibration_has_errors_of_noise_alone():
    mechanism, log = made("arm", 2.0)
    mechanism = mechanism.with_calibration("exact")
    last = streamed(mechanism, log, ident.complete(mechanism, log, cutoff=None)).finish()
    assert all(v.stderr == v.stderr_noise for v in last.identified)
    assert last.shares(last.identified[0].name) == {"noise": 1.0}
    with pytest.raises(KeyError, match="no parameter"):
        last.shares("forearm.mass")


def test_forgetting_keeps_the_errors_of_the_calibration():
    """A gain does not average out: of the last second or of all, its share of ± is the larger the
    more there is of noise's average.
    """
    mechanism, log = made("arm", 8.0)
    motion = ident.complete(mechanism, log, cutoff=12.0)
    forgetful, lasting = (
        streamed(mechanism, log, motion, forget=T).snapshot() for T in (1.0, None)
    )
    both = {v.name: v for v in forgetful.base_parameters}
    noise = [both[v.name].stderr_noise / v.stderr_noise for v in lasting.base_parameters]
    assert np.median(noise) > 1.2
    assert all(v.stderr > v.stderr_noise for v in forgetful.base_parameters)


def test_a_budget_stays_while_few_equations_are_new():
    mechanism, log = made("arm", 4.0)
    motion = ident.complete(mechanism, log, cutoff=None)
    online, budgets = Online(mechanism, like=motion), []
    for k in range(40):
        part = slice(20 * k, 20 * (k + 1))
        online.update({"t": log.t[part], **{name: x[part] for name, x in log.columns.items()}})
        if k >= 10:
            budgets.append(online.snapshot().solved.budget)
    assert 4 < len({id(budget) for budget in budgets}) < 12
    assert online.finish().solved.budget is not budgets[-1]


@pytest.mark.parametrize("forget", [None, 5.0])
def test_samples_are_kept_in_bounded_memory(forget):
    """Evenly over the time, the last ones among them; of a stream that forgets the last alone."""
    kept, rate, count = SampleExcerpt(1000.0, None, forget), 1000.0, 40 * SAMPLES
    for first in range(0, count, 777):
        t = np.arange(first, min(first + 777, count)) / rate
        kept.add(np.column_stack([t, np.sin(t)]))
    runs = list(kept.runs)
    X = np.concatenate(runs)
    assert len(X) <= 2 * SAMPLES + SAMPLES // STRETCHES
    np.testing.assert_array_equal(X[:, 1], np.sin(X[:, 0]))
    if forget:
        assert len(runs) == 1
        assert count / rate - X[0, 0] == pytest.approx(2 * forget, rel=0.01)
        assert X[-1, 0] == (count - 1) / rate
    else:
        assert len(X) >= SAMPLES - SAMPLES // STRETCHES
        assert X[0, 0] == 0.0
        assert X[-1, 0] > 0.9 * count / rate
        lengths = [len(run) for run in runs[:-1]]
        assert len({*lengths}) == 1


def test_a_table_says_what_makes_the_errors():
    mechanism, log = made("arm", 2.0)
    motion = ident.complete(mechanism, log, cutoff=None)
    text = str(streamed(mechanism, log, motion).finish())
    assert "± noise" in text
    assert "most of ±" in text
    exact = mechanism.with_calibration("exact")
    text = str(streamed(exact, log, ident.complete(exact, log, cutoff=None)).finish())
    assert "± noise" not in text
