"""The fit nearest to the data among those that are physically possible, and the cost of limits.

    x = argmin ‖A (x − x_u)‖² + ‖A_0 x − b_0‖² + ρ² ‖W (x − a)‖²    such that limits(x)

x_u is least squares without limits, A the rows that it rests on, in units of their noise. The
anchor a is the prior, or the nearest possible to it. It counts as if every body was known to
1/ρ = 100 times its own mass and size: that decides what the data leave open, unknowns in no base
parameter and those that were held at the prior, and moves a base parameter that the data know to
σ body sizes by (σ/100)² of its distance from the prior, which is nothing. A_0, b_0 are the rows at
standstill, where dry friction is open: they do not inform, but a choice is not made at their
expense. Those of a coordinate count as a tenth of one row, in units of the least error there of x_u
and a.

W measures a body's change by its own pseudo-inertia, ‖S^-½ (P − P_a) S^-½‖: the second-order part
of the affine-invariant distance of bodies (T. Lee, P. Wensing, F. Park, IEEE T-RO 36(1), 2020).

Possible bodies: the pseudo-inertia, measured by a ball of the body's own mass and size.

    P(π) = [Σ  h; hᵀ  m],  Σ = tr(L)/2 · 1 − L,  h = m c          possible: P ⪰ 0
    B = F Fᵀ,  F = √m [r·1  c; 0  1]                              of a ball: m, c, r of the prior

P ⪰ 0 says that some distribution of positive mass has these ten parameters (P. Wensing, S. Kim,
J.-J. Slotine, IEEE Robot. Autom. Lett. 3(1), 2018). The eigenvalues of F⁻¹ P F⁻ᵀ are numbers around
1/3 and 1 whatever the units, the frame, and whether a body weighs grams or tons.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.display import Displayed, Progress, no_progress
from ident.equations.problem import Problem, body_scales
from ident.equations.unknowns import Columns
from ident.errors import FitError, one_of
from ident.finding import Finding
from ident.fit.findings import IMPOSSIBLE_BODY, bodies_with_unknowns
from ident.fit.shapes import shape_bounds
from ident.information import cone
from ident.information.blocks import Squares
from ident.information.chance import held_out, rise
from ident.information.estimate import MATERIAL, Estimate
from ident.information.evidence import MATTERS
from ident.information.linear import Triangle
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import (
    CENTROIDAL,
    COUNT,
    DYNAMIC,
    Consistency,
    about_origin,
    pseudo_inertia,
    split,
)

STILL = 0.1  # numerics: rows that all rows of a coordinate at standstill count as
PULL = 0.01  # numerics: ρ: bodies' own sizes in which the prior counts as one standard deviation
BALL = 0.05  # numerics: of the prior's ball in S: a flat prior can become a little less flat
EFFECT = 1e-4  # numerics: of a plausible size: an effect that bodies can replace gives way to them
UNFELT = 1e9  # numerics: plausible size of an unknown that no data feel
PASSES = 6  # work: over what the equations are not linear in
CONVERGED = 1e-6  # numerics: of a plausible size: a smaller change of any unknown is the last
PUSHED = 0.1  # level: standard errors of white noise by which a limit must push to count as active
IMPOSSIBLE = -1e-9  # numerics: smallest eigenvalue of a prior that is no possible body
MARGIN = 1e-6  # numerics: of the ball, what a body keeps: a simulator inverts its mass
STURDY = 1e-3  # numerics: the same of bodies for files: none of a milligram, which are placeholders
SMALL = 1e-3  # range: of a mean link, the least size that is believed
CENTROID = {centroidal: about for about, centroidal in CENTROIDAL.items()}


@dataclass(frozen=True, repr=False)
class Binding(Displayed):
    """Where a consistent fit touches its limits, and what that costs."""

    asked: Consistency  #: bounds and total mass
    at_bound: frozenset[str]  #: names of parameters
    active: tuple[str, ...]  #: all limits that hold the fit back, as a person reads them
    repaired: tuple[str, ...]  #: links whose prior is no possible body
    impossible: tuple[str, ...]  #: links that are known, and that of no possible body
    #: by link with unknowns, the smallest one of its pseudo-inertia in units of the prior's ball
    eigenvalues: Mapping[str, float]
    #: √ of the mean over joints of (error / error without limits)², less 1
    rise: float
    held_out_rise: float | None = None  #: the same of held-out errors

    @property
    def findings(self) -> list[Finding]:
        """Findings about the limits and their cost."""
        findings = []
        if self.impossible:
            text = (
                f"{', '.join(self.impossible)} is known, and that of no possible body (its "
                "pseudo-inertia has a negative eigenvalue): a simulator may refuse it"
            )
            remedy = "correct the URDF, or make it unknown"
            findings.append(Finding("impossible known body", text, remedy, self.impossible))
        if self.repaired:
            text = (
                f"the prior of {', '.join(self.repaired)} is that of no possible body; the nearest "
                "possible one stands in for it"
            )
            findings.append(Finding("prior repaired", text, where=self.repaired))
        if (cost := max(self.rise, self.held_out_rise or 0.0)) > MATTERS:
            text = (
                "these data contradict what is physically possible: something is missing from the "
                "model, or a sign, unit or bound is wrong"
            )
            findings.append(Finding("contradiction", text, "see ident diagnose", (), cost, MATTERS))
        return findings

    def json(self) -> dict[str, Any]:
        """Return the entry of fit.json."""
        return {
            "bounds": {
                name: [low if np.isfinite(low) else None, high if np.isfinite(high) else None]
                for name, (low, high) in self.asked.bounds.items()
            },
            "total_mass": self.asked.total_mass,
            "active": list(self.active),
            "at_bound": sorted(self.at_bound),
            "repaired_priors": list(self.repaired),
            "smallest_eigenvalues": dict(self.eigenvalues),
            "rise": {"train": self.rise, "held_out": self.held_out_rise},
        }


def nearest_possible(
    problem: Problem,
    unlimited_estimate: Estimate,
    asked: Consistency,
    on_progress: Progress = no_progress,
) -> tuple[Problem, Estimate, Estimate, Squares | None, Binding]:
    """Return the consistent estimate that is nearest to the data; weights are those of `found`.

    Where columns depend on the solution, the rows are made anew there until it rests; rows in which
    the motion has moved stay as they are.

    Returns:
        The problem at the point where it was found; the estimate with the consistent x, and without
        limits; held-out errors, each stretch of time predicted by a consistent fit to the others;
        which limits hold it back, and what they cost.

    Raises:
        FitError: for limits that contradict each other, or a solution that does not hold.
    """
    on_progress("physical consistency", 0.0)
    unlimited = problem.information.squares(unlimited_estimate.x)
    before = held_out(problem.fitting, problem.information, unlimited_estimate, problem.prior)
    program = Program.of(problem, asked)
    point = program.solve(unlimited_estimate)
    nonlinear = any(not effect.linear for effect in problem.mechanism.effects)
    for _ in range(PASSES if nonlinear and not problem.runs else 0):
        at, last = problem.point_at(point.x), point
        problem = Problem.of(problem.mechanism, problem.motion, at)
        unlimited_estimate = problem.estimate(
            sigma=unlimited_estimate.sigma, fixed=unlimited_estimate.fixed
        )
        program = Program.of(problem, asked)
        point = program.solve(unlimited_estimate)
        if np.abs((point.x - last.x) / problem.plausible).max(initial=0.0) < CONVERGED:
            break
    outside = held_out(
        problem.fitting, problem.information, unlimited_estimate, problem.prior,
        lambda other: program.solve(other).x,
    )  # fmt: skip
    worse = None if outside is None or before is None else rise(outside, before)
    mechanism, unknown = problem.mechanism, bodies_with_unknowns(problem.mechanism)
    pi = problem.columns.dynamic_parameters(mechanism, point.x)
    after = smallest_eigenvalues(mechanism, pi)
    priors = smallest_eigenvalues(mechanism, mechanism.plausible_prior)
    if broken := [link for link in unknown if not after[link] >= cone.SLACK["psd"] - 1e-9]:
        raise FitError(f"no consistent fit was found: {', '.join(broken)} is no possible body")
    both = zip(program.limits, point.push, strict=True)
    pushing = [limit for limit, push in both if push > PUSHED]
    edge = dict.fromkeys(limit.of for limit in pushing if limit.kind == "psd")
    bounds = [limit for limit in pushing if limit.kind != "psd"]
    possible = [f"possible bodies ({', '.join(edge)})"] if edge else []
    impossible = [link for link, value in priors.items() if value < IMPOSSIBLE]
    binding = Binding(
        asked=asked,
        at_bound=frozenset(limit.of for limit in bounds if limit.of),
        active=(*possible, *(limit.name for limit in bounds)),
        repaired=tuple(link for link in impossible if link in unknown),
        impossible=tuple(link for link in impossible if link not in unknown),
        eigenvalues={link: after[link] for link in unknown},
        rise=rise(problem.information.squares(point.x), unlimited),
        held_out_rise=worse,
    )
    return problem, unlimited_estimate.at(point.x), unlimited_estimate, outside, binding


@dataclass(frozen=True, eq=False)
class PossibleBodies:
    """The possible bodies nearest to a fit whose own are not, for files that a simulator reads."""

    x: np.ndarray  #: (k,) all unknowns, those of effects moved along with the bodies
    links: tuple[str, ...]  #: whose identified bodies are impossible
    #: by joint, rms [N m | N] of the difference of the torques, and of what the fit leaves of them
    difference: Mapping[str, float]
    residual: Mapping[str, float]

    @classmethod
    def of(
        cls, problem: Problem, estimate: Estimate, findings: Sequence[Finding]
    ) -> PossibleBodies | None:
        """Return the nearest possible bodies; None where those of the fit are possible, or where
        known ones contradict each other.
        """
        x = possible_bodies(problem, estimate, findings, (STURDY, MARGIN))
        if x is None:
            return None
        joints, d = problem.motion.independent, len(problem.motion.independent)
        sums, rows = np.zeros(d), np.zeros(d)
        for block in problem.information:
            change = block.triangle.R @ (x - estimate.x)[block.support]
            sums[block.coordinate] += change @ change
            rows[block.coordinate] += block.triangle.rows
        errors = problem.information.squares(estimate.x).errors(joints, problem.units)
        rms = np.sqrt(sums / np.maximum(rows, 1))
        return cls(
            x,
            next(f.where for f in findings if f.code == IMPOSSIBLE_BODY),
            dict(zip(joints, map(float, rms), strict=True)),
            {joint: errors[joint].rms for joint in joints},
        )

    @property
    def findings(self) -> list[Finding]:
        """The finding that they change the torques by more than the fit leaves of them, if so."""
        beyond = [j for j, rms in self.difference.items() if rms > self.residual[j]]
        if not beyond:
            return []
        sizes = ", ".join(
            f"{joint} {self.difference[joint]:.2g} ({self.residual[joint]:.2g})" for joint in beyond
        )
        text = (
            "the possible bodies of identified.urdf change torques by more than the fit leaves of "
            f"them, rms (and what is left): {sizes}"
        )
        remedy = "see --consistent, or ident diagnose: something is missing from the model"
        return [Finding("possible bodies differ", text, remedy, tuple(beyond))]

    def json(self, names: Sequence[str]) -> dict[str, Any]:
        """Return the entry of fit.json, with the (k,) names of the unknowns."""
        return {
            "links": list(self.links),
            "parameters": dict(zip(names, map(float, self.x), strict=True)),
            "torque_change": dict(self.difference),
            "torque_error": dict(self.residual),
        }


def possible_bodies(
    problem: Problem,
    estimate: Estimate,
    findings: Sequence[Finding],
    margins: Sequence[float] = (MARGIN,),
) -> np.ndarray | None:
    """Return the x (k,) with possible bodies nearest to an estimate, at its working point; None
    where no finding says that its bodies are impossible, or where known ones contradict each other.
    Each body keeps the first of the `margins` of its ball that is possible; the default is that of
    a consistent fit.
    """
    if not any(finding.code == IMPOSSIBLE_BODY for finding in findings):
        return None
    for margin in margins:
        try:
            program = Program.of(problem, problem.mechanism.consistency, margin)
            return program.solve(estimate).x
        except FitError:
            continue
    return None


@dataclass(frozen=True, eq=False)
class Program:
    """The conic problem without its data. Made once, solved for the fit and every fold."""

    columns: Columns
    limits: Sequence[cone.Limit]  # what must hold
    anchor: np.ndarray  # (k,) the nearest to the prior within the limits
    W: np.ndarray  # (rows, k) the metric; ‖W (x − a)‖ is the distance from the anchor
    # rows at standstill, and least error of each coordinate [N m | N]
    rest: Sequence[tuple[Triangle, float]]

    @classmethod
    def of(cls, problem: Problem, asked: Consistency, margin: float = MARGIN) -> Program:
        """Return the limits of a mechanism, and the prior within them; every body keeps `margin` of
        its prior's ball.
        """
        mechanism, columns, prior = problem.mechanism, problem.columns, problem.prior
        scale = problem.plausible
        scale = np.where(scale < UNFELT, scale, 1.0)  # of a column of zeros any size will do
        limits = limits_of(problem, asked, scale, margin)
        anchor, within = prior, cone.holds(limits, prior)
        if not within and (against := cone.conflict(limits, scale)):
            names = "; ".join(limit.name for limit in against)
            raise FitError(
                f"these limits contradict each other: {names}; each can hold without one of the "
                "others: loosen one of them"
                if against[1:]
                else f"{names}: impossible with what is known of it, or flat to a millionth of its "
                "size; make more of it unknown, or correct what the URDF says"
            )
        if not within:
            W = _metric(mechanism, columns, scale, 1.0, None)
            anchor = cone.nearest_within(W, W @ prior, limits, W, None).x
        W = _metric(mechanism, columns, scale, BALL, anchor)
        least = MATERIAL * problem.torque + 1e-300
        rest = list(zip(problem.information.at_rest, least, strict=True))
        return cls(columns, limits, anchor, W, rest)

    def solve(self, estimate: Estimate) -> cone.NearestPoint:
        """Return the nearest x within the limits, and by how much each of them pushes."""
        base, rigid = estimate.base, len(self.columns.rigid)
        held_places = np.flatnonzero(estimate.fixed)
        B = np.zeros((base.rank + len(held_places), len(estimate.x)))  # x ↦ (β, held unknowns)
        B[np.arange(base.rank), base.independent] = 1.0
        B[: base.rank, base.dependent] += base.K
        B[np.arange(base.rank, len(B)), held_places] = 1.0
        triangle = estimate.triangle.restricted(
            np.concatenate([base.independent, held_places]).astype(int)
        )
        data = triangle.R @ B / _noise(estimate)  # A in units of the rows' noise
        stiff = np.ones(len(estimate.x))  # for effects that are in no base parameter
        stiff[base.dependent[base.dependent >= rigid]] = 1 / EFFECT
        W = self.W * stiff
        A, b = [data, PULL * W], [data @ estimate.x, PULL * (W @ self.anchor)]
        for total, least in self.rest:
            rows = max(total.rows, 1)
            errors = [total.residual_norm(y) / np.sqrt(rows) for y in (estimate.x, self.anchor)]
            weight = np.sqrt(STILL / rows) / max(min(errors), least)
            A.append(weight * total.R)
            b.append(weight * total.d)
        free = ~estimate.fixed  # effects that no data feel or that are held stay where they are
        free[base.dependent[~base.K.any(axis=0)]] = False
        free[:rigid] = True
        for limit in self.limits:
            if limit.kind == "psd":
                free |= limit.G.any(axis=0)
        fixed = np.where(free, 0.0, self.anchor)
        limits = cone.restricted(self.limits, fixed, free)
        stacked = np.vstack(A)
        part = cone.nearest_within(
            stacked[:, free], np.concatenate(b) - stacked @ fixed, limits, W[:, free],
            self.anchor[free],
        )  # fmt: skip
        x = self.anchor.copy()
        x[free] = part.x
        return replace(part, x=x)


def _noise(estimate: Estimate) -> float:
    """Return the noise of the rows divided by their weights: 1, or with equal weights the rms."""
    if (estimate.sigma != 1.0).any():
        return 1.0
    residual = estimate.triangle.residual_norm(estimate.x)
    terms = np.linalg.norm(estimate.triangle.column_norms() * estimate.x)
    return float(max(residual, MATERIAL * terms) / np.sqrt(max(estimate.triangle.rows, 1))) or 1.0


def _metric(
    mechanism: Mechanism, columns: Columns, scale: np.ndarray, ball: float, at: np.ndarray | None
) -> np.ndarray:
    """Return W: a body's change by S = P(at) + ball · B (or the ball alone), an effect by size."""
    rows, D = [], of_bodies(mechanism, columns)
    pi = None if at is None else columns.dynamic_parameters(mechanism, at)
    for link, P in zip(mechanism.bodies.links, in_balls(mechanism), strict=True):
        body = mechanism.bodies.columns(link)
        if not D[body].any():
            continue
        S = ball * np.eye(4) + (0.0 if pi is None else cone.smat(P @ pi[body]))
        eigenvalues, V = np.linalg.eigh(S)
        root = V @ np.diag(eigenvalues**-0.5) @ V.T
        block = np.stack([cone.svec(root @ cone.smat(column) @ root) for column in P.T], axis=1)
        rows.append(block @ D[body])
    effects = np.arange(len(columns.rigid), len(columns))
    rows.append(np.eye(len(columns))[effects] / scale[effects, None])
    return np.vstack(rows)


