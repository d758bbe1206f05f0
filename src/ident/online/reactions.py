"""The closures' forces at every sample, with how sure they are.

    λ = K⁺ᵀ_λ (b − A x),     Var λ = G C Gᵀ + Σ_s (K⁺ᵀ_λ W_s)² σ_s²,     G = −K⁺ᵀ_λ A_I

A x = b are all rows of a sample, with what the independent joints' drives measured left out; C is
the covariance of the base parameters, σ_s the noise of a drive s beyond those. What torques do not
determine stays at its prior here: λ may rest on it, and no error bar shows that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.scene import Scene
from ident.equations.terms import terms
from ident.fit.estimate import Estimate
from ident.mechanism.mechanism import Mechanism
from ident.online.window import Window
from ident.tables import rounded


@dataclass(frozen=True, eq=False)
class Multipliers:
    """λ of n samples.

    Attributes:
        names, units: (m,).
        t: (n,) [s]; values, stderr: (n, m); NaN where a multiplier is not determined.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    t: np.ndarray
    values: np.ndarray
    stderr: np.ndarray

    def __len__(self) -> int:
        return len(self.t)

    @classmethod
    def joined(cls, parts: Sequence[Multipliers]) -> Multipliers:
        """One after the other."""
        t, values, stderr = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("t", "values", "stderr")
        )
        return cls(parts[0].names, parts[0].units, t, values, stderr)

    def __str__(self) -> str:
        if not len(self):
            return "no multipliers"
        each = zip(self.names, self.values[-1], self.stderr[-1], self.units, strict=True)
        said = [f"{name} = {rounded(x, error)} {unit}" for name, x, error, unit in each if x == x]
        return ", ".join(said) or "no multiplier is determined"


def multipliers(
    mechanism: Mechanism,
    columns: Columns,
    point: Point,
    window: Window,
    cutoff: float | None,
    determined: np.ndarray,
    estimate: Estimate,
    covariance: np.ndarray,
    noise: np.ndarray,
) -> Multipliers:
    """λ of the samples of a window.

    Args:
        mechanism, columns, point: of the equations.
        window: completed samples.
        cutoff: of the rows' filter [Hz].
        determined: (m,) which multipliers motion and torques determine.
        estimate: of the unknowns; covariance: (n_ind, n_ind) of the base parameters.
        noise: (driven,) standard deviation of white noise in the torques [N m | N].
    """
    kinematics = mechanism.kinematics
    m = len(kinematics.multipliers)
    scene, part = Scene.of(mechanism, columns, window.e, point, cutoff), window.inside
    e, found, s = scene.e, terms(scene, part, full=True), scene.generalised(part)
    assert e.pinv is not None
    K_T = e.pinv[part, :, :m].transpose(0, 2, 1)
    b = found.b - s.measured(e.independent)
    values = np.einsum("nmi,ni->nm", K_T, b - found.A @ estimate.solution.x)
    G = -K_T @ found.A[:, :, estimate.base.independent]
    variance = np.einsum("nmi,ij,nmj->nm", G, covariance, G)
    for name, sigma in zip(mechanism.driven, noise, strict=True):
        if name not in e.independent and sigma > 0:
            W = np.zeros(s.shape)
            s.add_torque(W, name, np.ones(len(s)))
            variance += (np.einsum("nmi,ni->nm", K_T, W) * sigma) ** 2
    open_ = np.where(determined, 0.0, np.nan)
    return Multipliers(
        kinematics.multipliers,
        kinematics.units,
        e.t[part],
        values + open_,
        np.sqrt(variance) + open_,
    )
