"""Logs of drives that lead a fit astray: names, gains, sensors of some logs, joints held still."""

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.effects.servo import HOLD

pl = pytest.importorskip("polars")

JOINTS = ("yaw", "shoulder", "elbow")
ARM = ROBOTS / "servo_arm"


@pytest.fixture(scope="module")
def mechanism():
    return ident.load(ARM).with_calibration("exact")  # its sensors are those of a simulator


@pytest.fixture(scope="module")
def log():
    return pl.read_csv(ARM / "run.csv").head(2000)


def test_a_column_called_hold_moves_no_command(mechanism, log):
    (e,) = ident.complete(mechanism, log.with_columns(hold=pl.lit(1.0))).experiments
    assert np.all(e.extra["hold"] == 1.0)
    assert e.extra[HOLD] == pytest.approx(0.005)