# --- limits -----------------------------------------------------------------------------------


def in_balls(mechanism: Mechanism) -> list[np.ndarray]:
    """Return (10, 10) of every body: `svec` of F⁻¹ P F⁻ᵀ of each dynamic parameter, a column each;
    where the URDF gives no mass or no size, those of a mean link stand in.
    """
    balls = []
    priors = mechanism.plausible_prior.reshape(-1, COUNT)
    for prior, mean_m, mean_l in zip(priors, *body_scales(mechanism), strict=True):
        m, moments, L = split(prior)
        c = moments / m if m > 0 else np.zeros(3)
        m = m if m > 0 else mean_m
        r = np.sqrt(max(np.trace(L) / (2 * m) - c @ c, 0.0))
        if r < SMALL * mean_l:
            r = 0.1 * mean_l
        F = np.eye(4)  # its inverse
        F[:3, :3] /= r
        F[:3, 3] = -c / r
        F /= np.sqrt(m)
        columns = [cone.svec(F @ pseudo_inertia(one) @ F.T) for one in np.eye(COUNT)]
        balls.append(np.stack(columns, axis=1))
    return balls


def of_bodies(mechanism: Mechanism, columns: Columns) -> np.ndarray:
    """Return ∂π/∂x (10 · bodies, k) of all dynamic parameters."""
    D = np.zeros((len(mechanism.prior), len(columns)))
    D[columns.rigid, np.arange(len(columns.rigid))] = 1.0
    return D


