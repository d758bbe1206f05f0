"""The problem of `excite`: motions inside the limits, their criterion, and slopes of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from ident.equations.unknowns import Columns
from ident.errors import MechanismError, MotionError, one_of
from ident.excite.commands import planned_commands
from ident.excite.excitation import (
    Criterion,
    Determined,
    Excitation,
    determined_places,
    informative,
)
from ident.excite.limits import LimitBox, Limits
from ident.excite.trajectory import Family, Fourier, MotionRows, at_rest, moved_joints
from ident.fit.shapes import initial
from ident.information.estimate import TOLERANCE, rank_revealing
from ident.information.linear import Triangle
from ident.log import Log
from ident.mechanism.closures import LinearClosure
from ident.mechanism.mechanism import Mechanism
from ident.motion import Band, Motion
from ident.motion.closures import LoopSolver
from ident.motion.recipe import still_speeds
from ident.simulate.inverse import joint_columns

SAMPLES = 24  # work: of the search, a period of the highest harmonic
FINE = 10  # work: times these samples at which the result is checked
MARGIN = 0.97  # range: share of the limits that follow from the drives' motion, at the samples
PILOTS = 12, 40  # work: random motions whose rows give base and scale; draws at most
SHRINK, SHRINKS = 0.99, 20  # numerics: of a motion that breaks a limit between the samples
HOME_MARGIN = 0.05  # range: of its range, the distance of home from a joint's limits
SOFT = 0.02  # range: share of the top speed within which the step of dry friction is smooth
NOISE = 0.01  # range: of the limit of torque: the noise expected of a torque signal


@dataclass(frozen=True, eq=False)
class ExcitingMotion:
    """A motion: x (d, P), its rows, quantities z (n, Z) that have a limit, and criterion J."""

    x: np.ndarray
    rows: MotionRows
    z: np.ndarray
    J: float


class DesignProblem:
    """Motions of one mechanism, their limits, and the scales in which they are compared."""

    def __init__(
        self,
        mechanism: Mechanism,
        limits: Limits,
        period: float,
        harmonics: int,
        noise: Mapping[str, float],
        seed: int,
        values: Mapping[str, float] | None = None,
    ) -> None:
        """Prepare a search; refuse limits without a motion, and models without unknowns."""
        columns = Columns.of(mechanism)
        if not len(columns):
            raise MotionError(f"{mechanism.name}: nothing is unknown, so no motion is needed")
        names = moved_joints(mechanism)
        start = LoopSolver(mechanism, names).coordinates(mechanism.assembled[None]).value[0]
        at_start = at_rest(mechanism, names, start, np.arange(2.0))
        size = 1.0 if at_start.loop is None else float(np.linalg.norm(at_start.pinv[0]))
        known = dict(zip(names, start, strict=True))
        exact, notes = LimitBox.of(mechanism, limits, known, size)
        low, high = exact.of_joints("position", names)
        speed = exact.of_joints("speed", names)[1]
        acceleration = exact.of_joints("acceleration", names)[1]
        home = _home(mechanism, names, at_start.leverage[0], start, low, high, notes)
        series = Fourier(period, harmonics, home, 0.5 * (high - low), speed, acceleration)
        n = SAMPLES * harmonics
        t = period * np.arange(n) / n
        rest = at_rest(mechanism, names, home, t)
        # one wide band of standstill for all motions, so that the criterion is a smooth function
        # of x where otherwise it has a step for each sample and reversal
        top = np.minimum(series.speed, series.half * 2 * np.pi * harmonics / period)
        reached = np.abs(rest.leverage[0]) @ top
        rest = replace(rest, still=np.maximum(SOFT * reached, 1e-9))
        motion = Motion((rest,), names, Band(0.0, 0.0, None), 0.0)
        point = initial(mechanism, motion).with_values(values or {})
        bodies, given = mechanism.bodies, dict(values or {})
        fixed = {name: x for name, x in given.items() if name.rpartition(".")[0] in bodies.links}
        point = replace(point, pi=bodies.with_values(point.pi, fixed))
        family = Family(mechanism, columns, point, series, rest, series.basis(t))
        z = exact.z(family.rows(rest.at_samples(slice(0, 1))).e)
        if (at := exact.broken(z)) is not None:
            joint, kind, unit = exact.quantities[at]
            what, reserve = joint, ""
            if kind != "position":
                what = f"the {kind} of {joint}"
                reserve = f" (less the reserve of {100 * limits.reserve:.3g} %)"
            raise MotionError(
                f"{mechanism.name}: the limits leave no motion: at home {what} is at "
                f"{z[0, at]:.4g} {unit}, its range is {exact.low[at]:.4g} to {exact.high[at]:.4g}"
                f"{reserve}; widen it, or give another [joints] start"
            )
        self.family, self.exact = family, exact  # of motions; their limits
        self.box = box = exact.tightened(names, series.between(n), MARGIN)  # for samples
        self.limited = np.isfinite(box.low) | np.isfinite(box.high)  # of the quantities
        self.names, self.notes = names, tuple(notes)  # of the drives that are moved; assumptions
        self.pinv = size  # ‖K⁺‖ at home, 1 in a tree
        self.given = given  # values of parameters by name
        random = np.random.default_rng([seed, 1])
        drawn = (family.draw(box, random) for _ in range(PILOTS[1]))
        pilots = [pilot[1] for pilot in islice(filter(None, drawn), PILOTS[0])]
        if not pilots:
            raise MotionError(
                f"{mechanism.name}: none of {PILOTS[1]} random motions from home keeps the limits; "
                "home is too near a limit or a singular position: give another [joints] start, or "
                "wider limits"
            )
        torque = exact.of_joints("torque", names)[1] / (1 - limits.reserve)
        self.sigma = _noise(names, torque, pilots, noise)  # (d,) of the torques [N m | N]
        W = np.concatenate([informative(rows) for rows in pilots]) / self.sigma[:, None]
        W = W.reshape(-1, W.shape[2])
        # what can be identified at all, and usual norms of its columns
        self.base = rank_revealing(Triangle.of(W, np.zeros(len(W))), TOLERANCE)
        self.size = np.linalg.norm(W[:, self.base.independent], axis=0) / np.sqrt(len(pilots))

    def criterion(self, separate: tuple[str, str] | None, balance: float) -> Criterion:
        """Return D-optimality, or the separation of two effects that no others make up."""
        if separate is None:
            return Criterion.of_all(self.base.rank, balance)
        columns, independent = self.family.columns, list(self.base.independent)
        both = [determined_places(columns, label, independent) for label in separate]
        for label, effect_columns in zip(separate, both, strict=True):
            if lost := [columns.names[i] for i in effect_columns if i not in independent]:
                raise MotionError(
                    f"{self.family.mechanism.name}: no motion separates {label} from everything "
                    f"else: the column of {lost[0]} is made by the others in all motions that were "
                    "tried; open the loop, change the load or the base, or measure more torques"
                )
        return Criterion.of_pair(
            self.base.rank, *([*map(independent.index, effect_columns)] for effect_columns in both)
        )

    def W(self, rows: MotionRows) -> np.ndarray:
        """Return the rows (n d, r) of the base parameters, over the noise and the usual size."""
        A = rows.A[:, :, self.base.independent] / self.size / self.sigma[:, None]
        return A.reshape(-1, len(self.size))

    def z(self, rows: MotionRows) -> np.ndarray:
        """Return (n, Z) of the quantities that have a limit."""
        return self.box.z(rows.e)[:, self.limited]

    def draw(self, random: np.random.Generator, criterion: Criterion) -> ExcitingMotion | None:
        """Return a random motion inside the limits; None if it is home alone or not informative."""
        drawn = self.family.draw(self.box, random)
        return None if drawn is None else self.candidate(*drawn, criterion)

    def candidate(
        self, x: np.ndarray, rows: MotionRows, criterion: Criterion
    ) -> ExcitingMotion | None:
        """Evaluate a motion; None where it does not determine all unknowns."""
        J = criterion.at(self.W(rows))
        return None if J is None else ExcitingMotion(x, rows, self.z(rows), J)

    def slopes(self, c: ExcitingMotion, criterion: Criterion) -> tuple[np.ndarray, np.ndarray]:
        """Return ∂J/∂x (d P,) and ∂z/∂x (n Z, d P), from G = ∂J/∂A (n, d, k)."""
        n = len(c.rows.e)
        G = np.zeros(c.rows.A.shape[::-1]).T  # in the order of A in memory
        slope = criterion.slope(self.W(c.rows)).reshape(n, -1, len(self.size))
        G[:, :, self.base.independent] = slope / self.size / self.sigma[:, None]
        changes = []
        for m, rows in self.family.perturbed(c.rows.e):
            change = np.zeros((m, n, 1 + c.z.shape[1]))
            if rows is not None:
                A = rows.A.reshape(m, *c.rows.A.shape)
                change[:, :, 0] = np.einsum("mndk,ndk->mn", A - c.rows.A, G)
                change[:, :, 1:] = self.z(rows).reshape(m, *c.z.shape) - c.z
            changes.append(change)
        by_x = self.family.by_x(np.concatenate(changes))
        return by_x[:, 0].sum(axis=0), by_x[:, 1:].reshape(-1, by_x.shape[2])

    def inside(self, x: np.ndarray, rate: float) -> np.ndarray:
        """Return x (d, P), shrunk towards home where a limit is broken between the samples."""
        period = self.family.series.period
        n = max(FINE * len(self.family.rest), int(np.ceil(period * rate)))
        fine = self.family.at(period * np.arange(n) / n)
        grown = None
        for _ in range(SHRINKS):
            grown = fine.grow(x, lambda rows: self.exact.broken(self.exact.z(rows.e)) is None)
            if grown is not None and np.allclose(grown[0], x, rtol=1e-9, atol=0.0):
                return x
            x = SHRINK * x
        if grown is not None:  # torques that gravity makes do not shrink with the motion
            return grown[0]
        raise MotionError(
            f"{self.family.mechanism.name}: the motion found breaks a limit between its "
            "samples; try another seed, or fewer harmonics"
        )

    def excitation(
        self,
        x: np.ndarray,
        duration: float,
        periods: int,
        rate: float,
        separate: tuple[str, str] | None,
        seed: int,
        finished: bool = True,
    ) -> Excitation:
        """Return the excitation of the motion x (d, P), with the log of all periods."""
        family, series = self.family, self.family.series
        t = np.arange(round(duration * rate) + 1) / rate
        grown = family.at(t).grow(x, lambda rows: True)
        assert grown is not None  # it is known to close
        e = grown[1].e
        rows = family.rows(replace(e, still=still_speeds(e)))
        e, mechanism, columns = rows.e, family.mechanism, family.columns
        result = Determined(columns, rows, self.sigma)
        logged = joint_columns(mechanism, {"q": e.y, "v": e.yd, "a": e.ydd}, mechanism.driven)
        logged |= {f"tau.{name}": e.tau[:, i] for i, name in enumerate(mechanism.driven)}
        commands, remarks = planned_commands(mechanism, family.point, self.given, e)
        logged |= commands
        uses = self.exact.uses(self.exact.z(e))
        return Excitation(
            name=mechanism.name,
            log=Log.from_arrays(f"{mechanism.name} excited", t, logged),
            period=duration / periods,
            periods=periods,
            harmonics=series.harmonics,
            series=dict(zip(self.names, series.coefficients(x), strict=True)),
            uses=uses,
            home=0.0 if e.loop is None else uses[-1].high / self.pinv,
            unknowns=len(columns),
            base=result.expected(family.point),
            condition_number=result.base.condition_number,
            log_det=result.log_det,
            noise=dict(zip(self.names, self.sigma, strict=True)),
            separation=None if separate is None else result.separation(separate),
            seed=seed,
            notes=(*self.notes, *remarks),
            finished=finished,
            without_effect=result.without_effect,
        )


def _home(
    mechanism: Mechanism,
    names: tuple[str, ...],
    leverage: np.ndarray,
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    notes: list[str],
) -> np.ndarray:
    """Return the home (d,) [rad | m]: the start, moved into the ranges of joints in no loop.

    `leverage` (joints, d) are the speeds of all joints at the start, by which a joint moves those
    that are geared to it, wherever it stands, and those of its loop.
    """
    geared = [n for c in mechanism.closures if isinstance(c, LinearClosure) for n in c.joints]
    leveraged = leverage[[name not in geared for name in mechanism.joint_index]] != 0
    alone = leveraged.sum(axis=0) <= [name not in geared for name in names]
    margin = HOME_MARGIN * (high - low)
    home = np.where(alone, np.clip(start, low + margin, high - margin), start)
    for i in np.flatnonzero((start < low) | (start > high)):
        unit = mechanism.joint(names[i]).unit
        if not alone[i]:
            raise MotionError(
                f"{mechanism.name}: [joints] start has {names[i]} at {start[i]:.4g} {unit}, "
                f"outside its range {low[i]:.4g} to {high[i]:.4g}; widen the range, or write a "
                f"configuration of the closed loop inside it: [joints] start = {{ {names[i]} = … }}"
            )
        notes.append(f"{names[i]} starts outside its range: {home[i]:.4g} {unit} is home instead")
    return home


def _noise(
    names: tuple[str, ...], most: np.ndarray, pilots: list[MotionRows], given: Mapping[str, float]
) -> np.ndarray:
    """Return (d,) expected noise of torques: given, else 1 % of the limit, else of the rms."""
    for name, x in given.items():
        if name not in names:
            raise MechanismError(f"noise: no drive '{name}' is moved; {one_of(name, names)}")
        if not 0 < x < np.inf:
            raise MechanismError(f"noise: {name} = {x:g}; a number above 0 is expected")
    rms = max(float(np.sqrt(np.mean(np.concatenate([p.e.tau for p in pilots]) ** 2))), 1e-9)
    usual = NOISE * np.where(np.isfinite(most), most, rms)
    return np.array([given.get(name, x) for name, x in zip(names, usual, strict=True)])
