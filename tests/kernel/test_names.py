"""The nearest of valid names, which messages suggest."""

import pytest

from ident.errors import near

COLUMNS = ["position4", "position7", "torque7", "time"]


@pytest.mark.parametrize(
    ("name", "meant"),
    [("pos7", "position7"), ("position5", ""), ("positon4", "position4"), ("tiem", "time"),
     ("time1", "time"), ("torque", "torque7")],
)  # fmt: skip
def test_another_number_is_another_joint(name, meant):
    assert near(name, COLUMNS) == meant
