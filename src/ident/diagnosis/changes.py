"""What changes within a log: a cause that acts from some time on, and no sooner.

    b = A x + w(t − t₀) C θ       C: columns of any effect at any place; t₀: a boundary of blocks

All stretches have the model's parameters and what comes later θ besides, w = [t ≥ t₀]: a load that
is taken up, a friction that rises, channels that are exchanged. A constant torque and friction may
also grow from t₀ on, w = (t − t₀)₊, as of a sensor or a gear that warms; a torque may last for some
blocks, as a push does. All causes at all times are judged at once, by left-out errors held against
the most that any of them explains of random residuals, and must explain more than any effect that
acts all the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ident.diagnosis.candidates import SURROGATES, Contest, absorbed, possible
from ident.diagnosis.null import judging, null_shares
from ident.diagnosis.selection import MAIN_CAUSE, Ranking
from ident.finding import Finding
from ident.information.chance import CERTAIN, PARSIMONY, exceeding, paired
from ident.information.hypotheses import Array, Gains, PartialRegression

CODE = "changed within the log"
FEWEST_BLOCKS = 3  # work: of each stretch
TIMES = 8  # work: in each of two blocks, at which the change is sought in the end
COMPARED = 8  # work: causes whose times are sought
ROUNDING_OF_VALUES = 1e-9  # numerics: of the largest number of a change
SHOWN = 3  # shown: values of a change
LEAST_SHARE = 0.5  # range: of an exchange: 1, but for what a fit of both stretches takes of it
WARMING = ("coulomb", "viscous")  # kinds of friction that change with a machine's temperature
PUSHES = (1, 2, 4)  # work: blocks that a push lasts
Gate = Callable[[np.ndarray], np.ndarray]


def _on(since: np.ndarray) -> np.ndarray:
    """Return w of times (n,) since a change [s]: it lasts."""
    return (since >= 0).astype(float)


def _growing(since: np.ndarray) -> np.ndarray:
    """Return w of times (n,) since a change [s]: it grows."""
    return np.maximum(since, 0.0)


@dataclass(frozen=True, eq=False)
class Cause:
    """What may set in within a log, with its columns in the rows of each part."""

    words: str  # `coulomb:elbow`, or what happens to channels
    joints: tuple[str, ...]
    names: tuple[str, ...]  # of its numbers, with their units
    units: tuple[str, ...]
    columns: list[np.ndarray]  # by part (m, u)
    least: float = -np.inf  # of its number, below which it is no such cause
    gate: Gate = _on  # how much of it acts, by the time since the change
    lasts: float = np.inf  # for so long [s]
    remedy: str = ""  # what to do, if not to part the log

    def gated(self, since: list[np.ndarray]) -> list[np.ndarray]:
        """Return its columns by part (m, u) at times since the change, by part (m,)."""
        pairs = zip(self.columns, since, strict=True)
        return [columns * self.gate(t)[:, None] for columns, t in pairs]


@dataclass(frozen=True, eq=False)
class Change:
    """A cause that acts from a time on.

    Attributes:
        cause: an effect of the library or of the model, whose values differ from then on, or an
            exchange of channels.
        log: name of the log; time: in it [s].
        values, stderr: (u,) of its numbers, by how much they differ.
        gain: share of the left-out squares that it explains; p: chance of such a gain.
        coordinate: whose error it lowers most; loss: (blocks,) left-out squares there with it.
    """

    cause: Cause
    log: str
    time: float
    values: Array
    stderr: Array
    gain: float
    p: float
    coordinate: int
    loss: Array

    def finding(self) -> Finding:
        """Return it in words."""
        pairs = zip(self.cause.names, self.values, self.stderr, self.cause.units, strict=False)
        listed = list(pairs)
        least = ROUNDING_OF_VALUES * float(np.abs(self.values).max())  # no torque feels it
        large = [x for x in listed if abs(x[1]) > max(CERTAIN * x[2], least)][:SHOWN] or listed[:1]
        values = ", ".join(
            f"{name} {value:+.3g} ± {error:.1g} {unit}".removesuffix(" 1")
            for name, value, error, unit in large
        )
        begin, end = self.time, self.time + self.cause.lasts
        if end < np.inf:
            text = f"from t = {begin:.2f} to {end:.2f} s of {self.log}: {self.cause.words}"
            text, remedy = f"{text} ({values})", f"leave out {begin:.2f} to {end:.2f} s"
        else:
            text = f"from t = {begin:.2f} s of {self.log} on: {self.cause.words} ({values})"
            parted = f"split the log at {begin:.2f} s and identify its parts by themselves"
            remedy = self.cause.remedy or parted
        return Finding(CODE, text, remedy, (self.log, *self.cause.joints), self.gain)


def change_within(first: Ranking) -> Change | None:
    """Return what changes within a log of a fit, of which all effects are ranked; None if nothing
    does, or an effect that acts all the time explains it as well.
    """
    contest, boundaries = first.contest, [*_boundaries(first.contest)]
    causes = [*_effects(contest), *_exchanges(contest)]
    causes += [course for cause in causes for course in _courses(contest, cause)]
    if not (boundaries and causes):
        return None
    if contest.regression.residual[0].shape[1] <= 1:
        contest = judging(contest)
    # all causes from all times
    where = [(cause, number, time) for cause in causes for number, time in boundaries]
    times = [_since(contest, number, time) for number, time in boundaries]
    by_cause = [cause.gated(since) for cause in causes for since in times]
    gated = [np.concatenate(columns, axis=1) for columns in zip(*by_cause, strict=True)]
    regression, new = contest.regression.added(gated)
    widths = [len(cause.names) for cause in causes for _ in times]
    groups = np.split(new, np.cumsum(widths)[:-1])
    measured = regression.gains(groups)
    gains = regression.explained(measured.by)
    best = int(gains.argmax())
    share = float(regression.explained_by_coordinate(measured.by[best]).max())
    if share < MAIN_CAUSE:
        return None
    p = _chance(float(gains[best]), regression, measured)
    if not p < contest.decision.alpha:
        # a spectrum that holds the change itself makes much of it: that of what it leaves
        rest = judging(contest.with_model(regression.extended(groups[best]).bare)).regression
        p = _chance(float(gains[best]), rest, rest.gains(groups))
    if not p < contest.decision.alpha:
        return None
    # the times of the best ones, and the simplest of those that do as well
    timed = dict[int, Change]()
    for i in np.argsort(-gains).tolist():
        cause, number, time = where[i]
        if id(cause) not in timed and len(timed) < COMPARED:
            timed[id(cause)] = _with_time(contest, cause, number, time, boundaries, p)
    timed = {
        i: change for i, change in timed.items() if (change.values >= change.cause.least).all()
    }
    if not timed:
        return None
    least_left = 1 - max(change.gain for change in timed.values())
    most_left = (1 + PARSIMONY) * least_left
    equal = [change for change in timed.values() if 1 - change.gain <= most_left]
    change = min(equal, key=lambda change: (len(change.cause.names), -change.gain))
    always = [e.refit.loss[:, change.coordinate] for e in first.evidence]
    least = min(always, key=lambda loss: float(loss.sum()), default=None)
    if least is not None and (
        change.loss.sum() > MAIN_CAUSE * least.sum()
        or paired(least, change.loss) < contest.decision.rival_se
    ):
        return None
    return change


def _chance(gain: float, regression: PartialRegression, measured: Gains) -> float:
    """Return the chance that some cause explains more than a gain of random residuals."""
    null = null_shares(regression, measured).max(axis=0)
    return max(exceeding(gain, x) for x in (null[:SURROGATES], null[SURROGATES:]) if len(x))


def _effects(contest: Contest) -> Iterator[Cause]:
    """Yield effects that may set in: candidates, those of the model, and loads of unknown links."""
    fit, labels = contest.fit, set[str]()
    absorbed_loads = (e for e in possible(fit.mechanism, fit.motion) if absorbed(fit.mechanism, e))
    laws = (law.effect for law in contest.laws)
    for effect in (*laws, *fit.mechanism.effects, *absorbed_loads):
        grows = effect.kind == "ripple" or effect.memory or effect.corrects
        if effect.label in labels or not effect.unknowns or grows:
            continue
        labels.add(effect.label)
        bare = replace(effect, values={})
        shape = contest.table.starts(bare)[0] if bare.shapes else {}
        names = tuple(parameter.name for parameter in bare.unknowns)
        columns = contest.columns(bare, shape)
        yield Cause(bare.label, bare.joints, names, bare.units[: len(names)], columns)


def _exchanges(contest: Contest) -> Iterator[Cause]:
    """Yield exchanges of two torque channels of a tree: τ_i − τ_j in row i, τ_j − τ_i in row j."""
    table = contest.table
    if table.mechanism.closures:
        return
    driven = [*enumerate(table.motion.independent)]
    driven = [(u, name) for u, name in driven if name in table.mechanism.driven]
    for (i, one), (j, other) in combinations(driven, 2):
        columns, difference = [], table.tau[:, i] - table.tau[:, j]
        for part in contest.regression.parts:
            u = part.coordinate
            sign = {i: 1.0, j: -1.0}.get(u, 0.0)
            columns.append(sign * difference[contest.use[:, u], None])
        words = f"the torques of {one} and {other} are exchanged"
        yield Cause(words, (one, other), ("share",), ("1",), columns, least=LEAST_SHARE)


def _boundaries(contest: Contest) -> Iterator[tuple[int, float]]:
    """Yield experiments and times [s] between their blocks, a few from either end."""
    table = contest.table
    for number in range(len(table.scenes)):
        rows = table.experiment == number
        blocks, t = table.blocks[rows], table.t[rows]
        numbers = np.unique(blocks)
        for block in numbers[FEWEST_BLOCKS : 1 - FEWEST_BLOCKS]:
            yield number, float(t[np.argmax(blocks >= block)])


def _courses(contest: Contest, cause: Cause) -> Iterator[Cause]:
    """Yield what a cause does that does not set in at once: friction that changes as a machine
    warms, a constant torque that grows, as that of a sensor that warms, or lasts for a while.
    """
    kind, _, place = cause.words.partition(":")
    if kind not in ("torque_offset", *WARMING):
        return
    words = f"tau.{place} drifts" if kind == "torque_offset" else f"{cause.words} changes steadily"
    units = tuple(f"{unit}/s" for unit in cause.units)
    names = ("rate",) if kind == "torque_offset" else tuple(f"{n} rate" for n in cause.names)
    warm = f"warm {place} up before the log, or log temperature.{place} for temperature_friction"
    remedy = warm * (kind != "torque_offset")
    yield replace(cause, words=words, names=names, units=units, gate=_growing, remedy=remedy)
    if kind != "torque_offset":
        return
    table = contest.table
    block = float(np.median(np.diff([t for _, t in _boundaries(contest)]) if table.t.size else 0.0))
    for count in PUSHES:
        lasts = count * block

        def pushed(since: np.ndarray, lasts: float = lasts) -> np.ndarray:
            return ((since >= 0) & (since < lasts)).astype(float)

        yield replace(
            cause, words=f"a push on {place}", names=("torque",), gate=pushed, lasts=lasts
        )


def _since(contest: Contest, number: int, time: float) -> list[np.ndarray]:
    """Return by part the rows' times since a time of an experiment [s], −∞ of other ones."""
    table = contest.table
    since = np.where(table.experiment == number, table.t - time, -np.inf)
    return [since[contest.use[:, part.coordinate]] for part in contest.regression.parts]


def _with_time(
    contest: Contest, cause: Cause, number: int, time: float,
    boundaries: list[tuple[int, float]], p: float,
) -> Change:  # fmt: skip
    """Return the change with the time near a boundary that leaves least."""
    times = [t for n, t in boundaries if n == number]
    step = float(np.diff(times).mean()) if len(times) > 1 else 0.0
    bare: PartialRegression = contest.regression.bare
    trials = []
    for t in time + step * np.linspace(-1, 1, 2 * TIMES + 1):
        refit = bare.refit_with(cause.gated(_since(contest, number, float(t))))
        trials.append((float(refit.loss.sum()), float(t), refit))
    loss, t, refit = min(trials, key=lambda trial: trial[0])
    noise, u = np.sqrt(loss / max(float(bare.rows.sum()), 1.0)), int(refit.by.argmax())
    log = contest.table.scenes[number].e.name
    stderr = noise * refit.stderr
    return Change(cause, log, t, refit.theta, stderr, bare.gain(refit), p, u, refit.loss[:, u])
