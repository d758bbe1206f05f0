"""The verb `diagnose`, and its noun: where a model fails, and which effect is missing."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import chain, count, pairwise, product
from operator import add
from pathlib import Path
from typing import Any

import numpy as np

from ident.diagnosis.candidates import Contest, OnProgress, candidates_of
from ident.diagnosis.found_curves import FoundCurve, curve_of
from ident.diagnosis.law_search import CERTAIN
from ident.diagnosis.laws import FoundLaw, laws_of
from ident.diagnosis.null import NoiseDraws, noise
from ident.diagnosis.search import Member, Selection, select
from ident.diagnosis.selection import (
    Decision,
    Evidence,
    Ranking,
    Weigh,
    chance_of,
    torque_squares,
)
from ident.diagnosis.unobservable import Invisible, Unsupported, invisible, name_of, unsupported
from ident.display import Plotted, render
from ident.effects import Effect
from ident.effects.formula import Formula
from ident.equations.unknowns import Point
from ident.errors import FitError, IdentError
from ident.fit import Fit, identify
from ident.fit.channel_fits import LEAVES
from ident.fit.data_checks import DataChecks, Health
from ident.fit.residual import Failure, Periods, residual_of
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.information.hypotheses import PartialRegression
from ident.mechanism.mechanism import Mechanism
from ident.text import rounded

SHOWN = 3  # candidates that are listed though nothing speaks for them
TRIED = 3  # rivals of a formula whose constants are not determined
LISTED = 8  # candidates that are listed at most
LOUD = 1.25  # times the largest of the noise's draws, from which a residual is more than noise
VERDICTS = ("missing", "nothing", "unexplained", "undecided")
THIRD = 1 / 3  # of a length, by which no drawing is off
AGAIN = 0.6  # correlation of a residual between periods that noise does not have


@dataclass(frozen=True, eq=False)
class Explanation:
    """One candidate: what speaks for it, and what adding it does.

    Attributes:
        effect: the candidate; evidence: from rows away from reversals.
        joint: the independent joint whose error it lowers most.
        fit: everything refitted with it, on all rows; None where its numbers are announced.
        before, after: held-out errors by joint, without it and with it.
        parameters: its values.
        rivals: effects that this data cannot tell from it.
        known: values that the model before gave it, by full name: then it has changed.
    """

    effect: Effect
    evidence: Evidence
    joint: str
    fit: Fit | None
    before: dict[str, Error]
    after: dict[str, Error]
    parameters: tuple[Value, ...]
    rivals: tuple[Effect, ...] = ()
    known: Mapping[str, float] = field(default_factory=dict)

    @property
    def error_before(self) -> float | None:
        """Held-out relative error of its joint without it."""
        return self.before[self.joint].relative

    @property
    def error_after(self) -> float | None:
        """Held-out relative error of its joint with it."""
        return self.after[self.joint].relative

    @property
    def fall(self) -> float:
        """Share by which the error of its joint falls."""
        return 1 - self.after[self.joint].rms / max(self.before[self.joint].rms, 1e-300)

    def json(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        e = self.evidence
        return {
            **name_of(self.effect),
            "joint": self.joint,
            "error_before": self.error_before,
            "error_after": self.error_after,
            "fall": self.fall,
            "refitted": self.fit is not None,
            "p_value": e.p,
            "z": e.z,
            "gain": e.gain,
            "quantile": e.limit,
            "visible": e.refit.visible,
            "credible": e.credible,
            "rivals": [name_of(each) for each in self.rivals],
            "known": dict(self.known),
            "parameters": [
                {"name": v.name, "value": v.value, "stderr": v.stderr, "unit": v.unit}
                for v in self.parameters
            ],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Law:
    """A formula for what no effect of the library explains, everything refitted with it.

    Attributes:
        found: how it was found.
        effect: the formula with its constants; `mechanism + law` is a model with it.
        beside: effects that the diagnosis names beside it, and laws of other joints.
        fit: everything refitted with it and those.
        parameters: values of its constants.
        before, after: held-out errors by joint, without them and with them.
    """

    found: FoundLaw
    effect: Formula
    beside: tuple[Effect, ...]
    fit: Fit
    parameters: tuple[Value, ...]
    before: dict[str, Error]
    after: dict[str, Error]

    def __radd__(self, mechanism: Mechanism) -> Mechanism:
        return mechanism + self.effect

    @property
    def joint(self) -> str:
        """Joint of its torque."""
        return self.found.joint

    @property
    def formula(self) -> str:
        """Its formula in Python, over the signals q, v, a, load, t of its joint."""
        return self.effect.text

    @property
    def determined(self) -> bool:
        """Whether the data determine a coefficient of each term: else it is a simpler law in
        disguise.
        """
        large = [
            v.stderr is not None and abs(v.value) > CERTAIN * v.stderr for v in self.parameters
        ]
        ends = np.cumsum([0, *(len(term.columns) for term in self.effect.terms)])
        return all(any(large[a:b]) for a, b in pairwise(ends))

    def __str__(self) -> str:
        constants = ", ".join(
            f"{v.name.rpartition('.')[2]} = {rounded(v.value, v.stderr)} {v.unit}"
            for v in self.parameters
        )
        return f"torque of {self.joint} = {self.formula}: {constants}"

    __repr__ = __str__

    @property
    def file(self) -> str:
        """Name of its effect file."""
        return self.effect.file_name

    @property
    def option(self) -> str:
        """The text by which `--with` takes it."""
        return f"{self.file}:{self.effect.name}:{','.join(self.effect.joints)}"

    @property
    def code(self) -> str:
        """The content of its effect file."""
        own = self.effect.source_file(self.fit.found[self.effect.label])
        assert own is not None  # its constants are found
        return own[1].decode()

    def json(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        law, joint = self.found, self.joint
        before, after = (
            errors[joint].relative if joint in errors else None
            for errors in (self.before, self.after)
        )
        return {
            "joint": joint,
            "signals": list(law.formula.logged),
            "formula": self.formula,
            "parameters": [
                {
                    "name": v.name.rpartition(".")[2],
                    "value": v.value,
                    "stderr": v.stderr,
                    "unit": v.unit,
                }
                for v in self.parameters
            ],
            "error_before": before,
            "error_after": after,
            "explained": law.explained,
            "gain": law.gain,
            "quantile": law.limit,
            "complexity": law.formula.cost,
            "nearest": law.nearest,
            "distance": law.distance,
            "effect": self.option,
            "beside": [each.label for each in self.beside],
            "code": self.code,
            "rivals": [each.formula.text for each in law.rivals],
            "replaced": list(law.replaced),
            "front": [
                {"complexity": c, "left": left, "formula": text} for c, left, text in law.front
            ],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Plotted):
    """Where a model fails and which effects would explain it. Made by `ident.diagnose`.

    Attributes:
        fit: what was diagnosed.
        verdict: `missing` (one effect, or rivals that this data cannot tell apart), `unexplained`
            (what is left is determined by the motion, and no effect explains it), `undecided`
            (more than the sensors' noise is left, and this log cannot tell coloured noise from
            physics) or `nothing` (what is left is the sensors' noise, or does not matter).
        decision: what a name takes.
        health: of the data; where: by joint, worst first; periods: if the motion repeats.
        candidates: best first; selection: the evidence on all others, and the set they make.
        invisible: effects that this data cannot show; unsupported: of the model, better removed.
        curves: of signals, that explain what no effect of the library does.
        laws: formulas for them, with their constants.
        floor: by joint, rms of a residual of nothing but noise [N m | N].
        loud: joints in which more than the sensors' noise is left, without the effect named.
    """

    fit: Fit
    verdict: str
    decision: Decision
    health: Health
    where: tuple[Failure, ...]
    periods: Periods | None
    candidates: tuple[Explanation, ...]
    selection: Selection
    invisible: tuple[Invisible, ...]
    unsupported: tuple[Unsupported, ...]
    curves: tuple[FoundCurve, ...]
    laws: tuple[Law, ...]
    floor: dict[str, float]
    loud: tuple[str, ...]

    @property
    def best(self) -> Effect | None:
        """The missing effect, for `mechanism + diagnosis.best`; None if none is named."""
        return self.candidates[0].effect if self.verdict == "missing" else None

    @property
    def rivals(self) -> tuple[Effect, ...]:
        """Effects that this data cannot tell from the best."""
        return self.candidates[0].rivals if self.verdict == "missing" else ()

    def of_same_form(self, law: Law) -> tuple[Law, ...]:
        """Laws of other joints that have a law's form, with constants of their own."""
        others = (each for each in self.laws if each is not law)
        return tuple(each for each in others if each.effect.terms == law.effect.terms)

    @property
    def together(self) -> tuple[Member, ...]:
        """Further effects of the set that explains most."""
        best = self.best
        return tuple(m for m in self.selection.members if best is None or m.label != best.label)

    @property
    def verdicts(self) -> set[str]:
        """The verdict, as `Verdicts` has those of many logs."""
        return {self.verdict}

    @cached_property
    def group(self) -> tuple[Effect, ...]:
        """The best effect, then those of its kind at other joints that the data ask for beside it.

        The best alone where it has rivals, none where nothing is named.
        """
        if self.best is None or self.rivals:
            return () if self.best is None else (self.best,)
        own = next(m for m in self.selection.members if m.label == self.best.label)
        others = (m for m in self.selection.named if m.effect.kind == self.best.kind)
        together = (m.effect for m in others if m is not own and not own.stands_in)
        return (self.best, *together)

    @cached_property
    def after(self) -> dict[str, Error]:
        """Held-out errors with the group in the model; of several effects, announced."""
        if self.best is None:
            return errors_of(self.fit)
        if len(self.group) == 1:
            return self.candidates[0].after
        labels = {effect.label for effect in self.group}
        regression = self.selection.last.regression
        for each in self.selection.members:
            if each.label not in labels:
                regression = regression.without(each.columns)
        return _scaled(self.fit, self.selection, regression)

    @cached_property
    def every(self) -> tuple[Explanation, ...]:
        """All candidates: `candidates`, then the others as announced, by what they explain."""
        first = self.selection.first
        weigh = Weigh(first.contest, first.regression, self.decision, first.total)
        done = {each.effect.label for each in self.candidates}
        looked = {each.effect.label: each for each in first.evidence}
        rest = []
        for each in first.contest.candidates:
            if each.curve or each.effect.label in done or each.effect.label not in first.gains:
                continue
            start = int(first.regression.gains(each.groups).G.argmax())
            gain = first.gains[each.effect.label][0]
            rest.append(
                looked.get(each.effect.label)
                or weigh(each, start, gain, first.limit_of(each), chance_of(gain, first.chance))
            )
        rest.sort(key=lambda each: -each.gain)
        more = (_announced(self.fit, self.selection, each, ()) for each in rest)
        return (*self.candidates, *more)

    @property
    def choice(self) -> Ranking:
        """The evidence on all candidates beside the model as it is."""
        return self.selection.first

    @cached_property
    def next_experiment(self) -> str:
        """Which motion would tell more, in words."""
        return str(render(self, "experiment"))

    @cached_property
    def text(self) -> str:
        """The whole diagnosis as text."""
        return str(render(self, "words"))

    @property
    def short(self) -> str:
        """First lines: the verdict, its certainty, errors by joint, and the next step."""
        return str(render(self, "short"))

    def json(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        found: dict[str, Any] = render(self, "json")
        return found

    def write(self, folder: str | Path) -> list[Path]:
        """diagnosis.json, report.html, files of laws and tables of curves; all of them or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        paths: list[Path] = render(self, "files", folder)
        return paths


def diagnose(
    fit: Fit,
    *,
    seed: int = 0,
    alpha: float = 0.01,
    material: float = 0.003,
    rival_se: float = 2.0,
    progress: OnProgress | None = None,
) -> Diagnosis:
    """Where the model fails, what is missing, how sure that is, and what to measure next.

    Every effect of the library at every place is judged after refitting everything else: by the
    fall of the error of stretches of time that were left out, held against the largest fall that
    any candidate brings on residuals in which nothing is missing.

    Args:
        fit: from `ident.identify`.
        seed: of the residuals in which nothing is missing.
        alpha: chance of a name where nothing is missing.
        material: share of a joint's torque below which an effect does not matter.
        rival_se: standard errors of the difference within which two effects are rivals.
        progress: called with (what is being done, share done).

    Returns:
        The diagnosis; `print(diagnosis)` says it in words.

    Raises:
        FitError: if it is given no fit.
    """
    if not isinstance(fit, Fit):
        raise FitError(
            f"diagnose needs a fit, given: {type(fit).__name__}; write "
            "ident.diagnose(ident.identify(mechanism, motion))"
        )
    on_progress = progress or (lambda what, share: None)
    decision = Decision(alpha, material, rival_se)
    contest = Contest.of(fit, candidates_of(fit), on_progress)
    on_progress("noise of the sensors", 0.4)
    return concluded(contest, noise(contest, seed), decision, seed, on_progress)


def concluded(
    contest: Contest, draws: NoiseDraws, decision: Decision, seed: int, on_progress: OnProgress
) -> Diagnosis:
    """The diagnosis of a fit from the rows of all candidates and draws of the sensors' noise."""
    fit = contest.fit
    selection = select(contest, draws, decision, seed, on_progress)
    names = fit.motion.independent
    floor = dict(zip(names, map(float, draws.floor), strict=True))
    left = louder(contest, draws, selection.last, decision)
    loud = tuple(name for name, each in zip(names, left, strict=True) if each)
    last = selection.last.regression
    data = _health_beside(contest, last.losses / last.weight**2)
    laws: tuple[Law, ...] = ()
    if not data.faults:
        lawful, found = laws_of(contest, selection, loud, floor, decision, on_progress)
        on_progress("refitting", 0.8)
        selection, laws = _refitted(fit, lawful, found)
    best = selection.named[0] if selection.named else None
    candidates = _explanations(fit, selection, best)
    if best is not None and (not candidates or candidates[0].effect.label != best.label):
        best = None  # what cannot be refitted is no name
    if best is not None and (data.faults or not _explains(candidates[0], contest, draws, last)):
        best = None
    residual = residual_of(fit)
    verdict = _verdict(selection, best, bool(loud), residual.periods)
    curves = found_curves(contest, selection, [law.found for law in laws], verdict, decision)
    on_progress("where it fails", 0.9)
    return Diagnosis(
        fit=fit,
        verdict=verdict,
        decision=decision,
        health=data,
        where=residual.where,
        periods=residual.periods,
        candidates=tuple(candidates),
        selection=selection,
        invisible=invisible(fit, contest),
        unsupported=unsupported(fit, contest, decision),
        curves=curves,
        laws=laws,
        floor=floor,
        loud=loud,
    )


def _refitted(
    fit: Fit, selection: Selection, found: Collection[FoundLaw]
) -> tuple[Selection, tuple[Law, ...]]:
    """Refit the laws, with what is named beside them; without those that cannot be refitted, and
    what these replaced has its name again.
    """
    laws: list[Law] = []
    for each in of_one_form(found):
        formulas = (each.found, *each.rivals[:TRIED])  # the next, where one is not determined
        with_names: list[Sequence[Member | Law]] = [[*selection.named, *laws], laws]
        for formula, others in product(formulas, with_names[not selection.named :]):
            with suppress(IdentError):
                law = refitted(fit, each.instead(formula), others)
                if law.determined:
                    laws.append(law)
                    break
    good = tuple(laws)
    joints = {law.joint for law in good}
    members = tuple(
        m if m.law is None or m.law.joints[0] in joints else replace(m, law=None)
        for m in selection.members
    )
    return replace(selection, members=members), good


def of_one_form(found: Collection[FoundLaw]) -> list[FoundLaw]:
    """Give laws of several joints one form, with constants of its own at each, where a formula of
    these terms is the law or a rival of it at every joint; of several forms the best in all.
    """
    forms = [{e.formula.terms: e for e in (*law.rivals, law.found)} for law in found]
    common = set(forms[0]).intersection(*forms[1:]) if len(forms) > 1 else set()
    if not common:
        return list(found)
    losses = [float(law.found.loss.sum()) for law in found]
    best = min(
        common,
        key=lambda t: sum(float(f[t].loss.sum()) / x for f, x in zip(forms, losses, strict=True)),
    )
    return [law.instead(form[best]) for law, form in zip(found, forms, strict=True)]


def _explains(
    found: Explanation, contest: Contest, draws: NoiseDraws, last: PartialRegression
) -> bool:
    """Whether the best is a cause: of a possible size, a length changed by no more than a third,
    and of a joint of which it and what was found with it do not leave most of the torque.
    """
    lengths = contest.fit.mechanism.lengths if found.effect.sits == "place" else {}
    length = abs(lengths.get(found.effect.joints[0], np.inf)) if found.effect.joints else np.inf
    if any(abs(value.value) > THIRD * length for value in found.parameters):
        return False
    u = found.evidence.coordinate
    rows = max(float(last.rows[u]), 1.0)
    left = float(last.losses[:, u].sum()) / rows / last.weight[u] ** 2 - draws.floor[u] ** 2
    torque = float(torque_squares(contest, last)[u]) / rows / last.weight[u] ** 2
    return bool(left < LEAVES**2 * torque)


def health(fit: Fit) -> Health:
    """Judge the data behind a fit, from `identify`.

    Returns:
        Its findings, gravest first; `print` shows them in words.
    """
    return fit.health


def _health_beside(contest: Contest, explained: np.ndarray) -> Health:
    """The same beside a diagnosis, on its rows: a wrong channel must explain more than the effects
    that it found, which leave squares (blocks, d) of blocks that were left out.
    """
    fit = contest.fit
    checks = DataChecks(
        fit.problem, fit.estimate, fit.relative, contest.table, contest.use, explained
    )
    health = checks.health()
    # a joint swings freely by the fitted terms, which wrong channels spoil
    freely = () if health.faults else (e for e in fit.findings if e.code == "swings freely")
    return Health((*health.findings, *freely))


def louder(contest: Contest, noise: NoiseDraws, last: Ranking, decision: Decision) -> np.ndarray:
    """(d,) whether more than the sensors' noise is left, and matters."""
    regression = last.regression
    rows = np.maximum(regression.rows, 1)
    rms = np.sqrt(regression.losses.sum(axis=0) / rows) / regression.weight
    torque = np.sqrt(torque_squares(contest, regression) / rows) / regression.weight
    excess = np.sqrt(np.maximum(rms**2 - noise.floor**2, 0.0))
    return np.asarray((rms > LOUD * noise.ceiling) & (excess > decision.material * torque))


def _verdict(selection: Selection, best: Member | None, loud: bool, periods: Periods | None) -> str:
    if best is not None:
        return "missing"
    if selection.members or (loud and selection.last.curves):
        return "unexplained"
    if loud and periods is not None and max(periods.rho.values()) > max(AGAIN, periods.chance):
        return "unexplained"
    return "undecided" if loud else "nothing"


def refitted(fit: Fit, found: FoundLaw, beside: Collection[Member | Law]) -> Law:
    """Refit everything with a law and what is beside it; searches set out from where they ended."""
    others = [each.effect for each in beside]
    taken = {effect.kind for effect in (*fit.mechanism.effects, *others)}
    name = next(n for n in chain(["law"], map("law{}".format, count(2))) if n not in taken)
    at = {n: (x, *found.bounds[n]) for n, x in found.found.shape.items()}
    law = replace(found.formula, name=name, found=at)
    evidence = [e.evidence for e in beside if isinstance(e, Member) and e.evidence is not None]
    point = started(fit.point, fit, evidence)
    full = dict(zip((p.name for p in law.parameters), law.names, strict=True))
    start = Point(point.pi, {**point.values, **{full[n]: x for n, (x, *_) in at.items()}})
    refit = identify(
        reduce(add, (*others, law), fit.mechanism),
        fit.motion,
        start=start,
        estimator="least-squares",
    )
    own = next(e for e in refit.effects if e.effect.label == law.label)
    assert isinstance(own.effect, Formula)
    values = {v.name.rpartition(".")[2]: v.value for v in own.parameters}
    effect = replace(own.effect, found={n: (values[n], *at[n][1:]) for n in at})
    return Law(
        found, effect, tuple(others), refit, tuple(own.parameters), errors_of(fit), errors_of(refit)
    )  # fmt: skip


def found_curves(
    contest: Contest, selection: Selection, laws: Collection[FoundLaw], verdict: str,
    decision: Decision,
) -> tuple[FoundCurve, ...]:  # fmt: skip
    """Find the curves of the joints that have a law, or where the model fails unexplained."""
    limit, last = selection.last.limit_with_curves, selection.last
    least = 0.0 if laws else limit  # a law has the evidence
    places = {law.joint: law.beside for law in laws}
    if verdict == "unexplained" and not places:
        rest = last.regression.judging([p.Y[:, :1] for p in last.regression.parts])
        for member in selection.members:
            rest = rest.without(member.columns) if member.rejected else rest
        curves = [curve for curve, _ in (*last.curves, *selection.first.curves)]
        curves += [m.curve for m in selection.members if m.curve is not None]
        places = {curve.joints[0]: rest for curve in curves[:1]}
    found = (
        curve_of(last.contest, beside, joint, limit, decision.rival_se, least)
        for joint, beside in places.items()
    )
    return tuple(each for each in found if each is not None)


# --- candidates, refitted ----------------------------------------------------------------------


def _explanations(fit: Fit, selection: Selection, best: Member | None) -> list[Explanation]:
    """The best refitted, its rivals and what else is promising, best first."""
    first = [best.evidence, *best.rivals] if best is not None and best.evidence else []
    labels = {each.effect.label for each in first}
    rest = [e for e in selection.first.evidence if e.effect.label not in labels]
    rest.sort(key=lambda each: not each.credible)
    wanted = [*first, *rest][: max(SHOWN, min(LISTED, len(first) + 1))]
    effects = [each.effect for each in first]
    cheap = all(each.linear for each in fit.mechanism.effects)  # no search of shapes
    found = []
    for each in wanted:
        rivals = tuple(e for e in effects if e.label != each.effect.label)
        rivals = rivals if each.effect.label in labels else ()
        if (first and each is first[0]) or (each.effect.linear and cheap):
            with suppress(IdentError):  # a correction too large for the loops to close, say
                found.append(explain(fit, each, rivals))
        else:
            found.append(_announced(fit, selection, each, rivals))
    return found


def explain(fit: Fit, found: Evidence, rivals: tuple[Effect, ...] = ()) -> Explanation:
    """The refit with a candidate; searched shapes set out from where they were found."""
    refit = identify(
        fit.mechanism + found.effect, fit.motion, start=started(fit.point, fit, [found]),
        estimator="least-squares",
    )  # fmt: skip
    values = next(e.parameters for e in refit.effects if e.effect.label == found.effect.label)
    return _explanation(fit, found, refit, errors_of(refit), values, rivals)


def started(point: Point, fit: Fit, found: Collection[Evidence]) -> Point:
    """The working point with the shapes of some candidates where they were found."""
    shapes: dict[str, float] = {}
    for each in found:
        effect = each.effect
        before = known_of(fit, effect) if effect.corrects else {}
        names = effect.names[len(effect.unknowns) :]
        shapes |= {
            full: each.shape[shape.name] + before.get(full, 0.0)
            for full, shape in zip(names, effect.shapes, strict=True)
            if shape.name in each.shape
        }
    return Point(point.pi, {**point.values, **shapes})


def _announced(
    fit: Fit, selection: Selection, found: Evidence, rivals: tuple[Effect, ...]
) -> Explanation:
    """Explain by a candidate as the rows that decide predict it, without a refit."""
    before = selection.first.regression.losses.sum(axis=0)
    after = announced_errors(errors_of(fit), before, found.refit.loss.sum(axis=0))
    effect, known = found.effect, known_of(fit, found.effect)
    linear = dict(zip((p.name for p in effect.unknowns), found.refit.theta, strict=False))
    errors = dict(
        zip(
            (p.name for p in (*effect.unknowns, *effect.searched)), found.refit.stderr, strict=False
        )
    )
    values = tuple(
        Value(full, float({**found.shape, **linear}.get(p.name, 0.0)) + known.get(full, 0.0),
              float(errors[p.name]) if p.name in errors else None, unit, True, 0.0)
        for full, p, unit in zip(effect.names, effect.parameters, effect.units, strict=True)
    )  # fmt: skip
    return _explanation(fit, found, None, after, values, rivals)


def _scaled(fit: Fit, selection: Selection, regression: PartialRegression) -> dict[str, Error]:
    """Return the errors of a fit as a regression of the search changes them."""
    before, after = (
        each.losses.sum(axis=0) / each.weight**2
        for each in (selection.first.regression, regression)
    )
    return announced_errors(errors_of(fit), before, after)


def _explanation(
    fit: Fit, found: Evidence, refit: Fit | None, after: dict[str, Error],
    values: tuple[Value, ...], rivals: tuple[Effect, ...],
) -> Explanation:  # fmt: skip
    joint, known = fit.motion.independent[found.coordinate], known_of(fit, found.effect)
    return Explanation(
        found.effect, found, joint, refit, errors_of(fit), after, tuple(values), rivals, known
    )


def known_of(fit: Fit, effect: Effect) -> dict[str, float]:
    """Return the known values, by full name, of an effect of the model, or nothing."""
    own = next((e for e in fit.mechanism.effects if e.label == effect.label), None)
    if own is None:
        return {}
    return {full: own.values[p.name] for full, p in zip(own.names, own.parameters, strict=True)}


def errors_of(fit: Fit) -> dict[str, Error]:
    """Held out, or of the fitted data where the log is too short to hold anything out."""
    return dict(fit.held_out or fit.train)


def announced_errors(
    errors: Mapping[str, Error], before: np.ndarray, after: np.ndarray
) -> dict[str, Error]:
    """Return errors by joint as left-out squares (d,) before and after a change scale them."""
    ratio = np.sqrt(after / np.where(before > 0, before, 1.0))
    return {
        name: replace(e, rms=e.rms * s, relative=None if e.relative is None else e.relative * s)
        for (name, e), s in zip(errors.items(), map(float, ratio), strict=True)
    }


def fall_of(before: Mapping[str, Error], after: Mapping[str, Error]) -> float:
    """1 − Σ (rms₁/rms τ)² / Σ (rms₀/rms τ)² over joints: squares weighted by their torque."""
    names = [name for name, error in before.items() if error.relative]
    weight = {
        name: (before[name].relative or 0.0) / max(before[name].rms, 1e-300) for name in names
    }
    old = sum((weight[name] * before[name].rms) ** 2 for name in names)
    new = sum((weight[name] * after[name].rms) ** 2 for name in names)
    return float(1 - new / old) if old > 0 else 0.0
