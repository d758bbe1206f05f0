"""Findings to read before a fit is trusted, each with a remedy.

Which parameters a motion hides: it is compared with one made up in which everything moves
(`excitation`). An unknown that leads a base parameter there and none here is lost to this motion;
`ident excite` plans one that determines it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.effects.transmission import Elasticity
from ident.equations.filter import Decimator
from ident.equations.problem import Problem
from ident.equations.unknowns import Columns
from ident.errors import MotionError
from ident.finding import Finding, note
from ident.fit.drives import HELD_AT_ZERO
from ident.fit.prediction import identifiable_multipliers, multiplier_errors
from ident.fit.shapes import initial
from ident.fit.values import EffectValues, ParameterValues, absorbed_by
from ident.information.blocks import Error
from ident.information.chance import FEWEST_EQUATIONS
from ident.information.estimate import Estimate, estimate, term_sizes
from ident.information.evidence import CERTAIN, EXPLAINED_BELOW, MATTERS
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import pseudo_inertia
from ident.motion import Motion
from ident.motion.closures import LoopSolver, best_conditioned, independent_joints
from ident.motion.motion import prescribed
from ident.text import percent, shortlist, significant, two_digits

# of a load
IN_PROPORTION = "in proportion to the torques' scale, whose error is not in their standard errors"
BIASED = 1e-4  # tuned: share of a parameter that a time basis may move unmentioned
SHORT, USUAL = 10.0, 30.0  # level: the same: below the first a log is called short; what is advised
POOR = 1e3  # level: condition number above which the motion excites some base parameter poorly
LEAST_MASS = 1e-9  # range: kg below which a body with first moments cannot be written in a URDF
# tuned: torque over its terms: an error of 5 % in one of them is half the torque or more; and the
# relative error of a torque from which its unit is in doubt
FREELY = 0.1
LITTLE = 0.1  # shown: of the farthest joint's way: one that moves less is named
NEGATIVE_VALUE = "negative"  # code of a finding
DRIVING = "friction drives"  # code of a finding
IMPOSSIBLE_BODY = "impossible body"  # code of a finding
# shown: shares by which the error of a joint that is named must fall, and the mean of all joints
BETTER, EVERYWHERE = 0.1, 0.02
POSSIBLE = -1e-6  # numerics: of a body's largest eigenvalue: what rounding may leave below zero
# codes of findings on values that cannot be, which are read first, and on what was only left out
GRAVE = (NEGATIVE_VALUE, DRIVING, IMPOSSIBLE_BODY, "possible bodies", "few equations", "absorbed")
HARMLESS = ("note", "standstill", "scale", "rest on priors", "massless", "basis", "short runs")
Errors = Mapping[str, Error]  # by joint
Effects = Sequence[EffectValues]


def severity(finding: Finding) -> int:
    """Return the place of a finding among others: 0 of the gravest, 2 of what is harmless."""
    return 0 if finding.code in GRAVE else 2 if finding.code in HARMLESS else 1


def findings_of(
    problem: Problem, estimate: Estimate, errors: Errors, effects: Effects, more: Iterable[Finding]
) -> tuple[Finding, ...]:
    """Return the findings of a fit, in the order in which a person should read them; `errors` by
    joint are those of the data that were fitted, `more` is of the way of the estimate.
    """
    pi = problem.point_at(estimate.x).pi
    # unknowns of one term may cancel, as moments of two parallel links do; gravity and inertia do
    # where a joint swings freely
    terms = problem.columns.terms
    parted = np.where(terms[:, None] == np.unique(terms), estimate.x[:, None], 0.0)
    more = [*more]
    at_zero = [finding for finding in more if finding.code in (HELD_AT_ZERO, NEGATIVE_VALUE)]
    reported = {name for finding in at_zero for name in finding.where}
    findings = [
        *_equations(problem, estimate),
        *_held_unknowns(problem.columns, estimate, reported),
        *_short_runs(problem.motion),
        *_absorbed(problem.columns, estimate),
        *_multipliers(problem, estimate),
        *more,
        *_swinging(problem, estimate.at(parted), errors),
        *_implausible(problem.mechanism, errors, effects, pi),
        *_rigid(problem, effects),
    ]
    every = dict.fromkeys(findings)
    # what was done to the data comes behind what a person should act on
    return tuple(sorted(every, key=lambda finding: finding.code == "note"))


def _equations(problem: Problem, estimate: Estimate) -> Iterator[Finding]:
    """Report equations that are few, poor, at standstill, or without unknowns; the data's notes."""
    rows, rank = estimate.triangle.rows, estimate.base.rank
    if rank and rows < SHORT * rank:
        seconds = sum(float(e.t[-1] - e.t[0]) for e in problem.motion.experiments)
        wanted = two_digits(seconds * USUAL * rank / max(rows, 1))
        remedy = f"log about {wanted} s of varied motion instead of {two_digits(seconds)} s"
        text = f"{rows} equations for {rank} parameters"
        if rows < FEWEST_EQUATIONS * rank:
            text = f"only {text}: these values and errors mean nothing"
            remedy += ", or make less unknown ([parameters] unknown)"
            yield Finding("few equations", text, remedy, (), rows / rank, FEWEST_EQUATIONS)
        else:
            text = f"a short log: {text}, so values and errors are rough"
            yield Finding("short log", text, remedy, (), rows / rank, SHORT)
    yield from map(note, (*problem.mechanism.notes, *problem.motion.notes))
    off = problem.mechanism.unmeasured_rows
    poses = {i for i, e in enumerate(problem.motion.experiments) if e.poses}
    every = (block for block in problem.information if block.log not in poses)
    blocks = [block for block in every if block.coordinate not in off]
    if rest := sum(block.rest.rows for block in blocks):
        share = rest / sum(block.rows for block in blocks)
        used = problem.sigma is not None
        how = "count as one row a stretch" if used else "are not used"
        text = (
            f"{100 * share:.3g} % of the samples are at standstill and {how}: dry friction can "
            f"have any value {'up to its limit ' * used}there"
        )
        yield Finding("standstill", text)
    if not len(problem.columns):
        text = "nothing is unknown: these are the errors of the model as it is"
        remedy = "to identify, give [parameters] unknown in mechanism.toml or add an effect"
        yield Finding("nothing unknown", text, remedy)
    if loads := tuple(e.label for e in problem.mechanism.effects if e.loaded_link):
        text = f"{shortlist(loads, 4)}: masses and moments are {IN_PROPORTION}"
        yield Finding("scale", text, "log once more with a known mass to measure the scale", loads)
    if (condition := estimate.base.condition_number) > POOR:
        size = significant(condition)
        text = f"condition number {size}: this motion excites some base parameters poorly"
        remedy = "see their standard errors, and move more joints, faster or farther"
        yield Finding("excitation", text, remedy, (), condition, POOR)


