"""The first screen: the stretch in which a model's residual falls most, and what is drawn there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from ident.fit.residual import residual_of
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.show.bodies import FACES, coil, decimated, hull, sphere
from ident.show.charts import Line
from ident.show.front import forest_rows, stretch_of
from ident.show.residual import plot_map
from identification import motion_log, plant, robot

T = np.arange(0.0, 20.0, 0.01)
NOISE = 0.1 * np.sin(40 * T)


@dataclass
class Predicted:
    """What a prediction has that is looked at here."""

    t: np.ndarray
    residual: np.ndarray
    usable: np.ndarray


@dataclass
class Left:
    """What a residual has that is looked at here."""

    joints: tuple[str, ...]
    predictions: list[Predicted]
    errors: dict[str, Error]


def left(residual: np.ndarray) -> Left:
    rms = float(np.sqrt(np.mean(residual**2)))
    return Left(
        ("a", "b"),
        [Predicted(T, np.stack([NOISE, residual], axis=1), np.ones(len(T), bool))],
        {"a": Error(0.1, 0.1, "N m"), "b": Error(rms, rms, "N m")},
    )


def test_the_stretch_is_where_the_error_falls_most():
    bump = np.exp(-(((T - 13.0) / 0.5) ** 2))
    before, now = left(NOISE + bump), left(NOISE)
    stretch = stretch_of(before, now, "b")
    assert T[stretch.samples][0] < 12.5 < 13.5 < T[stretch.samples][-1]
    assert np.ptp(T[stretch.samples]) < 6.1


def test_of_one_model_the_stretch_is_where_its_error_is_largest():
    only = left(NOISE + 2.0 * (np.abs(T - 5.0) < 0.3))
    stretch = stretch_of(only, only, "b")
    assert T[stretch.samples][0] <= 4.71
    assert T[stretch.samples][-1] >= 5.29


def test_intervals_of_a_forest_hold_their_value_in_their_scale():
    values = [
        Value(f"p{i}", value, error, "kg", True, prior)
        for i, (value, error, prior) in enumerate([(1.0, 0.01, 0.0), (-2.0, 0.5, -2.1), (3, 9, 3)])
    ]
    rows = forest_rows(values)
    assert [row.name for row in rows] == ["p0", "p1", "p2"]  # those known best as shares first
    for row, v in zip(rows, values, strict=True):
        assert 0 < row.low < row.value < row.high < 100
        scale = (row.high - row.low) / (2 * 1.96 * v.stderr)
        assert row.value - row.prior == pytest.approx(scale * (v.value - v.prior))


def volume(corners: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume of a closed surface, positive if its faces look outward."""
    a, b, c = (corners[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_a_fine_mesh_is_decimated_and_stays_closed_and_as_large():
    from scipy.spatial import ConvexHull

    cloud = sphere(1.0, 4000)
    fine = ConvexHull(cloud)
    faces = fine.simplices.copy()
    a, b, c = (cloud[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), fine.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    corners, few = decimated(cloud, faces)
    assert 100 < len(few) <= FACES
    assert volume(corners, few) == pytest.approx(4.19, rel=0.15)


def test_faces_of_a_coil_and_a_ball_look_outward():
    assert volume(*coil(1.0, 2.0)) > 0
    assert volume(*hull(sphere(1.0))) == pytest.approx(4.19, rel=0.1)


def test_a_passive_joint_of_a_loop_is_drawn_by_its_own_torque():
    with_friction = robot("four_bar").with_effect("viscous:rocker")
    planted = plant(with_friction, motion_log("four_bar"), {"viscous.rocker.Fv": 0.2})
    now = planted.fit()
    before = planted.fit(mechanism=robot("four_bar"))
    chart = plot_map(residual_of(before), residual_of(now), "crank", "viscous:rocker", 2.0)
    assert chart is not None
    panel = chart.rows[0][0]
    line = next(mark for mark in panel.marks if isinstance(mark, Line))
    assert np.allclose(np.polyfit(line.x, line.y, 1)[0], 0.2, rtol=0.02)
    assert "rocker" in panel.y
