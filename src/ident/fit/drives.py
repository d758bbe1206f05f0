"""Two sources of torque for one joint: a sensor and a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.effects import Effect, ReversalPulses
from ident.effects.drive import RotorInertia
from ident.effects.effect import Signals
from ident.effects.servo import LATEST_COMMAND, PREFIX, CommandDelay, Drive
from ident.equations.problem import Problem
from ident.equations.terms import Samples
from ident.equations.unknowns import Point
from ident.errors import FitError
from ident.finding import Finding
from ident.fit.shapes import NoScale
from ident.information import linear
from ident.information.estimate import Estimate
from ident.information.evidence import NEGATIVE
from ident.mechanism.drives import with_common_delay
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, State
from ident.motion.commands import ON_ABOVE, servo_cutoff
from ident.text import listed, percent, shortlist, significant

DIFFERS = 0.1  # level: share of the measured torque by which a drive's differs and is named
AT_BOUND = 1e-6  # numerics: [s] from the end of its search within which a delay is at it
DELAYS = 11  # work: delays of a command that are tried before the nearest is refined
BELOW_LIMIT = 0.95  # numerics: of a drive's limit: a measured torque below it is not clipped …
HELD_AT_ZERO = "held at zero"  # code of a finding
FAR_ABOVE = 1.5  # level: a cut-off over that of servos, from which noise biases what they show
ROUNDS = 4  # work: … at first, then one that the fitted law does not clip


def with_sensors_first(
    mechanism: Mechanism, motion: Motion, validate: Motion | None = None
) -> tuple[Mechanism, tuple[Finding, ...]]:
    """Return the mechanism without the drives of joints whose torque all logs have, and a finding
    on each of them whose torque is another than the measured one.

    Raises:
        FitError: if some logs have the torque of a driven joint, and others its command alone.
    """
    logs = [*motion.logs, *(validate.logs if validate is not None else ())]
    measured = []
    for name, drive in mechanism.drives.items():
        having = [log.name for log in logs if f"tau.{name}" in log.columns]
        lacking = [log.name for log in logs if f"tau.{name}" not in log.columns]
        if having and lacking:
            raise FitError(
                f"{having[0]} has a column tau.{name}, and {lacking[0]} has none: all logs take "
                f"the torque of a joint from its sensor, or all from {drive.label}; fit these logs "
                f"apart, or take tau.{name} out of {listed(having[:3])}"
            )
        if having:
            measured.append(name)
    if not measured:
        return mechanism, ()
    findings = [
        finding
        for name in measured
        if (finding := _compared(mechanism, mechanism.drives[name], motion.experiments))
    ]
    drives = [drive for name, drive in mechanism.drives.items() if name not in measured]
    others = [e for e in mechanism.effects if not e.supplies_torque and e.kind != CommandDelay.kind]
    kept = replace(mechanism, effects=tuple(others))
    for effect in with_common_delay(drives):
        kept = kept + effect
    return kept, tuple(findings)


def with_known_drives(mechanism: Mechanism, point: Point) -> tuple[Mechanism, Point]:
    """Return the mechanism whose drives have the gains and delays of a point as known ones, and the
    point without the delay that they share: so the drives of some joints can be left out.
    """
    drives = []
    for drive in mechanism.drives.values():
        values = {**drive.values, **point.of(drive)[1]}
        if "delay" in drive.settings and isinstance(drive, Drive):
            nothing = np.zeros(0)
            at = Signals(nothing, nothing, nothing, nothing, nothing, {}, {}, point.values)
            values["delay"] = drive.delay(at)
        drives.append(replace(drive, values=values))
    others = [e for e in mechanism.effects if not e.supplies_torque and e.kind != CommandDelay.kind]
    values = {name: x for name, x in point.values.items() if not name.startswith(PREFIX)}
    return replace(mechanism, effects=(*others, *drives)), replace(point, values=values)


def _compared(mechanism: Mechanism, drive: Effect, experiments: Sequence[State]) -> Finding | None:
    """Return a finding where a drive's best torque is not the measured one.

    Given values are kept; unknown gains and an unknown delay are those that come nearest to it.
    """
    name = drive.joints[0]
    if not isinstance(drive, Drive) or any(
        not e.extra.keys() >= {*drive.reads()} for e in experiments
    ):
        return None
    delay = next(
        (e for e in mechanism.effects if e.kind == CommandDelay.kind and name in e.joints), None
    )
    if delay is None:
        share = _difference(mechanism, drive, experiments, {})
    elif delay.values:
        (shape,) = delay.shapes
        known = {delay.full[shape.name]: delay.values[shape.name]}
        share = _difference(mechanism, drive, experiments, known)
    else:
        (key,) = (delay.full[shape.name] for shape in delay.shapes)
        share = _least(lambda d: _difference(mechanism, drive, experiments, {key: d}))
    if share < DIFFERS:
        return None
    column = f"tau.{name}"
    return Finding(
        "two torques",
        f"{name}: the log has {column}, which is used, and {drive.label} would make another torque "
        f"from {', '.join(drive.reads())}: they differ by {percent(share)} rms",
        f"check the gains, limit and delay of the drive, or leave out the column {column}",
        (column,), share, DIFFERS,
    )  # fmt: skip


def _least(share: Callable[[float], float]) -> float:
    """Return the least of a function of a delay, over all by which drives may follow late."""
    from scipy.optimize import minimize_scalar  # takes 0.2 s to import

    grid = np.linspace(0.0, LATEST_COMMAND, DELAYS)
    best = int(np.argmin([share(float(d)) for d in grid]))
    ends = grid[max(best - 1, 0)], grid[min(best + 1, DELAYS - 1)]
    return float(minimize_scalar(share, bounds=ends, method="bounded").fun)


def _difference(
    mechanism: Mechanism, drive: Drive, experiments: Sequence[State], present: Mapping[str, float]
) -> float:
    """Return by what share (rms) of the measured torque a drive's best one differs from it, with
    the delay that `present` has.
    """
    name, limit = drive.joints[0], drive.setting("limit")
    j, at = mechanism.driven.index(name), mechanism.joint_index[name]
    free = [shape.name for shape in drive.shapes if shape.name not in drive.values]
    zero = {shape.name: 0.0 for shape in drive.shapes} | {**drive.values}
    rows, offsets, measured = [], [], []
    for e in experiments:
        # a late command of the first samples was sent before the log
        used = e.usable & (e.poses | (e.t >= e.t[0] + (LATEST_COMMAND if present else 0.0)))
        on = e.extra.get(f"on.{name}", np.ones(len(e.t))) > ON_ABOVE

        def unlimited(
            shape: dict[str, float], e: State = e, on: np.ndarray = on, used: np.ndarray = used
        ) -> np.ndarray:
            motion = e.y[:, [at]], e.yd[:, [at]], e.ydd[:, [at]]
            s = Signals(e.t, *motion, np.zeros(1), e.extra, shape, present)
            return (on * drive.unlimited(s))[used]

        known = unlimited(zero)
        # the law is linear in its gains but for its limit
        columns = [unlimited({**zero, key: zero[key] + 1.0}) - known for key in free]
        rows.append(np.stack(columns, axis=1) if free else np.zeros((len(known), 0)))
        offsets.append(known)
        measured.append(e.tau[used, j])
    A, known, tau = np.concatenate(rows), np.concatenate(offsets), np.concatenate(measured)
    torque = known
    inside = np.abs(tau) < BELOW_LIMIT * limit
    for _ in range(ROUNDS if free and np.isfinite(limit) else min(len(free), 1)):
        if inside.sum() <= len(free):
            break
        gains = linear.lstsq(A[inside], (tau - known)[inside], rcond=1e-9)[0]
        torque = known + A @ gains
        inside = np.abs(torque) < limit
    size = float(np.sqrt(np.mean(tau**2)))
    error = tau - np.clip(torque, -limit, limit)
    return float(np.sqrt(np.mean(error**2))) / size if size else 0.0


def without_held_drives(mechanism: Mechanism, motion: Motion, unscaled: NoScale) -> Mechanism:
    """Return the mechanism without the drives that nothing gives a scale because they hold their
    joint still in all logs, and without the equations of these joints.

    Raises:
        NoScale: for drives that are off in all logs, with what to do; `unscaled`, if there are
            other drives among them, if they are all there are, or if the mechanism has closures,
            which pass their torques on to all equations.
    """
    names = {
        name
        for name, drive in mechanism.drives.items()
        if all(np.ptp(e.extra[drive.reads()[0]]) == 0 for e in motion.experiments)
    } & {*unscaled.joints}
    if off := [name for name in unscaled.joints if _off_throughout(name, motion)]:
        key = mechanism.drives[off[0]].scale
        raise NoScale(
            f"{mechanism.drives[off[0]].kind}: off in all samples (on. is 0) in {listed(off)}, so "
            "nothing shows its gain; log with the drive on, too, or give any gain, which then acts "
            f"nowhere: --drive {off[0]}:{key}=1",
            off,
        ) from unscaled
    if mechanism.closures or names != {*unscaled.joints} or names == {*mechanism.driven}:
        raise unscaled
    delays = [e for e in mechanism.effects if e.kind == CommandDelay.kind]
    drives = [drive for name, drive in mechanism.drives.items() if name not in names]
    others = [e for e in mechanism.effects if not e.supplies_torque and e not in delays]
    kept = replace(
        mechanism, effects=tuple(others), unmeasured=(*mechanism.unmeasured, *sorted(names))
    )
    for effect in with_common_delay(drives):
        kept = kept + effect
    return kept


def _off_throughout(name: str, motion: Motion) -> bool:
    """Whether the drive of a joint is off in all samples of all logs."""
    on = [e.extra.get(f"on.{name}") for e in motion.experiments]
    return all(x is not None and not (x > ON_ABOVE).any() for x in on)


def held_drives(names: Sequence[str]) -> list[Finding]:
    """Return a finding on joints whose equations were left out as their drives hold them still."""
    if not names:
        return []
    return [
        Finding(
            "held joint",
            f"{listed(names)}: held still by a command that never changes, which shows no gain of "
            "the drive; its equation is left out",
            f"move {listed(names)} too, or give the gain (--drive {names[0]}:…)",
            tuple(names),
        )
    ]


def with_reversal_pulses(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism with pulses at reversals of drives' joints that have dry friction.

    A joint that sticks while its command goes on has another friction than ± Fc for some
    milliseconds; delay and damping of its drive would take that over (measured: 0.7 ms, 3 %).
    """
    present = {effect.label for effect in mechanism.effects}
    for effect in mechanism.effects:
        (joint, *others) = effect.joints or ("",)
        label = f"{ReversalPulses.kind}:{joint}"
        if effect.jumps and not others and joint in mechanism.drives and label not in present:
            mechanism = mechanism + ReversalPulses((joint,))
            present.add(label)
    return mechanism


