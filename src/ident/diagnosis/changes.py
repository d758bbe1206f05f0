"""What changes within a log: a cause that acts from some time on, and no sooner.

    b = A x + w(t − t₀) C θ       C: columns of any effect at any place; t₀: a boundary of blocks

All stretches have the model's parameters and what comes later θ besides, w = [t ≥ t₀]: a load that
is taken up, a friction that rises, channels that are exchanged. A constant torque and friction may
also grow from t₀ on, the log's beginning as well, w = (t − t₀)₊, as of a sensor or a gear that
warms, together with the friction of other places that does so; a torque may last for some
blocks, as a push does. All causes at all times are judged at once, by left-out errors held against
the most that any of them explains of random residuals, and must explain more than any effect that
acts all the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from ident.diagnosis.candidates import Contest, absorbed, possible
from ident.diagnosis.null import judging, null_shares
from ident.diagnosis.selection import Ranking
from ident.finding import Finding
from ident.fit import Fit
from ident.fit.calibration_rows import ReducedRows
from ident.information.cause import Cause
from ident.information.evidence import (
    CERTAIN,
    MAIN_CAUSE,
    PARSIMONY,
    SURROGATES,
    credible,
    exceeding,
    paired,
    surprise,
)
from ident.information.hypotheses import Array, Index, PartialRegression, Refit
from ident.text import listed

CODE = "changed within the log"
FEWEST_BLOCKS = 3  # work: of each stretch
AT_ONCE = 100  # work: causes whose gains are found together
TIMES = 8  # work: in each of two blocks, at which the change is sought in the end
COMPARED = 8  # work: causes whose times are sought
ROUNDING_OF_VALUES = 1e-9  # numerics: of the largest number of a change
SHOWN = 3  # shown: values of a change
LEAST_SHARE = 0.5  # range: of an exchange: 1, but for what a fit of both stretches takes of it
WARMING = ("coulomb", "viscous")  # kinds of friction that change with a machine's temperature
PUSHES = (1.0, 1.5, 2.0, 3.0, 4.0)  # work: blocks that a push lasts
BLURRED = 0.5  # work: of what a change explains at its own time, at the nearest one that is tried
BEGINS = 2  # work: of pushes in a block: one that is covered badly predicts no block left out
Gate = Callable[[np.ndarray], np.ndarray]


def _on(since: np.ndarray) -> np.ndarray:
    """Return w of times (n,) since a change [s]: it lasts."""
    return (since >= 0).astype(float)


def _growing(since: np.ndarray) -> np.ndarray:
    """Return w of times (n,) since a change [s]: it grows."""
    return np.maximum(since, 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Course(Cause):
    """What may set in within a log, with its columns in the rows of each part."""

    words: str  # `coulomb:elbow`, or what happens to channels
    names: tuple[str, ...]  # of its numbers, with their units
    units: tuple[str, ...]
    columns: list[np.ndarray]  # by part (m, u)
    least: float = -np.inf  # of its number, below which it is no such cause
    gate: Gate = _on  # how much of it acts, by the time since the change
    lasts: float = np.inf  # for so long [s]
    values: tuple[float, ...] = ()  # of its parameters in the fit, over the whole log

    @property
    def grows(self) -> bool:
        """Return whether it grows from its time on, which may be the log's beginning."""
        return self.gate is _growing

    @property
    def warms(self) -> bool:
        """Return whether it is friction that changes steadily, as a machine warms."""
        return self.grows and self.kind in WARMING

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
        values, stderr: (u,) of its numbers, by how much they differ, with the standard errors of
            noise and calibration.
        gain: share of the left-out squares that it explains; p: chance of such a gain.
        coordinate: whose error it lowers most; loss: (blocks,) left-out squares there with it.
        begins: whether the time is the log's beginning; until: the log's end [s].
        others: further causes of the same course in other places, with their numbers.
    """

    cause: Course
    log: str
    time: float
    values: Array
    stderr: Array
    gain: float
    coordinate: int
    loss: Array
    begins: bool = False
    until: float = np.inf
    p: float = np.nan
    others: tuple[tuple[Course, Array], ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Return all joints in which something changes."""
        every = (*self.cause.places, *(joint for cause, _ in self.others for joint in cause.places))
        return tuple(dict.fromkeys(every))

    def _share(self, cause: Course, values: Array) -> str:
        """Return by how much a parameter changes until the log's end, of its value over the log."""
        pairs = zip(cause.values, values, strict=False)
        shares = [rate * (self.until - self.time) / value for value, rate in pairs if value]
        return f"{100 * shares[0]:+.0f} %" if shares and np.isfinite(shares).all() else ""

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
        if share := self._share(self.cause, self.values):
            values += f", {share} of its value until the end"
        begin, end = self.time, self.time + self.cause.lasts
        if end < np.inf:
            text = f"from t = {begin:.2f} to {end:.2f} s of {self.log}: {self.cause.words}"
            text, remedy = f"{text} ({values})", f"leave out {begin:.2f} to {end:.2f} s"
        else:
            since = f"from t = {begin:.2f} s of {self.log} on"
            since = f"all through {self.log}" if self.begins else since
            text = f"{since}: {self.cause.words} ({values}){self._others()}"
            parted = f"split the log at {begin:.2f} s and identify its parts by themselves"
            remedy = warming_remedy(self.joints) if self.cause.warms else parted
        return Finding(CODE, text, remedy, (self.log, *self.joints), self.gain)

    def _others(self) -> str:
        """Return the causes of the same course, joint by joint."""
        if not self.others:
            return ""
        by_joint = dict[str, list[str]]()
        for cause, values in self.others:
            words = f"{cause.kind} {self._share(cause, values)}".rstrip()
            by_joint.setdefault(listed(cause.places), []).append(words)
        return ", and so does the friction of " + listed(
            [f"{joint} ({', '.join(words)})" for joint, words in by_joint.items()]
        )


