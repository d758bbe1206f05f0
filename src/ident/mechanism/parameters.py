"""Dynamic parameters of bodies: names, limits, places in Γ, and Γ; the only file that counts them.

Ten a body in Pinocchio's order, about the joint frame's origin, which is what Γ multiplies:

    m, mx, my, mz, Lxx, Lxy, Lyy, Lxz, Lyz, Lzz          L = I + m (|c|² 1 − c cᵀ)

`I` is the same about the centre of mass, as a URDF has it.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ident.effects import KINDS
from ident.effects.joint import Payload
from ident.errors import MechanismError, line_of, one_of
from ident.files import HUGE, TomlTable, is_number
from ident.lazy import lazy
from ident.mechanism import batched
from ident.mechanism.tangents import tangents

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

UNITS = {number.name: number.units[0] for number in Payload.unknowns}  # of a body as of a payload
DYNAMIC = tuple(UNITS)
CENTROIDAL = {name: "I" + name[1:] for name in DYNAMIC if name.startswith("L")}
# the order in which base parameters are sought, so that they read as robotics has them:
# inertias first, masses last, from the base to the tip
READING_ORDER = ("Lxx", "Lxy", "Lxz", "Lyy", "Lyz", "Lzz", "mx", "my", "mz", "m")
COUNT = len(DYNAMIC)
WORDS = (*DYNAMIC, *CENTROIDAL.values())
MODELS = 32  # work: of which the shape of Γ is kept


def unit_of(parameter: str) -> str:
    """The unit of a body's parameter by its last name."""
    return UNITS.get(parameter.rsplit(".", 1)[-1], UNITS["Lxx"])  # Ixx … are no names of Γ


@dataclass(frozen=True)
class Bodies:
    """The moving bodies of a mechanism by the URDF's link names, in Pinocchio's joint order."""

    links: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Ten names a body: `rod.m`, …, `rod.Lzz`."""
        return tuple(f"{link}.{word}" for link in self.links for word in DYNAMIC)

    def columns(self, link: str) -> slice:
        """Where the ten columns of a body stand in Γ."""
        start = COUNT * self.links.index(link)
        return slice(start, start + COUNT)

    def reading_order(self) -> np.ndarray:
        """Columns of Γ in the order in which base parameters are sought."""
        within = [DYNAMIC.index(word) for word in READING_ORDER]
        return np.array([COUNT * i + k for i in range(len(self.links)) for k in within], dtype=int)

    def select(self, patterns: Iterable[str], where: str) -> tuple[str, ...]:
        """Return full names of `rod`, `rod.*`, `rod.Ixx` or `rod.Lxx`, in Γ's order."""
        chosen: set[str] = set()
        for pattern in patterns:
            link, _, word = pattern.rpartition(".") if "." in pattern else (pattern, "", "*")
            if pattern in self.links:  # a link's own name may contain a dot
                link, word = pattern, "*"
            if link not in self.links:
                raise MechanismError(
                    f"{where}: unknown = '{pattern}': no moving link is named '{link}'; "
                    f"{one_of(link, self.links)} (a link fixed to another is one body with it)"
                )
            if word not in ("*", *WORDS):
                raise MechanismError(
                    f"{where}: unknown = '{pattern}': a link has no parameter '{word}'; "
                    f"{one_of(word, WORDS)}"
                )
            wanted = DYNAMIC if word == "*" else ("L" + word[1:] if word[0] == "I" else word,)
            chosen.update(f"{link}.{parameter}" for parameter in wanted)
        return tuple(name for name in self.names if name in chosen)

    def with_values(self, pi: np.ndarray, given: dict[str, float]) -> np.ndarray:
        """Return dynamic parameters (10 · bodies,) with other values by name, which leave `given`;
        moments `rod.Ixx` are about the centre of mass.
        """
        pi = pi.copy()
        for i, name in enumerate(self.names):
            pi[i] = given.pop(name, pi[i])
        for link in self.links:
            at = self.columns(link)
            shift = beyond_centroidal(pi[at])
            for k, word in enumerate(DYNAMIC):
                if (name := f"{link}.{CENTROIDAL.get(word)}") in given:
                    pi[at.start + k] = given.pop(name) + shift[k]
        return pi

    def check(self, name: str, where: str) -> None:
        """Refuse a name that is no body's parameter and can be no effect's."""
        link, _, word = name.rpartition(".")
        if link in self.links and word not in WORDS:
            raise MechanismError(
                f"{where}: '{name}': a link has no '{word}'; {one_of(word, WORDS)}"
            )
        # an effect, which may be added later, has names of three parts
        if link not in self.links and name.count(".") < 2 and link not in KINDS:
            raise MechanismError(
                f"{where}: '{name}' is no parameter of a link or effect: no link '{link}'; "
                f"{one_of(link, self.links)}"
            )