def without_long_pulses(problem: Problem, estimate: Estimate) -> Estimate:
    """Return the estimate without the pulses at reversals that are longer than a filter hides.

    A pulse stands for the first moments of another friction during a time that is short beside
    1 / (2π cut-off). Moments beyond Fc times that, or its square, are of no pulse: friction of the
    model is wrong over a longer time, and the pulses would take its place in the rows, but not in a
    simulation, which has none (a Go2's commands were played 8.4 mrad off, and 6.8 without).
    """
    mechanism, cutoff = problem.mechanism, problem.motion.band.cutoff
    pulses = [e for e in mechanism.effects if isinstance(e, ReversalPulses)]
    pulses = [e for e in pulses if e.joints[0] in mechanism.drives]
    if not pulses or not cutoff or problem.stacked:
        return estimate
    short = 1 / (2 * np.pi * cutoff)
    place = {name: at for at, name in enumerate(problem.columns.names)}
    dry = _dry_friction(problem, [effect.joints[0] for effect in pulses])
    while True:
        longest, worst = 1.0, None
        for effect in pulses:
            at = [place.get(effect.full[unknown.name], -1) for unknown in effect.unknowns]
            (joint,) = effect.joints
            if joint not in dry or min(at) < 0 or estimate.fixed[at].any():  # or given
                continue
            places, friction = dry[joint]
            level = float(np.sqrt(np.mean((friction @ estimate.x[places]) ** 2)))
            most = level * short ** np.arange(1, len(at) + 1)
            over = np.abs(estimate.x[at]) / np.maximum(most, np.finfo(float).tiny)
            if over.max() > longest:
                longest, worst = float(over.max()), at
        if worst is None:
            return estimate
        fixed = estimate.fixed.copy()
        fixed[worst] = True
        estimate = problem.estimate(sigma=estimate.sigma, fixed=fixed)


