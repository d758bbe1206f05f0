"""The verb `grow`: the set of effects that explains most, searched, fitted, and searched again.

One pass makes the rows of the model and of all candidates, on which a set is searched. The set is
then fitted once; if at the new working point the search finds another set, it goes on from there.

Finished rounds are in a file, from which an interrupted run goes on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.diagnosis.candidates import Contest, OnProgress, candidates_of, possible
from ident.diagnosis.diagnosis import at_reversals, conclude, seen_elsewhere, start_point
from ident.diagnosis.effect_set import EffectSet, leader, on_rows_in_motion, reweighted
from ident.diagnosis.null import with_noise
from ident.diagnosis.result import Concluded, Diagnosis, announced_errors, errors_of
from ident.diagnosis.search import Search, select
from ident.diagnosis.selection import can_be, has_mass, may_be_load, rank
from ident.diagnosis.unseen import carried
from ident.diagnosis.validation import ValidationErrors
from ident.display import Displayed, part, render
from ident.effects import Effect
from ident.equations.unknowns import Point
from ident.errors import FitError, IdentError, check_whole
from ident.files import json_bytes, version, write_all
from ident.fit import Fit, identify
from ident.fit.shapes import NoScale, widened
from ident.information.blocks import Error
from ident.information.estimate import MATERIAL
from ident.information.evidence import ALPHA, CERTAIN, RIVAL, Chance, Decision, paired
from ident.information.hypotheses import Index, PartialRegression
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.simulate.replay import unplayable

NAME = "growing.json"
SCHEMA = "ident.growing/2"
CHANGES = ("added", "removed")
ROUNDS = 8  # work: fits, lest shapes that move with the working point take turns for ever


@dataclass(eq=False)
class SavedRounds:
    """Rounds of `grow`, each written as soon as it is fitted."""

    folder: Path | None  # where they are written; None: nowhere
    key: str  # of all that they depend on
    # by round the `rungs` as (added, removed, rivals_of, errors), effects by label, the `start` of
    # the fit's shapes, and the sets `visited` so far
    rounds: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def of(
        cls, folder: Path | None, mechanism: Mechanism, motion: Motion, rule: Any, resume: bool
    ) -> SavedRounds:
        """Return what an earlier run has left there, with `resume`; else nothing.

        Raises:
            FitError: if there is nothing, or what is there belongs to other inputs.
        """
        files = [path for path in (mechanism.urdf, mechanism.toml) if path and path.is_file()]
        effects = [(effect.label, dict(effect.values)) for effect in mechanism.effects]
        words = [version(), effects, motion.band.cutoff, motion.samples, str(rule)]
        digest = hashlib.sha256(repr(words).encode())
        for path in files:
            digest.update(path.read_bytes())
        for log in motion.logs:
            digest.update((log.sha256 or log.name).encode())
        saved = cls(folder, digest.hexdigest())
        if not resume:
            return saved
        file = None if folder is None else folder / NAME
        if file is None or not file.is_file():
            raise FitError(
                f"resume: there is no {file or NAME} of an interrupted run; give the folder of its "
                "--out, or leave --resume out to begin anew"
            )
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            known, saved.rounds = content["key"], list(content["rounds"])
        except (ValueError, KeyError, TypeError):
            raise FitError(f"{file}: is broken; leave --resume out to begin anew") from None
        if known != saved.key:
            raise FitError(
                f"{file}: was made with other logs, another model, other options or another "
                "version; give the same ones, or leave --resume out to begin anew"
            )
        return saved

    def add(
        self,
        rungs: Collection[Any],
        start: Mapping[str, float],
        visited: Collection[frozenset[str]],
    ) -> None:
        """Write a further round: its steps, its fit's start, and all sets that were searched."""
        words = []
        for step in rungs:
            effects: dict[str, Any] = {n: [e.label for e in getattr(step, n)] for n in CHANGES}
            near = {name: [e.label for e in rivals] for name, rivals in step.rivals_of.items()}
            effects["rivals_of"] = near
            errors = {joint: asdict(error) for joint, error in step.errors.items()}
            words.append({**effects, "errors": errors})
        sets = sorted(map(sorted, visited))
        self.rounds.append({"rungs": words, "start": dict(start), "visited": sets})
        self.write()

    def write(self) -> None:
        """Write all rounds so far; the file is removed where the result is written."""
        if self.folder is not None:
            content = {"schema": SCHEMA, "key": self.key, "rounds": self.rounds}
            write_all(self.folder, {NAME: json_bytes(content)})


