"""Logs with gaps, empty cells, channels of different rates and irregular stamps: as any other."""

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.assess.exploration import Exploration
from ident.fit.residual import residual_of
from identification import robot

FRICTION = ("coulomb.elbow.Fc", "viscous.elbow.Fv")
pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def log():
    return ident.read_log(ROBOTS / "arm" / "run.csv")


@pytest.fixture(scope="module")
def mechanism():
    return robot("arm").with_effect("viscous").with_effect("coulomb")


@pytest.fixture(scope="module")
def reference(log, mechanism):
    return ident.identify(mechanism, ident.complete(mechanism, log))


def without(log, *cuts):
    keep = np.ones(len(log.t), dtype=bool)
    for first, last in cuts:
        keep[first - 1 : last] = False
    columns = {name: x[keep] for name, x in log.columns.items()}
    return ident.Log.from_arrays("gaps.csv", log.t[keep], columns)


def described(mechanism, log):
    """A fit whose residual's maps and repetitions were all asked for."""
    motion = ident.complete(mechanism, log)
    fit = ident.identify(mechanism, motion)
    residual = residual_of(fit, motion)
    assert residual.where
    assert str(residual)
    return fit


def alike(fit, reference, times=6.0):
    for joint, error in fit.held_out.items():
        assert error.relative < max(times * reference.held_out[joint].relative, 0.02)
    for name in FRICTION:
        off = abs(fit[name].value - reference[name].value)
        assert off < 4 * np.hypot(fit[name].stderr, reference[name].stderr)


def test_rows_between_two_gaps_that_are_too_few_for_a_spectrum(log, mechanism, reference):
    alike(described(mechanism, without(log, (1001, 1061), (1206, 1266))), reference)


@pytest.mark.parametrize("apart", [90, 100, 110, 120, 130, 140, 150, 160])
def test_any_number_of_rows_between_two_gaps(log, mechanism, reference, apart):
    cuts = (1001, 1061), (1061 + apart, 1121 + apart), (1121 + 2 * apart, 1181 + 2 * apart)
    alike(described(mechanism, without(log, *cuts)), reference)


def test_half_of_all_cells_empty(log, mechanism, reference):
    random = np.random.default_rng(0)
    columns = {k: np.where(random.random(len(x)) < 0.5, np.nan, x) for k, x in log.columns.items()}
    alike(described(mechanism, ident.Log.from_arrays("half", log.t, columns)), reference)


def test_channels_of_different_rates(log, mechanism, reference):
    columns = {
        name: np.where(np.arange(len(x)) % (1 + i % 4), np.nan, x)
        for i, (name, x) in enumerate(log.columns.items())
    }
    alike(described(mechanism, ident.Log.from_arrays("rates", log.t, columns)), reference, 12.0)


def test_irregular_stamps_with_gaps(log, mechanism, reference):
    random = np.random.default_rng(1)
    t = log.t + random.uniform(-0.4, 0.4, len(log.t)) * np.median(np.diff(log.t))
    columns = {name: np.interp(t, log.t, x) for name, x in log.columns.items()}
    cut = without(ident.Log.from_arrays("uneven", t, columns), (601, 700), (1501, 1560))
    alike(described(mechanism, cut), reference)


def test_a_long_filter_leaves_rows_between_gaps(log, mechanism):
    random = np.random.default_rng(0)
    t = log.t + random.uniform(-0.4, 0.4, len(log.t)) * np.median(np.diff(log.t))  # of no use
    cut = without(ident.Log.from_arrays("jitter", t, log.columns), (501, 560), (1001, 1400))
    motion = ident.complete(mechanism, cut)
    fit = ident.identify(mechanism, motion)
    assert not any("mean nothing" in note for note in fit.warnings)  # of too few equations
    assert all(error.relative < 0.1 for error in fit.held_out.values())


# --- every verb ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gappy(log):
    """Two gaps that leave a few rows between them, a third of the cells empty, rates of its own."""
    random = np.random.default_rng(3)
    cut = without(log, (1001, 1061), (1206, 1266))
    columns = {
        name: np.where(random.random(len(x)) < 0.3, np.nan, x) for name, x in cut.columns.items()
    }
    columns["q.wrist"] = np.where(np.arange(len(cut.t)) % 2, np.nan, cut.columns["q.wrist"])
    return ident.Log.from_arrays("gappy", cut.t, columns)


def test_diagnose_and_compare_on_a_log_with_gaps(gappy, mechanism, tmp_path):
    lacking = mechanism.without("coulomb:elbow")
    motion = ident.complete(mechanism, gappy)
    fit = ident.identify(lacking, motion)
    found = ident.diagnose(fit)
    assert found.best is not None
    assert found.best.label == "coulomb:elbow"
    found.write(tmp_path / "diagnosed")
    full = ident.identify(mechanism, motion)
    full.write(tmp_path / "fitted")
    compared = ident.compare(fit, full)
    assert "nan" not in str(compared)
    compared.write(tmp_path / "compared")


def test_explore_and_grow_on_a_log_with_gaps(gappy, mechanism):
    lacking = mechanism.without("viscous:elbow")
    motion = ident.complete(mechanism, gappy)
    explored = Exploration.of(lacking, motion).screened()
    offered = (each for each in explored.candidates if not each.present)
    assert max(offered, key=lambda each: each.fall or 0).label == "viscous:elbow"
    grown = ident.grow(lacking, motion)
    assert [each.label for each in grown.mechanism.effects if each.joints == ("elbow",)]


def test_one_absurd_cell_beside_gaps(gappy, mechanism, reference):
    columns = dict(gappy.columns)
    k = int(np.flatnonzero(np.isfinite(columns["tau.elbow"]))[500])
    columns["tau.elbow"] = columns["tau.elbow"].copy()
    columns["tau.elbow"][k] = 1e20
    fit = described(mechanism, ident.Log.from_arrays("absurd", gappy.t, columns))
    alike(fit, reference, 12.0)
    assert any("tau.elbow = 1e+20 in row" in warning for warning in fit.warnings)
    assert not any("least noise" in warning for warning in fit.warnings)


def test_a_torque_without_any_value_is_refused_as_such(log, mechanism):
    columns = {**log.columns, "tau.elbow": np.full(len(log.t), np.nan)}
    empty = ident.Log.from_arrays("empty.csv", log.t, columns)
    with pytest.raises(ident.errors.MotionError, match=r"'tau\.elbow' has no value in any"):
        ident.complete(mechanism, empty)


def test_a_torque_in_words_is_refused_as_such(log, mechanism, tmp_path):
    names = ["t", *log.columns]
    rows = zip(log.t, *log.columns.values(), strict=True)
    words = [
        ["high" if n == "tau.elbow" else x for n, x in zip(names, r, strict=True)] for r in rows
    ]
    lines = [",".join(map(str, row)) for row in [names, *words]]
    (tmp_path / "words.csv").write_text("\n".join(lines))
    with pytest.raises(ident.errors.MotionError, match=r"'tau\.elbow' holds text \('high'\); log"):
        ident.complete(mechanism, tmp_path / "words.csv")
