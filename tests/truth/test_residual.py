"""The residual at the rows of the regression: the fit's errors, and parts that add up."""

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident import FitError, Noise
from identification import motion_log, plant, robot

NOISE = [Noise("tau", 0.02, relative=True)]


def planted(name, *effects, seconds=8.0, seed=1):
    mechanism = robot(name)
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    return plant(mechanism, motion_log(name, 100.0, seconds), noise=NOISE, seed=seed)


@pytest.mark.parametrize("cutoff", ["auto", None])
@pytest.mark.parametrize("name", ["arm", "five_bar", "slider_crank"])
def test_it_has_the_errors_of_the_fit(name, cutoff):
    case = planted(name, "viscous", "coulomb")
    fit = case.fit(cutoff=cutoff)
    residual = ident.residual_of(fit)
    assert residual.rows == fit.rows
    for joint, error in fit.train.items():
        assert residual.errors[joint].rms == pytest.approx(error.rms, rel=1e-9)
        assert residual.errors[joint].relative == pytest.approx(error.relative, rel=1e-9)


def test_unfiltered_it_is_the_prediction():
    fit = planted("five_bar", "viscous").fit()
    (trace,), (said,) = ident.residual_of(fit).traces, fit.predict()
    np.testing.assert_allclose(trace.predicted, said.predicted, atol=1e-11)
    np.testing.assert_allclose(trace.measured, said.measured, atol=1e-12)
    np.testing.assert_allclose(trace.t, said.t)
    assert "Scene(" not in repr(said)  # all that it was made from


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar", "slider_crank"])
def test_the_parts_add_up(name):
    case = planted(name, "viscous", "coulomb")
    residual = ident.residual_of(case.fit(cutoff="auto"))
    (trace,) = residual.traces
    assert list(trace.parts) == ["rigid bodies", *(e.label for e in case.mechanism.effects)]
    np.testing.assert_allclose(sum(trace.parts.values()), trace.predicted, atol=1e-12)
    np.testing.assert_allclose(trace.measured - trace.residual, trace.predicted, atol=1e-12)
    assert (np.abs(trace.gravity) <= np.abs(trace.parts["rigid bodies"]).max() + 10).all()


def test_gravity_is_what_a_slow_motion_needs():
    case = planted("arm")
    (trace,) = ident.residual_of(case.fit()).traces
    slow = motion_log("arm", 100.0, 8.0)
    columns = {k: 0 * x if k[0] in "va" else x for k, x in slow.columns.items()}
    log, _ = ident.simulate(
        case.mechanism, ident.Log.from_arrays("slow", slow.t, columns), values=case.values
    )
    tau = np.stack([log.columns[f"tau.{joint}"] for joint in case.mechanism.driven], axis=1)
    scale = np.abs(tau).max()
    np.testing.assert_allclose(trace.gravity, tau, atol=0.03 * scale)


def test_a_wrench_is_a_part():
    mechanism = robot("arm")
    log = motion_log("arm", 100.0, 8.0)
    push = {"wrench.hand.fz": 3 * np.sin(2 * log.t), "wrench.hand.mx": np.cos(log.t)}
    pushed = ident.Log.from_arrays("pushed", log.t, {**log.columns, **push})
    case = plant(mechanism, pushed)
    log = ident.Log.from_arrays("pushed", case.log.t, {**case.log.columns, **push})
    fit = ident.identify(mechanism, ident.complete(mechanism, log, cutoff=None))
    (trace,) = ident.residual_of(fit).traces
    assert "external wrenches" in trace.parts
    np.testing.assert_allclose(sum(trace.parts.values()), trace.predicted, atol=1e-12)


def test_a_fit_read_back_leaves_the_same(tmp_path):
    fit = planted("five_bar", "viscous", "coulomb").fit(cutoff="auto")
    fit.write(tmp_path)
    saved = ident.read_fit(tmp_path, robot("five_bar"))
    with pytest.raises(FitError, match="has no motion"):
        ident.residual_of(saved)
    mine, theirs = ident.residual_of(fit), ident.residual_of(saved, fit.motion)
    np.testing.assert_allclose(theirs.traces[0].residual, mine.traces[0].residual, atol=1e-8)
    told = saved.errors["train"]
    assert told == {joint: replace(error) for joint, error in fit.train.items()}


def test_several_logs_are_several_traces():
    case = planted("arm")
    motion = ident.complete(case.mechanism, [case.log, replace(case.log, name="other")])
    residual = ident.residual_of(ident.identify(case.mechanism, motion))
    assert [trace.name for trace in residual.traces] == ["arm.csv", "other"]
    for trace in residual.traces:
        assert trace.q.shape == (len(trace), len(case.mechanism.joints))
        assert trace.informed.all()
    assert "the sum taken apart" in str(residual)
    assert "<table" in residual._repr_html_()


def test_a_motion_that_is_made_twice_repeats():
    """Once more as the diagnosis of a residual advises it, though smoothing takes both ends."""
    mechanism = robot("arm").with_effect("drag:elbow")
    case = plant(mechanism, motion_log("arm", 100.0, 8.0, 4.0), noise=(Noise("q", 1e-5),))
    again = case.fit(mechanism=mechanism.without("drag:elbow"), cutoff="auto").residual.periods
    assert again is not None
    assert list(again.period.values()) == pytest.approx([4.0], rel=0.01)
    once = plant(mechanism, motion_log("arm", 100.0, 8.0, 8.0), noise=(Noise("q", 1e-5),))
    assert once.fit(cutoff="auto").residual.periods is None