def _held_unknowns(
    columns: Columns, estimate: Estimate, reported: Collection[str]
) -> Iterator[Finding]:
    """Report what the data know too badly, but for the names that others have `reported`."""
    number = np.arange(len(columns))
    rigid, shapes = number < len(columns.rigid), np.isin(number, columns.shapes)
    # what stands in rows alone is nobody's parameter
    of_rows = {name for e, _ in columns.effects if e.in_rows_alone for name in e.full.values()}
    reported = {*reported, *of_rows}
    for kind, where in (
        (rigid, "held at the prior"),
        (shapes, "left where the search ended"),
        (~rigid & ~shapes, "held at zero"),
    ):
        every = (columns.names[i] for i in np.flatnonzero(estimate.fixed & kind))
        if names := tuple(name for name in every if name not in reported):
            far = ", or it is far outside its range" * (kind is shapes)
            count = f"{len(names)} parameter{'s' * (len(names) > 1)}"
            text = (
                f"{count} {where} ({shortlist(names, 3)}): the model error is so large that this "
                f"motion cannot tell them{far}"
            )
            remedy = "see what is missing first (ident diagnose), then move more joints or faster"
            yield Finding("held", text, remedy, names)


def _absorbed(columns: Columns, estimate: Estimate) -> Iterator[Finding]:
    held_names = {columns.names[i] for i in np.flatnonzero(estimate.fixed)}
    names: dict[str, list[str]] = {}
    for name, carrier in absorbed_by(columns, estimate.base).items():
        if columns.index[name] >= len(columns.rigid) and name not in held_names:
            names.setdefault(carrier, []).append(name)
    for carrier, absorbed_names in names.items():
        alone = "it has no effect on any torque in this motion"
        why = f"same columns as {carrier}" if carrier else alone
        text = f"{shortlist(absorbed_names, 6)} cannot be identified: {why}"
        yield Finding("absorbed", text, where=tuple(absorbed_names))


def _short_runs(motion: Motion) -> Iterator[Finding]:
    """Report runs between gaps that are too short for the filter to give a row."""
    for e in motion.experiments:
        half = Decimator.of(motion.band.cutoff, e.rate).half
        runs = (segment.stop - segment.start for segment in e.segments())
        if half and (short := [length for length in runs if length <= 2 * half]):
            text = (
                f"{e.name}: {sum(short)} samples in {len(short)} runs between gaps are left "
                f"out: shorter than the filter ({(2 * half + 1) / e.rate:.3g} s)"
            )
            yield Finding("short runs", text, "a higher cut-off keeps them", (e.name,))