@dataclass(frozen=True, eq=False, repr=False)
class Step(Displayed):
    """One rung of the ladder.

    Attributes:
        added: effects of one kind; removed: effects; both none on the first rung.
        rivals_of: by label of an added effect, those that could as well have been added.
        fit: everything refitted; None where the errors are announced by the search.
        errors: held out, by joint.
    """

    added: tuple[Effect, ...]
    removed: tuple[Effect, ...]
    rivals_of: Mapping[str, tuple[Effect, ...]]
    fit: Fit | None
    errors: dict[str, Error]

    @property
    def rivals(self) -> tuple[Effect, ...]:
        """The rivals of all added effects."""
        near = (rival for rivals in self.rivals_of.values() for rival in rivals)
        return tuple({rival.label: rival for rival in near}.values())


@dataclass(frozen=True, eq=False, repr=False)
class History(Concluded):
    """The ladder of a growing model, from `ident.grow`.

    Attributes:
        steps: the ladder, from the model that was given.
        diagnosis: of the last model.
        stopped: what the next step would have added, and which error on a validation log would have
            risen with it by more than chance makes; "" where the search came to its own end.
    """

    steps: tuple[Step, ...]
    diagnosis: Diagnosis
    stopped: str = ""

    @property
    def fits(self) -> tuple[Fit, ...]:
        """Return the fits of the rungs that were fitted, the first and the last among them."""
        return tuple(step.fit for step in self.steps if step.fit is not None)

    @property
    def fit(self) -> Fit:
        """The last."""
        return self.fits[-1]

    @property
    def mechanism(self) -> Mechanism:
        """The grown mechanism."""
        return self.fit.mechanism

    @property
    def added(self) -> tuple[Effect, ...]:
        """Effects that were added and are still there, in order."""
        present = {effect.label for effect in self.mechanism.effects}
        every = (effect for step in self.steps for effect in step.added)
        return tuple({e.label: e for e in every if e.label in present}.values())

    def table(self) -> list[list[str]]:
        """The ladder as cells: effects, held-out error a joint, rivals; the head first."""
        rows: list[list[str]] = render(self, "ladder")
        return rows