def warming_remedy(joints: Sequence[str]) -> str:
    """Return what to do about friction that changes as joints warm."""
    names = listed(joints)
    columns = listed([f"temperature.{joint}" for joint in joints])
    return f"warm {names} up before the log, or log {columns} for temperature_friction"


def change_within(first: Ranking) -> Change | None:
    """Return what changes within a log of a fit, of which all effects are ranked; None if nothing
    does, or an effect that acts all the time explains it as well.
    """
    contest, boundaries = first.contest, [*_boundaries(first.contest)]
    causes = [*_effects(contest), *_exchanges(contest)]
    causes += [course for cause in causes for course in _courses(contest, cause)]
    if not (boundaries and causes):
        return None
    # all causes from all times
    begins, between = _beginnings(contest), _between(boundaries)
    where = [
        (cause, number, time)
        for cause in causes
        for number, time in (
            *(begins.items() if cause.grows else ()),
            *boundaries,
            *(between if cause.lasts < np.inf else ()),
        )
    ]
    times = {(n, t): _since(contest, n, t) for n, t in (*begins.items(), *boundaries, *between)}
    bare = contest.regression.bare
    before = bare.losses.sum(axis=0)

    def with_gated(
        chosen: Sequence[tuple[Course, int, float]],
    ) -> tuple[PartialRegression, list[Index]]:
        """The rows with the columns of some causes from their times on, and which these are."""
        by_cause = [cause.gated(times[number, time]) for cause, number, time in chosen]
        by_part = zip(*by_cause, strict=True)
        gated = [np.concatenate([C.T for C in columns]).T for columns in by_part]
        regression, new = bare.added(gated)
        widths = [len(cause.names) for cause, _, _ in chosen]
        return regression, np.split(new, np.cumsum(widths)[:-1])

    falls = list[Array]()
    for start in range(0, len(where), AT_ONCE):  # all of them would be gigabytes
        regression, groups = with_gated(where[start : start + AT_ONCE])
        falls.append(regression.gains(groups).by)
    by = np.concatenate(falls)
    gains = bare.explained(by, before)
    best = int(gains.argmax())
    share = float(bare.explained_by_coordinate(by[best], before).max())
    if share <= MAIN_CAUSE * BLURRED:
        return None
    # the times of the best ones, and the simplest of those that do as well
    timed = dict[int, Change]()
    for i in np.argsort(-gains).tolist():
        cause, number, time = where[i]
        if id(cause) not in timed and len(timed) < COMPARED:
            timed[id(cause)] = _with_time(contest, cause, number, time, boundaries)
    able = [change for change in timed.values() if (change.values >= change.cause.least).all()]
    most_left = (1 + PARSIMONY) * (1 - max((change.gain for change in able), default=1.0))
    equal = [change for change in able if 1 - change.gain <= most_left]
    if not equal:
        return None
    change = min(equal, key=lambda change: (len(change.cause.names), -change.gain))
    always = [e.refit.loss[:, change.coordinate] for e in first.evidence]
    always.append(contest.regression.losses[:, change.coordinate])
    least = min(always, key=lambda loss: float(loss.sum()))
    # of what is over after a while few blocks tell
    z = paired(least, change.loss) if change.cause.lasts == np.inf else np.inf
    remaining, most = float(change.loss.sum()), MAIN_CAUSE * float(least.sum())
    if not credible(z, contest.decision.rival_se, remaining=remaining, most=most):
        return None
    if contest.regression.residual[0].shape[1] <= 1:
        contest = judging(contest)
    chance, gain = surprise(contest.decision.alpha), float(gains[best])
    regression, groups = with_gated(where)
    regression = regression.with_targets([part.Y for part in contest.regression.parts])
    p = _chance(gain, regression, groups)
    if not credible(surprise(p), chance):
        # a spectrum that holds the change itself makes much of it: that of what it leaves
        rest = judging(contest.with_model(regression.extended(groups[best]).bare)).regression
        p = _chance(gain, rest, groups)
        if not credible(surprise(p), chance):
            return None
    change = replace(change, p=p)
    change = _with_values(_with_others(contest, change, causes), contest.fit)
    return _with_calibration(contest, change)


