"""One log's experiment: motion, torques, wrenches, and what was done to its channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.channels import Smoothed, channels_of
from ident.motion.clock import runs
from ident.motion.decided import Decided
from ident.motion.derive import AS_LOGGED, derive, smoothed
from ident.motion.fuse import along, fused, missed, reweighted, through_motion
from ident.motion.independent import best_conditioned
from ident.motion.measure import Signals
from ident.motion.motion import Band, Experiment
from ident.motion.place import disagreements, in_tree, through_closures
from ident.motion.spectrum import noise_level
from ident.motion.wrench import wrenches

ROUNDING = 1e-6  # of a sampling step, within which two times are the same
TWICE = 2.0  # times a channel's noise: what smoothing leaves beyond that is no noise


def experiment_of(
    mechanism: Mechanism,
    signals: Signals,
    names: tuple[str, ...],
    band: Band,
    smoothing: float | str | None,
    decided: Decided | None = None,
) -> tuple[Experiment, list[str]]:
    """The experiment of a log, and what a person should know of how it was had.

    Args:
        mechanism: the mechanism; signals: the log.
        names: joints from which the motion follows.
        band: what the spectra say.
        smoothing: spacing of the knots [s], "auto" or None.
        decided: of a part of a log: what the whole log has decided.
    """
    n, log = len(signals.t), signals.log.name
    derived = derive(signals, names, band, smoothing, decided)
    tau = np.zeros((n, len(mechanism.driven)))
    for i, name in enumerate(mechanism.driven):
        tau[:, i] = signals.columns.get(f"tau.{name}", 0.0)
    base = Experiment(
        name=log, t=signals.t, q=np.empty(0), v=np.empty(0), a=np.empty(0), y=np.empty(0),
        yd=np.empty(0), ydd=np.empty(0), tau=tau, wrench=None, pinv=None, leverage=None,
        usable=_without_ends(signals, derived.ends), still=np.empty(0), logged=names,
        independent=names,
        extra={k: x for k, x in signals.columns.items() if not k.startswith(("q.", "v.", "a."))},
        noise=_noise(mechanism, signals, names), smooth=derived.smooth,
        channels=tuple(derived.table),
    )  # fmt: skip
    notes: list[str] = []
    place = through_closures if mechanism.closures else in_tree
    experiment = place(mechanism, base, names, derived.known)
    if len(names) > mechanism.degrees_of_freedom:
        if decided is None:  # a part may hardly move, and then disagree by noise alone
            notes = disagreements(mechanism, experiment, names, derived.known[0])
        if derived.smooth is not None:
            experiment = _together(mechanism, signals, experiment, band, decided)
    said: dict[str, list[str]] = {}
    for channel in experiment.channels:
        if channel.how != AS_LOGGED:
            said.setdefault(channel.how, []).append(channel.column)
    notes = [f"{log}: {', '.join(same)}: {how}" for how, same in said.items()] + notes
    why = "the knots are too far apart (--smoothing)"
    if len(experiment.channels) > 1:
        why = f"it contradicts other channels, or {why}"
    notes += [
        f"{log}: smoothing leaves {c.residual / c.noise:.3g} times the noise of {c.column}: {why}"
        for c in experiment.channels
        if c.spacing and c.residual > TWICE * c.noise
    ]
    if (lost := int((signals.usable & ~base.usable).sum())) > 0:
        notes.append(
            f"{log}: {lost} samples within {1e3 * derived.ends:.3g} ms of where splines end are "
            "left out"
        )
    wrench = wrenches(mechanism, log, signals.columns, experiment.q)
    return replace(experiment, wrench=wrench), notes


def _together(
    mechanism: Mechanism,
    signals: Signals,
    e: Experiment,
    band: Band,
    decided: Decided | None,
) -> Experiment:
    """More joints logged than needed, with noise: one smooth motion made by all their channels.

    Its knots are those that the channels of single joints asked for.
    """
    assert e.smooth is not None
    names = best_conditioned(mechanism, e.q) if decided is None else decided.carriers
    channels = channels_of(signals, e.logged)
    through = through_motion(mechanism, e, names)
    own = decided and replace(decided, noise={})
    e = along(mechanism, e, smoothed(signals, through, names, band, e.smooth.spacing, own)[0])
    white = [channel.sigma for channel in channels]
    if decided is not None:
        channels = [channel.with_noise(decided.noise[channel.column]) for channel in channels]
    else:
        e = along(mechanism, e, fused(mechanism, e, channels))
        channels = reweighted(mechanism, e, channels)
    smooth = fused(mechanism, e, channels)
    e = along(mechanism, e, smooth)
    how = f"spline in {', '.join(names)}, knots {1e3 * smooth.spacing:.3g} ms"
    table = [
        Smoothed(c.column, how, sigma, float(np.sqrt(np.mean(off**2))), smooth.spacing)
        for c, sigma, off in zip(channels, white, missed(mechanism, e, channels), strict=True)
    ]
    return replace(e, channels=tuple(table))


def _noise(mechanism: Mechanism, signals: Signals, names: tuple[str, ...]) -> dict[str, float]:
    wanted = [f"{channel}.{name}" for name in names for channel in "qva"]
    wanted += [f"tau.{name}" for name in mechanism.driven]
    return {name: noise_level(signals.even(name)[0]) for name in wanted if name in signals.columns}


def _without_ends(signals: Signals, ends: float) -> np.ndarray:
    """Usable samples (n,) that are `ends` [s] away from both ends of their run, if any are."""
    usable, rounding = signals.usable.copy(), ROUNDING * signals.dt
    for run in runs(signals.usable):
        t = signals.t[run]
        usable[run] = (t >= t[0] + ends - rounding) & (t <= t[-1] - ends + rounding)
    return usable if usable.any() else signals.usable
