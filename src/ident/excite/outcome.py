"""What a course is as a log, and what a log of it would tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.excite.criterion import Separation, apart
from ident.excite.draw import grown
from ident.excite.excitation import Excitation, Expected, Use
from ident.excite.prepare import Ready
from ident.excite.rivals import places_of, with_rivals
from ident.excite.stage import Seen, Stage, stilled
from ident.fit.estimate import TOLERANCE
from ident.fit.naming import base_names
from ident.fit.settle import initial
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.solve.factor import Factor
from ident.solve.rank import Base, reveal, solve


@dataclass(frozen=True, eq=False)
class Told:
    """What the rows of a motion determine.

    Attributes:
        W: (N, k) all rows, divided by the noise; base: the independent columns.
        C: covariance of the base parameters; log_det: of its inverse.
    """

    W: np.ndarray
    base: Base
    C: np.ndarray
    log_det: float

    @classmethod
    def of(cls, seen: Seen, sigma: np.ndarray) -> Told:
        """From the rows of a motion and the noise (d,) of the torques."""
        W = (seen.rows / sigma[:, None]).reshape(-1, seen.A.shape[2])
        factor = Factor.of(W, np.zeros(len(W)))
        base = reveal(factor, TOLERANCE)
        R = factor.restricted(base.independent).R
        log_det = 2 * float(np.log(np.abs(R.diagonal())).sum())
        return cls(W, base, solve(factor, base).C, log_det)

    @property
    def stderr(self) -> np.ndarray:
        """Of the base parameters (r,)."""
        return np.sqrt(self.C.diagonal())


def outcome(
    ready: Ready,
    x: np.ndarray,
    duration: float,
    periods: int,
    rate: float,
    separate: tuple[str, str] | None,
    seed: int,
) -> Excitation:
    """The excitation of a course x (d, P)."""
    track, mechanism = ready.track, ready.track.stage.mechanism
    names = track.rest.independent
    t = np.arange(round(duration * rate) + 1) / rate
    whole = grown(track.at(t, ready.exact.open), x)
    assert whole is not None  # it is known to close
    e = stilled(whole[1].e)
    seen = track.stage.seen(e)
    told = Told.of(seen, ready.scale.sigma)
    z = ready.exact.quantities(seen.e)
    return Excitation(
        name=mechanism.name,
        log=_log(mechanism, seen),
        period=duration / periods,
        periods=periods,
        harmonics=track.fourier.harmonics,
        series=dict(zip(names, track.fourier.coefficients(x), strict=True)),
        uses=_uses(ready, z),
        home=0.0 if e.pinv is None else float(z[:, -1].max()) / ready.size,
        unknowns=len(track.stage.columns),
        base=_expected(track.stage, told),
        condition_number=told.base.condition_number,
        log_det=told.log_det,
        noise=ready.sigma,
        separation=None if separate is None else _separation(track.stage, told, separate),
        seed=seed,
        notes=ready.kept.notes,
    )


def separation(
    mechanism: Mechanism, pair: tuple[str, str], motion: Motion, noise: float = 1.0
) -> Separation:
    """How well a motion tells two effects apart, whatever moves.

    Args:
        mechanism: the model; the effects are added where it lacks them.
        pair: labels of the two.
        motion: completed; of several experiments the first.
        noise: of all torques [N m | N], for the standard errors.

    Raises:
        MechanismError: for what is no pair of effects of this mechanism.
    """
    model = with_rivals(mechanism, pair)
    e = motion.experiments[0]
    stage = Stage(model, Columns.of(model), initial(model, motion))
    seen = stage.seen(e)
    return _separation(stage, Told.of(seen, np.full(seen.A.shape[1], noise)), pair)


def _log(mechanism: Mechanism, seen: Seen) -> Log:
    e, columns = seen.e, {}
    for channel, series in (("q", e.y), ("v", e.yd), ("a", e.ydd)):
        for name in mechanism.driven:
            columns[f"{channel}.{name}"] = series[:, mechanism.joint_index[name]]
    for i, name in enumerate(mechanism.driven):
        columns[f"tau.{name}"] = e.tau[:, i]
    return Log.from_arrays(f"{mechanism.name} excited", e.t, columns)


def _uses(ready: Ready, z: np.ndarray) -> tuple[Use, ...]:
    box = ready.exact
    low, high, share = z.min(axis=0), z.max(axis=0), box.used(z)
    return tuple(
        Use(
            side.joint, side.kind, float(low[i]), float(high[i]), float(box.low[i]),
            float(box.high[i]), side.unit, float(share[i]),
        )
        for i, side in enumerate(box.sides)
    )  # fmt: skip


def _expected(stage: Stage, told: Told) -> tuple[Expected, ...]:
    columns, base = stage.columns, told.base
    x = columns.prior_at(stage.point.values)
    prior = x[base.independent] + base.K @ x[base.dependent]
    units = [columns.units[i] for i in base.independent]
    named = zip(base_names(columns, base), prior, told.stderr, units, strict=True)
    return tuple(Expected(name, float(p), float(s), unit) for name, p, s, unit in named)


def _separation(stage: Stage, told: Told, pair: tuple[str, str]) -> Separation:
    columns, keep = stage.columns, list(told.base.independent)
    a, b = (places_of(columns, label) for label in pair)
    cosine, share = apart(told.W, a, b)
    errors = [
        float(told.stderr[keep.index(own[0])]) if own[0] in keep else np.inf for own in (a, b)
    ]
    return Separation(
        *pair, cosine, share, (errors[0], errors[1]), (columns.units[a[0]], columns.units[b[0]])
    )
