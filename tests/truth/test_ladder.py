"""Rungs of a ladder that are announced, and the fit that ends it."""

from ident.diagnosis.grow import _contradicted
from ident.information.blocks import Error


def test_a_fit_that_leaves_more_contradicts_what_was_announced():
    announced = {"yaw": Error(0.2, 0.02, "N m"), "lift": Error(1.0, None, "N")}
    for rms, expected in ((0.1, False), (0.201, False), (0.5, True)):
        fitted = {"yaw": Error(rms, rms / 10, "N m"), "lift": Error(2.0, None, "N")}
        assert _contradicted(announced, fitted, 0.003) is expected
