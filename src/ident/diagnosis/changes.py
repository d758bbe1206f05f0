"""What changes within a log: an effect that acts from some time on, and no sooner.

    b = A x + [t ≥ t₀] C θ        C: columns of any effect at any place; t₀: a boundary of blocks

Both stretches have the model's parameters and the later one θ besides: a load that is taken up, a
friction that rises, a channel that is exchanged. All effects at all times are judged at once, by
left-out errors held against the most that any of them explains of random residuals, and must
explain more than any effect that acts all the time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ident.diagnosis.candidates import SURROGATES, Contest, absorbed, possible
from ident.diagnosis.null import judging, null_shares
from ident.diagnosis.selection import MAIN_CAUSE, Ranking
from ident.effects import Effect
from ident.finding import Finding
from ident.information.chance import PARSIMONY, exceeding, paired
from ident.information.hypotheses import Array, PartialRegression

CODE = "changed within the log"
FEWEST_BLOCKS = 3  # work: of each stretch
TIMES = 8  # work: in each of two blocks, at which the change is sought in the end
COMPARED = 8  # work: effects whose times are sought
CLEARLY = 2.0  # tuned: left-out squares with what acts all the time over those with the change


@dataclass(frozen=True, eq=False)
class Change:
    """An effect that acts from a time on.

    Attributes:
        effect: of the library, or of the model, whose values differ from then on.
        log: name of the log; time: in it [s]; error: of the time, as the motion shows it [s].
        values, stderr: (u,) of its unknowns, by how much they differ.
        gain: share of the left-out squares that it explains; p: chance of such a gain.
        loss: (blocks,) left-out squares with it.
    """

    effect: Effect
    log: str
    time: float
    values: Array
    stderr: Array
    gain: float
    p: float
    loss: Array

    def finding(self) -> Finding:
        """Return it in words."""
        names = (parameter.name for parameter in self.effect.unknowns)
        pairs = list(zip(names, self.values, self.stderr, self.effect.units, strict=False))
        large = [x for x in pairs if abs(x[1]) > 3 * x[2]][:3] or pairs[:1]
        values = ", ".join(f"{name} {value:+.3g} ± {error:.1g} {unit}".removesuffix(" 1")
                           for name, value, error, unit in large)  # fmt: skip
        text = f"from t = {self.time:.2f} s of {self.log} on: {self.effect.label} ({values})"
        remedy = f"split the log at {self.time:.2f} s and identify its parts by themselves"
        return Finding(CODE, text, remedy, (self.log, *self.effect.joints), self.gain)


def change_within(first: Ranking) -> Change | None:
    """Return what changes within a log of a fit, of which all effects are ranked; None if none
    does, or an effect that acts all the time explains it as well.
    """
    contest = first.contest
    boundaries = [*_boundaries(contest)]
    if not boundaries:
        return None
    if contest.regression.residual[0].shape[1] <= 1:
        contest = judging(contest)
    regression, effects = contest.regression, list[tuple[Effect, list[np.ndarray]]]()
    for effect in _acting(contest):
        (shape,) = [{}] if not effect.shapes else contest.table.starts(effect)[:1] or [{}]
        effects.append((effect, contest.columns(effect, shape)))
    where = [(effect, number, time) for effect, _ in effects for number, time in boundaries]
    masks = [_later(contest, number, time) for number, time in boundaries]
    gated = [
        np.concatenate([C[i] * mask[i][:, None] for _, C in effects for mask in masks], axis=1)
        for i in range(len(regression.parts))
    ]
    regression, new = regression.added(gated)
    widths = [C[0].shape[1] for _, C in effects for _ in masks]
    groups = np.split(new, np.cumsum(widths)[:-1])
    measured = regression.gains(groups)
    gains = regression.explained(measured.by)
    null = null_shares(regression, measured).max(axis=0)
    best = int(gains.argmax())
    p = max(
        exceeding(float(gains[best]), x) for x in (null[:SURROGATES], null[SURROGATES:]) if len(x)
    )
    share = float(regression.explained_by_coordinate(measured.by[best]).max())
    if not p < contest.decision.alpha or share < MAIN_CAUSE:
        return None
    columns = {effect.label: C for effect, C in effects}
    tried = list[Change]()
    for i in np.argsort(-gains).tolist():
        effect, number, time = where[i]
        if any(change.effect is effect for change in tried) or len(tried) >= COMPARED:
            continue
        tried.append(_refined(contest, effect, columns[effect.label], number, time, boundaries, p))
    most = max(change.gain for change in tried)
    equal = [change for change in tried if change.gain >= (1 - PARSIMONY) * most]
    change = min(equal, key=lambda change: (len(change.effect.unknowns), -change.gain))
    always = min((e.refit.loss.sum(axis=1) for e in first.evidence), key=np.sum, default=None)
    if always is not None and (
        change.loss.sum() > always.sum() / CLEARLY
        or paired(always, change.loss) < contest.decision.rival_se
    ):
        return None
    return change


def _acting(contest: Contest) -> Iterator[Effect]:
    """Yield effects that may set in: candidates, those of the model, and loads of unknown links."""
    fit = contest.fit
    labels = set()
    absorbed_loads = (e for e in possible(fit.mechanism, fit.motion) if absorbed(fit.mechanism, e))
    laws = (law.effect for law in contest.laws)
    for effect in (*laws, *fit.mechanism.effects, *absorbed_loads):
        grows = effect.kind in ("drift", "ripple") or effect.memory or effect.corrects
        if effect.label not in labels and effect.unknowns and not grows:
            labels.add(effect.label)
            yield replace(effect, values={})


def _boundaries(contest: Contest) -> Iterator[tuple[int, float]]:
    """Yield experiments and times [s] between their blocks, a few from either end."""
    table = contest.table
    for number in range(len(table.scenes)):
        rows = table.experiment == number
        blocks, t = table.blocks[rows], table.t[rows]
        numbers = np.unique(blocks)
        for block in numbers[FEWEST_BLOCKS : 1 - FEWEST_BLOCKS]:
            yield number, float(t[np.argmax(blocks >= block)])


def _later(contest: Contest, number: int, time: float) -> list[np.ndarray]:
    """Return by part which rows are of an experiment and not before a time."""
    table = contest.table
    later = (table.experiment == number) & (table.t >= time)
    return [later[contest.use[:, part.coordinate]] for part in contest.regression.parts]


def _refined(
    contest: Contest, effect: Effect, C: list[np.ndarray], number: int, time: float,
    boundaries: list[tuple[int, float]], p: float,
) -> Change:  # fmt: skip
    """Return the change with the time near a boundary that leaves least."""
    times = [t for n, t in boundaries if n == number]
    step = float(np.diff(times).mean()) if len(times) > 1 else 0.0
    bare: PartialRegression = contest.regression.bare
    trials = []
    for t in time + step * np.linspace(-1, 1, 2 * TIMES + 1):
        later = _later(contest, number, float(t))
        refit = bare.refit_with([c * mask[:, None] for c, mask in zip(C, later, strict=True)])
        trials.append((float(refit.loss.sum()), float(t), refit))
    loss, t, refit = min(trials, key=lambda trial: trial[0])
    noise = np.sqrt(loss / max(float(bare.rows.sum()), 1.0))
    name, gain = contest.table.scenes[number].e.name, bare.gain(refit)
    return Change(
        effect, name, t, refit.theta, noise * refit.stderr, gain, p, refit.loss.sum(axis=1)
    )
