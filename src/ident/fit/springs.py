"""What a fit says of springs between motors and links: signs, and intervals beyond the curvature.

    ±² = jackknife² + (x(noise twice) − x)² + (farthest shape that is as good)²/4

Encoder noise reaches the twist through accelerations, and a column with noise is fitted too small
(errors in variables). The same noise once more shows by how much: Cook, Stefanski, J. Am. Stat.
Assoc. 89(428), 1994. Least squares are no parabola beside a resonance: shapes are tried.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ident.effects import Effect
from ident.effects.transmission import Elasticity
from ident.equations.problem import Problem
from ident.equations.terms import Samples
from ident.errors import IdentError
from ident.finding import Finding
from ident.fit.drives import HELD_AT_ZERO
from ident.fit.shapes import refitted, shape_bounds
from ident.information.chance import covariance
from ident.information.estimate import Estimate
from ident.information.evidence import CERTAIN, EXCESS, PARSIMONY, RIVAL
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.text import listed, percent, significant

TRIED = (0.0, 0.1, 0.3, 1.0)  # work: of the largest damping
TIMES = (0.5, 0.75, 1.33, 2.0)  # work: of the compliance


def places_of(problem: Problem, effect: Effect) -> dict[str, int]:
    """Return the places in x of an effect's unknown shapes, by name."""
    ((_, places),) = (both for both in problem.columns.effects if both[0].label == effect.label)
    shapes = zip(effect.shapes, places[len(effect.unknowns) :].tolist(), strict=True)
    return {shape.name: place for shape, place in shapes if place >= 0}


def springs(problem: Problem) -> list[Effect]:
    """Return the springs of which something is unknown, unless rows are those of a time basis."""
    effects = [e for e in problem.mechanism.effects if isinstance(e, Elasticity)]
    return [e for e in effects if places_of(problem, e)] if not problem.stacked else []


def without_negative_springs(
    problem: Problem, estimate: Estimate
) -> tuple[Problem, Estimate, list[Finding]]:
    """Return the problem and the estimate with springs that are held at zero where their compliance
    or damping came out negative, and a finding on each of them.
    """
    findings = list[Finding]()
    for effect in springs(problem):
        places, joint = places_of(problem, effect), effect.joints[0]
        below = [name for name, place in places.items() if estimate.x[place] < 0]
        if not below:
            continue
        place = places[below[0]]
        value, error = float(estimate.x[place]), float(_jackknife(problem, estimate)[place])
        names = [*places] if "compliance" in below else below
        by_chance = -value < CERTAIN * error
        at = [places[name] for name in names]
        problem, estimate = _held_at_zero(problem, estimate, at, by_chance)
        came = f"it came out negative ({significant(value, 2)}) and is held at zero"
        code = HELD_AT_ZERO if by_chance or "compliance" not in below else "rigid here"
        what = "compliance" if "compliance" in below else "damping of the spring"
        text = f"{what} of {joint}: not to be seen here; {came}"
        remedy = f"log a faster motion of {joint}; else leave {effect.label} out"
        where = tuple(effect.full[name] for name in names)
        findings.append(Finding(code, text, remedy, where, value, 0.0))
    return problem, estimate, findings


