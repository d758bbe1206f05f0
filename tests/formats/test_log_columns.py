"""The [log] mapping: ident's names from the file's columns, in SI units."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ident.errors import LogError
from ident.log import Column, Log
from ident.log.table import RawTable

ROWS = "\n".join(
    ["stamp_ms,motor_current,theta,mode", *(f"{10 * k},{k},{k / 8},run" for k in range(12))]
)
STAMP = Column("stamp_ms", 0.001)


def test_scale_and_offset(read: Callable[..., Log]) -> None:
    log = read(ROWS, {"t": STAMP, "tau.theta": Column("motor_current", 0.12, -0.5)})
    np.testing.assert_allclose(log.t, np.arange(12) / 100, rtol=1e-15)
    np.testing.assert_allclose(log.columns["tau.theta"], 0.12 * np.arange(12) - 0.5, rtol=1e-15)
    assert list(log.columns) == ["tau.theta", "theta"]  # in the file's order; the mapped one once


def test_one_column_may_serve_two_names(read: Callable[..., Log]) -> None:
    log = read(ROWS, {"t": STAMP, "q.a": Column("theta"), "q.b": Column("theta", -1.0)})
    np.testing.assert_array_equal(log.columns["q.a"], -log.columns["q.b"])
    assert list(log.columns) == ["motor_current", "q.a", "q.b"]


def test_a_name_may_be_mapped_to_itself(read: Callable[..., Log]) -> None:
    log = read(ROWS, {"t": STAMP, "theta": Column("theta", 8.0)})
    np.testing.assert_array_equal(log.columns["theta"], np.arange(12))


def test_two_columns_may_exchange_names(read: Callable[..., Log]) -> None:
    swap = {"theta": Column("motor_current"), "motor_current": Column("theta")}
    log = read(ROWS, {"t": STAMP} | swap)
    np.testing.assert_array_equal(log.columns["theta"], np.arange(12))
    np.testing.assert_array_equal(log.columns["motor_current"], np.arange(12) / 8)


BAD = {
    "missing": (
        {"t": STAMP, "tau.theta": Column("motor_curent")},
        ("'motor_curent'", "'tau.theta'", "did you mean 'motor_current'", "theta"),
    ),
    "ambiguous": (
        {"t": STAMP, "theta": Column("motor_current")},
        ("'theta' is ambiguous", "'motor_current'", "remove"),
    ),
    "ambiguous with text": (
        {"t": STAMP, "mode": Column("motor_current")},
        ("'mode' is ambiguous", "'motor_current'", "remove"),
    ),
    "text": (
        {"t": STAMP, "q.a": Column("mode")},
        ("'mode'", "'q.a'", "holds text ('run')", "numbers are needed"),
    ),
    "overflow": ({"t": STAMP, "q.a": Column("theta", 1e308)}, ("'q.a'", "line 13", "inf")),
}


@pytest.mark.parametrize(("columns", "says"), BAD.values(), ids=BAD)
def test_these_are_refused(
    csv: Callable[..., Path],
    refused: Callable[..., str],
    columns: dict[str, Column],
    says: tuple[str, ...],
) -> None:
    rows = ROWS.replace("11,1.375", "11,137500")
    refused(csv(rows), says, columns)


def test_only_columns_of_no_other_use_are_proposed(
    csv: Callable[..., Path], refused: Callable[..., str]
) -> None:
    mapping = {"v.elbow": Column("velocity.elbow"), "tau.elbow": Column("effort.elbow")}
    path = csv("t,velocity.elbow,torque.elbow\n0,1,2\n1,1,2\n")
    says = "did you mean 'torque.elbow'? valid: t, torque.elbow, velocity.elbow"
    refused(path, (says,), mapping)


@pytest.mark.parametrize(
    ("scale", "offset"), [(0.0, 0.0), (np.nan, 0.0), (np.inf, 0.0), (1.0, np.nan)]
)
def test_a_scale_that_loses_the_data_is_refused(scale: float, offset: float) -> None:
    with pytest.raises(LogError, match=r"'q': scale = .*valid: finite"):
        Column("q", scale, offset)


def test_a_file_in_own_names_needs_no_mapping() -> None:
    mapping = {"t": Column("stamp", 1e-3), "q.hip": Column("deg", 0.0174)}
    t, q = np.linspace(0, 1, 101), np.ones(101)
    log = Log.from_table("next.csv", RawTable("next.csv", {"t": t, "q.hip": q}), mapping)
    np.testing.assert_array_equal(log.columns["q.hip"], q)