def _dry_friction(
    problem: Problem, joints: Sequence[str]
) -> dict[str, tuple[list[int], np.ndarray]]:
    """Return the places in x (k,) of a joint's dry friction, and its columns (n, k), by joint."""
    dry = dict[str, tuple[list[int], list[np.ndarray]]]()
    for effect, places in problem.columns.effects:
        if not effect.jumps or effect.in_rows_alone or len(effect.joints) != 1:
            continue
        (joint,) = effect.joints
        if joint not in joints:
            continue
        shape = problem.point.of(effect)[1]
        columns = np.concatenate([
            Samples(problem.mechanism, e, slice(None), problem.point).columns(effect, shape)[:, 0]
            for e in problem.motion.experiments
        ])  # fmt: skip
        at, friction = dry.setdefault(joint, ([], []))
        for place, column in zip(places, columns.T, strict=False):
            if place >= 0:
                at.append(int(place))
                friction.append(column)
    return {joint: (at, np.stack(x, axis=1)) for joint, (at, x) in dry.items() if at}


def narrow_intervals(problem: Problem) -> list[Finding]:
    """Return a finding on damping, rotors and delay of servos with dry friction where a cut-off was
    given far above the servos' own: noise of accelerations biases them by more than their standard
    errors (measured with 12 bit encoders at 2.5 times that: 95 % intervals hold in 42 to 55 %).
    """
    mechanism, motion = problem.mechanism, problem.motion
    pulsed = {
        effect.joints[0]
        for effect in mechanism.effects
        if isinstance(effect, ReversalPulses) and effect.joints[0] in mechanism.drives
    }
    if not pulsed or all(e.smooth is None for e in motion.experiments):
        return []
    servos, cutoff = servo_cutoff(mechanism, motion.experiments), motion.band.cutoff or np.inf
    if servos is None or cutoff <= FAR_ABOVE * servos:
        return []
    names = [
        effect.full[parameter.name]
        for effect, places in problem.columns.effects
        if effect.supplies_torque or isinstance(effect, RotorInertia | CommandDelay)
        for parameter, place in zip(effect.parameters, places, strict=True)
        if place >= 0 and parameter.name != effect.scale and {*effect.joints} & pulsed
    ]
    if not names:
        return []
    return [
        Finding(
            "narrow intervals",
            f"intervals of {shortlist(names)} are too narrow: rows pass up to {cutoff:.3g} Hz, and "
            f"servos follow up to {servos:.3g} Hz; above it there is noise of accelerations alone, "
            "which biases damping, rotors and delay",
            "leave out the cut-off",
            tuple(names), cutoff / servos, FAR_ABOVE,
        )
    ]  # fmt: skip