def rigid_mechanism(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism whose unknown springs are stiff, with rows of the same unknowns."""
    stiff = (
        replace(e, values={**dict.fromkeys((s.name for s in e.shapes), 0.0), **e.values})
        if isinstance(e, Elasticity) and e.extent not in e.values
        else e
        for e in mechanism.effects
    )
    return replace(mechanism, effects=tuple(stiff))


def worse_than_rigid(
    problem: Problem, estimate: Estimate, rigid: Problem, without: Estimate
) -> list[str]:
    """Return the joints whose error springs raise; none where they lower errors over all joints,
    and raise none much.
    """
    names, units = problem.motion.independent, problem.units
    soft, stiff = (
        p.information.squares(e.x).errors(names, units)
        for p, e in ((problem, estimate), (rigid, without))
    )
    ratios = {name: soft[name].rms / stiff[name].rms for name in names if stiff[name].rms > 0}
    if not ratios:
        return []
    if np.mean(np.square([*ratios.values()])) < 1 and max(ratios.values()) < EXCESS:
        return []
    return [name for name, ratio in ratios.items() if ratio >= 1]


def held_rigid(
    problem: Problem, rigid: Problem, without: Estimate, joints: list[str]
) -> tuple[Problem, Estimate, list[Finding]]:
    """Return the rigid fit with the unknowns of the one with springs, all of them at zero, and a
    finding that no compliance can be seen.
    """
    effects = springs(problem)
    point = rigid.point_at(without.x)
    names = [effect.full[name] for effect in effects for name in places_of(problem, effect)]
    point = point.with_values(dict.fromkeys(names, 0.0))
    again = Problem.of(problem.mechanism, rigid.motion, point)
    again = replace(again, sigma=rigid.sigma)
    places = np.flatnonzero(np.isin(problem.columns.names, names))
    at_zero = again.estimate(sigma=without.sigma).limited(places)
    text = (
        f"compliance of {listed([e.joints[0] for e in effects])}: not to be seen here; with it "
        f"{listed([f'tau.{name}' for name in joints])} would be explained less well than by rigid "
        "joints, and it is held at zero"
    )
    remedy = "log a faster motion, or see what else is missing (ident diagnose)"
    return again, at_zero, [Finding(HELD_AT_ZERO, text, remedy, tuple(names))]


def _jackknife(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Return standard errors (k,) by the jackknife; 0 of what is not independent."""
    errors = np.zeros(len(estimate.x))
    variances = np.diag(covariance(problem.fitting, estimate))
    errors[estimate.base.independent] = np.sqrt(variances)
    return errors


def _held_at_zero(
    problem: Problem, estimate: Estimate, places: list[int], by_chance: bool
) -> tuple[Problem, Estimate]:
    """Return the problem and the estimate with shapes at zero; those that are negative by chance
    keep the standard errors that they have.
    """
    fixed, names = estimate.fixed.copy(), [problem.columns.names[place] for place in places]
    fixed[places] = True
    if any(problem.point.values[name] for name in names):  # else they are there already
        zero = problem.point_at(estimate.x).with_values(dict.fromkeys(names, 0.0))
        point, _, _ = refitted(problem.mechanism, problem.motion, zero)
        again = Problem.of(problem.mechanism, problem.motion, point)
        problem = replace(again, sigma=problem.sigma)
    if not by_chance:
        return problem, problem.estimate(sigma=estimate.sigma, fixed=fixed)
    free = problem.estimate(sigma=estimate.sigma, fixed=estimate.fixed)
    return problem, free.limited(np.union1d(estimate.at_limit, places))


def widened_springs(
    problem: Problem, estimate: Estimate
) -> tuple[Mapping[int, float], list[Finding]]:
    """Return standard errors of springs' shapes that come on top of the jackknife's, by the place
    in x, and a finding where noise of the motion makes most of a compliance's.
    """
    wider, findings = dict[int, float](), list[Finding]()
    every = [effect for effect in springs(problem) if problem.point.of(effect)[1]["compliance"] > 0]
    if not every:
        return wider, findings
    noisier = _with_noise_again(problem, estimate)
    for effect in every:
        findings += _beyond_band(problem, effect)
        for name, place in places_of(problem, effect).items():
            if estimate.fixed[place]:
                continue
            change = 0.0 if noisier is None else float(noisier.x[place] - estimate.x[place])
            wider[place] = float(np.hypot(change, _as_good(problem, estimate, effect, name) / 2))
            value = float(estimate.x[place])
            if name == "compliance" and abs(change) > PARSIMONY * abs(value):
                findings.append(
                    Finding(
                        "noisy spring",
                        f"compliance of {effect.joints[0]} is not determined: as much noise of the "
                        f"positions again changes it by {percent(abs(change / value))}, so the "
                        "noise that there is moves it too, mostly towards the rigid joint",
                        f"log a faster motion of {effect.joints[0]}, or finer positions",
                        (effect.full[name],), abs(change / value), PARSIMONY,
                    )
                )  # fmt: skip
    return wider, findings


def _beyond_band(problem: Problem, effect: Effect) -> list[Finding]:
    """Return a finding on a spring whose resonance is above the rows' band: they show c L̈ alone,
    which noise of accelerations, delays and rotors show too.
    """
    cutoff, c = problem.motion.band.cutoff, problem.point.of(effect)[1]["compliance"]
    e = problem.motion.experiments[0]
    if cutoff is None or e.poses or e.smooth is None:
        return []
    signals = Samples(problem.mechanism, e, slice(None), problem.point).signals(effect.acting)
    shape = {"compliance": c}
    critical = effect.bounds(replace(signals, shape=shape))["damping"][1]  # 2 √(M/c)
    resonance = 1 / (np.pi * c * critical)  # [Hz]
    if resonance < cutoff:
        return []
    joint = effect.joints[0]
    return [
        Finding(
            "spring beyond the band",
            f"compliance of {joint}: it would swing at {resonance:.3g} Hz, and rows pass up to "
            f"{cutoff:.3g} Hz, where noise of accelerations, a delay or a rotor pass for it; its "
            "interval does not hold what these make of it",
            f"log a motion in which {joint} reaches {resonance:.2g} Hz, with a higher --cutoff",
            (effect.full["compliance"],), resonance, cutoff,
        )
    ]  # fmt: skip


def _with_noise_again(problem: Problem, estimate: Estimate) -> Estimate | None:
    """Return the estimate of the same equations from positions with as much noise once more; None
    where the positions have none.
    """
    motion, random = problem.motion, np.random.default_rng(0)
    logs, noisy = [], False
    for log, e in zip(motion.logs, motion.experiments, strict=True):
        columns = dict(log.columns)
        for name, noise in e.noise.items():
            if name.startswith("q.") and name in columns and noise > 0 and not e.poses:
                columns[name] = columns[name] + noise * random.normal(size=len(columns[name]))
                noisy = True
        logs.append(replace(log, columns=columns))
    if not noisy:
        return None
    spacing = [e.smooth.spacing for e in motion.experiments if e.smooth is not None]
    try:
        again = complete(
            problem.mechanism, logs, cutoff=motion.band.cutoff,
            smoothing=min(spacing) if spacing else None,
        )  # fmt: skip
    except IdentError:  # with more noise the logs may say nothing
        return None
    same = Problem.of(problem.mechanism, _at_rest_as(again, motion), problem.point)
    return replace(same, sigma=problem.sigma).estimate(sigma=estimate.sigma, fixed=estimate.fixed)


def _at_rest_as(again: Motion, motion: Motion) -> Motion:
    pairs = zip(again.experiments, motion.experiments, strict=True)
    return replace(again, experiments=tuple(e.with_rest(before.rest) for e, before in pairs))


def _as_good(problem: Problem, estimate: Estimate, effect: Effect, name: str) -> float:
    """Return how far the farthest value of a shape is with which the fit is as good, with all but
    shapes refitted.
    """
    place, mechanism = places_of(problem, effect)[name], problem.mechanism
    # neighbouring rows are alike: least squares fall by so many times what white noise makes
    cov = np.diag(covariance(problem.fitting, estimate))
    inflation = max(float(np.median(cov / np.diag(estimate.solution.C))), 1.0)
    value, most = float(estimate.x[place]), shape_bounds(problem)[place][1]
    tried = [share * most for share in TRIED]
    if name == "compliance":
        tried = [times * value for times in TIMES]
    point = problem.point_at(estimate.x)
    _, best, first = refitted(mechanism, problem.motion, point)
    far = 0.0
    for other in sorted(tried, key=lambda x: -abs(x - value)):
        if abs(other - value) <= far:
            continue
        nearby = point.with_values({effect.full[name]: other})
        loss = refitted(mechanism, problem.motion, nearby, first)[1]
        if loss - best < RIVAL**2 * inflation:
            far = abs(other - value)
    return far
