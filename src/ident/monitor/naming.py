"""What changed: every suspect fitted to the intervals since the onset, and which of them are tied.

    θ_g = argmin |e − R_g θ|²,   F_g = |R_g θ_g|²          e = d − R x_ref, from one triangle
    worth  q_g = F_g / φ² − k_g log(n / φ²)                 parsimony: a payload has ten columns
    apart  z_gh = (q_g − q_h) / (2 |R_g θ_g − R_h θ_h| / φ)

If g is the truth, F_g − F_h scatters with twice the distance of the two predictions, so z is the
evidence for g over h in its own standard errors (Vuong, Econometrica 57(2), 1989, with the noise
known from the clean log); suspects within APART of the best are its rivals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.monitor.body import load
from ident.monitor.clean import Clean
from ident.monitor.interval import Interval
from ident.monitor.watched import Suspect, Watched
from ident.solve.factor import Factor

APART = 3.0  # standard errors within which two suspects are not told apart
RANK = 1e-4  # of the largest singular value of unit columns; below, a direction is not asked for
SURPLUS = 2.5  # standard errors by which what is left may exceed noise
EXPLAINS = 0.999  # or share of what is beyond noise that is explained: no model is that exact
MOSTLY = (
    0.8  # share that a cause must explain however little is left: a weak stranger leaves little
)
LATELY = 10  # intervals before the onset that tell how large errors have been of late
BLURRED = 1e-6  # share of a parameter in directions that are not asked for: it is not told alone
NEGATIVE = 2.0  # standard errors below zero at which a value is one that no such thing can have


@dataclass(frozen=True, eq=False)
class Reading:
    """One suspect fitted.

    Attributes:
        theta: (k,) change of its parameters; stderr: (k,), NaN where the window does not tell one.
        root: (k, r) a root of θ's covariance.
        fall: F; worth: q; predicted: (all columns,) R_g θ_g in the triangle's coordinates.
    """

    suspect: Suspect
    theta: np.ndarray
    stderr: np.ndarray
    root: np.ndarray
    fall: float
    worth: float
    predicted: np.ndarray


@dataclass(frozen=True, eq=False)
class Naming:
    """All suspects by their worth, and how many of them are tied.

    Attributes:
        readings: best first; rivals: of the best one.
        surplus: standard errors by which what the best leaves exceeds noise; explained: share of
            the squares beyond noise that it removes; remains: mean square of what is left, 1 in
            normal running.
        least: worth that a cause must have to be one.
    """

    readings: tuple[Reading, ...]
    rivals: tuple[Reading, ...]
    surplus: float
    explained: float
    remains: float
    least: float

    @property
    def best(self) -> Reading | None:
        """The likeliest; None where no suspect fits better than none at all."""
        return self.readings[0] if self.readings else None

    @property
    def sound(self) -> bool:
        """Whether the best is likely enough by itself, and leaves nothing to be explained."""
        likely = self.best is not None and self.best.worth >= self.least
        enough = self.surplus < SURPLUS and self.explained >= MOSTLY
        return likely and (self.explained >= EXPLAINS or enough)


def named(
    watched: Watched,
    window: Sequence[Interval],
    x: np.ndarray,
    clean: Clean,
    least: float,
    before: Sequence[Interval] = (),
) -> Naming:
    """The suspects on the intervals of a window.

    Args:
        watched: with the suspects.
        window: intervals since the onset.
        x: (k,) the reference; clean: normal running.
        least: worth that a cause must have to be one.
        before: intervals before the onset; where their errors are larger than usual already, that
            is nothing that the cause has to explain.
    """
    factor = Factor.merge([each.factor for each in window])
    e = factor.d - factor.R @ x
    phi2 = clean.typical
    n = max(factor.rows, 2) / phi2
    found = [
        reading
        for suspect in watched.suspects
        if (reading := _read(suspect, factor.R, e, x, phi2, n)) is not None
    ]
    found.sort(key=lambda each: -each.worth)
    d = len(clean.sigma)
    usual = np.array([each.rows[:d] for each in window]) * _level(clean, before)
    normal = float(usual.sum())
    scatter = float(np.sqrt((2.0 / clean.freedom[:d] * usual**2).sum()))
    best = found[0] if found else None
    squares = float(e @ e + factor.rho**2)
    rest = squares - (best.fall if best else 0.0)
    return Naming(
        readings=tuple(found),
        rivals=tuple(each for each in found[1:] if best and _rival(best, each, phi2)),
        surplus=(rest - normal) / scatter,
        explained=(squares - rest) / max(squares - normal, 1e-300),
        remains=rest / normal,
        least=least,
    )


def _level(clean: Clean, before: Sequence[Interval]) -> np.ndarray:
    """(d,) mean squares of the coordinates, as learnt, or as they have been of late if more."""
    d = len(clean.sigma)
    if len(before) < LATELY:
        return clean.energy[:d]
    squares, rows = (
        np.sum([getattr(x, n)[:d] for x in before], axis=0) for n in ("squares", "rows")
    )
    return np.maximum(clean.energy[:d], squares / np.maximum(rows, 1))


def onset(held: Sequence[Interval], x: np.ndarray, best: Reading) -> int:
    """The interval from which on a change of θ is likeliest: argmax_j Σ_{i ≥ j} θᵀs_i − |R_i θ|²/2.

    Args:
        held: intervals, the last one now.
        x: (k,) the reference; best: what has changed.
    """
    places, theta = best.suspect.places, best.theta
    gain = [
        float(each.score(x)[places] @ theta)
        - 0.5 * float(np.sum((each.factor.R[:, places] @ theta) ** 2))
        for each in held
    ]
    return int(np.cumsum(gain[::-1])[::-1].argmax())


def _rival(best: Reading, other: Reading, phi2: float) -> bool:
    """Whether another is not told apart; what is the best one and more is no other."""
    return not other.suspect.contains(best.suspect) and separation(best, other, phi2) < APART


def separation(a: Reading, b: Reading, phi2: float) -> float:
    """z of a over b; two that predict nearly the same are apart only by what a clear worth says."""
    distance = float(np.linalg.norm(a.predicted - b.predicted)) / np.sqrt(phi2)
    return (a.worth - b.worth) / (2.0 * max(distance, 1.0))


def _read(
    suspect: Suspect, R: np.ndarray, e: np.ndarray, x: np.ndarray, phi2: float, n: float
) -> Reading | None:
    """The suspect fitted; None where nothing of it is felt, or it came out as it cannot be."""
    C = R[:, suspect.places]
    size = np.linalg.norm(C, axis=0)
    if not (size > 0).any():
        return None
    safe = np.where(size > 0, size, 1.0)
    U, s, Vt = np.linalg.svd(C / safe, full_matrices=False)
    good = s > RANK * s[0]
    theta = Vt[good].T @ ((U[:, good].T @ e) / s[good]) / safe
    root = np.sqrt(phi2) * (Vt[good].T / s[good]) / safe[:, None]
    error = np.linalg.norm(root, axis=1)
    blurred = (Vt[~good] ** 2).sum(axis=0) > BLURRED
    if suspect.payload:
        theta = load(C, e)
    elif not _possible(suspect, x[suspect.places], theta, error):
        return None
    predicted = C @ theta
    fall = float(e @ e - np.sum((e - predicted) ** 2))
    worth = fall / phi2 - len(theta) * float(np.log(n))
    stderr = np.where((size > 0) & ~blurred, error, np.nan)
    return Reading(suspect, theta, stderr, root, fall, worth, predicted) if worth > 0 else None


def _possible(suspect: Suspect, x: np.ndarray, theta: np.ndarray, stderr: np.ndarray) -> bool:
    """Whether the changed values are such as this cause can have."""
    return not any(
        (each.nonnegative and value < -NEGATIVE * error) or abs(value) > each.largest + error
        for each, value, error in zip(suspect.parameters, x + theta, stderr, strict=True)
    )
