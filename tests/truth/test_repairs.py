"""What an effect says of a log or a file is put right there: with its lines the effect is gone."""

import shlex
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import ident
from ident import Noise
from ident.assess.fit import assess_fit
from ident.assess.repairs import repairs_of
from ident.cli.lines import ShellRequest
from ident.effects.effect import Correction
from ident.log import Column
from ident.request import PYTHON
from ident.show.fit import card
from ident.show.repairs import repair_lines
from identification import motion_log, plant, robot

SENSORS = (Noise("tau", 0.003, relative=True), Noise("q", 1e-5))
DELTA, GAIN = -0.052, 0.4


def fitted(label, values, seconds=8.0):
    """The fit of a log of the arm with an effect, which is in the model."""
    mechanism = robot("arm").with_effect(label)
    log = plant(mechanism, motion_log("arm", seconds=seconds), values, noise=SENSORS, seed=3).log
    return log, ident.identify(mechanism, ident.complete(mechanism, log))


@pytest.mark.parametrize(
    ("label", "name", "value", "channel"),
    [
        ("encoder_offset:shoulder", "delta", DELTA, "q.shoulder"),
        ("torque_gain:elbow", "g", GAIN, "tau.elbow"),
    ],
)
def test_the_line_to_paste_takes_the_effect_out(label, name, value, channel):
    kind, joint = label.split(":")
    log, fit = fitted(label, {f"{kind}.{joint}.{name}": value})
    step = assess_fit(fit).next
    assert step.verb == "identify"
    entry = tomllib.loads("\n".join(repair_lines(step)))["log"][channel]
    if kind == "encoder_offset":
        assert entry["offset"] == pytest.approx(DELTA, abs=0.003)
    else:
        assert entry["scale"] == pytest.approx(1 / (1 + GAIN), abs=0.02)
    column = Column(**entry)
    columns = {**log.columns}
    columns[channel] = column.scale * columns[column.column] + column.offset
    right = ident.Log.from_arrays("run.csv", log.t, columns)
    for model in (robot("arm"), fit.mechanism):
        again = ident.identify(model, ident.complete(model, right))
        assert again.train[joint].rms < 1.2 * fit.train[joint].rms
        assert not repairs_of(again)
    text = " ".join(card(fit).text())
    assert f"identify again without {label}" in " ".join(text.split())


def test_a_length_is_that_of_the_urdf():
    _, fit = fitted("geometry:elbow.z", {"geometry.elbow.z.Delta": 0.03})
    (repair,) = repairs_of(fit)
    before, after = repair.now
    origin = fit.mechanism.model.jointPlacements[fit.mechanism.model.getJointId("elbow")]
    assert before == pytest.approx(origin.translation[2])
    assert after - before == pytest.approx(0.03, abs=0.006)


def test_gravity_is_what_the_tilted_base_feels():
    _, fit = fitted("gravity_tilt", {"gravity_tilt.x": 0.05, "gravity_tilt.y": -0.03})
    (repair,) = repairs_of(fit)
    tilt = dict(zip("xy", (v.value for v in fit.effects[0].parameters), strict=True))
    corrected = fit.mechanism.corrected(Correction(tilt=(tilt["x"], tilt["y"])))
    np.testing.assert_allclose(repair.now, corrected.model.gravity.linear, atol=1e-9)
    assert repair_lines(assess_fit(fit).next)[0].startswith("gravity = [")


def test_a_late_position_is_shifted():
    _, fit = fitted("position_delay:elbow", {"position_delay.elbow.d": 0.015})
    (repair,) = repairs_of(fit)
    assert (repair.kind, repair.where) == ("delay", "q.elbow")
    assert repair.number == pytest.approx(0.015, abs=0.002)


def test_a_late_torque_is_shifted_and_what_is_known_or_uncertain_stays():
    label = "delay:elbow"
    _, fit = fitted(label, {"delay.elbow.d": 0.015})
    (repair,) = repairs_of(fit)
    assert (repair.kind, repair.where) == ("delay", "tau.elbow")
    assert repair.number == pytest.approx(0.015, abs=0.002)
    assert "ms late, so shift column tau.elbow" in " ".join(card(fit).text())
    assert not repairs_of(fit, but=[label])
    assert PYTHON.line(assess_fit(fit).next) == ""  # the log is read again
    known = fit.mechanism.without(label) + replace(
        ident.effect("delay", "elbow"), values={"d": 0.015}
    )
    assert not repairs_of(ident.identify(known, fit.motion))


def test_the_command_has_the_folder_and_no_longer_the_effect():
    _, fit = fitted("torque_gain:elbow", {"torque_gain.elbow.g": GAIN})
    step = assess_fit(fit).next
    options = ("--with", "viscous", "--with", "torque_gain:elbow")
    request = ShellRequest("here/arm.urdf", ("run.csv",), options)
    bare = tuple(replace(repair, file="arm.urdf") for repair in step.repairs)
    words = shlex.split(request.line(replace(step, repairs=bare)))
    assert words[1:6] == ["identify", "here", "run.csv", "--with", "viscous"]
    assert "torque_gain:elbow" not in words
    assert repair_lines(replace(step, repairs=bare))[:2] == ['urdf = "arm.urdf"', "[log]"]
    assert step.json()["arguments"]["repairs"][0]["kind"] == "scale"