def grow(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    seed: int = 0,
    alpha: float = ALPHA,
    material: float = MATERIAL,
    rival_se: float = RIVAL,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: OnProgress | None = None,
    step: Callable[[Step], None] | None = None,
) -> History:
    """Adds the effects that explain most until no effect is missing, and refits.

    Args:
        mechanism: to start from.
        motion: that is fitted.
        validate: of other logs, on which errors are reported.
        seed, alpha, material, rival_se: as `diagnose` takes them.
        checkpoint: a folder that keeps what is fitted until the history is written there.
        resume: whether to go on from there.
        progress: called with (what is being done, share done).
        step: called with every rung as it is reached.
    """
    if not isinstance(motion, Motion):
        raise FitError(
            f"grow needs a motion, given: {type(motion).__name__}; write "
            "ident.grow(mechanism, ident.complete(mechanism, log))"
        )
    on_progress = part(progress, 0.05, 1.0)
    decision = Decision(alpha, material, rival_se)
    check_whole("seed", seed)
    given = frozenset(effect.label for effect in mechanism.effects if not effect.known)
    # least squares throughout, as the rows that announce an effect's fall
    folder = None if checkpoint is None else Path(checkpoint)
    saved = SavedRounds.of(folder, mechanism, motion, (decision, seed), resume)
    first = part(progress, 0.0, 0.05)
    fit = identify(mechanism, motion, validate=validate, estimator="least-squares", progress=first)
    steps = [Step((), (), {}, fit, errors_of(fit))]

    def contest_of(fit: Fit, on_progress: OnProgress, earlier: Contest | None = None) -> Contest:
        # curves judge what is left in the end, the search needs none
        effects = candidates_of(fit)
        return with_noise(
            Contest.of(fit, effects, on_progress, False, earlier, decision=decision, seed=seed)
        )

    def reached(rungs: Collection[Step]) -> None:
        steps.extend(rungs)
        if step:
            for rung in rungs:
                step(rung)

    saved.write()
    if step:
        step(steps[0])
    visited: set[frozenset[str]] = set()
    best = ValidationErrors.of(fit, validate)
    for done in saved.rounds:
        rungs, fit = _replay_round(done, fit, validate)
        visited |= set(map(frozenset, done["visited"]))
        reached(rungs)
        best = best.best(ValidationErrors.of(fit, validate))
    given &= {effect.label for effect in fit.mechanism.effects}
    begun, contest, stopped = len(saved.rounds), None, ""
    for number in range(begun, ROUNDS + 1):
        done_before = 1 - 0.5 ** (number - begun)  # nobody knows how many rounds
        rest = part(on_progress, done_before, 1.0)
        on_round = part(rest, 0.0, 0.5)
        grown, turning, last = None, None, None
        contest = None if contest is None else contest.columns_alone  # its rows need not stay
        contest = contest_of(fit, part(on_round, 0.0, 0.4), contest)
        search = Search(contest, given, part(on_round, 0.4, 0.6), visited, to_refit=True)
        if number < ROUNDS and not stopped:
            effect_set, moved = with_given_moved(search.run(), given)
            on_round("refitting", 0.6)
            grown = refit_set(fit, search, carried(effect_set, given), validate, moved)
            if moved and grown is not None:
                given -= {effect.label for effect in moved}
            if grown is None and (turning := contest.at_reversals(part(on_round, 0.6, 0.65))):
                elsewhere, turns = seen_elsewhere(search.first), part(on_round, 0.65, 0.9)
                search = Search(with_noise(turning), given, turns)
                leading_set = led_at_reversals(search, search.run(), elsewhere)
                if leading_set is not None:
                    grown = refit_set(fit, search, carried(leading_set, given), validate)
        if grown is None:  # what a diagnosis names of this model is the next step
            del search
            if not any(candidate.curve for candidate in contest.candidates):
                contest = contest.with_curves(part(rest, 0.35, 0.4))
            last = conclude(select(contest, part(rest, 0.4, 0.6)), part(rest, 0.6, 0.8))
            last = at_reversals(last, part(rest, 0.8, 1.0), turning)
            if number < ROUNDS and not stopped:
                search, effect_set = named_set(last, given, visited)
                grown = refit_set(fit, search, carried(effect_set, given), validate)
        errors = ValidationErrors.of(grown[-1], validate) if grown is not None else best
        if grown is not None and (
            stopped := errors.increased_error(best) or spoils(fit, grown[-1])
        ):
            stopped = f"{named(grown, search)}: {stopped}"
            grown = None
            if last is None:
                continue
        if grown is None:
            assert last is not None
            break
        effect_set, removed, start, again = grown
        rungs = ladder(search, effect_set, removed, again)
        saved.add(rungs, start.values, visited)
        reached(rungs)
        fit, best = again, best.best(errors)
        del search, effect_set, grown, turning  # all rows of the round before
    assert last is not None
    final = rivals_in_the_end(steps, last.selection.first.contest)
    return History(final, last, stopped)


def rivals_in_the_end(steps: Sequence[Step], contest: Contest) -> tuple[Step, ...]:
    """Return the ladder with those rivals alone that do as well in the final model, of whose rows
    `contest` is: many of a step are told apart by what later steps add.
    """
    places = columns_of(contest.fit)
    losses = contest.regression.losses.sum(axis=1)

    def as_good(label: str, rivals: Sequence[Effect]) -> tuple[Effect, ...]:
        if (columns := places.get(label)) is None:
            return ()  # removed since
        bare = contest.with_model(contest.regression.without(columns))
        near = {rival.label for rival in rivals}
        no_limit = Chance({}, {}, contest.decision.alpha, -np.inf)
        evidence = rank(bare, (), False, no_limit, 0.0, near).evidence
        least = contest.decision.rival_se
        good = {
            e.effect.label
            for e in evidence
            if e.sensible and paired(e.refit.loss.sum(axis=1), losses) < least
        }
        return tuple(rival for rival in rivals if rival.label in good)

    final = []
    for step in steps:
        near = {label: as_good(label, rivals) for label, rivals in step.rivals_of.items()}
        final.append(replace(step, rivals_of={n: rivals for n, rivals in near.items() if rivals}))
    return tuple(final)