def smallest_eigenvalues(mechanism: Mechanism, pi: np.ndarray) -> dict[str, float]:
    """Return that of F⁻¹ P F⁻ᵀ by link: below zero for an impossible body."""
    bodies = zip(mechanism.bodies.links, in_balls(mechanism), pi.reshape(-1, COUNT), strict=True)
    return {link: float(np.linalg.eigvalsh(cone.smat(S @ body))[0]) for link, S, body in bodies}


def limits_of(
    problem: Problem, asked: Consistency, scale: np.ndarray, margin: float = MARGIN
) -> list[cone.Limit]:
    """Return limits: possible bodies, effects that cannot be negative, shapes within the range in
    which their columns mean something, bounds, total mass; `scale` (k,): plausible sizes.
    """
    mechanism, columns, shapes = problem.mechanism, problem.columns, shape_bounds(problem)
    intervals = [  # low ≤ x_at + constant ≤ high
        (name, at, 0.0, (0.0, np.inf), "")
        for effect, places in columns.effects
        for name, unknown, at in zip(effect.names, effect.parameters, places, strict=True)
        if at >= 0 and unknown.nonnegative
    ]
    intervals += [(columns.names[at], at, 0.0, bounds, "") for at, bounds in shapes.items()]
    for name, bounds in asked.bounds.items():
        at, constant = _linear(mechanism, columns, name)
        intervals.append((name, at, constant, bounds, f" {columns.units[at]}"))
    limits = _bodies(mechanism, columns, margin)
    for name, at, constant, bounds, unit in intervals:
        row = np.zeros((1, len(columns)))
        row[0, at] = 1.0 / scale[at]
        low, high = (np.array([(bound - constant) / scale[at]]) for bound in bounds)
        if bounds[0] == bounds[1]:
            limits.append(cone.Limit(f"{name} = {bounds[0]:.6g}{unit}", "zero", row, -low, name))
            continue
        for sign, bound, G, h in (("≥", bounds[0], row, -low), ("≤", bounds[1], -row, high)):
            if np.isfinite(bound):
                limits.append(
                    cone.Limit(f"{name} {sign} {bound:.6g}{unit}", "nonnegative", G, h, name)
                )
    if mass := asked.total_mass:
        masses = np.tile(np.eye(COUNT)[0], len(mechanism.bodies.links))
        row = masses @ of_bodies(mechanism, columns) / mass
        known = float(masses @ columns.dynamic_parameters(mechanism, np.zeros(len(columns))))
        if not row.any():
            raise FitError(
                f"total mass {mass:g} kg: no body's mass is unknown, they add up to {known:.6g} "
                "kg; leave it out, or make a link's m unknown"
            )
        excess = np.array([known / mass - 1.0])
        limits.append(cone.Limit(f"total mass = {mass:g} kg", "zero", row[None], excess))
    return limits


