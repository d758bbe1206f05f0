"""No effect is claimed of one log of the double pendulum that the others do not bear out.

A name is borne out where its refit lowers the error of its joint in another log, and where the
other log finds its parameters within three standard errors.
"""

import importlib.util
from functools import cache

import numpy as np
import pytest

import ident

CUTOFF = 12.0  # Hz


@pytest.fixture(scope="module")
def dfki(root, shared_data):
    if not (shared_data / "dfki_double_pendulum").is_dir():
        pytest.skip(f"no dfki_double_pendulum in {shared_data}")
    spec = importlib.util.spec_from_file_location("dfki", root / "benchmarks" / "dfki.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def diagnosis(dfki):
    return cache(lambda log: ident.diagnose(ident.identify(*dfki.given([log], CUTOFF))))


def borne_out(dfki, found, log, other):
    """Of the named effect, by another log of the same design."""
    (model, _), (_, there) = dfki.given([log], CUTOFF), dfki.given([other], CUTOFF)
    best = found.candidates[0]
    plain = ident.identify(model, found.fit.motion, validate=there, start=found.fit.point)
    richer = model.with_effect(best.effect.label)
    both = ident.identify(richer, found.fit.motion, validate=there, start=found.fit.point)
    own = ident.identify(richer, there)
    (before,), (after,) = plain.validation.values(), both.validation.values()
    lower = after[best.joint].rms < 0.95 * before[best.joint].rms
    pairs = zip(both.effects[-1].parameters, own.effects[-1].parameters, strict=True)
    return lower and all(
        abs(a.value - b.value) < 3 * np.hypot(a.stderr or np.inf, b.stderr or np.inf)
        for a, b in pairs
    )


@pytest.mark.parametrize(
    ("log", "others"),
    [
        pytest.param(
            "A0_11",
            ["A0_12", "A0_13"],
            marks=pytest.mark.xfail(
                reason="a play in the other joint makes a friction of this one credible"
            ),
        ),
        pytest.param(
            "A0_13",
            ["A0_11"],
            marks=[
                pytest.mark.slow,
                pytest.mark.xfail(
                    reason="names rest on one log's left-out time, which others do not bear out"
                ),
            ],
        ),
        ("C1_154220", ["C1_154548"]),
    ],
)
def test_no_effect_is_claimed_that_other_logs_do_not_bear_out(dfki, diagnosis, log, others):
    found = diagnosis(log)
    if found.verdict == "missing":
        assert all(borne_out(dfki, found, log, other) for other in others), str(found.best)


def test_a_joint_without_torque_is_said_to_be_one(diagnosis):
    assert "the motor does next to nothing" in diagnosis("A0_13").text


def test_fast_predicted_torques_are_not_in_the_measured_one(dfki):
    """Above 8 Hz the residual of joint 1 is the prediction, so that no torque can explain it."""
    fit = ident.identify(*dfki.given(["A0_11"], 8.0))
    (trace,) = ident.residual_of(fit, motion=dfki.given(["A0_11"], 30.0)[1]).traces
    fast = {}
    for name, x in (("measured", trace.measured[:, 0]), ("predicted", trace.predicted[:, 0])):
        power = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2
        hz = np.fft.rfftfreq(len(x), float(np.diff(trace.t).mean()))
        fast[name] = power[hz > 8].sum()
    assert fast["measured"] < 0.05 * fast["predicted"]