def named_set(
    diagnosis: Diagnosis, given: Collection[str], visited: set[frozenset[str]]
) -> tuple[Search, EffectSet]:
    """Return a search that has found what a diagnosis names, and that set."""
    first = diagnosis.selection.first
    search = Search(first.contest, given, lambda what, share: None, visited)
    search.first, effect_set = first, search.start
    for member in diagnosis.members_of_group if diagnosis.best else ():
        if member.evidence is not None:
            effect_set = effect_set.plus(member.evidence, member.rivals)
    return search, effect_set


def spoils(before: Fit, after: Fit) -> str:
    """Return why commands of drives cannot be played by a model, which the one before can; "" where
    nothing speaks against that.
    """
    if (why := unplayable(after)) and not unplayable(before):
        return f"its motion could not be simulated: {why}"
    return ""


def named(grown: Grown, search: Search) -> str:
    """Return the labels of what a step would have added."""
    return ", ".join(member.label for member in search.new(grown[0])) or "the next step"


Grown = tuple[EffectSet, tuple[Effect, ...], Point, Fit]
"""A set of effects, those that it no longer has, the start of its fit, and the fit."""


def columns_of(fit: Fit) -> dict[str, Index]:
    """Return the columns of each effect that a fit determines, by label; not of known ones."""
    unknown = ((e.label, places[places >= 0]) for e, places in fit.columns.effects)
    free = {label: places[~fit.estimate.fixed[places]] for label, places in unknown if len(places)}
    return {label: columns for label, columns in free.items() if len(columns)}


def with_given_moved(
    now: EffectSet, given: Collection[str]
) -> tuple[EffectSet, tuple[Effect, ...]]:
    """Return a set in which effects of other joints of a loop stand for given ones of their kind,
    where rows show that, by RIVAL standard errors of the paired difference; and those replaced.
    """
    fit, moved = now.contest.fit, list[Effect]()
    if not fit.mechanism.closures:
        return now, ()
    no_limit = Chance({}, {}, now.contest.decision.alpha, -np.inf)
    least = now.contest.decision.rival_se
    for label, columns in columns_of(fit).items():
        effect = next(e for e in fit.mechanism.effects if e.label == label)
        if label not in given:
            continue
        contest = now.contest.with_model(now.regression.without(columns))
        losses, bare = (x.losses.sum(axis=1) for x in (now.regression, contest.regression))
        new = [m for m in now.members if m.evidence and m.effect.kind == effect.kind]
        if new and paired(bare, losses) < least:  # another joint has it already
            now = replace(now, contest=contest)
            moved.append(effect)
            continue
        of_kind = {c.effect.label for c in now.contest.laws if c.effect.kind == effect.kind}
        if not (others := of_kind - now.labels):
            continue
        better_ones = (
            e
            for e in rank(contest, (), False, no_limit, 0.0, others).credible
            if paired(losses, e.refit.loss.sum(axis=1)) >= least
        )
        if (other := max(better_ones, key=lambda e: e.gain, default=None)) is not None:
            now = replace(now, contest=contest).plus(other)
            moved.append(effect)
    return now, tuple(moved)


def refit_set(
    fit: Fit, search: Search, effect_set: EffectSet, validate: Motion | None,
    moved: tuple[Effect, ...] = (),
) -> Grown | None:  # fmt: skip
    """Refit the set that a search found, without effects that the fit does not determine or that
    have values that cannot be, without those with which commands of drives cannot be played, and
    without those that have `moved`; None where it is the set at the
    start, or predicts left-out rows no better.
    """
    model = fit.mechanism
    without = search.start.labels - effect_set.labels | {effect.label for effect in moved}
    removed = tuple(e for e in model.effects if e.label in without)
    for effect in removed:
        model = model.without(effect.label)
    new = search.new(effect_set)
    if not (new or removed):
        return None
    start = start_point(fit, [member.evidence for member in new if member.evidence])
    for member in new:
        model = model + member.effect

    def fitted(start: Point) -> Fit:
        least = "least-squares"
        return identify(model, fit.motion, validate=validate, start=start, estimator=least)

    def dropped(loose: str) -> None:
        """Take a new effect out of the model, the set and what is new; a drive gets back the gains
        that were given.
        """
        nonlocal new, effect_set, model
        new = [member for member in new if member.label != loose]
        effect_set = effect_set.minus(
            next(member for member in effect_set.members if member.label == loose)
        )
        model = model.without(loose)
        for effect in fit.mechanism.effects:
            if effect.label == loose:
                model = model + effect

    def determined(start: Point) -> Fit:
        """Return the fit without the new gains of drives that nothing gives a scale."""
        while True:
            try:
                return fitted(start)
            except NoScale as unscaled:
                gains = [m.label for m in new if m.effect.supplies_torque]
                loose = [label for label in gains if label.partition(":")[2] in unscaled.joints]
                if not loose:
                    raise
                for label in loose:
                    dropped(label)

    again = determined(start)
    table = search.contest.table
    while label := undetermined(again, [member.effect for member in new], table.bounds):
        dropped(label)
        again = determined(again.point)
    while new and unplayable(again) and not unplayable(fit):  # as with a load that no body is
        dropped(max(new, key=lambda member: len(member.effect.parameters)).label)
        again = determined(again.point)
    if not (new or removed) or not better(errors_of(fit), errors_of(again)):
        return None
    return effect_set, removed, start, again