def held_at_zero(problem: Problem, estimate: Estimate) -> tuple[Estimate, list[Finding]]:
    """Return the estimate within the signs that effects of drives' joints can have, and a finding
    on those that it holds at zero because they came out on the other side.

    A command shows inertia and friction less well than a torque does, and no simulation runs with
    negative ones. The one that is farthest from zero in standard errors is held first, as the
    others may follow it.
    """
    drives, negative = problem.mechanism.drives, dict[int, float]()
    if not drives or problem.stacked:
        return estimate, []
    places = np.array([
        place
        for effect, columns in problem.columns.effects if {*effect.joints} & {*drives}
        for unknown, place in zip(effect.unknowns, columns[: len(effect.unknowns)], strict=True)
        if unknown.nonnegative and place >= 0 and problem.prior[place] == 0
    ], dtype=int)  # fmt: skip
    while True:
        base, x = estimate.base, estimate.x
        error = np.zeros(len(x))  # of those that no other column is made from
        error[base.independent] = np.sqrt(np.diag(estimate.solution.C)) * ~base.K.any(axis=1)
        below = places[(x[places] < 0) & (error[places] > 0) & ~estimate.fixed[places]]
        if not len(below):
            break
        worst = below[np.argmin(x[below] / error[below])]
        negative[int(worst)] = float(x[worst])
        fixed = estimate.fixed.copy()
        fixed[worst] = True
        estimate = problem.estimate(sigma=estimate.sigma, fixed=fixed)
    if not negative:
        return estimate, []
    names = [problem.columns.names[place] for place in negative]
    values = [
        f"{name} ({significant(value, 2)})"
        for name, value in zip(names, negative.values(), strict=True)
    ]
    return estimate, [
        Finding(
            HELD_AT_ZERO,
            f"{shortlist(values)} came out negative, which no such effect can be, and "
            f"{'is' if len(names) == 1 else 'are'} held at zero",
            "log a faster motion, or see what is missing (ident diagnose)",
            tuple(names),
        )
    ]