def _bodies(mechanism: Mechanism, columns: Columns, margin: float) -> list[cone.Limit]:
    """Return P ⪰ margin · B of every body with unknowns, and of every body with its payload."""
    D = of_bodies(mechanism, columns)
    known = columns.dynamic_parameters(mechanism, np.zeros(len(columns)))
    payloads = {
        effect.joints[0]: (effect, places)
        for effect, places in columns.effects
        if effect.loaded_link
    }
    result, edge = [], margin * cone.svec(np.eye(4))
    for link, S in zip(mechanism.bodies.links, in_balls(mechanism), strict=True):
        mine = mechanism.bodies.columns(link)
        G, pi = D[mine].copy(), known[mine].copy()
        if G.any():
            result.append(
                cone.Limit(f"{link} is a possible body", "psd", S @ G, S @ pi - edge, link)
            )
        if link in payloads:
            effect, places = payloads[link]
            for j, (at, parameter) in enumerate(zip(places, effect.parameters, strict=True)):
                if at >= 0:
                    G[j, at] += 1.0
                else:
                    pi[j] += effect.values[parameter.name]
            name = f"{link} with its payload is a possible body"
            result.append(cone.Limit(name, "psd", S @ G, S @ pi - edge, link))
    return result


def _linear(mechanism: Mechanism, columns: Columns, name: str) -> tuple[int, float]:
    """Return the unknown and the constant of which a named parameter is the sum."""
    link, _, word = name.rpartition(".")
    column, constant = name, 0.0
    if link in mechanism.bodies.links and word in CENTROID:
        moving = [f"{link}.{w}" for w in DYNAMIC[:4] if f"{link}.{w}" in columns.index]
        if moving:
            raise FitError(
                f"bounds of {name}: about the centre of mass, which is unknown ({moving[0]}), it "
                f"is no linear function of the unknowns; bound {link}.{CENTROID[word]}, about the "
                "joint frame's origin, or m and the first moments"
            )
        pi = mechanism.prior[mechanism.bodies.columns(link)]
        column = f"{link}.{CENTROID[word]}"
        i, j = ("xyz".index(axis) for axis in word[1:])
        constant = -float(about_origin(*split(pi)[:2])[i, j])
    if column in columns.index:
        return columns.index[column], constant
    known = [*mechanism.bodies.names, *(n for effect, _ in columns.effects for n in effect.names)]
    if name in known or word in CENTROID:
        raise FitError(
            f"bounds of {name}: it is known, so nothing can move it; add it to [parameters] "
            "unknown, or leave the bound out"
        )
    raise FitError(f"bounds of {name}: there is no such parameter; {one_of(name, known)}")
