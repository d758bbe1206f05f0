"""Bodies are drawn to their prior as far as the rows do not know better.

    d = β − β₀,  Cov(d) = C + s² B        B = [1 K] P² [1 K]ᵀ        (base parameters of bodies)
    β' = β − C (C + s² B)⁻¹ d             further parameters follow their correlation with them

C: what noise makes of β; β₀, P: values of the prior and their plausible distances. A direction that
the rows know much better than the prior stays, one that they do not know goes to the prior, without
a limit between them. s ≥ 1 is the scale with which these d are most likely: placeholders in place
of bodies are no prior (empirical Bayes: Efron, Morris, J. Am. Stat. Assoc. 70(350), 1975).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.information.blocks import Information
from ident.information.chance import moderated_covariance
from ident.information.estimate import Estimate
from ident.information.left_out import LeftOut
from ident.information.linear import Array

# level: standard errors by which some parameter must move: below, least squares stay as they are
NEAR = 0.1
WIDEST = 12.0  # range: of log s
SCALES = 1201  # work: s that are tried, a percent apart


@dataclass(frozen=True, eq=False)
class Shrinkage:
    """How far base parameters are drawn to a prior.

    Attributes:
        prior, plausible: (k,) values of unknowns and their distances; bodies: (k,) which are of
            bodies; wider: (k,) of base parameters, errors over those of white rows; scale: s.
    """

    prior: Array
    plausible: Array
    bodies: np.ndarray
    wider: Array
    scale: float

    @classmethod
    def of(
        cls,
        information: Information,
        estimate: Estimate,
        prior: Array,
        plausible: Array,
        bodies: int,
        blocks: LeftOut | None = None,
    ) -> Shrinkage | None:
        """Return the shrinkage of least squares on some rows; None where no parameter moves.

        `prior`, `plausible`: (k,); the first unknowns, as many as `bodies`, are of bodies.
        `blocks`: of the rows and the estimate, where they are made already.
        """
        places = estimate.base.independent
        if len(information.times) < 2 or not (places < bodies).any():
            return None
        blocks = blocks or LeftOut.of(information, estimate)
        noise = moderated_covariance(information, estimate, blocks.white_covariance, blocks)
        variances = np.diag(noise)
        if not (variances > 0).all():
            return None
        wider = np.ones(len(prior))
        wider[places] = np.sqrt(variances / np.diag(estimate.solution.C))
        self = cls(prior, plausible, np.arange(len(prior)) < bodies, wider, 1.0)
        try:
            values, _, z = self._directions(estimate)
        except np.linalg.LinAlgError:
            return None
        # −2 log density of d by s
        scales = np.exp(np.linspace(0.0, WIDEST, SCALES))
        total = 1 + scales[:, None] ** 2 * values
        misfit = (np.log(total) + z**2 / total).sum(axis=1)
        self = replace(self, scale=float(scales[misfit.argmin()]))
        change = np.abs(self.change(estimate)) / np.sqrt(variances)
        return self if change.max() > NEAR else None

    def _directions(self, estimate: Estimate) -> tuple[Array, Array, Array]:
        """Return squares (m,) of the prior over those of noise along m directions of bodies, the
        directions (m, m), and d along them, in units of noise.
        """
        base = estimate.base
        of_bodies = self.bodies[base.independent]
        body_places = base.independent[of_bodies]
        wider = self.wider[body_places]
        C = estimate.solution.C[np.ix_(of_bodies, of_bodies)] * np.outer(wider, wider)
        K = base.K[of_bodies]
        held = estimate.fixed[base.dependent]
        distances = self.plausible[base.dependent] * ~held * self.bodies[base.dependent]
        B = np.diag(self.plausible[body_places] ** 2) + (K * distances**2) @ K.T
        d = (
            estimate.solution.beta[of_bodies]
            - self.prior[body_places]
            - K @ self.prior[base.dependent]
        )
        L = np.linalg.cholesky(C)
        values, V = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, B).T))
        return np.maximum(values, 0.0), L @ V, V.T @ np.linalg.solve(L, d)

    def change(self, estimate: Estimate) -> Array:
        """Return the change (n_ind,) of the base parameters of an estimate."""
        values, directions, z = self._directions(estimate)
        of_bodies = self.bodies[estimate.base.independent]
        of_body = -directions @ (z / (1 + self.scale**2 * values))
        wider = self.wider[estimate.base.independent]
        C = estimate.solution.C * np.outer(wider, wider)
        inner = np.linalg.solve(C[np.ix_(of_bodies, of_bodies)], of_body)
        return np.asarray(C[:, of_bodies] @ inner)

    def drawn(self, estimate: Estimate) -> Estimate:
        """Return the estimate drawn to the prior; what is at a limit stays there."""
        x, base = estimate.x.copy(), estimate.base
        x[base.independent] += self.change(estimate)
        limits = estimate.x[estimate.at_limit]
        return estimate.at(x).limited(estimate.at_limit, limits)