def led_at_reversals(
    search: Search, effect_set: EffectSet, elsewhere: Collection[str]
) -> EffectSet | None:
    """The set of effects that are `seen` on other rows too, or else of those that act at reversals,
    if one of them explains most of what is new; else None: rows at reversals are those at which
    friction is least exact, and name nothing else.
    """
    new = search.new(effect_set)
    first = max(new, key=lambda m: search.first.gains[m.label][0], default=None)
    staying = [m for m in new if m.label in elsewhere]
    if not staying and first is not None and first.effect.at_reversals:
        staying = [m for m in new if m.effect.at_reversals]
    required = {label for member in staying for label in member.effect.required}
    for member in new:
        if member not in staying and member.label not in required:
            effect_set = effect_set.minus(member)
    return effect_set if staying else None


def _replay_round(
    saved: Mapping[str, Any], fit: Fit, validate: Motion | None
) -> tuple[list[Step], Fit]:
    """Return the rungs and the fit of a round that was saved."""
    model = fit.mechanism
    known = {effect.label: effect for effect in (*possible(model, fit.motion), *model.effects)}
    rungs = []
    for rung in saved["rungs"]:
        added, removed = (tuple(known[label] for label in rung[n]) for n in CHANGES)
        near = {n: tuple(map(known.__getitem__, x)) for n, x in rung["rivals_of"].items()}
        for effect in removed:
            model = model.without(effect.label)
        for effect in added:
            model = model + effect
        errors = {joint: Error(**error) for joint, error in rung["errors"].items()}
        rungs.append(Step(added, removed, near, None, errors))
    start = Point(fit.point.pi, saved["start"])
    fit = identify(model, fit.motion, validate=validate, start=start, estimator="least-squares")
    rungs[-1] = replace(rungs[-1], fit=fit, errors=errors_of(fit))
    return rungs, fit


def undetermined(
    fit: Fit, new: Collection[Effect],
    bounds: Callable[[Effect], Mapping[str, tuple[float, float]]] = lambda effect: {},
) -> str:  # fmt: skip
    """Return the label of an added effect all values of which are smaller than their errors (than
    CERTAIN times these where it moves the machine's geometry or clock), or one of which cannot be:
    that with most parameters first, what every machine has last; "" if there is none.
    """
    required = {label for effect in fit.mechanism.effects for label in effect.required}
    labels = {effect.label for effect in new} - required
    loose = []
    # not by what faults of the data change: these are sought in the last model alone
    for e in fit.effects_with(fit.without_faults):
        parameters = e.parameters[: len(e.effect.unknowns) or None]
        values = np.array([v.value for v in parameters])
        errors = np.array([np.inf if v.stderr is None else v.stderr for v in parameters])
        least = CERTAIN if e.effect.corrects else 1.0
        small = all(abs(v.value) < least * (v.stderr or 0.0) for v in parameters)
        possible = can_be(fit.mechanism, e.effect, values, errors)
        if e.effect.loaded_link:
            possible &= has_mass(fit.mechanism, values, errors) and may_be_load(values, errors)
        if e.effect.slow and not e.effect.corrects:  # of the motion: a reach longer than its travel
            shapes = {
                p.name: v.value for p, v in zip(e.effect.parameters, e.parameters, strict=True)
            }
            possible &= all(
                low <= shapes[name] <= high
                for name, ends in bounds(e.effect).items()
                for low, high in [widened(*ends)]
            )
        if e.effect.label in labels and (small or not possible):
            loose.append(e.effect)
    last = max(loose, key=lambda e: (not e.common, len(e.parameters)), default=None)
    return last.label if last else ""


