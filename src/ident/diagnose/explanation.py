"""A candidate with the refit that it announces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ident.diagnose.evidence import Evidence
from ident.effects import Correcting, Effect
from ident.equations.point import Point
from ident.fit import Fit, identify
from ident.fit.values import Value
from ident.residual.error import Error

WORSE = 1.5  # times the best's held-out error on its joint, from which a rival is none


@dataclass(frozen=True, eq=False)
class Explanation:
    """One candidate: what speaks for it, and the fit with it.

    Attributes:
        effect: the candidate; evidence: from rows away from reversals.
        joint: the independent joint whose error it lowers most.
        fit: everything refitted with it, on all rows.
        before, after: held-out errors by joint, without it and with it.
        fall: of the held-out squares weighted by each joint's measured torque, as a share.
        rivals: effects that this data cannot tell from it.
        known: values that the model before gave it, by full name: then it has changed.
    """

    effect: Effect
    evidence: Evidence
    joint: str
    fit: Fit
    before: dict[str, Error]
    after: dict[str, Error]
    fall: float
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
    def parameters(self) -> tuple[Value, ...]:
        """Its parameters in the refit."""
        return next(e.parameters for e in self.fit.effects if e.effect.label == self.effect.label)

    def json(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        return {
            **name_of(self.effect),
            "joint": self.joint,
            "error_before": self.error_before,
            "error_after": self.error_after,
            "fall": self.fall,
            "p_value": self.evidence.p,
            "z": self.evidence.z,
            "closure": self.evidence.closure,
            "visible": self.evidence.candidate.judged.visible,
            "credible": self.evidence.credible,
            "rivals": [name_of(each) for each in self.rivals],
            "known": dict(self.known),
            "parameters": [
                {"name": v.name, "value": v.value, "stderr": v.stderr, "unit": v.unit}
                for v in self.parameters
            ],
        }


def name_of(effect: Effect) -> dict[str, Any]:
    """`{"effect": …, "joints": […]}`."""
    return {"effect": effect.kind, "joints": list(effect.joints)}


def explain(fit: Fit, found: Evidence, rivals: tuple[Effect, ...] = ()) -> Explanation:
    """The refit with a candidate; searched shapes set out from where they were found."""
    effect = found.candidate.effect
    before = known_of(fit, effect) if isinstance(effect, Correcting) else {}
    stem = effect.names[len(effect.unknowns) :]
    shapes = {
        full: found.candidate.shape[shape.name] + before.get(full, 0.0)
        for full, shape in zip(stem, effect.shapes, strict=True)
        if shape.name in found.candidate.shape
    }
    start = Point(fit.point.pi, {**fit.point.values, **shapes})
    refit = identify(fit.mechanism + effect, fit.motion, start=start, estimator="least-squares")
    old, new = errors_of(fit), errors_of(refit)
    return Explanation(
        effect=effect,
        evidence=found,
        joint=fit.motion.independent[found.candidate.coordinate],
        fit=refit,
        before=old,
        after=new,
        fall=fall_of(old, new),
        rivals=rivals,
        known=known_of(fit, effect),
    )


def known_of(fit: Fit, effect: Effect) -> dict[str, float]:
    """By full name, the values of an effect that the model has with known values; else none."""
    own = next((e for e in fit.mechanism.effects if e.label == effect.label), None)
    if own is None:
        return {}
    names = zip(own.names, own.parameters, strict=True)
    return {full: own.values[each.name] for full, each in names}


def errors_of(fit: Fit) -> dict[str, Error]:
    """Held out, or of the fitted data where the log is too short to hold anything out."""
    return dict(fit.held_out or fit.train)


def told_apart(found: list[Explanation]) -> list[Explanation]:
    """Without rivals whose refit on all rows is clearly worse: there the data do tell."""
    worse = {
        each.effect.label
        for each in found[1:]
        if each.after[found[0].joint].rms > WORSE * found[0].after[found[0].joint].rms
    }
    if not found or found[0].effect.label in worse:
        return found
    return [
        replace(each, rivals=tuple(r for r in each.rivals if r.label not in worse))
        if each.effect.label not in worse
        else replace(each, rivals=())
        for each in found
    ]


def fall_of(before: dict[str, Error], after: dict[str, Error]) -> float:
    """1 − Σ (rms₁/rms τ)² / Σ (rms₀/rms τ)² over joints: squares weighted by their torque."""
    names = [name for name, error in before.items() if error.relative]
    weight = {
        name: (before[name].relative or 0.0) / max(before[name].rms, 1e-300) for name in names
    }
    old = sum((weight[name] * before[name].rms) ** 2 for name in names)
    new = sum((weight[name] * after[name].rms) ** 2 for name in names)
    return float(1 - new / old) if old > 0 else 0.0
