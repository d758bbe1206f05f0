"""Possible changes of a machine, and which of them explains the intervals since an onset.

    r = b − A x_ref          A: columns of all bodies' parameters and of all suspects, x_ref: known

A suspect is a cause and its columns of A: an effect's own, or for a payload those of its link. All
else is arithmetic on the triangle R of the intervals, in all columns:

    θ_g = argmin |e − R_g θ|²,   F_g = |R_g θ_g|²          e = d − R x_ref
    gain   G_g = Σ_k D_k / φ²        fall of the squares of intervals that are left out of the fit
    apart  z_gh = (G_g − G_h) / (2 d_gh),  d_gh = |R_g θ_g − R_h θ_h| / φ
                                     of nested ones the smaller if z < 3

If g is the truth, F_g − F_h scatters with twice the distance of the two predictions, so z is the
evidence for g over h in its own standard errors, with the noise known from normal running
(`information.evidence`); one that is CERTAIN against all others leads alone, as each interval asks
again. z is d/2 ± 1 if g is the truth and −d/2 ± 1 if h is, so in the end h is no rival where
z + d/2, of which d/2 counts up to z + 1, is CERTAIN. What the best leaves is held against noise and
the error δ of x_ref, which the normal rows A_n hold:

    rest = min |r − R δ|² + |A_n δ|²          r: what g leaves

A load is a body that can exist, put on or taken off, since ten free columns explain much that no
body does:

    θ = argmin |C θ − e|²     such that P(θ) ⪰ 0, or P(−θ) ⪰ 0     (the 4 × 4 pseudo-inertia)

Free multipliers are no further sensors: their error is that of the torques, through the loop.
What a change Δx does to them is Δλ = −K⁺ᵀ_λ A Δx.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from ident.diagnosis.candidates import possible as candidates
from ident.effects import KINDS, Effect
from ident.effects.drive import TorqueGain
from ident.effects.effect import Unknown
from ident.equations.filter import STANDING
from ident.equations.rows import Rows, Scene, rows
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, one_of
from ident.fit import Fit
from ident.information import linear
from ident.information.blocks import Block, Information
from ident.information.cone import Limit, nearest, svec
from ident.information.evidence import CERTAIN, MAIN_CAUSE, credible, rivals_of, zscore_in_noise
from ident.information.hypotheses import PartialRegression
from ident.information.linear import Triangle
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, pseudo_inertia
from ident.motion import Motion
from ident.motion.state import State
from ident.streams.charts import FELT, MARGIN, NormalRunning, WatchedInterval

WATCHED = tuple(kind for kind, cls in KINDS.items() if cls.watched == "always")
DIRECT = 4  # range: columns of a suspect that have charts: a payload's mass and first moments
RANK = 1e-4  # numerics: of unit columns' largest singular value: below, it is not asked for
SURPLUS = 2.5  # level: standard errors by which what is left may exceed noise
EXPLAINS = 0.999  # numerics: or share beyond noise that is explained: no model is that exact
EARLIER = 10  # work: intervals before the leading chart's onset in which it can have been
RIDGE = 1e-3  # numerics: of unit columns, for what the intervals do not determine of a load
THINNED = 600  # work: samples of an experiment in which Δλ is taken
TINY = 1e-300  # numerics: so that nothing is divided by zero
BODIES = np.stack([svec(pseudo_inertia(column)) for column in np.eye(COUNT)], axis=1)


@dataclass(frozen=True, eq=False)
class Suspect:
    """A cause that could change, and its k columns."""

    effects: tuple[Effect, ...]  # that change together
    places: np.ndarray  # (k,) of its columns among all
    parameters: tuple[Unknown, ...]  # (k,) what they are
    units: tuple[str, ...]  # (k,) of them
    load: tuple[int, ...] = ()  # those of the places that are columns of a load

    @classmethod
    def of(cls, effects: tuple[Effect, ...], columns: Columns) -> Suspect:
        """Make the suspect whose columns are those of some effects."""
        open_ = [
            (effect, unknown) for effect in effects for unknown in effect.unknowns or effect.shapes
        ]
        names = [  # of a load, the link's own columns
            f"{effect.loaded_link}.{unknown.name}"
            if effect.loaded_link
            else effect.full[unknown.name]
            for effect, unknown in open_
        ]
        places = np.array([columns.index[name] for name in names])
        units = tuple(columns.units[i] for i in places)
        load = tuple(int(i) for i, (e, _) in zip(places, open_, strict=True) if e.loaded_link)
        return cls(effects, places, tuple(unknown for _, unknown in open_), units, load)

    @property
    def label(self) -> str:
        """`coulomb:elbow`, `viscous:elbow + coulomb:elbow`."""
        return " + ".join(effect.label for effect in self.effects)

    def within(self, R: np.ndarray) -> Suspect:
        """Return it without columns of rounding; a load has all ten."""
        size = np.linalg.norm(R[:, self.places], axis=0)
        keep = (size >= FELT * size.max()) | self.loaded
        if keep.all():
            return self
        parameters, units = compress(self.parameters, keep), compress(self.units, keep)
        return Suspect(self.effects, self.places[keep], tuple(parameters), tuple(units), self.load)

    @property
    def loaded(self) -> np.ndarray:
        """(k,) whether a column is one of a load."""
        return np.isin(self.places, self.load)

    def __add__(self, other: Suspect) -> Suspect:
        """Return both together."""
        places = np.concatenate([self.places, other.places])
        parameters, units = self.parameters + other.parameters, self.units + other.units
        return Suspect(
            self.effects + other.effects, places, parameters, units, self.load + other.load
        )

    def contains(self, other: Suspect) -> bool:
        """Whether it is the other one and more."""
        return set(other.places.tolist()) < set(self.places.tolist())


class Watched:
    """The reference, opened for everything that could change."""

    def __init__(self, reference: Fit | Mechanism, motion: Motion, kinds: Sequence[str]) -> None:
        """Open the reference for suspects of some kinds."""
        valid = [*WATCHED, *(kind for kind, cls in KINDS.items() if cls.watched == "request")]
        for kind in kinds:
            if kind not in valid:
                raise FitError(f"no change of '{kind}' can be watched for; {one_of(kind, valid)}")
        known, values = _known(reference)
        mechanism = replace(known, unknown=known.bodies.names, effects=())
        for effect in known.effects:
            mechanism = mechanism + (effect.freed if effect.kind in kinds else effect)
        effects = [effect for effect in candidates(known, motion) if effect.kind in kinds]
        shapes: dict[str, float] = {}
        for effect in effects:
            if effect.loaded_link:
                continue
            if effect.label not in {effect_present.label for effect_present in mechanism.effects}:
                mechanism = mechanism + effect
            if effect.corrects:
                shapes |= {name: values.values.get(name, 0.0) for name in effect.names}
        self.mechanism = mechanism  # with all suspects
        self.columns = Columns.of(mechanism)  # its k unknowns
        self.point = Point(values.pi, {**values.values, **shapes})  # where rows are evaluated
        self.reference = self.point.unknowns(self.columns)  # (k,) x_ref
        self.joints = motion.independent  # of the d coordinates in which torques are compared
        self.cutoff = motion.band.cutoff  # of the rows' filter [Hz]
        # each alone, and companions of a joint together
        groups: list[tuple[Effect, ...]] = [(effect,) for effect in effects]
        for name in dict.fromkeys(e.joints[0] for e in effects if e.companions):
            together = tuple(e for e in effects if e.companions and e.joints[0] == name)
            groups += [together] if len(together) > 1 else []
        self.suspects = tuple(Suspect.of(group, self.columns) for group in groups)

    def scene(self, e: State) -> Scene:
        """Return an experiment as these equations see it."""
        return Scene.of(self.mechanism, self.columns, e, self.point, self.cutoff)

    def rows(self, e: State) -> Iterator[Rows]:
        """Yield all rows of an experiment."""
        return rows(self.scene(e), self.cutoff, STANDING, keep=False)

    def with_gains(self, rows: Rows) -> Rows:
        """Return rows with the columns that a torque channel of a wrong scale shows, 1 + g times
        those of the joint's torque; what x_ref leaves is the same.
        """
        A, b = rows.A.copy(), rows.b.copy()
        scaled = np.ones(len(self.columns), dtype=bool)
        for effect, places in self.columns.effects:
            scaled[places[places >= 0]] = not effect.implicit
        at_reference = np.where(scaled, self.reference, 0.0)
        gains = (effect for effect in self.mechanism.effects if isinstance(effect, TorqueGain))
        for effect in gains:
            (g,), _ = self.point.of(effect)
            for joint in effect.joints:
                if not g or joint not in self.joints:
                    continue
                u = self.joints.index(joint)
                b[:, u] += g * (rows.A[:, u] @ at_reference)
                A[:, u] += g * (rows.A[:, u] * scaled)
        return replace(rows, A=A, b=b)

    def multiplier_triangles(self, motion: Motion) -> tuple[Triangle, ...]:
        """Return by multiplier the triangle of ∂λ/∂x (samples, k), which a force sensor shows."""
        m = len(self.mechanism.kinematics.multipliers)
        triangles = [Triangle.empty(len(self.columns)) for _ in range(m)]
        for e in motion.experiments if m else ():
            at = np.flatnonzero(e.usable)[:: max(1, len(e) // THINNED)]
            scene = self.scene(e.at_samples(at))
            A = scene.terms(slice(None), full=True).A
            slope = -scene.e.pinv[:, :, :m].transpose(0, 2, 1) @ A
            triangles = [f.updated(slope[:, j], np.zeros(len(at))) for j, f in enumerate(triangles)]
        return tuple(triangles)


def _known(reference: Fit | Mechanism) -> tuple[Mechanism, Point]:
    """The mechanism with its effects at known values, and all values."""
    if isinstance(reference, Fit):
        effects = []
        for effect, solution in reference.effect_solution:
            named = zip(effect.parameters, solution, strict=True)
            values = {parameter.name: float(v) for parameter, v in named}
            effects.append(replace(effect, values={**effect.values, **values}))
        mechanism = replace(reference.mechanism, effects=tuple(effects), unknown=())
        return mechanism, Point(reference.point.pi, Point.prior(mechanism).values)
    open_ = [*reference.unknown, *(e.label for e in reference.effects if not e.known)]
    if open_:
        raise FitError(
            f"{reference.name}: a reference must be known, and {open_[0]} is not; give a fit, or "
            "the folder identified/ that a fit writes"
        )
    return reference, Point.prior(reference)


@dataclass(frozen=True, eq=False)
class Reading:
    """One suspect fitted."""

    suspect: Suspect
    theta: np.ndarray  # (k,) change of its parameters
    stderr: np.ndarray  # (k,), NaN where it is not determined alone
    root: np.ndarray  # (k, r) a root of θ's covariance
    fall: float  # F
    gain: float  # G
    predicted: np.ndarray  # (all columns,) R_g θ_g in the triangle's coordinates

    @classmethod
    def of(
        cls, suspect: Suspect, R: np.ndarray, e: np.ndarray, x: np.ndarray, phi2: float, gain: float
    ) -> Reading | None:
        """Fit a suspect; None where its columns have no effect, or values come out impossible."""
        if gain <= 0:
            return None
        C = R[:, suspect.places]
        size = np.linalg.norm(C, axis=0)
        safe = np.where(size > 0, size, 1.0)
        inverse = linear.pinv(C / safe, RANK) / safe[:, None]
        theta, root = inverse @ e, np.sqrt(phi2) * inverse
        error = np.linalg.norm(root, axis=1)
        alone = (size > 0) & (1 - np.einsum("ij,ji->i", inverse, C) <= FELT)
        load = suspect.loaded
        if load.any():  # less than what ten free columns would explain
            free, theta = C @ theta, possible_load(C, e, load)
            gain -= float(np.sum((e - C @ theta) ** 2) - np.sum((e - free) ** 2)) / phi2
            if gain <= 0:
                return None
        values = zip(suspect.parameters, x[suspect.places] + theta, error, load, strict=True)
        if any(not (of_load or p.possible(value, se)) for p, value, se, of_load in values):
            return None
        predicted = C @ theta
        fall = float(e @ e - np.sum((e - predicted) ** 2))
        return cls(suspect, theta, np.where(alone, error, np.nan), root, fall, gain, predicted)

    def apart_from(self, other: Reading, phi2: float) -> tuple[float, float]:
        """Return z over another, and d."""
        d = float(np.linalg.norm(self.predicted - other.predicted)) / np.sqrt(phi2)
        return zscore_in_noise(self.gain - other.gain, d), d


@dataclass(frozen=True, eq=False)
class Naming:
    """All suspects by their gain, and how many of them are tied."""

    readings: tuple[Reading, ...]  # best first
    rivals: tuple[Reading, ...]  # of the best one
    alone: bool  # whether the best is CERTAIN against all others
    excess: float  # standard errors by which what the best leaves exceeds noise …
    surplus: float  # … and the error of x_ref
    explained: float  # share of the squares beyond noise that it removes
    remains: float  # mean square of what is left, 1 in normal running
    least: float  # gain that a cause must have to be one

    @property
    def best(self) -> Reading | None:
        """The likeliest; None where no suspect fits better than none at all."""
        return self.readings[0] if self.readings else None

    @property
    def sound(self) -> bool:
        """Whether the best is likely enough by itself, and leaves nothing to be explained."""
        most = MAIN_CAUSE**2 if self.surplus < SURPLUS else 1 - EXPLAINS
        return self.best is not None and credible(
            self.best.gain, self.least, remaining=1 - self.explained, most=most
        )


def name_change(
    suspects: Sequence[Suspect], window: Sequence[WatchedInterval], x: np.ndarray,
    normal: NormalRunning, least: float,
) -> Naming:  # fmt: skip
    """Fit all suspects to the intervals of a window."""
    triangle = Triangle.merge([reading.triangle for reading in window])
    e, phi2 = triangle.d - triangle.R @ x, normal.typical
    suspects = [reading.within(triangle.R) for reading in suspects]
    gains = left_out_gains(suspects, window, x) / phi2
    fitted = (
        Reading.of(suspect, triangle.R, e, x, phi2, float(gain))
        for suspect, gain in zip(suspects, gains, strict=True)
    )
    readings = sorted(filter(None, fitted), key=lambda reading: -reading.gain)
    for smaller in readings[1:]:
        contained = readings[0].suspect.contains(smaller.suspect)
        if contained and readings[0].apart_from(smaller, phi2)[0] < CERTAIN:
            readings.remove(smaller)  # as good with fewer numbers
            readings.insert(0, smaller)
            break
    best = readings[0] if readings else None
    usual = np.array([reading.rows for reading in window]) * normal.energy
    expected = max(float(usual.sum()), TINY)  # nothing where all rows are at rest
    scatter = max(float(np.sqrt((2.0 / normal.freedom * usual**2).sum())), TINY)
    squares = float(e @ e + triangle.rho**2)
    rest = squares - (best.fall if best else 0.0)
    beyond = normal.beyond_error(triangle.R, e - best.predicted if best else e)
    unexplained = beyond + triangle.rho**2
    louder = max(1.0, unexplained / expected / MARGIN) ** 0.5  # than normal running with its margin
    apart = {id(reading): readings[0].apart_from(reading, phi2) for reading in readings}

    def behind(reading: Reading) -> float:
        return apart[id(reading)][0]

    def behind_in_the_end(reading: Reading) -> float:
        z, d = apart[id(reading)]
        return z + min(z + 1.0, max(d, 1.0) / 2)

    def others(behind: Callable[[Reading], float], within: float) -> tuple[Reading, ...]:
        """Rivals, without those that contain the best, or another one: they are no other causes."""
        near = rivals_of(readings[0], readings, behind, within) if readings else []
        less = [*readings[:1], *near]
        return tuple(e for e in near if not any(e.suspect.contains(x.suspect) for x in less))

    return Naming(
        readings=tuple(readings),
        rivals=others(behind_in_the_end, CERTAIN * louder),
        alone=not others(behind, CERTAIN),
        excess=(rest - expected) / scatter,
        surplus=(unexplained - expected) / scatter,
        explained=(squares - rest) / max(squares - expected, TINY),
        remains=rest / expected,
        least=least,
    )


def left_out_gains(
    suspects: Sequence[Suspect], window: Sequence[WatchedInterval], x: np.ndarray
) -> np.ndarray:
    """(suspects,) fall of the squares of intervals when each is left out of the suspect's fit."""
    none, every = Triangle.empty(len(x)), np.arange(len(x))
    blocks = [
        Block(0, i, 0, w.triangle, none, none, every, (w.torque, 0.0), (w.start, w.end))
        for i, w in enumerate(window)
    ]
    information = Information.of(blocks, len(x), 1)
    if len(information.times) < 2:
        return np.zeros(len(suspects))
    regression = PartialRegression.of(information, np.ones(1), np.empty(0, dtype=int), x)
    return np.asarray(regression.gains([suspect.places for suspect in suspects]).G)