def better(before: Mapping[str, Error], after: Mapping[str, Error]) -> bool:
    """Return whether a fit has the larger held-out log density, all joints together."""
    return sum(np.log(max(after[n].rms, 1e-300) / max(before[n].rms, 1e-300)) for n in before) < 0


# --- the ladder --------------------------------------------------------------------------------


def ladder(
    search: Search, effect_set: EffectSet, removed: tuple[Effect, ...], after: Fit
) -> list[Step]:
    """A rung a kind of effect: what a diagnosis names, then what explains most of what is left.

    The last rung is fitted; errors before it are announced by the same regression, of all rows in
    motion. What the rung after it contradicts is fitted as well.
    """
    contest, first = search.contest, search.first
    material = contest.decision.material
    new = search.new(effect_set)
    regression, columns = on_rows_in_motion(contest, new)
    given = regression.losses.sum(axis=0) / regression.weight**2
    errors, rungs = errors_of(contest.fit), list[Step]()

    def announced(regression: PartialRegression) -> dict[str, Error]:
        now = regression.losses.sum(axis=0) / regression.weight**2
        return announced_errors(errors, given, now)

    last, places = errors, columns_of(contest.fit)
    if removed:
        for effect in removed:
            if effect.label in places:
                regression = regression.without(places[effect.label])
        last = announced(regression)
        rungs.append(Step((), removed, {}, None, last))
    new.sort(key=lambda member: first.place(member.label))
    lead = leader(new, first) if new else None
    new.sort(key=lambda member: member is not lead)
    kinds = dict.fromkeys(member.effect.kind for member in new)
    groups = [[member for member in new if member.effect.kind == kind] for kind in kinds]
    while groups:
        at = [np.concatenate([columns[member.label] for member in group]) for group in groups]
        order = [0] if len(groups) == len(kinds) else np.argsort(-regression.gains(at).G)
        steps = []
        for i in order:  # of all steps the largest that raises no error
            richer = reweighted(regression.extended(at[i]))
            now = announced(richer)
            steps.append((_fall(last, now), int(i), richer, now))
            if steps[-1][0] >= 0:
                break
        _, i, regression, last = max(steps, key=lambda step: step[0])
        group = groups.pop(i)
        near = {
            member.label: tuple(
                e.effect for e in member.rivals if e.effect.label not in effect_set.labels
            )
            for member in group
        }
        near = {label: rivals for label, rivals in near.items() if rivals}
        rungs.append(Step(tuple(member.effect for member in group), (), near, None, last))
    rungs[-1] = replace(rungs[-1], fit=after, errors=errors_of(after))
    for i in reversed(range(len(rungs) - 1)):
        if _contradicted(rungs[i].errors, rungs[i + 1].errors, material):
            with suppress(IdentError):  # it may not determine all that the last one does
                errors = _fitted_errors(contest.fit, rungs[: i + 1], after)
                rungs[i] = replace(rungs[i], errors=errors)
    return rungs


def _fitted_errors(before: Fit, rungs: Sequence[Step], after: Fit) -> dict[str, Error]:
    """Return the errors, by joint, of a model with some rungs, refitted from the shapes `after`."""
    model = before.mechanism
    for rung in rungs:
        for effect in rung.removed:
            model = model.without(effect.label)
        for effect in rung.added:
            model = model + effect
    fit = identify(model, before.motion, start=after.point, estimator="least-squares")
    return errors_of(fit)


def _contradicted(announced: Mapping[str, Error], fitted: Mapping[str, Error], most: float) -> bool:
    """Whether a fit with more effects leaves more in a joint, by a share `most` of its torque."""
    pairs = [(error, fitted[joint]) for joint, error in announced.items() if error.relative]
    return any((b.rms / a.rms - 1) * (a.relative or 0.0) > most for a, b in pairs if a.rms)


def _fall(before: Mapping[str, Error], after: Mapping[str, Error]) -> float:
    """1 − Σ (rms₁/rms τ)² / Σ (rms₀/rms τ)² over joints: squares weighted by their torque."""
    old, new = (sum((e[n].relative or 0.0) ** 2 for n in before) for e in (before, after))
    return 1 - new / old if old > 0 else 0.0
