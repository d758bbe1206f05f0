"""Logs of machines whose sensors and drawings are off, by errors drawn from their priors.

The log is made by the true machine and then read by sensors that are wrong: nothing of it is
linear, and none of the columns with which a fit describes these errors is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

import ident
from ident import Fit, Log, Mechanism
from ident.mechanism.causes import Cause, causes_of
from identification import plant

ENDS = 10  # samples at either end, where late channels are not known


@dataclass(frozen=True, eq=False)
class Misread:
    """A log, the machine as its user knows it, and what is true.

    Attributes:
        errors: of each cause by name, in its prior scale; values: of all parameters, by name.
    """

    mechanism: Mechanism
    log: Log
    errors: Mapping[str, float]
    values: Mapping[str, float]

    def fit(self, **options) -> Fit:
        """Of the log."""
        return ident.identify(self.mechanism, ident.complete(self.mechanism, self.log, **options))

    def without_rates(self) -> Misread:
        """The same log without logged velocities and accelerations."""
        columns = {n: x for n, x in self.log.columns.items() if not n.startswith(("v.", "a."))}
        return replace(self, log=Log.from_arrays(self.log.name, self.log.t, columns))

    def base(self, fit: Fit) -> np.ndarray:
        """(n,) true base parameters."""
        x = np.array([self.values.get(name, 0.0) for name in fit.columns.names])
        base = fit.estimate.base
        return x[base.independent] + base.K @ x[base.dependent]

    def off(self, fit: Fit) -> np.ndarray:
        """(n,) base parameters less their true values, in standard errors."""
        found = np.array([value.value for value in fit.base_parameters])
        stderr = np.array([value.stderr for value in fit.base_parameters])
        return (found - self.base(fit)) / stderr

    def plain(self, fit: Fit) -> np.ndarray:
        """(n,) least squares less the true values, in standard errors of the residual's scatter."""
        found = np.array([value.as_logged for value in fit.base_parameters])
        return np.asarray((found - self.base(fit)) / np.sqrt(np.diag(fit.scatter)))


def misread(
    mechanism: Mechanism,
    motion: Log,
    seed: int,
    *,
    size: Callable[[Cause, np.random.Generator], float] = lambda cause, random: random.normal(),
    noise: float = 0.01,
    spread: float = 0.3,
) -> Misread:
    """A log of a machine with errors of its calibration.

    Args:
        mechanism: as its user knows it, with its priors.
        motion: q, v, a of the driven joints, as they truly move.
        seed: of parameters, errors and noise.
        size: error of a cause in its prior scale.
        noise: of the torques, white, as a share of their rms.
        spread: of the dynamic parameters, as a share.
    """
    random = np.random.default_rng(seed)
    logged = tuple(name[2:] for name in motion.columns if name.startswith("q."))
    rate = (len(motion.t) - 1) / float(motion.t[-1] - motion.t[0])
    errors, true, by_place = {}, mechanism, {}
    for cause in causes_of(mechanism, logged, rate):
        errors[cause.name] = size(cause, random)
        by_place[cause.kind, cause.place] = errors[cause.name] * cause.scale
        if cause.kind == "length":
            true = true.displaced(cause.place, by_place[cause.kind, cause.place])
    case = plant(true, motion, spread=spread, seed=seed)
    t, inside = case.log.t, slice(ENDS, -ENDS)
    clock = 1 + by_place.get(("clock", ""), 0.0)

    def read(x: np.ndarray, late: float) -> np.ndarray:
        return np.asarray(CubicSpline(t, x)(t - late))

    def torque(name: str, late: float) -> np.ndarray:
        """Of the machine as it was before: friction that steps is none between two samples."""
        channel = f"tau.{name}"
        if not late:
            return case.log.columns[channel]
        before = Log.from_arrays("before", t, {n: read(x, late) for n, x in motion.columns.items()})
        return ident.simulate(true, before, values=case.values)[0].columns[channel]

    columns = {}
    for name in logged:
        late = by_place.get(("lateness", f"q.{name}"), 0.0)
        for order, kind in enumerate("qva"):
            x = read(case.log.columns[f"{kind}.{name}"], late) * clock**order
            zero = by_place.get(("q", f"q.{name}"), 0.0) if kind == "q" else 0.0
            columns[f"{kind}.{name}"] = (x - zero)[inside]
    for name in mechanism.driven:
        x = torque(name, by_place.get(("lateness", f"tau.{name}"), 0.0))
        x = x * (1 + by_place.get(("tau", f"tau.{name}"), 0.0))
        x = x + noise * np.sqrt(np.mean(x**2)) * random.normal(size=len(x))
        columns[f"tau.{name}"] = x[inside]
    return Misread(mechanism, Log.from_arrays("run.csv", t[inside], columns), errors, case.values)
