"""Possible bodies: the pseudo-inertia, measured by a ball of the body's own mass and size.

    P(π) = [Σ  h; hᵀ  m],  Σ = tr(L)/2 · 1 − L,  h = m c          possible: P ⪰ 0
    B = F Fᵀ,  F = √m [r·1  c; 0  1]                              of a ball: m, c, r of the prior

P ⪰ 0 says that some distribution of positive mass has these ten parameters (P. Wensing, S. Kim,
J.-J. Slotine, IEEE Robot. Autom. Lett. 3(1), 2018). The eigenvalues of F⁻¹ P F⁻ᵀ are numbers around
1/3 and 1 whatever the units, the frame, and whether a body weighs grams or tons.
"""

from __future__ import annotations

import numpy as np

from ident.fit.plausible import body_scales
from ident.information.cone import svec
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, pseudo_inertia, split

MARGIN = 1e-6  # of the ball, what a body keeps at least: with 0 no simulator could invert its mass
VERIFIED = 0.5  # of the margin, which the check of the result asks for
SMALL = 1e-3  # of a mean link, the least size that is believed


def unit_ball(mechanism: Mechanism, link: int) -> np.ndarray:
    """F⁻¹ (4, 4) of a body, by its number.

    Where the URDF gives no mass or no size, those of a mean link stand in.
    """
    mean_m, mean_l = (scale[link] for scale in body_scales(mechanism))
    m, moments, L = split(mechanism.prior[COUNT * link : COUNT * (link + 1)])
    known = m > 0
    m = m if known else mean_m
    c = moments / m if known else np.zeros(3)
    r = np.sqrt(max(np.trace(L) / (2 * m) - c @ c, 0.0))
    if r < SMALL * mean_l:
        r = 0.1 * mean_l
    inverse = np.eye(4)
    inverse[:3, :3] /= r
    inverse[:3, 3] = -c / r
    return inverse / np.sqrt(m)


def basis(inverse: np.ndarray) -> np.ndarray:
    """(10, 10): `svec` of F⁻¹ P F⁻ᵀ of each dynamic parameter, a column each."""
    return np.stack(
        [svec(inverse @ pseudo_inertia(one) @ inverse.T) for one in np.eye(COUNT)], axis=1
    )


def smallest_eigenvalue(mechanism: Mechanism, link: int, pi: np.ndarray) -> float:
    """Of F⁻¹ P F⁻ᵀ for ten parameters: below zero for no possible body."""
    inverse = unit_ball(mechanism, link)
    return float(np.linalg.eigvalsh(inverse @ pseudo_inertia(pi) @ inverse.T)[0])