def _multipliers(problem: Problem, estimate: Estimate) -> Iterator[Finding]:
    mechanism = problem.mechanism
    names = mechanism.kinematics.multipliers
    determined = identifiable_multipliers(mechanism, problem.motion)
    open_ = tuple(name for name, good in zip(names, determined, strict=True) if not good)
    if open_:
        text = (
            f"multipliers {', '.join(open_)} are not determined: closure equations are redundant "
            f"({len(determined)} of rank {mechanism.rank}), which is normal for planar loops"
        )
        yield Finding("redundant", text, where=open_)
    resting = multiplier_errors(problem, estimate).resting
    if resting := {name: on for name, on in resting.items() if name not in open_}:
        on = tuple(dict.fromkeys(name for names in resting.values() for name in names))
        text = (
            f"multipliers {', '.join(resting)} rest on the priors of {shortlist(on, 6)}"
            ", which no torque determines: a wrong prior moves them, however well torques fit"
        )
        yield Finding("rest on priors", text, where=tuple(resting))


def basis_bias(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Report what a time basis does to the parameters: its misfit of λ(t) is no noise, not in ±."""
    if not problem.stacked or problem.runs:
        return []
    free = problem.estimate(free=True)
    if not np.array_equal(estimate.base.independent, free.base.independent):
        return []
    cov = np.zeros((estimate.base.rank,) * 2)
    values = (ParameterValues(problem.columns, x, cov) for x in (estimate, free))
    both = [parameter_values.rigid(problem.mechanism) for parameter_values in values]
    biased = [
        f"{a.name} {100 * (a.value / b.value - 1):+.3g} %"
        for a, b in zip(*both, strict=True)
        if a.identifiable and b.value != 0 and abs(a.value / b.value - 1) > BIASED
    ]
    basis = problem.mechanism.multipliers
    text = (
        f"the {basis.basis} basis with knots of {1e3 * basis.spacing:.4g} ms moves parameters from "
        f"where free multipliers put them: {shortlist(biased, 6)}"
    )
    return [Finding("basis", text, "standard errors do not hold this bias")] if biased else []


def _swinging(problem: Problem, estimate: Estimate, errors: Errors) -> Iterator[Finding]:
    """Report driven joints whose torque is a small, unexplained remainder of terms that cancel."""
    shares: dict[str, float] = {}
    sizes = term_sizes(problem.information.totals, estimate.x)
    for (joint, error), size in zip(errors.items(), sizes, strict=True):
        if error.relative and size > 0 and joint in problem.mechanism.driven:
            share = error.rms / error.relative / float(size)
            if share < FREELY < error.relative:
                shares[joint] = share
    if shares:
        where, joints = tuple(f"tau.{joint}" for joint in shares), ", ".join(shares)
        parts = ", ".join(f"tau.{joint} is {100 * share:.2g} %" for joint, share in shares.items())
        text = (
            f"{parts} of the inertia, gravity and coupling terms that cancel in it: unit or "
            "scale is wrong, or the motor does next to nothing, and a relative error there says "
            "little"
        )
        remedy = (
            f"check {', '.join(where)} in [log] (N m, not mN m, A or %); if right, put {joints} "
            "among the passive joints for this log, the friction kept as an effect, or judge by "
            "the rms error"
        )
        yield Finding("swings freely", text, remedy, where, min(shares.values()), FREELY)


def _implausible(
    mechanism: Mechanism, errors: Errors, effects: Effects, pi: np.ndarray
) -> Iterator[Finding]:
    negative = tuple(
        value.name
        for effect_values in effects
        for value, unknown in zip(
            effect_values.parameters, effect_values.effect.parameters, strict=True
        )
        if unknown.nonnegative and value.stderr and value.value < -CERTAIN * value.stderr
    )
    if negative:
        text = (
            f"{', '.join(negative)} came out negative, which no such effect can be: check the sign "
            "of the torque, or whether another effect is missing"
        )
        yield Finding(NEGATIVE_VALUE, text, where=negative)
    yield from _driving(effects, errors)
    bodies = {link: pi[mechanism.bodies.columns(link)] for link in mechanism.bodies.links}
    light = [link for link, body in bodies.items() if abs(body[0]) <= LEAST_MASS]
    if massless := tuple(link for link in light if np.any(bodies[link][1:])):
        text = (
            f"{', '.join(massless)} has moments but a mass that no torque determines: "
            "identified.urdf gives it 1 kg, shifted along what has no effect on torques"
        )
        yield Finding("massless", text, where=massless)
    impossible = []
    for link in bodies_with_unknowns(mechanism):
        eigenvalues = np.linalg.eigvalsh(pseudo_inertia(bodies[link]))
        if eigenvalues[0] < POSSIBLE * max(eigenvalues[-1], 1e-300):
            impossible.append(link)
    if impossible:
        text = (
            f"the identified inertia of {', '.join(impossible)} is that of no possible body (its "
            "pseudo-inertia has a negative eigenvalue): identified.urdf holds the nearest possible "
            "bodies in their place, and other motions may be predicted worse"
        )
        remedy = "--consistent fits within what is possible"
        yield Finding(IMPOSSIBLE_BODY, text, remedy, tuple(impossible))


def _rigid(problem: Problem, effects: Effects) -> Iterator[Finding]:
    """Report springs between motor and link that the log cannot tell from none, with the stiffness
    below which it would: that whose compliance is CERTAIN standard errors.
    """
    cutoff = problem.motion.band.cutoff
    for effect_values in effects:
        if not isinstance(effect_values.effect, Elasticity):
            continue
        value, joint = effect_values.parameters[0], effect_values.effect.joints[0]
        if not value.stderr or abs(value.value) >= CERTAIN * value.stderr:
            continue
        unit = "N m/rad" if problem.mechanism.joint(joint).rotational else "N/m"
        reach = f": rows pass up to {cutoff:.3g} Hz" if cutoff else ""
        stiffness = 1 / (CERTAIN * value.stderr)
        yield Finding(
            "rigid here",
            f"compliance of {joint}: not to be seen here; below {significant(stiffness, 2)} {unit} "
            f"it would be{reach}",
            f"log a faster motion, or one with more load on {joint}; else leave "
            f"{effect_values.effect.label} out",
            (value.name,), value.value / value.stderr, CERTAIN,
        )  # fmt: skip


def _driving(effects: Effects, errors: Errors) -> Iterator[Finding]:
    """Report joints that dry friction drives instead of braking them, with much of their torque."""
    for effect_values in effects:
        value = effect_values.parameters[0]
        if not effect_values.effect.unknowns or effect_values.effect.unknowns[0].acts != "level":
            continue
        joint = effect_values.effect.joints[0]
        error = errors.get(joint)
        if error is None or not error.relative or not value.stderr:
            continue
        share = -value.value / (error.rms / error.relative)
        if share > EXPLAINED_BELOW and value.value < -CERTAIN * value.stderr:
            text = (
                f"tau.{joint}: dry friction would drive the joint, with {100 * share:.2g} % of its "
                "torque: the sign of the torque is wrong, or another effect is missing"
            )
            remedy = f'if it is the sign, [log] "tau.{joint}" = {{ column = …, scale = -1 }}'
            yield Finding(DRIVING, text, remedy, (f"tau.{joint}",), share, EXPLAINED_BELOW)


def predicts_better(log: str, before: Errors, after: Errors) -> list[Finding]:
    """Say where possible bodies predict a validation log better, if they do over all joints."""
    known = [name for name, error in before.items() if error.rms > 0 and error.relative]
    ratio = {name: after[name].rms / before[name].rms for name in known}
    joints = sorted((name for name in ratio if ratio[name] < 1 - BETTER), key=ratio.__getitem__)
    if not joints or np.mean(np.log(np.maximum(list(ratio.values()), 1e-12))) > -EVERYWHERE:
        return []
    both = {name: [percent(x[name].relative) for x in (before, after)] for name in joints}
    falls = [f"{name} from {first} to {last}" for name, (first, last) in both.items()]
    text = f"with bodies that are possible, {log} is predicted better: {shortlist(falls, 3)}"
    return [Finding("possible bodies", text, "identify with --consistent", tuple(joints))]


def beyond_range(mechanism: Mechanism, motion: Motion, validate: Motion) -> Iterator[Finding]:
    """Report where validation logs leave the range of positions in which a curve was identified: it
    is no law, and says nothing there.
    """
    for effect in (effect for effect in mechanism.effects if effect.descriptive):
        joint = mechanism.joint(effect.joints[0])
        low, high = _range(motion, joint.index)
        for e in validate.experiments:
            y = e.y[e.usable, joint.index]
            outside = float(((y < low) | (y > high)).mean()) if len(y) else 0.0
            if outside > MATTERS:
                text = (
                    f"{effect.label} is a curve between {low:.3g} and {high:.3g} {joint.unit}, and "
                    f"{percent(outside)} of {e.name} lies beyond, where it says nothing"
                )
                remedy = f"identify from a log in which {joint.name} goes as far"
                yield Finding("beyond its range", text, remedy, (joint.name,), outside, MATTERS)


def _range(motion: Motion, joint: int) -> tuple[float, float]:
    """Return the least and the largest position of a joint, by its place, in all logs."""
    y = np.concatenate([e.y[e.usable, joint] for e in motion.experiments])
    return float(y.min()), float(y.max())


def bodies_with_unknowns(mechanism: Mechanism) -> list[str]:
    """Return the links of bodies with an unknown parameter, in Γ's order."""
    unknown = {name.rpartition(".")[0] for name in mechanism.unknown}
    return [link for link in mechanism.bodies.links if link in unknown]


def with_inputs(mechanism: Mechanism, motion: Motion) -> Motion:
    """Return a made-up motion with columns that forces at places read, lively ones."""
    (e,) = motion.experiments
    effects = [effect for effect in mechanism.effects if effect.site == "frame"]
    columns = dict.fromkeys(name for effect in effects for name in effect.reads())
    if not columns:
        return motion
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, (len(columns), 2))
    extra = {
        name: 1.0 + 0.3 * np.sin(3 * e.t + a) + 0.2 * np.sin(7 * e.t + b)
        for name, (a, b) in zip(columns, phases, strict=True)
    }
    return replace(motion, experiments=(replace(e, extra={**e.extra, **extra}),))