def without_negative_delay(
    problem: Problem, estimate: Estimate
) -> tuple[Mechanism | None, list[Finding]]:
    """Return the mechanism whose drives follow at once, with a finding, where their delay came out
    below zero by more than its error; None where it did not.
    """
    mechanism, base = problem.mechanism, estimate.base
    errors = np.sqrt(np.diag(estimate.solution.C))
    early = dict[str, float]()
    for effect, places in problem.columns.effects:
        if effect.kind != CommandDelay.kind:
            continue
        if (place := int(places[-1])) in base.independent:
            error = float(errors[list(base.independent).index(place)])
            if estimate.x[place] < -NEGATIVE * error:
                early |= dict.fromkeys(effect.joints, float(estimate.x[place]))
    if not early:
        return None, []
    drives = [
        replace(drive, values={**drive.values, "delay": 0.0}) if name in early else drive
        for name, drive in mechanism.drives.items()
    ]
    others = [e for e in mechanism.effects if not e.supplies_torque and e.kind != CommandDelay.kind]
    at_once = replace(mechanism, effects=tuple(others))
    for effect in with_common_delay(drives):
        at_once = at_once + effect
    value = 1e3 * next(iter(early.values()))
    return at_once, [
        Finding(
            "delay at its bound",
            f"delay of the commands of {listed([*early])}: came out at {value:.2g} ms, before the "
            "command, and is taken as zero",
            "check that commands and positions have one clock, or see what is missing (ident "
            "diagnose)",
            tuple(early), 1e-3 * value, 0.0,
        )
    ]  # fmt: skip


def delays_at_bounds(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Return a finding on each delay of commands that ends where its search ends."""
    findings = []
    for effect, places in problem.columns.effects:
        if effect.kind != CommandDelay.kind or places[-1] < 0:
            continue
        (shape,) = effect.shapes
        assert shape.range is not None
        low, high = shape.range
        value = float(problem.point_at(estimate.x).of(effect)[1][shape.name])
        if low + AT_BOUND < value < high - AT_BOUND:
            continue
        end = high if value > (low + high) / 2 else low
        text = f"delay of the commands of {listed(effect.joints)}: at its bound of {end:g} s"
        remedy = (
            "check that commands and positions have one clock, or give the delay: [drives] delay"
            if end == high
            else "no lateness shows: give delay = 0 in [drives], which makes kd more certain"
        )
        findings.append(Finding("delay at its bound", text, remedy, effect.joints, value, end))
    return findings
