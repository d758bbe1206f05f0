"""What a fit says of springs and plays between motors and links: signs, and what biases them.

    ±² = jackknife² + (x(noise twice) − x)² + (x(half the band) − x)²

Encoder noise reaches a twist through accelerations, and columns with noise give biased values
(errors in variables). The same noise once more shows by how much: Cook, Stefanski, J. Am. Stat.
Assoc. 89(428), 1994. What splines take off at high frequencies biases them, too: rows of half the
band have less of it, and a right model has the same values there (Hausman, Econometrica 46(6),
1978).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ident.effects import Effect
from ident.equations.problem import Problem
from ident.equations.terms import Samples
from ident.errors import IdentError
from ident.finding import Finding
from ident.fit.drives import HELD_AT_ZERO
from ident.fit.findings import NEGATIVE_VALUE
from ident.information.chance import covariance
from ident.information.estimate import Estimate
from ident.information.evidence import CERTAIN
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.text import significant

AT_END = 0.8  # level: of a cut-off, from which a resonance shows half of itself or less


def places_of(problem: Problem, effect: Effect) -> dict[str, int]:
    """Return the places in x of an effect's unknown shapes, by name."""
    ((_, places),) = (both for both in problem.columns.effects if both[0].label == effect.label)
    shapes = zip(effect.shapes, places[len(effect.unknowns) :].tolist(), strict=True)
    return {shape.name: place for shape, place in shapes if place >= 0}


def extents(problem: Problem) -> dict[int, tuple[Effect, str]]:
    """Return the unknown extents, and what goes with them, that cannot be negative: effect and name
    of a shape by its place in x.
    """
    effects = (effect for effect in problem.mechanism.effects if effect.extent)
    return {
        place: (effect, shape.name)
        for effect in effects
        for shape in effect.shapes
        if shape.nonnegative and (place := places_of(problem, effect).get(shape.name, -1)) >= 0
    }


def within_signs(problem: Problem, estimate: Estimate) -> tuple[Problem, Estimate, list[Finding]]:
    """Return the problem and the estimate whose extents, and what goes with them, are not negative,
    and a finding on each that was: what chance alone makes negative is at its limit, with the
    standard error that it has without, and what is negative beyond chance is known to be zero.
    """
    findings, every = list[Finding](), extents(problem)
    if problem.stacked:
        return problem, estimate, findings
    places = np.array([*every], dtype=int)
    while len(below := estimate.negative(places)):
        errors = _standard_errors(problem, estimate)
        z = estimate.x[below] / errors[below]
        if not (z <= -CERTAIN).any():
            break
        worst = int(below[np.nanargmin(z)])
        effect, name = every[worst]
        findings.append(_impossible(effect, name, float(estimate.x[worst]), -float(np.nanmin(z))))
        fixed = estimate.fixed.copy()
        fixed[worst] = True
        zero = problem.point.with_values({effect.full[name]: 0.0})
        problem = replace(problem, point=zero)
        estimate = problem.estimate(sigma=estimate.sigma, fixed=fixed)
    within = estimate.nonnegative(places)
    return problem, within, [*findings, *at_zero(problem, within, estimate)]


