"""Two sources of torque for one joint: a sensor and a drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.effects import Effect, ReversalPulses
from ident.effects.effect import Signals
from ident.effects.servo import CommandDelay
from ident.equations.problem import Problem
from ident.finding import Finding
from ident.information import linear
from ident.information.estimate import Estimate
from ident.mechanism.drives import with_common_delay
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, State
from ident.text import listed, percent

DIFFERS = 0.1  # level: share of the measured torque by which a drive's differs and is named
AT_BOUND = 1e-6  # numerics: [s] from the end of its search within which a delay is at it


def with_sensors_first(
    mechanism: Mechanism, motion: Motion
) -> tuple[Mechanism, tuple[Finding, ...]]:
    """Return the mechanism without the drives of joints whose torque all logs have, and a finding
    on each of them whose torque is another than the measured one.
    """
    measured = [
        name
        for name in mechanism.drives
        if motion.logs and all(f"tau.{name}" in log.columns for log in motion.logs)
    ]
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


def _compared(mechanism: Mechanism, drive: Effect, experiments: Sequence[State]) -> Finding | None:
    """Return a finding where a drive's best torque is not the measured one.

    Given values are kept; unknown ones are those that come nearest to the sensor.
    """
    name = drive.joints[0]
    j, column = mechanism.driven.index(name), f"tau.{name}"
    at = mechanism.joint_index[name]
    rows, rest = [], []
    free = [shape.name for shape in drive.shapes if shape.name not in drive.values]
    zero = {shape.name: 0.0 for shape in drive.shapes} | {**drive.values}
    for e in experiments:
        if not e.extra.keys() >= {*drive.reads()}:
            return None

        def torque(shape: dict[str, float], e: State = e) -> np.ndarray:
            s = Signals(
                e.t, e.y[:, [at]], e.yd[:, [at]], e.ydd[:, [at]], np.zeros(1), e.extra,
                shape, {},
            )  # fmt: skip
            return np.asarray(drive.correction(s).torque[name])[e.usable]

        known = torque(zero)
        # a drive's torque is linear in its gains but for its limit
        columns = [torque({**zero, key: zero[key] + 1.0}) - known for key in free]
        rows.append(np.stack(columns, axis=1) if free else np.zeros((len(known), 0)))
        rest.append(e.tau[e.usable, j] - known)
    A, b = np.concatenate(rows), np.concatenate(rest)
    tau = np.concatenate([e.tau[e.usable, j] for e in experiments])
    left = b - A @ linear.lstsq(A, b, rcond=1e-9)[0] if free else b
    size = float(np.sqrt(np.mean(tau**2)))
    share = float(np.sqrt(np.mean(left**2))) / size if size else 0.0
    if share < DIFFERS:
        return None
    return Finding(
        "two torques",
        f"{name}: the log has {column}, which is used, and {drive.label} would make another torque "
        f"from {', '.join(drive.reads())}: they differ by {percent(share)} rms",
        f"check the gains, limit and delay of the drive, or leave out the column {column}",
        (column,), share, DIFFERS,
    )  # fmt: skip


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
