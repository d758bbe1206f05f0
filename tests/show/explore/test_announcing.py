"""What is announced is what explicit refits deliver; what cannot be seen or told apart is said."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from explored import given, grown, screened

import ident
from ident.fit.table import Table
from ident.show.explore.exploration import Exploration
from ident.show.explore.predicted import CachedTable, ColumnCache, PredictedGain, ScreeningContext
from ident.show.explore.views import beside_verdict, rows_of

ARM = ["viscous:elbow", "coulomb:wrist", "spring:shoulder", "coupling:shoulder,wrist"]


def announced(e: Exploration, label: str, present: bool = False) -> PredictedGain:
    return next(x for x in e.candidates if x.label == label and x.present == present)


def refitted(ground: ScreeningContext, label: str) -> np.ndarray:
    """Σ e²/rms(τ)² of each block (blocks,) by one explicit fit to all the others a block."""
    table, screen, fit = ground.table, ground.screen, ground.fit
    row, u = screen.row, screen.coordinate
    sigma = fit.estimate.sigma[u]
    A = table.A[row, u][:, fit.estimate.base.independent] / sigma[:, None]
    if label:
        effect = fit.mechanism.with_effect(label).effects[-1]
        full = np.zeros((*table.b.shape, len(effect.unknowns)))
        plain = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
        full[:, plain.felt(effect)] = plain.with_effect(effect, [{}])
        A = np.column_stack([A, full[row, u] / sigma[:, None]])
    A = A / np.linalg.norm(A, axis=0)
    b = table.b[row, u] / sigma
    tau = np.array([np.sum(table.tau[row[u == i], i] ** 2) for i in range(screen.d)])
    found = []
    for i, j in zip(screen.edges[:-1], screen.edges[1:], strict=True):
        others = np.r_[0:i, j : len(b)]
        x = np.linalg.lstsq(A[others], b[others], rcond=1e-12)[0]
        error = (b[i:j] - A[i:j] @ x) * sigma[i:j]
        found.append(float(np.sum(error**2 / tau[u[i:j]])))
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "label"), [*(("arm", label) for label in ARM), ("four_bar", "viscous:rocker")]
)
def test_the_fall_announced_is_that_of_explicit_refits(name, label):
    e = screened(name)
    assert e.ground is not None
    before, after = refitted(e.ground, ""), refitted(e.ground, label)
    found = announced(e, label)
    assert found.fall == pytest.approx(1 - after.sum() / before.sum(), abs=1e-7)
    spread = (before - after).std(ddof=1) * np.sqrt(len(before)) / before.sum()
    assert found.error == pytest.approx(spread, rel=1e-5)


@pytest.mark.parametrize("label", ARM)
def test_what_is_announced_is_delivered(label):
    e = screened()
    now = e.with_effect(label).now
    assert now.announced == announced(e, label).fall
    same = now.fit.estimate.held[: len(e.fit.columns)].sum() == e.fit.estimate.held.sum()
    assert same == (label != "spring:shoulder")  # with it the refit leaves one at its prior
    assert now.delivered == pytest.approx(now.announced, abs=1e-8 if same else 0.01)


def test_what_a_removal_costs_is_announced_too():
    e = grown("viscous:elbow").screened()
    worth = announced(e, "viscous:elbow", present=True).fall
    assert worth is not None
    now = e.without("viscous:elbow").now
    assert now.announced == pytest.approx(-worth / (1 - worth))
    assert now.delivered == pytest.approx(now.announced, rel=1e-8)


def test_the_best_come_first_and_those_of_the_model_last():
    found = grown("viscous:elbow").screened().candidates
    falls = [x.fall for x in found if not x.present and x.fall is not None]
    assert falls == sorted(falls, reverse=True)
    assert [x.label for x in found if x.present] == ["viscous:elbow"]
    assert found[-1].present
    assert "viscous:elbow" not in {x.label for x in found if not x.present}


def test_rivals_are_named():
    viscous, coulomb = (announced(screened(), f"{kind}:wrist") for kind in ("viscous", "coulomb"))
    assert "viscous:wrist" in coulomb.rivals  # their falls differ by less than they are known
    assert "viscous:wrist" in announced(screened(), "coupling:yaw,wrist").better
    assert "coupling:shoulder,wrist" in coulomb.rivals
    assert "viscous:elbow" not in {*viscous.better, *viscous.rivals}  # another part
    for each in screened().candidates:
        for label in each.rivals:
            assert each.label in announced(screened(), label).rivals


def test_what_cannot_be_seen_says_why():
    hidden = [x for x in screened().candidates if x.fall is None]
    payload = next(x for x in hidden if x.label == "payload:hand")
    assert "absorbed" in payload.why
    assert all(x.why and not x.present for x in hidden)


def test_columns_are_made_once_and_are_the_same(monkeypatch):
    e = screened()
    after = grown("viscous:elbow").fit
    kept = CachedTable.of_fit(after, e.store)
    plain = Table.of(after.mechanism, after.columns, after.motion, after.point)
    made = []
    monkeypatch.setattr(Table, "with_effect", lambda self, effect, shapes: made.append(effect))
    looked_up = {}
    for label in ("coulomb:yaw", "stribeck:wrist", "ripple:elbow", "cable:shoulder"):
        effect = after.mechanism.with_effect(label).effects[-1]
        looked_up[label] = effect, kept.starts(effect)
        looked_up[label] += (kept.with_effect(*looked_up[label]),)
    assert not made
    monkeypatch.undo()
    for effect, shapes, columns in looked_up.values():
        np.testing.assert_array_equal(columns, plain.with_effect(effect, shapes))


def test_columns_of_a_corrected_motion_are_not_those_of_the_log():
    e = given()
    mechanism = e.mechanism.with_effect("encoder_offset:elbow")
    fit = ident.identify(mechanism, e.fit.motion, estimator="least-squares")
    store = ColumnCache(dict(screened().store.columns))
    kept = CachedTable.of_fit(fit, store)
    effect = fit.mechanism.with_effect("spring:elbow").effects[-1]
    plain = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    np.testing.assert_array_equal(kept.with_effect(effect, [{}]), plain.with_effect(effect, [{}]))
    assert set(store.columns) == set(screened().store.columns)


def test_better_is_said_only_where_falls_differ_by_more_than_they_are_known():
    by = {x.label: x for x in screened().candidates if not x.present}
    for each in by.values():
        for label in each.better:
            other = by[label]
            assert other.fall - each.fall >= max(other.error, each.error)
    assert any(each.better for each in by.values())


def test_what_would_raise_the_error_lowers_none():
    rows = {row["label"]: row for row in rows_of(screened().candidates)}
    falls = {x.label: x.fall for x in screened().candidates if x.fall is not None}
    for label, fall in falls.items():
        assert ("lowers the error" in rows[label]["words"]) == (fall > 0)


@pytest.mark.parametrize(("verdict", "said"), [("missing", False), ("nothing", True)])
def test_falls_beside_a_verdict_are_spoken_of(verdict, said):
    judged = SimpleNamespace(verdict=verdict)
    words = beside_verdict(screened().candidates, judged)
    assert ("stribeck:wrist 41.6 % ± 5.9 the largest" in words) is said
    assert beside_verdict(screened().candidates[-3:], judged) == ""
    assert beside_verdict(screened().candidates, None) == ""
