"""Motions of logs whose noise is not white: errors of time stamps, knots chosen by the torques.

Stamps jitter and rows repeat: positions are then off by speed times one time error δ_i,

    r_ij = q_ij − s_j(t_i) = ṡ_j(t_i) δ_i + e_ij
    δ_i = Σ_j ṡ_j r_ij/σ_j² / (Σ_j ṡ_j²/σ_j² + 1/σ_t²)

of row i and joint j, s: the smooth motion. Whether there is such an error is shown by each joint's
r, as far as the δ of all other joints predicts it: noise of encoders is not predicted at all.

Encoders have steps and links vibrate, too: such noise is alike from sample to sample, and a
criterion for white noise takes it for motion; of a trapeze it misses the ramps. But the torques
know which accelerations are real: with rigid bodies, friction and offsets in every joint they are
predicted best by the right ones. Their error at full rate, in stretches of time left out of the
fit, is one currency for all knots.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ident.information.blocks import Part
from ident.information.hypotheses import PartialRegression
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import regressor
from ident.motion.closures import best_conditioned
from ident.motion.recipe import Band
from ident.motion.signals import SLOW, LogSignals, runs
from ident.motion.smoothing import MIN_INTERVALS, Derived, finest
from ident.motion.spline import EXCESS, basis_over, fitted
from ident.motion.state import State

STEPS = 5  # work: of the alternation between δ and the sizes of both noises
STRETCHES = 10  # work: of a log, lest one jump decides
PREDICTED = 0.2  # tuned: share of a joint's squared r that others predict, in half of all cases
ROUGH = 0.3  # tuned: of 2 δ² that its steps must be: what a spline misses of a corner is smooth


def without_time_errors(
    signals: LogSignals, derived: Derived, names: Sequence[str]
) -> tuple[LogSignals, float] | None:
    """The log without the time errors of the joints `names`, and their rms [s]; None for none."""
    smooth, log = derived.smooth, signals.log
    moving = [n for n in names if smooth is not None and n in smooth.names]
    t = np.asarray(log.t)
    if smooth is None or len(moving) < 2:
        return None
    r, v, a = np.zeros((3, len(t), len(moving)))
    for run, spline in smooth.runs:
        inside = (t >= signals.t[run][0]) & (t <= signals.t[run][-1])
        at = [smooth.names.index(name) for name in moving]
        q, v[inside], a[inside] = spline.at(t[inside])[:, :, at]
        logged = np.stack([log.columns[f"q.{name}"][inside] for name in moving], axis=1)
        r[inside] = np.nan_to_num(logged - q)
    error, shares = common(r, v)
    size = float(np.mean(error**2))
    if np.median(shares) < PREDICTED or np.mean(np.diff(error) ** 2) < ROUGH * 2 * size:
        return None
    columns, resampled = dict(log.columns), dict(signals.columns)
    for j, name in enumerate(moving):
        for column, rate in ((f"q.{name}", v), (f"v.{name}", a)):
            if column in resampled:
                columns[column] = columns[column] - rate[:, j] * error
                good = np.isfinite(columns[column])
                resampled[column] = np.interp(signals.t, t[good], columns[column][good])
    return replace(signals, log=replace(log, columns=columns), columns=resampled), float(
        np.sqrt(size)
    )


def common(r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """δ (n,) [s] of residuals r and speeds v (n, J), and by stretch of time and joint the share
    (STRETCHES, J) of its squared residual that the others' δ predicts.
    """
    v = np.where(np.abs(v) > SLOW * np.abs(v).max(axis=0), v, 0.0)
    noise, spread = (r**2).mean(axis=0) + 1e-300, np.inf
    for _ in range(STEPS):
        up, down = v * r / noise, v**2 / noise
        error = up.sum(axis=1) / (down.sum(axis=1) + 1 / spread + 1e-300)
        noise = ((r - v * error[:, None]) ** 2).mean(axis=0) + 1e-300
        spread = float(np.mean(error**2)) + 1e-300
    others = (up.sum(axis=1)[:, None] - up) / (down.sum(axis=1)[:, None] - down + 1 / spread)
    squares = [
        [(x[part] ** 2).sum(axis=0) for x in (r - v * others, r)]
        for part in np.array_split(np.arange(len(r)), STRETCHES)
    ]
    return error, np.array([1 - remaining / (all_ + 1e-300) for remaining, all_ in squares])


STEP = 2.0  # work: ratio of one spacing that is tried to the next
FINER, COARSER = 4, 3  # work: steps from the present spacing that are tried
BETTER_BY = 0.02  # tuned: share by which errors must fall for other knots than the present ones
ROWS = 250  # work: filtered rows of a coordinate, at least: a dozen in each of 20 blocks
OVERSAMPLING = 4.0  # level: filtered rows a period of the cut-off, as `equations.filter` keeps them
CLOSEST = 1.01  # numerics: times the closest knots: no further than rounding
FILTER = 7.3  # level: knots that the filter of `equations.filter` spans at the cut-off of knots
LOST = 2.0  # range: lengths of the filter that the usual run between gaps must last
SAMPLES = 1000  # work: of a log, at which torques are predicted
FOLDS = 10  # work: stretches of time that are left out in turn
TORQUE_ROUNDING = 1e-9  # numerics: of the largest torque
EQUATIONS = 12_000  # work: of all joints: with more than twelve fewer samples are taken


def doubtful(derived: Sequence[Derived], band: Band) -> bool:
    """Whether smoothing leaves more than white noise, or asks for the closest knots there are."""
    return any(
        motion.smooth is not None
        and (
            motion.smooth.spacing
            <= CLOSEST * max(finest(band, motion.smooth.channels), band.knots[0])
            or any(c.spacing and c.residual > EXCESS * c.noise for c in motion.table)
        )
        for motion in derived
    )


def by_torques(
    mechanism: Mechanism,
    logs: list[LogSignals],
    band: Band,
    derived: list[Derived],
    given: bool,
    informing: Sequence[Collection[str]],
) -> Band:
    """The band with the knots of the least error, if that is clearly less than with those of
    `derived`. A cut-off that is not given leaves rows enough, and is below what knots pass.
    """
    start = float(np.median([motion.smooth.spacing for motion in derived if motion.smooth]))
    closest = max(band.knots[0], 2 * max(motion.dt for motion in logs))
    lengths = [np.array([run.stop - run.start for run in runs(motion.usable)]) for motion in logs]
    usual = [
        np.median(np.repeat(n, n)) * motion.dt for n, motion in zip(lengths, logs, strict=True)
    ]
    coarsest = float(min(usual)) / (MIN_INTERVALS if given else LOST * FILTER)
    if given and band.cutoff:
        coarsest = min(coarsest, 0.5 / band.cutoff)
    both, names = [*zip(logs, derived, strict=True)], derived[0].names
    votes = _votes(mechanism, informing)
    if not votes.any():
        return band
    scenes = [_scene(mechanism, signals, motion) for signals, motion in both]

    def error(spacing: float) -> float:
        """Mean of the logarithms of all rms errors."""
        logarithms = []
        for (signals, motion), e in zip(both, scenes, strict=True):
            known, t = e.known(mechanism, names), signals.t
            if motion.smooth is not None:
                place = [names.index(name) for name in motion.smooth.names]
                for run, _ in motion.smooth.runs:
                    inside = [channel.within(t[run]) for channel in motion.smooth.channels]
                    basis = basis_over(t[run][0], t[run][-1], spacing)
                    spline = fitted(basis, inside, motion.smooth.names)
                    inside_run = (e.t >= t[run][0]) & (e.t <= t[run][-1])
                    known[np.ix_(range(3), inside_run, place)] = spline.at(e.t[inside_run])
            errors_of_joints = torque_errors(mechanism, e.at(mechanism, known, names))
            logarithms.append(np.log(errors_of_joints[votes]))
        return float(np.mean(logarithms))

    ladder = [start * STEP**k for k in range(-FINER, COARSER + 1)]
    errors = {h: error(h) for h in ladder if h == start or closest <= h <= coarsest}
    best = min(errors, key=lambda h: errors[h])
    if errors[best] > errors[start] - np.log1p(BETTER_BY):
        best = start
    knots = (best, best) if best != start else band.knots
    if given:
        return replace(band, knots=knots)
    duration = sum(float(np.ptp(motion.t)) for motion in logs)
    cutoff = max(band.cutoff or 0.0, ROWS / OVERSAMPLING / duration)
    cutoff = min(cutoff if band.cutoff else np.inf, 0.5 / best)
    fast = cutoff >= 0.25 / max(motion.dt for motion in logs)
    return replace(band, cutoff=band.cutoff if fast else cutoff, knots=knots)


def _votes(mechanism: Mechanism, informing: Sequence[Collection[str]]) -> np.ndarray:
    """(d,) coordinates of a tree whose torques are measurements in all logs; all of a loop."""
    votes = np.ones(mechanism.degrees_of_freedom, dtype=bool)
    if mechanism.closures:
        return votes
    for name in mechanism.measured:
        votes[mechanism.joint(name).index] = all(name in names for names in informing)
    return votes


def _scene(mechanism: Mechanism, signals: LogSignals, derived: Derived) -> State:
    names, at = derived.names, np.flatnonzero(signals.usable)
    most = min(SAMPLES, EQUATIONS // mechanism.model.nv)
    at = at[:: max(1, len(at) // most)]
    none = np.zeros(len(signals.t))  # of a torque that is not measured
    tau = [signals.columns.get(f"tau.{name}", none) for name in mechanism.driven]
    e = State(
        name=signals.log.name, t=signals.t, tau=np.stack(tau, axis=1), usable=signals.usable,
        logged=names, independent=names,
    ).at(mechanism, derived.known, names, start="follow").at_samples(at)  # fmt: skip
    return e.transmitted(mechanism, best_conditioned(mechanism, e.q))


def torque_errors(mechanism: Mechanism, e: State) -> np.ndarray:
    """Rms (d,) held out of the torques that bodies, friction and offsets predict."""
    gamma, lever = regressor(mechanism.model, e.q, e.v, e.a), e.leverage
    if e.loop is not None:
        gamma = e.pinv[:, :, -lever.shape[2] :].transpose(0, 2, 1) @ gamma
    spread = lever.transpose(0, 2, 1)
    dry = np.tanh(e.yd / (SLOW * np.abs(e.yd).max(axis=0) + 1e-300))
    parts = (gamma, spread * e.yd[:, None], spread * dry[:, None], spread)
    driven = [mechanism.joint_index[name] for name in mechanism.driven]
    b = np.einsum("njd,nj->nd", lever[:, driven], e.tau)
    count = sum(part.shape[2] for part in parts)
    edges = np.linspace(0, len(e), FOLDS + 1).astype(int)
    blocks = []
    for u, y in enumerate(b.T):
        if u in mechanism.unmeasured_rows:
            continue
        x = np.concatenate([part[:, u] for part in parts], axis=1)
        present = np.flatnonzero(x.any(axis=0))  # in a tree, the bodies that the coordinate carries
        blocks.append(Part(u, present, x[:, present], y[:, None], edges))
    largest = float(np.abs(b).max()) or 1.0
    sigma = np.full(b.shape[1], largest)  # a passive joint has no torque
    for _ in range(2):  # the second time with weights by the errors of the first
        regression = PartialRegression(tuple(blocks), np.arange(count), 1 / sigma)
        remaining = sigma * np.sqrt(regression.losses.sum(axis=0) / len(e))
        sigma = np.maximum(remaining, TORQUE_ROUNDING * largest)
    return sigma