def _with_calibration(contest: Contest, change: Change) -> Change:
    """Return a change whose standard errors hold errors of the calibration as well: what one
    standard deviation of each would make of its numbers, if no other column took a part of it.
    """
    fit, table = contest.fit, contest.table
    if fit.mechanism.calibration.exact or fit.known_errors is not None:
        return change
    rows = ReducedRows(fit.problem, table)
    number = next(n for n, s in enumerate(table.scenes) if s.e.name == change.log)
    every = [change.cause, *(cause for cause, _ in change.others)]
    since = _since(contest, number, change.time)
    gated = zip(*(cause.gated(since) for cause in every), strict=True)
    columns = [np.concatenate(part, axis=1) for part in gated]
    values = np.concatenate([change.values, *(numbers for _, numbers in change.others)])
    variance, parts = change.stderr**2, contest.regression.parts
    causes = [*rows.causes()]
    for error, column in zip(causes, rows.columns(causes), strict=True):
        if column is None:
            continue
        targets = [column[contest.use[:, p.coordinate], p.coordinate, None] for p in parts]
        if error.kind == "tau":  # of the torque that the model predicts, which lacks the change
            joint = error.place.removeprefix("tau.")
            targets = [
                target + error.scale * (C @ values)[:, None]
                if table.motion.independent[part.coordinate] == joint
                else target
                for target, C, part in zip(targets, columns, parts, strict=True)
            ]
        refit = contest.regression.bare.with_targets(targets).refit_with(columns)
        variance = variance + refit.theta[: len(variance)] ** 2
    return replace(change, stderr=np.sqrt(variance))


def _with_values(change: Change, fit: Fit) -> Change:
    """Return a change of friction with the values of the fit, which are made where they are said:
    errors of the calibration are in them.
    """
    if not change.cause.warms:
        return change
    values = {e.effect.label: tuple(x.value for x in e.parameters) for e in fit.effects}

    def valued(cause: Course) -> Course:
        return replace(cause, values=values.get(cause.name, ()))

    others = tuple((valued(cause), numbers) for cause, numbers in change.others)
    return replace(change, cause=valued(change.cause), others=others)


def _with_others(contest: Contest, change: Change, causes: Sequence[Course]) -> Change:
    """Return a change with further friction that changes over the same time, one after the other,
    as long as each predicts time left out clearly better.
    """
    if not change.cause.warms:
        return change
    number = next(n for n, s in enumerate(contest.table.scenes) if s.e.name == change.log)
    since, bare = _since(contest, number, change.time), contest.regression.bare
    chosen = [change.cause]
    rest = [x for x in causes if x.warms and x is not change.cause and len(x.names) == 1]

    def refit(group: Sequence[Course]) -> Refit:
        columns = zip(*(cause.gated(since) for cause in group), strict=True)
        return bare.refit_with([np.concatenate(part, axis=1) for part in columns])

    now = refit(chosen)
    while rest:
        trials = [(cause, refit([*chosen, cause])) for cause in rest]
        cause, after = min(trials, key=lambda trial: float(trial[1].loss.sum()))
        if paired(now.loss.sum(axis=1), after.loss.sum(axis=1)) < contest.decision.rival_se:
            break
        chosen, now, rest = [*chosen, cause], after, [x for x in rest if x is not cause]
    width = len(change.cause.names)
    noise = np.sqrt(float(now.loss.sum()) / max(float(bare.rows.sum()), 1.0))
    others = zip(chosen[1:], np.split(now.theta[width:], len(chosen) - 1), strict=True)
    return replace(
        change, values=now.theta[:width], stderr=noise * now.stderr[:width],
        others=tuple(others) if len(chosen) > 1 else (),
    )  # fmt: skip


