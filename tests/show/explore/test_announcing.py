"""What is announced is what explicit refits deliver; what cannot be seen or told apart is said."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from explored import grown, judged, screened

import ident
from ident.assess.exploration import Exploration, PredictedGain, rows_of
from ident.diagnosis.selection import PARSIMONY
from ident.equations.table import Table
from ident.show.board import GROUPS, effect_rows

ARM = ["viscous:elbow", "coulomb:wrist", "spring:shoulder", "coupling:elbow,wrist"]


def announced(e: Exploration, label: str, present: bool = False) -> PredictedGain:
    return next(x for x in e.candidates if x.label == label and x.present == present)


def refitted(fit: ident.Fit, label: str) -> np.ndarray:
    """Σ w² e² of each block (blocks,) by one explicit fit to all the others a block."""
    contest = rows_of(fit)
    regression = contest.regression
    more = None
    if label:
        effect = fit.mechanism.with_effect(label).effects[-1]
        more = contest.columns(effect, {})
    A, b, u, block = [], [], [], []
    for i, part in enumerate(regression.parts):
        own = part.taken(regression.model)
        A.append(own if more is None else np.column_stack([own, more[i]]))
        b.append(part.Y[:, 0])
        u += [part.coordinate] * len(part.X)
        block += np.repeat(np.arange(len(part.edges) - 1), np.diff(part.edges)).tolist()
    A, b, u, block = np.concatenate(A), np.concatenate(b), np.array(u), np.array(block)
    A, b = A * regression.weight[u][:, None], b * regression.weight[u]
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    found = []
    for k in range(regression.blocks):
        x = np.linalg.lstsq(A[block != k], b[block != k], rcond=1e-12)[0]
        found.append(float(np.sum((b[block == k] - A[block == k] @ x) ** 2)))
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "label"), [*(("arm", label) for label in ARM), ("four_bar", "viscous:rocker")]
)
def test_the_fall_announced_is_that_of_explicit_refits(name, label):
    e = screened(name)
    before, after = refitted(e.fit, ""), refitted(e.fit, label)
    found = announced(e, label)
    assert found.fall == pytest.approx(1 - after.sum() / before.sum(), abs=1e-7)


def delivered(before: ident.Fit, after: ident.Fit) -> float:
    """The fall from one model to another in the rows and weights of the first."""
    mine, other = rows_of(before), rows_of(after)
    assert np.array_equal(mine.use, other.use)
    now = other.regression.weighted(mine.regression.weight)
    return 1 - now.loss.sum() / mine.regression.loss.sum()


@pytest.mark.parametrize("label", ARM)
def test_what_is_announced_is_delivered(label):
    e = screened()
    now = e.with_effect(label).now
    same = now.fit.estimate.fixed[: len(e.fit.columns)].sum() == e.fit.estimate.fixed.sum()
    assert same == (label != "spring:shoulder")  # with it the refit leaves one at its prior
    fall = delivered(e.fit, now.fit)
    assert fall == pytest.approx(announced(e, label).fall, abs=1e-8 if same else 0.05)


def test_columns_kept_from_the_model_before_announce_the_same():
    kept = grown("viscous:elbow").screened()
    anew = replace(grown("viscous:elbow"), contest=None).screened()
    assert kept.contest.unchanged(anew.contest.table)
    assert [(x.label, x.fall) for x in kept.candidates] == [
        (x.label, x.fall) for x in anew.candidates
    ]


def test_columns_are_made_anew_where_the_motion_is_corrected():
    e = grown("encoder_offset:elbow")
    contest = screened().contest
    table = Table.of(e.fit.mechanism, e.fit.columns, e.fit.motion, e.fit.point)
    assert not contest.unchanged(table)


def test_what_a_removal_costs_is_announced_too():
    e = grown("viscous:elbow").screened()
    worth = announced(e, "viscous:elbow", present=True).fall
    assert worth is not None
    fall = delivered(e.fit, e.without("viscous:elbow").fit)
    assert fall == pytest.approx(-worth / (1 - worth), rel=1e-8)


def test_the_best_come_first_and_those_of_the_model_last():
    found = grown("viscous:elbow").screened().candidates
    _, *gains = [x.gain for x in found if not x.present and x.fall is not None]
    # those as good as the best of the rest have the simplest first
    best = [max(gains[i:]) for i in range(len(gains))]
    assert all(x >= min((1 - PARSIMONY) * y, y) for x, y in zip(gains, best, strict=True))
    assert [x.label for x in found if x.present] == ["viscous:elbow"]
    assert found[-1].present
    assert "viscous:elbow" not in {x.label for x in found if not x.present}


@pytest.mark.parametrize(
    "name",
    ["arm", *(pytest.param(name, marks=pytest.mark.slow) for name in ("four_bar", "five_bar"))],
)
def test_what_a_diagnosis_names_first_is_first(name):
    best = judged(name).diagnosis.best
    assert best is not None
    rows = effect_rows(screened(name))
    assert rows[0]["label"] == best.label
    assert json.loads(json.dumps(rows)) == rows


@pytest.mark.parametrize("label", ["coulomb:shoulder", "viscous:elbow"])
def test_what_stands_under_would_lower_the_error_lowers_it(label):
    e = grown(label).screened()
    rows = [row for row in effect_rows(e) if row["group"] == GROUPS[1]]
    assert len(rows) > 5
    assert all(announced(e, row["label"]).fall > 0 for row in rows)
    assert all("≈ " in row["fall"] for row in rows)  # of the joint that it mends


def test_what_cannot_be_seen_says_why():
    hidden = [x for x in screened().candidates if x.fall is None]
    payload = next(x for x in hidden if x.label == "payload:hand")
    assert "absorbed" in payload.why
    assert all(x.why and not x.present for x in hidden)


def test_of_what_explains_the_same_the_simplest_is_offered_first():
    labels = [each.label for each in screened().candidates if not each.present]
    for joint in ("shoulder", "elbow"):
        assert labels.index(f"coulomb:{joint}") < labels.index(f"hysteresis:{joint}")
