"""Logs with planted parameters, and what a fit must find in them; by the project's own simulation.

`simulate` itself is held against Pinocchio and MuJoCo in tests/truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import ident
from helpers import ROBOTS, series
from ident import Fit, Log, Mechanism, Noise


def robot(name: str) -> Mechanism:
    """A robot of robots/ that something drives, with free multipliers and exact sensors."""
    mechanism = ident.load(ROBOTS / name).with_calibration("exact")
    if name == "pendulum":  # nothing drives it; here its angle is driven
        mechanism = replace(mechanism, driven=("theta",), passive=("x", "y"))
    return replace(mechanism, multipliers=ident.Multipliers("free"))


def motion_log(name: str, rate: float = 200.0, seconds: float = 4.0, period: float = 4.0) -> Log:
    """q, v, a of a robot's driven joints, analytic."""
    t, q, v, a = series(name, rate, seconds, period)
    columns = {f"{c}.{joint}": x[joint] for c, x in (("q", q), ("v", v), ("a", a)) for joint in q}
    return Log.from_arrays(f"{name}.csv", t, columns)


@dataclass(frozen=True, eq=False)
class Planted:
    """A mechanism, a log of it, and the values behind the log.

    Attributes:
        values: of all dynamic parameters and all effects' parameters, by name.
    """

    mechanism: Mechanism
    log: Log
    values: Mapping[str, float]

    def fit(self, *, cutoff: float | str | None = None, mechanism: Mechanism | None = None) -> Fit:
        """Of the log, unfiltered unless said otherwise."""
        mechanism = mechanism or self.mechanism
        return ident.identify(mechanism, ident.complete(mechanism, self.log, cutoff=cutoff))

    def base(self, fit: Fit) -> np.ndarray:
        """True values of a fit's base parameters."""
        x = np.array([self.values.get(name, 0.0) for name in fit.columns.names])
        base = fit.estimate.base
        return x[base.independent] + base.K @ x[base.dependent]


def plant(
    mechanism: Mechanism,
    motion: Log,
    effects: Mapping[str, float] | None = None,
    *,
    spread: float = 0.3,
    offset: float = 0.01,
    noise: Sequence[Noise] = (),
    seed: int = 0,
) -> Planted:
    """A log of the mechanism whose unknown parameters are off the URDF's by up to `spread`.

    Args:
        mechanism: with its effects.
        motion: what moves.
        effects: values of effects' parameters by full name; those left out are drawn in 0.1 … 0.3.
        spread: of the dynamic parameters that are unknown, as a share.
        offset: of the dynamic parameters that are unknown, in their units, times `spread`.
        noise: on the log.
        seed: of parameters and noise.
    """
    random = np.random.default_rng(seed)
    values = dict(zip(mechanism.bodies.names, mechanism.prior, strict=True))
    for name in mechanism.unknown:
        values[name] *= 1 + spread * random.uniform(-1, 1)
        values[name] += offset * spread * random.uniform(-1, 1)
    for effect in mechanism.effects:
        for name, parameter in zip(effect.names, effect.parameters, strict=True):
            known = effect.values.get(parameter.name, random.uniform(0.1, 0.3))
            values[name] = (effects or {}).get(name, known)
    log, _ = ident.simulate(mechanism, motion, values=values, noise=noise, seed=seed)
    return Planted(mechanism, log, values)


def close(found: np.ndarray, true: np.ndarray, tolerance: float) -> bool:
    """Whether found and true differ by less than `tolerance` of the largest true value."""
    return bool(np.abs(found - true).max() <= tolerance * np.abs(true).max())
