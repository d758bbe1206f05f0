"""Lines of [log] that the names of columns suggest, with the factors of their units."""

import math
import tomllib

import pytest

from ident.log.mapping import suggested_entries


def entries(columns):
    lines = suggested_entries(["time_ms", *columns], ["a", "b"], ["a", "b"])
    table = tomllib.loads("\n".join(lines))["log"]
    scales = {key: x["scale"] if isinstance(x, dict) else 1.0 for key, x in table.items()}
    return scales, lines


@pytest.mark.parametrize(
    ("position", "speed", "torque", "factors"),
    [
        ("q{} [deg]", "dq{} [deg/s]", "tau{} [mNm]", (math.pi / 180, math.pi / 180, 1e-3)),
        ("position_{}(deg)", "vel{}_deg_s", "current_{}(mA)", (math.pi / 180, math.pi / 180, 1e-3)),
        ("pos{}_mrad", "vel{}_mrad_per_s", "torque{} (N m)", (1e-3, 1e-3, 1.0)),
        ("pos{}_mm", "vel{}_rpm", "torque{}_mN_m", (1e-3, math.pi / 30, 1e-3)),
        ("pos{} {{rad}}", "vel{} rad/s", "torque{}_Nm", (1.0, 1.0, 1.0)),
    ],
)
def test_units_are_read_in_brackets_and_of_speeds(position, speed, torque, factors):
    scales, lines = entries([x.format(i) for x in (position, speed, torque) for i in (1, 2)])
    for signal, factor in zip(("q", "v", "tau"), factors, strict=True):
        assert scales[f"{signal}.a"] == scales[f"{signal}.b"] == pytest.approx(factor)
    assert "no unit" not in "".join(lines)


def test_a_line_without_a_unit_says_so():
    _, lines = entries([f"{x}{i}" for x in ("pos", "vel", "current") for i in (1, 2)])
    assert sum("no unit in its name: rad or m" in line for line in lines) == 2
    assert sum("no unit in its name: rad/s or m/s" in line for line in lines) == 2
    assert sum("no unit in its name: N m or N" in line for line in lines) == 2
