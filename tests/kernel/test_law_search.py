"""Shares of the squares that terms explain where they act, against a dense least-squares fit."""

from __future__ import annotations

import numpy as np

from ident.diagnosis.law_search import own_shares
from ident.information.blocks import Part
from ident.information.hypotheses import PartialRegression


def test_shares_are_those_of_a_fit_to_all_parts():
    random, m, groups, draws = np.random.default_rng(0), 60, 3, 4
    edges, weight = np.array([0, 20, 40, 60]), np.array([2.0, 0.5])
    A = [random.normal(size=(m, 4)) for _ in weight]
    Y = [random.normal(size=(m, 1 + draws)) for _ in weight]
    parts = tuple(Part(u, np.arange(4), A[u], Y[u], edges) for u in range(2))
    regression = PartialRegression(parts, np.arange(4), weight)
    C = [random.normal(size=(m, 2 * groups)), np.zeros((0, 2 * groups))]
    shares = own_shares(regression, C, [True, False], groups, draws)
    for k in range(groups):
        c = C[0][:, 2 * k : 2 * k + 2]
        model = np.concatenate([w * a for w, a in zip(weight, A, strict=True)])
        more = np.concatenate([weight[0] * c, np.zeros((m, 2))])
        y = np.concatenate([w * x for w, x in zip(weight, Y, strict=True)])
        left = [
            ((y - X @ np.linalg.lstsq(X, y, rcond=None)[0])[:m] ** 2).sum(axis=0)
            for X in (model, np.column_stack([model, more]))
        ]
        np.testing.assert_allclose(shares[k], 1 - left[1] / left[0], atol=1e-8)
