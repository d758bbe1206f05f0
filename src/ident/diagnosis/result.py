"""The nouns of a diagnosis: explanations, laws, and what they make together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ident.diagnosis.effect_set import Member, leading, on_rows_in_motion, reweighted
from ident.diagnosis.found_curves import FoundCurve
from ident.diagnosis.law_search import FittedFormula
from ident.diagnosis.laws import FoundLaw
from ident.diagnosis.search import Selection
from ident.diagnosis.selection import Evidence
from ident.diagnosis.unobservable import Invisible, Unsupported, name_of
from ident.display import Plotted, render
from ident.effects import Effect
from ident.effects.formula import Formula
from ident.faults.data_checks import Health
from ident.fit import Fit
from ident.fit.residual import Failure
from ident.fit.residual_maps import Periods
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.information.evidence import NEGATIVE, Decision
from ident.mechanism.mechanism import Mechanism
from ident.request import PYTHON, Request
from ident.text import rounded


@dataclass(frozen=True, eq=False)
class Explanation:
    """One candidate: its evidence, and what adding it does.

    Attributes:
        evidence: from rows away from reversals.
        joint: the independent joint whose error it lowers most.
        fit: everything refitted with it, on all rows; None where its numbers are announced.
        before, after: held-out errors by joint, without it and with it.
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

    @classmethod
    def of(
        cls, fit: Fit, evidence: Evidence, refit: Fit | None, after: dict[str, Error],
        parameters: tuple[Value, ...], rivals: tuple[Effect, ...],
    ) -> Explanation:  # fmt: skip
        """Explain by a candidate, with the errors after it."""
        joint, known = fit.motion.independent[evidence.coordinate], known_of(fit, evidence.effect)
        before = errors_of(fit)
        return cls(
            evidence.effect, evidence, joint, refit, before, after, parameters, rivals, known
        )

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
            "rivals": [name_of(rival) for rival in self.rivals],
            "known": dict(self.known),
            "parameters": [{**_entry(v), "name": v.name} for v in self.parameters],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Law:
    """A formula for what no effect explains; `mechanism + law` is a model with it.

    Attributes:
        found: how it was found; effect: the formula with its constants; parameters: their values.
        beside: effects that the diagnosis names beside it, and laws of other joints.
        fit: everything refitted with it and those.
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
    def felt(self) -> str:
        """Joint whose error falls most with it; its own, where that is an independent one."""
        ratios = {n: self.after[n].rms / max(e.rms, 1e-300) for n, e in self.before.items()}
        return self.joint if self.joint in ratios else min(ratios, key=lambda name: ratios[name])

    def matters(self, decision: Decision) -> bool:
        """Whether the error of its joint falls by what matters."""
        before, after = self.before[self.felt], self.after[self.felt]
        torque = before.rms / before.relative if before.relative else before.rms
        return decision.matters(before.rms**2, after.rms**2, torque**2)

    @property
    def nearest(self) -> str:
        """Name of the closest law of the literature."""
        return self.found.nearest

    @property
    def rivals(self) -> tuple[str, ...]:
        """Formulas that this motion cannot tell from it."""
        return tuple(formula.formula.text for formula in self.found.rivals)

    @property
    def determined(self) -> bool:
        """Whether the data determine each term and all constants: else it is a simpler law."""
        count = len(self.effect.unknowns)
        large = [
            v.stderr is not None and abs(v.value) > NEGATIVE * v.stderr for v in self.parameters
        ]
        ends = np.cumsum([0, *(len(term.columns) for term in self.effect.terms)])
        for scale, v, sure in zip(
            self.effect.scales, self.parameters[count:], large[count:], strict=True
        ):
            _, low, high = self.effect.found[scale.name]
            anywhere = v.stderr is None or NEGATIVE * v.stderr > (high - low) / 2
            if anywhere if scale.of in ("place", "beyond", "angle") else not sure:
                return False
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
        source = self.effect.source_file(self.fit.found[self.effect.label])
        assert source is not None  # its constants are found
        return source[1].decode()

    def json(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        law = self.found
        before, after = (errors[self.felt].relative for errors in (self.before, self.after))
        return {
            "joint": self.joint,
            "signals": list(law.formula.logged),
            "formula": self.formula,
            "parameters": [_entry(v) for v in self.parameters],
            "error_before": before,
            "error_after": after,
            "explained": law.explained,
            "gain": law.gain,
            "quantile": law.limit,
            "complexity": law.formula.cost,
            "nearest": self.nearest,
            "distance": law.distance,
            "effect": self.option,
            "beside": [effect.label for effect in self.beside],
            "code": self.code,
            "rivals": list(self.rivals),
            "replaced": list(law.replaced),
            "front": [
                {"complexity": c, "left": share, "formula": text} for c, share, text in law.front
            ],
        }


class Concluded(Plotted):
    """A noun with a verdict: its first lines, its content as JSON, and files of its own."""

    @property
    def short(self) -> str:
        """First lines: the verdict, its certainty, errors by joint, and the next step."""
        return str(render(self, "short"))

    def json(self) -> dict[str, Any]:
        """The content of diagnosis.json, or of grow.json."""
        return dict(render(self, "json"))

    def write(self, folder: str | Path, request: Request = PYTHON) -> list[Path]:
        """Write report and numbers, files of laws and tables of curves; of a model that was grown
        its folder too. All of them or none.

        Args:
            folder: made if it is not there.
            request: the command that asked for it, which the report's next commands repeat.

        Raises:
            IdentError: if the folder cannot be written, or is that of the mechanism that has grown.
        """
        return list(render(self, "files", folder, request=request))


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Concluded):
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
        laws: formulas for them, with their constants; unsearched: joints in which Ctrl-C ended the
            search for laws.
        relatives: laws of the literature that the travelled range cannot tell from the best, where
            that is a function of position.
        floor: by joint, the rms that noise of the sensors alone would leave [N m | N].
        loud: joints in which more than the sensors' noise is left, without the effect named.
        reversing: whether it is left in the rows at their reversals only.
        with_group: held-out errors by joint, refitted with the effects that are named together;
            None where one is named, whose fit is the first candidate's, or none.
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
    unsearched: tuple[str, ...]
    relatives: tuple[FittedFormula, ...]
    floor: dict[str, float]
    loud: tuple[str, ...]
    reversing: bool = False
    with_group: Mapping[str, Error] | None = None

    @property
    def best(self) -> Effect | None:
        """The missing effect, for `mechanism + diagnosis.best`; None if none is named."""
        return self.candidates[0].effect if self.verdict == "missing" else None

    @property
    def rivals(self) -> tuple[Effect, ...]:
        """Effects that this data cannot tell from the best."""
        return self.candidates[0].rivals if self.verdict == "missing" else ()

    @property
    def rivals_in_group(self) -> dict[str, tuple[Effect, ...]]:
        """By label of an effect of the group, effects that this data cannot tell from it."""
        labels = {effect.label for effect in self.group}
        rivals = {
            m.label: tuple(e.effect for e in m.rivals if e.effect.label not in labels)
            for m in self.members_of_group
        }
        if self.best is not None:
            rivals[self.best.label] = self.rivals
        return {label: near for label, near in rivals.items() if near}

    def of_same_form(self, law: Law) -> tuple[Law, ...]:
        """Laws of other joints that have a law's form, with constants of their own."""
        others = (other for other in self.laws if other is not law)
        return tuple(other for other in others if other.effect.terms == law.effect.terms)

    @property
    def together(self) -> tuple[Member, ...]:
        """Further effects of the set that explains most; what brings nothing there is left out."""
        best, members = self.best, self.selection.members
        return tuple(
            m for m in members if best is None or (m.label != best.label and not m.gain <= 0)
        )

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Findings of the fit, without errors of the data that what was found explains, and without
        that it fails: where and why is what a diagnosis says.
        """
        remaining = {(finding.code, finding.where) for finding in self.health.findings}
        before = self.fit.health.findings
        explained = [x for x in before if (x.code, x.where) not in remaining]
        explained += self.fit.poor
        return tuple(str(x) for x in self.fit.all_findings if x not in explained)

    @property
    def verdicts(self) -> set[str]:
        """The verdict, as `Verdicts` has those of many logs."""
        return {self.verdict}

    @cached_property
    def group(self) -> tuple[Effect, ...]:
        """What is named together: the best effect, then those of its kind at other joints without
        which the error of their joint would be larger by what matters; none without a name.
        """
        if self.best is None:
            return ()
        first_member = next(m for m in self.selection.members if m.label == self.best.label)
        others = (m for m in self.selection.named if m is not first_member)
        leaders = leading([first_member, *others])
        before, after = errors_of(self.fit), self._errors_with(leaders)

        def matters(m: Member) -> bool:
            assert m.evidence is not None
            joint = self.fit.motion.independent[m.evidence.coordinate]
            rest = announced_with(self.selection, [other for other in leaders if other is not m])
            e = before[joint]
            torque = (e.rms / e.relative) ** 2 if e.relative else 0.0
            return self.decision.matters(rest[joint].rms ** 2, after[joint].rms ** 2, torque)

        return tuple(m.effect for m in leaders if m is first_member or matters(m))

    def _errors_with(self, members: Sequence[Member]) -> dict[str, Error]:
        """Held-out errors with the best effect, refitted, or with several members, announced."""
        if len(members) == 1:
            return self.candidates[0].after
        return announced_with(self.selection, members)

    @cached_property
    def after(self) -> dict[str, Error]:
        """Held-out errors with the group in the model, refitted; announced where it cannot be."""
        if self.best is None:
            return errors_of(self.fit)
        return dict(self.with_group or self._errors_with(self.members_of_group))

    @property
    def members_of_group(self) -> list[Member]:
        """The members of the set that are named together."""
        return [m for m in self.selection.named if m.effect in self.group]

    @cached_property
    def also(self) -> tuple[Member, ...]:
        """Further effects of the set, beside the group, with which an error falls as matters."""
        named_labels = {effect.label for effect in self.group}
        group = [m for m in self.selection.members if m.label in named_labels]
        named_labels |= {
            effect.label for effect in self.rivals
        }  # which are for one of it, not beside it
        rest = [m for m in self.together if m.label not in named_labels]
        sizes = np.array([e.rms**2 / (e.relative or 1.0) ** 2 for e in self.after.values()])

        def squares(*more: Member) -> np.ndarray:
            errors = announced_with(self.selection, [*group, *more])
            return np.array([e.rms**2 for e in errors.values()])

        now = squares() if rest else sizes
        return tuple(m for m in rest if self.decision.matters(now, squares(m), sizes))

    @cached_property
    def every(self) -> tuple[Explanation, ...]:
        """All candidates: `candidates`, then the others as announced, by what they explain."""
        first = self.selection.first
        done = {evidence.effect.label for evidence in self.candidates}
        rest = [evidence for evidence in first.every if evidence.effect.label not in done]
        rest.sort(key=lambda evidence: -evidence.gain)
        more = (announced(self.selection, evidence, ()) for evidence in rest)
        return (*self.candidates, *more)

    @property
    def next_experiment(self) -> str:
        """Which motion would tell more, in words."""
        return str(render(self, "experiment"))

    @cached_property
    def text(self) -> str:
        """The whole diagnosis as text."""
        return str(render(self, "words"))


def _entry(v: Value) -> dict[str, Any]:
    name = v.name.rpartition(".")[2]
    return {"name": name, "value": v.value, "stderr": v.stderr, "unit": v.unit}


# --- errors and explanations of a fit ------------------------------------------------------------


def announced_with(selection: Selection, members: Sequence[Member]) -> dict[str, Error]:
    """Return held-out errors with members of the set, as rows in motion predict them."""
    contest = selection.first.contest
    regression, columns = on_rows_in_motion(contest, members)
    richer = reweighted(regression.extended(np.concatenate([*columns.values()])))
    old, new = (x.losses.sum(axis=0) / x.weight**2 for x in (regression, richer))
    return announced_errors(errors_of(contest.fit), old, new)


def announced(selection: Selection, evidence: Evidence, rivals: tuple[Effect, ...]) -> Explanation:
    """Explain by a candidate as the rows that decide predict it, without a refit."""
    fit, effect = selection.first.contest.fit, evidence.effect
    before, known = selection.first.regression.losses.sum(axis=0), known_of(fit, effect)
    after = announced_errors(errors_of(fit), before, evidence.refit.loss.sum(axis=0))
    linear = dict(zip((p.name for p in effect.unknowns), evidence.refit.theta, strict=False))
    names = (p.name for p in (*effect.unknowns, *effect.searched))
    errors = dict(zip(names, evidence.refit.stderr, strict=False))
    values = tuple(
        Value(full, float({**evidence.shape, **linear}.get(p.name, 0.0)) + known.get(full, 0.0),
              float(errors[p.name]) if p.name in errors else None, unit, True, 0.0)
        for full, p, unit in zip(effect.names, effect.parameters, effect.units, strict=True)
    )  # fmt: skip
    return Explanation.of(fit, evidence, None, after, values, rivals)


def known_of(fit: Fit, effect: Effect) -> dict[str, float]:
    """Return the known values, by full name, of an effect of the model, or nothing."""
    known = next((e for e in fit.mechanism.effects if e.label == effect.label), None)
    if known is None:
        return {}
    return {full: known.values[name] for name, full in known.full.items() if name in known.values}


def errors_of(fit: Fit) -> dict[str, Error]:
    """Held out, or of the fitted data where the log is too short to hold anything out."""
    return dict(fit.held_out or fit.train)


def announced_errors(
    errors: Mapping[str, Error], before: np.ndarray, after: np.ndarray
) -> dict[str, Error]:
    """Return errors by joint as left-out squares (d,) before and after a change scale them."""
    ratio = np.sqrt(np.where(before > 0, after, 1.0) / np.where(before > 0, before, 1.0))
    return {
        name: Error(e.rms * s, None if e.relative is None else e.relative * s, e.unit)
        for (name, e), s in zip(errors.items(), map(float, ratio), strict=True)
    }
