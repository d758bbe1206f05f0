"""What a mechanism is made of, and which of its parameters a motion can identify."""

from __future__ import annotations

import numpy as np

from ident.equations.columns import Columns
from ident.errors import MotionError
from ident.fit.accumulate import accumulate, coordinates
from ident.fit.estimate import estimate, totals
from ident.fit.naming import absorbed_by, base_names
from ident.fit.settle import initial
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.motion.close import Closer
from ident.motion.independent import best_conditioned, independent_joints
from ident.text import table


def describe(mechanism: Mechanism, motion: Motion | None = None) -> str:
    """Joints with limits, where they stand when assembled, and how far a motion takes them."""
    rows = [["joint", "", "lower", "upper", "assembled", "unit"]]
    if motion is not None:
        rows[0][-1:-1] = ["from", "to", "top speed"]
    names = tuple(joint.name for joint in mechanism.joints)
    here = Closer(mechanism, names).coordinates(mechanism.assembled[None]).value[0]
    for i, joint in enumerate(mechanism.joints):
        state = "driven" if joint.name in mechanism.driven else "passive"
        if joint.name.startswith("closure."):
            state = "of a closure"
        row = [joint.name, state, f"{joint.lower:.4g}", f"{joint.upper:.4g}", f"{here[i]:.4g}"]
        if motion is not None:
            y = np.concatenate([e.y[:, i] for e in motion.experiments])
            speed = np.concatenate([e.yd[:, i] for e in motion.experiments])
            row += [f"{y.min():.4g}", f"{y.max():.4g}", f"{np.abs(speed).max():.3g}/s"]
        rows.append([*row, joint.unit])
    return "\n".join([str(mechanism), *table(rows)])


def channels(mechanism: Mechanism, motion: Motion) -> str:
    """What became of every measured channel of the motion.

    Its estimated white noise, and the rms of measured less smoothed: equal
    where the channels agree with each other, the closures and the resolution of the splines.
    """
    units = ("{}", "{}/s", "{}/s²")
    rows = [["channel", "noise", "residual", "unit", "", "log"]]
    for e in motion.experiments:
        for channel in e.channels:
            letter, joint = channel.column.split(".", 1)
            unit = units["qva".index(letter)].format(mechanism.joint(joint).unit)
            left = f"{channel.residual:.3g}" if channel.spacing else "–"
            rows.append([channel.column, f"{channel.noise:.3g}", left, unit, channel.how, e.name])
    title = "what was measured of the motion: its white noise, and measured less smoothed (rms)"
    return "\n".join([title, *table(rows)])


def excitation(mechanism: Mechanism) -> Motion:
    """A made-up motion around the start in which every degree of freedom moves.

    For a structural answer only: sines of unrelated frequencies, smaller where loops are tight.
    """
    ways = [
        best_conditioned(mechanism, mechanism.assembled[None]),
        independent_joints(mechanism, [*mechanism.driven, *mechanism.joint_index]),
        independent_joints(mechanism, [*reversed(mechanism.driven), *mechanism.joint_index]),
    ]
    why: MotionError | None = None
    for names in dict.fromkeys(ways):
        for amplitude in (0.8, 0.3, 0.1, 0.03, 0.003):
            try:
                log = _sines(mechanism, names, amplitude)
                return complete(mechanism, log, cutoff=None, torques=False)
            except MotionError as error:
                why = error
    raise MotionError(
        f"{mechanism.name}: no motion made up around [joints] start can be followed ({why}); "
        "give a start farther from a singular position, or a log"
    )


def _sines(mechanism: Mechanism, names: tuple[str, ...], amplitude: float) -> Log:
    """A log of these joints moving by about the amplitude [rad | m] around the start."""
    t = np.linspace(0.0, 10.0, 801)
    rng = np.random.default_rng(1)
    frequency = rng.uniform(0.5, 1.5, (len(names), 3))
    phase = rng.uniform(0, 2 * np.pi, (len(names), 3))
    start = Closer(mechanism, names).coordinates(mechanism.assembled[None]).value[0]
    columns = {}
    for i, name in enumerate(names):
        w = 2 * np.pi * frequency[i][:, None]
        angle = w * t + phase[i][:, None]
        offset = np.sin(phase[i][:, None])
        columns[f"q.{name}"] = start[i] + amplitude / 3 * (np.sin(angle) - offset).sum(axis=0)
        columns[f"v.{name}"] = amplitude / 3 * (w * np.cos(angle)).sum(axis=0)
        columns[f"a.{name}"] = amplitude / 3 * (-(w**2) * np.sin(angle)).sum(axis=0)
    return Log.from_arrays("a made-up motion", t, columns)


def structure(mechanism: Mechanism, motion: Motion | None = None) -> str:
    """Which base parameters a motion identifies, or could at best if none is given."""
    columns = Columns.of(mechanism)
    if not len(columns):
        return "nothing is unknown"
    what = "this motion identifies"
    if motion is None:
        motion, what = excitation(mechanism), "a motion can identify"
    d = coordinates(mechanism, motion)
    cells = accumulate(mechanism, columns, motion, None, initial(mechanism, motion))
    found = estimate(totals(cells, len(columns), d), columns.prior, np.ones(d), sigma=np.ones(d))
    lines = [
        f"{what} {found.base.rank} base parameters of {len(columns)} unknowns "
        f"(condition number {found.base.condition_number:.3g}):"
    ]
    lines += [f"  {name}" for name in base_names(columns, found.base)]
    nothing = [name for name, carrier in absorbed_by(columns, found.base).items() if not carrier]
    if nothing:
        lines.append(f"no torque feels: {', '.join(nothing)}")
    return "\n".join(lines)