def excitation(mechanism: Mechanism) -> Motion:
    """Return a made-up motion around the start in which every degree of freedom moves.

    For a structural answer only: sines of unrelated frequencies, smaller where loops are tight.
    """
    choices = [
        best_conditioned(mechanism, mechanism.assembled[None]),
        independent_joints(mechanism, [*mechanism.driven, *mechanism.joint_index]),
        independent_joints(mechanism, [*reversed(mechanism.driven), *mechanism.joint_index]),
    ]
    why: MotionError | None = None
    t = np.linspace(0.0, 10.0, 801)
    for names in dict.fromkeys(choices):
        rng = np.random.default_rng(1)
        w = 2 * np.pi * rng.uniform(0.5, 1.5, (len(names), 3))
        phase = rng.uniform(0, 2 * np.pi, (len(names), 3))
        angle = w * t[:, None, None] + phase  # (n, d, 3)
        series = (np.sin(angle) - np.sin(phase), w * np.cos(angle), -(w**2) * np.sin(angle))
        shape = np.stack([x.mean(axis=2) for x in series])
        for amplitude in (0.8, 0.3, 0.1, 0.03, 0.003):  # [rad | m]
            try:
                known, solver = amplitude * shape, LoopSolver(mechanism, names)
                known[0] += solver.coordinates(mechanism.assembled[None]).value[0]
                motion = prescribed(mechanism, "a made-up motion", t, names, known)
                return with_inputs(mechanism, motion)
            except MotionError as error:
                why = error
    raise MotionError(
        f"{mechanism.name}: no motion made up around [joints] start can be followed ({why}); "
        "give a start farther from a singular position, or a log"
    )