def onset(intervals: Sequence[WatchedInterval], x: np.ndarray, best: Reading) -> int:
    """Return the likeliest begin of a change θ: argmax_j Σ_{i ≥ j} θᵀs_i − |R_i θ|²/2."""
    places, theta = best.suspect.places, best.theta
    gain = [
        float(interval.triangle.gradient(x)[places] @ theta)
        - 0.5 * float(np.sum((interval.triangle.R[:, places] @ theta) ** 2))
        for interval in intervals
    ]
    return int(np.cumsum(gain[::-1])[::-1].argmax())


def name_since_onset(
    suspects: Sequence[Suspect],
    intervals: Sequence[WatchedInterval],
    since: int,
    x: np.ndarray,
    normal: NormalRunning,
    least: float,
) -> tuple[Naming, list[WatchedInterval]]:
    """Fit all suspects to the intervals since the onset that the best of them gives."""

    def naming_from(start: int) -> Naming:
        # without the interval in which the onset was
        window = intervals[start + 1 :] or intervals[start:]
        return name_change(suspects, window, x, normal, least)

    start = max(len(intervals) - since, 0)
    naming = naming_from(start)
    if naming.best is not None:
        first = max(start - EARLIER, 0)
        start = first + onset(intervals[first:], x, naming.best)
        naming = naming_from(start)
    return naming, list(intervals[start:])