@dataclass(frozen=True)
class Consistency:
    """Physical consistency asked of a fit: possible bodies, no negative friction, and these limits.

    Args:
        bounds: (lowest, highest) by parameter's name, in its unit; ±inf where there is none.
        total_mass: of all moving bodies [kg].

    Raises:
        MechanismError: for bounds that are no two numbers in order, or a mass that is not positive.
    """

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    total_mass: float | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in self.bounds.items():
            if np.isnan(low) or np.isnan(high) or low > high:
                raise MechanismError(
                    f"bounds of {name}: [{low:g}, {high:g}]; give the lower one first"
                )
        if self.total_mass is not None and not 0 < self.total_mass < HUGE:
            raise MechanismError(f"total_mass = {self.total_mass:g}; give kilograms above 0")

    def __or__(self, other: Consistency) -> Consistency:
        """Both limits; of the same parameter the other's."""
        mass = self.total_mass if other.total_mass is None else other.total_mass
        return Consistency({**self.bounds, **other.bounds}, mass)


@dataclass(frozen=True, eq=False)
class Covariance:
    """Errors of known values that an earlier fit has found."""

    names: tuple[str, ...]  # (n,) of parameters of bodies and effects
    matrix: np.ndarray  # (n, n) their covariance, in the parameters' units

    @property
    def root(self) -> np.ndarray:
        """L (n, n) with L Lᵀ = matrix."""
        size = np.sqrt(np.maximum(np.diag(self.matrix), np.finfo(float).tiny))
        values, V = np.linalg.eigh(self.matrix / np.outer(size, size))
        return np.asarray(size[:, None] * V * np.sqrt(np.maximum(values, 0.0)))

    def without(self, names: Collection[str]) -> Covariance | None:
        """The errors of all but some parameters; None where no other is left."""
        rest = [i for i, name in enumerate(self.names) if name not in names]
        remaining = Covariance(tuple(self.names[i] for i in rest), self.matrix[np.ix_(rest, rest)])
        return remaining if rest else None

    def __add__(self, other: Covariance) -> Covariance:
        """Errors of both, of different parameters, that have nothing in common."""
        n = len(self.names)
        matrix = np.zeros((n + len(other.names),) * 2)
        matrix[:n, :n], matrix[n:, n:] = self.matrix, other.matrix
        return Covariance((*self.names, *other.names), matrix)

    def csv(self) -> bytes:
        """A table with the names as its first row and first column."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["parameter", *self.names])
        rows = zip(self.names, self.matrix.tolist(), strict=True)
        writer.writerows([name, *row] for name, row in rows)
        return stream.getvalue().encode()


def read_covariance(table: TomlTable, folder: Path) -> Covariance | None:
    """Return the `covariance` of [parameters], a table as `Covariance.csv` writes it."""
    if "covariance" not in table:
        return None
    path = folder / table.text("covariance")
    try:
        frame = pl.read_csv(path.read_bytes(), has_header=False, infer_schema=False)
        names, matrix = frame.row(0)[1:], frame[1:, 1:].cast(pl.Float64).to_numpy()
    except OSError as error:
        raise table.error(f"covariance = '{path.name}': {error.strerror}, in {folder}") from None
    except pl.exceptions.PolarsError as error:
        raise MechanismError(f"{path}: {line_of(error)}; give numbers below the names") from None
    good = tuple(frame[1:, 0]) == names and np.isfinite(matrix).all()
    if not good or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0):
        raise MechanismError(
            f"{path}: a covariance is finite and symmetric, with the same names in its first row "
            "and its first column"
        )
    return Covariance(names, matrix)


def read_consistency(table: TomlTable, bodies: Bodies) -> Consistency:
    """Return `bounds` and `total_mass` of [parameters]."""
    bounds = {}
    for name, pair in table.table("bounds", '"link.m" = [0.4, 0.6]').data.items():
        bodies.check(name, f"{table.where} bounds")
        two = isinstance(pair, list) and len(pair) == 2
        if not two or not all(type(x) in (int, float) for x in pair):
            raise MechanismError(
                f'{table.where} bounds: "{name}" = {pair!r}; give two numbers, [lowest, highest]; '
                "-inf and inf are valid"
            )
        bounds[name] = (float(pair[0]), float(pair[1]))
    mass = table.data.get("total_mass")
    if "total_mass" in table and not is_number(mass):
        raise table.error(f"total_mass = {mass!r}; give a number of kilograms")
    try:
        return Consistency(bounds, mass and float(mass))
    except MechanismError as error:
        raise table.error(str(error)) from None


def fixed_parameters(model: pin.Model, joint: int) -> np.ndarray:
    """The ten (10,) that links fixed to the own link of a body add to it."""
    fixed = [f for f in model.frames if f.type == pin.FrameType.FIXED_JOINT]
    inertias = [f.placement.act(f.inertia) for f in fixed if f.parentJoint == joint]
    return np.sum(
        [np.zeros(COUNT), *(inertia.toDynamicParameters() for inertia in inertias)], axis=0
    )


def split(pi: Sequence[float] | np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """(m, first moments (3,), L (3, 3) about the joint frame's origin) of ten parameters."""
    m, mx, my, mz, Lxx, Lxy, Lyy, Lxz, Lyz, Lzz = (float(value) for value in pi)
    L = np.array([[Lxx, Lxy, Lxz], [Lxy, Lyy, Lyz], [Lxz, Lyz, Lzz]])
    return m, np.array([mx, my, mz]), L


def about_origin(m: float, moments: np.ndarray) -> np.ndarray:
    """m (|c|² 1 − c cᵀ) (3, 3) with c = moments / m: what L has beyond I; zero for m = 0."""
    if m == 0:
        return np.zeros((3, 3))
    return (moments @ moments * np.eye(3) - np.outer(moments, moments)) / m


def beyond_centroidal(pi: np.ndarray) -> np.ndarray:
    """L − I in the places of the ten parameters."""
    L = about_origin(*split(pi)[:2])
    return np.array([0.0, 0.0, 0.0, 0.0, *L[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def pseudo_inertia(pi: Sequence[float] | np.ndarray) -> np.ndarray:
    """The 4 × 4 matrix that is positive semidefinite for a possible body (Wensing et al. 2018)."""
    m, moments, L = split(pi)
    return np.block(
        [[0.5 * np.trace(L) * np.eye(3) - L, moments[:, None]], [moments[None, :], np.array([[m]])]]
    )


# --- Γ --------------------------------------------------------------------------------------------

TURNED = 128  # work: samples whose Γ fits into a processor's cache while axes are exchanged
FAR = 1e3  # range: [m] a centre of mass beyond belongs to a mass of rounding error
BATCH = 1000  # work: samples from which passes over all of them are faster than calls


def regressor(
    model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, Z: np.ndarray | None = None
) -> np.ndarray:
    """Γ (n, nv, 10 · bodies) of q (n, nq), v (n, nv), a (n, nv); gravity is in it. With Z (nv, d),
    of all samples alike, ZᵀΓ (n, d, 10 · bodies).

    Samples are contiguous in memory, as the filter of the rows wants them.
    """
    if len(q) >= BATCH and (joints := batched.joints_of(model)):
        return batched.regressor(model, joints, q, v, a, Z).transpose(2, 0, 1)
    data, gamma = model.createData(), np.zeros((model.nv, COUNT * (model.njoints - 1), len(q)))
    piece, spans = np.empty((TURNED, *gamma.shape[:2])), row_spans(model)
    for start in range(0, len(q), TURNED):
        now = slice(start, start + TURNED)
        for i, state in enumerate(zip(q[now], v[now], a[now], strict=True)):
            piece[i] = pin.computeJointTorqueRegressor(model, data, *state)
        for row, span in enumerate(spans):  # the others are zero
            gamma[row, span, now] = piece[: len(q) - start, row, span].T
    gamma = gamma if Z is None else np.tensordot(Z.T, gamma, 1)
    return gamma.transpose(2, 0, 1)


def kinetic_energies(model: pin.Model, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """½ vᵀ M(q) v (n, 10 · bodies) by each parameter, of q (n, nq) and v (n, nv)."""
    data = model.createData()
    states = zip(q, v, strict=True)
    return np.array([pin.computeKineticEnergyRegressor(model, data, *state) for state in states])


def rigid_forces(
    model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, pi: np.ndarray
) -> np.ndarray:
    """Γ π (n, nv) of π (10 · bodies,), which needs no Γ."""
    if len(q) >= BATCH and (joints := batched.joints_of(model)):
        return batched.rigid_forces(model, joints, q, v, a, pi)
    states, total = [*zip(q, v, a, strict=True)], np.zeros((len(q), model.nv))
    for sign, other, data in Rigid.of(model, pi).terms:
        total += sign * np.reshape([pin.rnea(other, data, *state) for state in states], total.shape)
    return total


def rigid_tangents(
    model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, pi: np.ndarray
) -> np.ndarray:
    """∂(Γ π)/∂(q, v, a) (3, nv, nv, n), of each force by each coordinate."""
    if joints := batched.joints_of(model):
        return tangents(model, joints, q, v, a, pi)
    out = np.zeros((3, model.nv, model.nv, len(q)))
    for sign, other, data in Rigid.of(model, pi).terms:
        for i, state in enumerate(zip(q, v, a, strict=True)):
            by_q, by_v, by_a = pin.computeRNEADerivatives(other, data, *state)
            out[..., i] += sign * np.stack([by_q, by_v, by_a])
    return out


def supports(model: pin.Model) -> list[np.ndarray]:
    """For every row of Γ the columns that can differ from zero: the bodies the joint moves."""
    columns: list[np.ndarray] = []
    for joint in range(1, model.njoints):
        bodies = np.sort(model.subtrees[joint])[:, None] - 1
        columns += [(COUNT * bodies + np.arange(COUNT)).ravel()] * model.nvs[joint]
    return columns


@lru_cache(MODELS)
def row_spans(model: pin.Model) -> list[slice]:
    """For every row of Γ the stretch of its columns that can differ from zero."""
    return [slice(int(columns[0]), int(columns[-1]) + 1) for columns in supports(model)]


@dataclass(frozen=True, eq=False)
class Rigid:
    """Dynamics of a tree, linear in its dynamic parameters π.

    Pinocchio stores a body by mass and centre of mass, and adds bodies only if their mass is
    positive. Identified parameters need not be those of bodies that can exist, so π is written as
    the difference π⁺ − π⁻ of two sets with positive masses where that is necessary.
    """

    terms: tuple[tuple[float, pin.Model, pin.Data], ...]  # (sign, model, data)

    @classmethod
    def of(cls, model: pin.Model, pi: np.ndarray) -> Rigid:
        """Take π (10 · bodies,) in Γ's order, physically possible or not."""
        bodies = pi.reshape(-1, COUNT)
        added = np.zeros_like(bodies)
        for body, extra in zip(bodies, added, strict=True):
            storable = body[0] > 0 and np.abs(body[1:4]).max() < FAR * body[0]
            if body.any() and not storable:
                extra[0] = 1.0 + 2.0 * abs(body[0])
        signed = [(1.0, bodies + added), *([(-1.0, added)] if added.any() else [])]
        terms = []
        for sign, part in signed:
            other = model.copy()
            other.armature = np.zeros(model.nv)  # the inertia that turns with a motor is an effect
            for index, body in enumerate(part, start=1):
                inertia = pin.Inertia.FromDynamicParameters(body)
                other.inertias[index] = inertia if body.any() else pin.Inertia.Zero()
            terms.append((sign, other, other.createData()))
        return cls(tuple(terms))

    def __call__(self, algorithm: Callable[..., np.ndarray], *state: np.ndarray) -> np.ndarray:
        """Return what an algorithm of Pinocchio makes of a state: crba, nonLinearEffects, rnea."""
        parts = [sign * algorithm(model, data, *state) for sign, model, data in self.terms]
        return np.sum(parts, axis=0) if len(parts) > 1 else parts[0]