def unexcited(problem: Problem, fitted: Estimate) -> Finding | None:
    """Return which unknowns another motion would determine, and the joints that hardly move; None
    where there are none. MotionError if no motion can be made up for the mechanism.
    """
    mechanism, motion, columns = problem.mechanism, problem.motion, problem.columns
    other = excitation(mechanism)
    totals = Problem.reduced(mechanism, other, initial(mechanism, other)).information.totals
    ones = np.ones(len(totals))  # unknowns that lead a base parameter if everything moves:
    able = estimate(totals, columns.prior, ones, sigma=ones).base.independent
    lost = tuple(columns.names[i] for i in np.setdiff1d(able, fitted.base.independent))
    if not lost:
        return None
    still = []
    travel = np.ptp(np.concatenate([e.y[e.usable] for e in motion.experiments]), axis=0)
    for unit in ("rad", "m"):
        names = [name for name in motion.independent if mechanism.joint(name).unit == unit]
        far = {name: float(travel[mechanism.joint_index[name]]) for name in names}
        farthest = max(far.values(), default=0.0)
        still += [f"{name} by {x:.2g} {unit}" for name, x in far.items() if x < LITTLE * farthest]
    why = f" (it moves {shortlist(still, 3)} only)" if still else ""
    text = f"this motion does not determine {shortlist(lost, 5)}{why}"
    return Finding("unexcited", text, "ident excite plans one that does", lost)