def _standard_errors(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Return standard errors (k,) by the jackknife; NaN of what is not in the base."""
    errors = np.full(len(estimate.x), np.nan)
    variances = covariance(problem.fitting, estimate).diagonal()
    errors[estimate.base.independent] = np.sqrt(variances)
    return errors


def _impossible(effect: Effect, name: str, value: float, z: float) -> Finding:
    """Return the finding on a shape that is negative beyond chance and held at zero."""
    return Finding(
        NEGATIVE_VALUE,
        f"{name} of {effect.joints[0]} ({effect.kind}) came out negative ({significant(value, 2)}, "
        f"{z:.2g} standard errors), which none can be, and is held at zero: the model or the data "
        "are wrong there",
        f"see what is missing (ident diagnose), or leave {effect.label} out",
        (effect.full[name],), -z, -CERTAIN,
    )  # fmt: skip


def at_zero(problem: Problem, estimate: Estimate, before: Estimate) -> list[Finding]:
    """Return a finding on each extent, or what goes with it, that is at its limit and was not
    before.
    """
    findings, every = list[Finding](), extents(problem)
    for place in np.setdiff1d(estimate.at_limit, before.at_limit).tolist():
        effect, name = every[place]
        joint, value = effect.joints[0], float(before.x[place])
        came = f" ({significant(value, 2)})" if value < 0 else ""
        findings.append(
            Finding(
                HELD_AT_ZERO,
                f"{name} of {joint} ({effect.kind}): not to be seen here; it came out negative"
                f"{came} and is held at zero",
                f"log a faster motion of {joint}; else leave {effect.label} out",
                (effect.full[name],), value, 0.0,
            )
        )  # fmt: skip
    return findings


def beyond_band(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Return a finding on each effect that swings at the end of the rows' band or beyond it."""
    findings, cutoff = list[Finding](), problem.motion.band.cutoff
    point, e = problem.point_at(estimate.x), problem.motion.experiments[0]
    if cutoff is None or e.poses or e.smooth is None:
        return findings
    samples = Samples(problem.mechanism, e, slice(None), point)
    for effect in (effect for effect in problem.mechanism.effects if effect.by_load):
        signals, joint = samples.signals(effect.acting), effect.joints[0]
        at = effect.frequency(replace(signals, shape=point.of(effect)[1]))
        if at < AT_END * cutoff or not places_of(problem, effect):
            continue
        findings.append(
            Finding(
                "spring beyond the band",
                f"{effect.extent} of {joint}: it would swing at {at:.3g} Hz, and rows pass up to "
                f"{cutoff:.3g} Hz, where noise of accelerations, a delay or a rotor pass for it; "
                "its interval does not hold all that these make of it",
                f"log a motion in which {joint} reaches {at:.2g} Hz, with a higher --cutoff",
                (effect.full[effect.extent],), at, cutoff,
            )
        )  # fmt: skip
    return findings


def biases(problem: Problem, estimate: Estimate) -> Mapping[int, float]:
    """Return by how much shapes of effects with an extent, by place in x, may be biased: what as
    much noise of the positions once more changes, and rows of half the band; none where positions
    have no noise.
    """
    every = [effect for effect in problem.mechanism.effects if effect.extent]
    places = [place for effect in every for place in places_of(problem, effect).values()]
    places = [place for place in places if not estimate.fixed[place]]
    if problem.stacked or not any(estimate.x[place] for place in places):
        return {}
    again = _with_noise_again(problem.mechanism, problem.motion)
    if again is None:
        return {}
    x = estimate.x[places]
    same = Problem.of(problem.mechanism, again, problem.point)
    same = replace(same, sigma=problem.sigma)
    noisier = same.estimate(sigma=estimate.sigma, fixed=estimate.fixed)
    moved, further = noisier.x[places] - x, np.zeros(len(places))
    if lower := _in_half_the_band(problem):
        further = np.where(lower.fixed[places], 0.0, lower.x[places] - x)
    of_band = np.minimum(np.abs(further), np.abs(x))  # what it does not show may be anywhere
    return dict(zip(places, np.hypot(moved, of_band).tolist(), strict=True))


def _in_half_the_band(problem: Problem) -> Estimate | None:
    """Return the estimate of rows of half the band; None where there is none."""
    band = problem.motion.band
    if band.cutoff is None:
        return None
    half = replace(problem.motion, band=replace(band, cutoff=0.5 * band.cutoff))
    try:
        lower = Problem.of(problem.mechanism, half, problem.point)
        return replace(lower, sigma=problem.sigma).estimate()
    except IdentError:
        return None


def _with_noise_again(mechanism: Mechanism, motion: Motion) -> Motion | None:
    """Return the motion of positions with as much noise once more; None where they have none."""
    random, logs, noisy = np.random.default_rng(0), [], False
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
            mechanism, logs, cutoff=motion.band.cutoff,
            smoothing=min(spacing) if spacing else None,
        )  # fmt: skip
    except IdentError:  # with more noise the logs may say nothing
        return None
    pairs = zip(again.experiments, motion.experiments, strict=True)
    return replace(again, experiments=tuple(e.with_rest(before.rest) for e, before in pairs))
