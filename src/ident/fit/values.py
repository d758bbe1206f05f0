"""Values with their standard errors, under the names that users know.

Base parameters are named as a person reads them: `link_2.Lzz + 0.05 link_3.m + …`. Correlation of
their errors: r_ij = cov_ij / (s_i s_j). Of n base parameters b that an earlier fit determines too,
those have changed whose difference is beyond the errors of both:

    z_k = (b_k − b'_k) / √(s_k² + s'_k²),     |z_k| > Φ⁻¹(1 − α / 2n)          (Bonferroni)
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist
from typing import Protocol, TypeVar

import numpy as np

from ident.display import Displayed
from ident.effects import Effect
from ident.equations.unknowns import Columns, Point
from ident.information.estimate import Base, Estimate
from ident.information.evidence import ALPHA
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import CENTROIDAL, COUNT, DYNAMIC, beyond_centroidal, unit_of
from ident.motion import Motion
from ident.text import rounded

STRONG = 0.95  # level: |r| at which two parameters are known only together
SAME = 1e-4  # numerics: of a combination's coefficients, which names state with six digits
EXACT = 1e-6  # numerics: of a value: a change below is that of rounding and interpolation
V = TypeVar("V", "Value", "BaseValue")
TERM = re.compile(r"(?:^| ([+-]) )(?:([\d.e+-]+) )?(\S+)")


@dataclass(frozen=True, repr=False)
class Value:
    """One number of a fit."""

    name: str
    value: float
    stderr: float | None  #: standard error, None where the data do not determine it by itself
    unit: str
    #: whether they do; else it is at its prior, or carries a base parameter given others' priors
    identifiable: bool
    prior: float  #: the URDF's value; of effects the earlier fit's, 0 where there is none
    #: whether a bound holds it; it is no farther off than stderr says, and not normally distributed
    at_bound: bool = False
    stderr_noise: float | None = None  #: what noise makes of `stderr`, which holds calibration too
    #: with which the model predicts the torques as they are logged, by sensors that may be off
    as_logged: float = np.nan
    stderr_as_logged: float | None = None  #: by noise

    def __repr__(self) -> str:
        text = f"{self.name} = {rounded(self.value, self.stderr)} {self.unit}".removesuffix(" 1")
        return text if self.identifiable else f"{text}, not determined by this log"


@dataclass(frozen=True, repr=False)
class BaseValue:
    """A combination of unknowns that the data determine."""

    name: str
    value: float
    stderr: float  #: of noise and calibration
    unit: str
    stderr_noise: float = np.nan  #: what noise makes of it
    as_logged: float = np.nan  #: the value that predicts the torques as they are logged
    stderr_as_logged: float = np.nan  #: by noise

    @property
    def in_data(self) -> BaseValue:
        """The value as it is logged, by sensors whose errors are the same in all logs of them."""
        if not np.isfinite(self.as_logged):
            return self
        return replace(self, value=self.as_logged, stderr=self.stderr_as_logged)

    def __repr__(self) -> str:
        return f"{self.name} = {rounded(self.value, self.stderr)} {self.unit}".removesuffix(" 1")


@dataclass(frozen=True)
class EffectValues:
    """The parameters of one effect."""

    effect: Effect
    parameters: tuple[Value, ...]


def with_noise(values: Sequence[V], noise: Sequence[V], logged: Sequence[V]) -> tuple[V, ...]:
    """Return values with what noise alone makes of their errors, and as they are in the data."""
    return tuple(
        replace(
            value,
            stderr_noise=of_noise.stderr,
            as_logged=as_logged.value,
            stderr_as_logged=as_logged.stderr,
        )
        for value, of_noise, as_logged in zip(values, noise, logged, strict=True)
    )


@dataclass(frozen=True, eq=False)
class ParameterValues:
    """The values of an estimate with their standard errors, under the names that users know."""

    columns: Columns
    estimate: Estimate
    cov: np.ndarray  # of the base parameters (n, n)
    bounds: Collection[str] = ()  # names of those at a bound

    @property
    def base(self) -> tuple[BaseValue, ...]:
        """Base parameters with the unit of their leading unknown."""
        base, beta = self.estimate.base, self.estimate.solution.beta
        errors = np.sqrt(np.diag(self.cov))
        return tuple(
            BaseValue(name, float(value), float(error), self.columns.units[column])
            for name, value, error, column in zip(
                self._base_names, beta, errors, base.independent, strict=True
            )
        )

    @cached_property
    def _base_names(self) -> list[str]:
        return base_names(self.columns, self.estimate.base)

    @cached_property
    def _stderr(self) -> np.ndarray:
        """(k,) of unknowns that are base parameters themselves, else NaN."""
        base, stderr = self.estimate.base, np.full(len(self.columns), np.nan)
        single = ~np.any(base.K != 0.0, axis=1)
        stderr[base.independent[single]] = np.sqrt(np.diag(self.cov))[single]
        return stderr

    def _value(self, name: str, value: float, error: float, unit: str, prior: float) -> Value:
        known = bool(np.isfinite(error))
        stderr = float(error) if known else None
        return Value(name, float(value), stderr, unit, known, float(prior), name in self.bounds)

    def effects(
        self, point: Point, prior: Mapping[str, float] | None = None, columns: Collection[str] = ()
    ) -> tuple[EffectValues, ...]:
        """Return all effects' parameters, a given one at its value in `point`, without error;
        `prior`: values of an earlier fit, by full name; `columns`: of the logs.
        """
        every = list[EffectValues]()
        for effect, places in self.columns.effects:
            values = []
            units = effect.units_with(columns)
            for name, unit, at in zip(effect.names, units, places, strict=True):
                if at < 0:
                    given = point.values[name]
                    values.append(Value(name, given, 0.0, unit, True, given))
                else:
                    before, x = (prior or {}).get(name, 0.0), self.estimate.x[at]
                    values.append(self._value(name, x, self._stderr[at], unit, before))
            every.append(EffectValues(effect, tuple(values)))
        return tuple(every)

    def rigid(self, mechanism: Mechanism) -> tuple[Value, ...]:
        """Return unknown dynamic parameters in Γ's order.

        Moments of inertia are about the centre of mass where that is known or identified, and then
        named `I`, else about the joint frame's origin, `L`.
        """
        pi = self.columns.dynamic_parameters(mechanism, self.estimate.solution.x)
        values = []
        for link in mechanism.bodies.links:
            names = [f"{link}.{word}" for word in DYNAMIC]
            body = mechanism.bodies.columns(link)
            body_values, prior = pi[body], mechanism.plausible_prior[body]
            places = [self.columns.index.get(name, -1) for name in names]
            errors = np.array([self._stderr[i] if i >= 0 else 0.0 for i in places])
            centred = np.isfinite(errors[:4]).all() and body_values[0] != 0.0
            for k, (word, name) in enumerate(zip(DYNAMIC, names, strict=True)):
                if places[k] < 0:
                    continue
                value, error, before = body_values[k], errors[k], prior[k]
                if word in CENTROIDAL and centred:
                    value -= beyond_centroidal(body_values)[k]
                    before -= beyond_centroidal(prior)[k]
                    if np.isfinite(error):
                        error = self._centroidal_error(body_values, places, k)
                    name = f"{link}.{CENTROIDAL[word]}"
                values.append(self._value(name, value, error, unit_of(word), before))
        return tuple(values)

    def _centroidal_error(self, pi: np.ndarray, at: Sequence[int], k: int) -> float:
        """Return the error of I_k of a body pi (10,) with places `at` in x (delta method)."""
        gradient = self._centroidal_gradient(pi, at, k)
        return float(np.sqrt(gradient @ self.cov @ gradient))

    def _centroidal_gradient(self, pi: np.ndarray, at: Sequence[int], k: int) -> np.ndarray:
        """Return the slope (n,) of I_k of a body pi (10,) by the base parameters."""
        place = {int(column): i for i, column in enumerate(self.estimate.base.independent)}
        gradient = np.zeros(len(self.cov))
        for j in (0, 1, 2, 3):
            if at[j] >= 0:
                step = np.zeros(COUNT)
                step[j] = 1e-6 * max(abs(pi[j]), abs(pi[0]))
                rise = beyond_centroidal(pi + step)[k] - beyond_centroidal(pi - step)[k]
                gradient[place[at[j]]] = -rise / (2 * step[j])
        gradient[place[at[k]]] = 1.0
        return gradient

    def gradient(self, name: str, mechanism: Mechanism) -> np.ndarray | None:
        """Return the slope (n,) of a value by the base parameters; None if these do not hold it."""
        base, word = self.estimate.base, name.rpartition(".")[2]
        unit, names = np.eye(base.rank), self._base_names
        if name in names:
            return np.asarray(unit[names.index(name)])
        centroidal = {to: about for about, to in CENTROIDAL.items()}
        about = f"{name.rpartition('.')[0]}.{centroidal.get(word, word)}"
        place = self.columns.index.get(about, -1)
        if place not in base.independent or not np.isfinite(self._stderr[place]):
            return None
        if word not in centroidal:
            return np.asarray(unit[list(base.independent).index(place)])
        link = name.rpartition(".")[0]
        pi = self.columns.dynamic_parameters(mechanism, self.estimate.solution.x)
        body = mechanism.bodies.columns(link)
        places = [self.columns.index.get(f"{link}.{item}", -1) for item in DYNAMIC]
        return self._centroidal_gradient(pi[body], places, list(DYNAMIC).index(centroidal[word]))

    def correlation(self) -> Correlation:
        """Return the correlation of the errors of base parameters."""
        s = np.sqrt(np.diag(self.cov))
        with np.errstate(invalid="ignore", divide="ignore"):
            r = self.cov / np.outer(s, s)
        names = tuple(self.columns.names[i] for i in self.estimate.base.independent)
        return Correlation(names, np.clip(r, -1, 1))


def base_names(columns: Columns, base: Base) -> list[str]:
    """Return an expression for each independent column: the unknown and what is regrouped."""
    names = []
    for independent, row in zip(base.independent, base.K, strict=True):
        terms = [columns.names[independent]]
        for k in np.flatnonzero(row):
            number = "" if abs(abs(row[k]) - 1.0) < 1e-9 else f"{abs(row[k]):.6g} "
            terms.append(f"{'-' if row[k] < 0 else '+'} {number}{columns.names[base.dependent[k]]}")
        names.append(" ".join(terms))
    return names


def absorbed_by(columns: Columns, base: Base) -> dict[str, str]:
    """Return for every dependent unknown the unknowns that carry it; empty if no torque does."""
    return {
        columns.names[other]: ", ".join(
            columns.names[base.independent[i]] for i in np.flatnonzero(base.K[:, j])
        )
        for j, other in enumerate(base.dependent)
    }


@dataclass(frozen=True, eq=False, repr=False)
class Correlation(Displayed):
    """Correlation of the errors of base parameters; `print` shows the strong ones."""

    names: tuple[str, ...]  #: (n,) the leading unknown of each base parameter
    matrix: np.ndarray  #: (n, n), 1 on the diagonal; NaN where a standard error is not known

    def pairs(self, least: float = STRONG) -> list[tuple[str, str, float]]:
        """Return pairs with |r| ≥ least, the strongest first."""
        i, j = np.where(np.triu(np.abs(self.matrix) >= least, 1))
        r = self.matrix[i, j]
        order = np.argsort(-np.abs(r), kind="stable")
        return [(self.names[i[k]], self.names[j[k]], float(r[k])) for k in order]

    def __getitem__(self, names: tuple[str, str]) -> float:
        """Return r of two base parameters by their leading unknowns.

        Raises:
            KeyError: if one of them leads no base parameter.
        """
        for name in names:
            if name not in self.names:
                valid = ", ".join(self.names[:12]) + (", …" if len(self.names) > 12 else "")
                raise KeyError(f"'{name}' leads no base parameter; valid: {valid}")
        i, j = (self.names.index(name) for name in names)
        return float(self.matrix[i, j])


class Model(Protocol):
    """A mechanism with the values of all its parameters: a fit, or one read from a file."""

    @property
    def name(self) -> str:
        """In tables."""

    @property
    def mechanism(self) -> Mechanism:
        """With its effects."""

    @property
    def point(self) -> Point:
        """Values of all parameters."""

    @property
    def base_parameters(self) -> tuple[BaseValue, ...]:
        """The combinations that its log determined."""

    @property
    def motion(self) -> Motion | None:
        """Data of the fit; None if it was read from a file."""


@dataclass(frozen=True)
class Change:
    """One base parameter in two fits; z: their difference in standard errors of it.

    `effect`: whose parameter it is; None of a body's, and of a combination.
    """

    before: BaseValue
    after: BaseValue
    z: float
    effect: Effect | None = None

    @property
    def shape(self) -> bool:
        """Whether it is the shape of an effect with coefficients: its error is that of a slope,
        which says little about how far a shape may be off, and it is no size that changes.
        """
        if self.effect is None or not self.effect.unknowns:
            return False
        return self.after.name in self.effect.names[len(self.effect.unknowns) :]

    @property
    def terms(self) -> tuple[str, ...]:
        """Full names of the unknowns in it."""
        return tuple(name for _, _, name in TERM.findall(self.after.name))


@dataclass(frozen=True, repr=False)
class Changes(Displayed):
    """What a fit has in common with an earlier one, and what is different."""

    since: str  #: name of the earlier fit
    #: its base parameters that this one determines too, the most significant change first
    compared: tuple[Change, ...]
    apart: tuple[str, ...] = ()  #: the names of those that it does not determine

    @classmethod
    def of(cls, earlier: Model, now: ParameterValues) -> Changes:
        """Compare base parameters with those of an earlier fit."""
        columns, base = now.columns, now.estimate.base
        compared, apart = list[Change](), list[str]()
        effects = {name: effect for effect in earlier.mechanism.effects for name in effect.names}
        for before in (value.in_data for value in earlier.base_parameters):
            acting = (effects.get(name) for *_, name in TERM.findall(before.name))
            if any(effect is not None and effect.in_rows_alone for effect in acting):
                continue  # what a filter makes of reversals is no change of a machine
            c, known = np.zeros(len(columns)), True
            for sign, factor, name in TERM.findall(before.name):
                known &= name in columns.index
                if name in columns.index:
                    c[columns.index[name]] = float(factor or 1.0) * (-1.0 if sign == "-" else 1.0)
            g, c_dependent = c[base.independent], c[base.dependent]
            size = np.abs(base.K).T @ np.abs(g) + np.abs(c_dependent)
            value = float(g @ now.estimate.solution.beta)
            stderr = float(np.sqrt(g @ now.cov @ g))
            other = not known or (np.abs(base.K.T @ g - c_dependent) > SAME * size).any()
            if other or not np.isfinite(stderr):
                apart.append(before.name)
                continue
            after = BaseValue(before.name, value, stderr, before.unit)
            step, error = value - before.value, float(np.hypot(stderr, before.stderr))
            exact = abs(step) <= EXACT * max(abs(value), abs(before.value))
            z = 0.0 if exact else step / error if error else np.copysign(np.inf, step)
            compared.append(Change(before, after, float(z), effects.get(before.name)))
        compared.sort(key=lambda change: -abs(change.z))
        return cls(earlier.name, tuple(compared), tuple(apart))

    @property
    def least(self) -> float:
        """Return the standard errors from which a change is none of chance."""
        return -NormalDist().inv_cdf(ALPHA / 2 / max(len(self.compared), 1))

    @cached_property
    def changed(self) -> tuple[Change, ...]:
        """Return the changes beyond the errors of both fits, the most significant first."""
        return tuple(e for e in self.compared if abs(e.z) > self.least and not e.shape)