def possible_load(C: np.ndarray, e: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Fit θ (k,) of columns C (n, k), of which those of the mask `load` (k,) are a body that can
    exist. The free columns are eliminated: of the load only what they do not explain is fitted.
    """
    if load.all():
        return load_change(C, e)
    size = np.linalg.norm(C[:, ~load], axis=0)
    size = np.where(size > 0, size, 1.0)
    Q, s, _ = np.linalg.svd(C[:, ~load] / size, full_matrices=False)
    Q = Q[:, s > RANK * s.max(initial=0.0)]
    theta = np.zeros(len(load))
    theta[load] = load_change(*(y - Q @ (Q.T @ y) for y in (C[:, load], e)))
    free = linear.pinv(C[:, ~load] / size, RANK) / size[:, None]
    theta[~load] = free @ (e - C[:, load] @ theta[load])
    return theta


def load_change(C: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Fit θ (10,) of a body put on or taken off, the likelier; zero if neither can be."""
    size = np.linalg.norm(C, axis=0)
    size = np.where(size > FELT * size.max(), size, size.max())
    Q, R = np.linalg.qr(np.vstack([C / size, RIDGE * np.eye(COUNT)]))
    d = Q[: len(e)].T @ e
    bodies = [np.zeros(COUNT)]
    for sign in (1.0, -1.0):
        body = Limit("a possible body", "psd", sign * BODIES / size, np.zeros(len(BODIES)))
        try:
            bodies.append(nearest(R, d, [body]).x / size)
        except FitError:  # far from any body, or no number left to tell
            continue
    return min(bodies, key=lambda theta: float(np.linalg.norm(C @ theta - e)))