def _chance(gain: float, regression: PartialRegression, groups: Sequence[Index]) -> float:
    """Return the chance that some group explains more than a gain of random residuals."""
    null = null_shares(regression, regression.gains(groups)).max(axis=0)
    return max(exceeding(gain, x) for x in (null[:SURROGATES], null[SURROGATES:]) if len(x))


def _effects(contest: Contest) -> Iterator[Course]:
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
        units = bare.units[: len(names)]
        yield Course(
            bare.label, bare.kind, bare.joints, words=bare.label, names=names, units=units,
            columns=columns,
        )  # fmt: skip


def _exchanges(contest: Contest) -> Iterator[Course]:
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
        yield Course(
            words, "swapped", (one, other), words=words, names=("share",), units=("1",),
            columns=columns, least=LEAST_SHARE,
        )  # fmt: skip


def _boundaries(contest: Contest) -> Iterator[tuple[int, float]]:
    """Yield experiments and times [s] between their blocks, a few from either end."""
    table = contest.table
    for number in range(len(table.scenes)):
        rows = table.experiment == number
        blocks, t = table.blocks[rows], table.t[rows]
        numbers = np.unique(blocks)
        for block in numbers[FEWEST_BLOCKS : 1 - FEWEST_BLOCKS]:
            yield number, float(t[np.argmax(blocks >= block)])


def _between(boundaries: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """Return experiments and times [s] within the blocks that lie between boundaries."""
    shares = np.arange(1, BEGINS) / BEGINS
    return [
        (n, float(t + share * (later - t)))
        for (n, t), (m, later) in pairwise(boundaries)
        for share in shares
        if n == m
    ]


def _beginnings(contest: Contest) -> dict[int, float]:
    """Return the first times [s] of experiments by their numbers."""
    table = contest.table
    numbers = range(len(table.scenes))
    return {
        n: float(table.t[table.experiment == n].min()) for n in numbers if n in table.experiment
    }


def _courses(contest: Contest, cause: Course) -> Iterator[Course]:
    """Yield what a cause does that does not set in at once: friction that changes as a machine
    warms, a constant torque that grows, as that of a sensor that warms, or lasts for a while.
    """
    kind, place = cause.kind, listed(cause.places)
    if kind not in ("torque_offset", *WARMING):
        return
    words = f"tau.{place} drifts" if kind == "torque_offset" else f"{cause.name} changes steadily"
    units = tuple(f"{unit}/s" for unit in cause.units)
    names = ("rate",) if kind == "torque_offset" else tuple(f"{n} rate" for n in cause.names)
    yield replace(cause, words=words, names=names, units=units, gate=_growing)
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
    contest: Contest, cause: Course, number: int, time: float,
    boundaries: list[tuple[int, float]],
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
    rows = contest.table.t[contest.table.experiment == number]
    begin, until, begins = float(rows.min()), float(rows.max()), False
    if cause.grows:  # all through the log, which has no time to be found, where that does as well
        always = bare.refit_with(cause.gated(_since(contest, number, begin)))
        begins = t <= begin or float(always.loss.sum()) <= (1 + PARSIMONY) * loss
        if begins:
            loss, t, refit = float(always.loss.sum()), begin, always
    noise, u = np.sqrt(loss / max(float(bare.rows.sum()), 1.0)), int(refit.by.argmax())
    log = contest.table.scenes[number].e.name
    stderr = noise * refit.stderr
    gain, of_coordinate = bare.gain(refit), refit.loss[:, u]
    theta = refit.theta
    return Change(cause, log, t, theta, stderr, gain, u, of_coordinate, begins, until)
