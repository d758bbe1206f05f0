"""What a trial motion would show: rivals apart from one another, effects beside the model.

    s_A = C_A θ_A     separation² = min_s Σ ((I − P) s_A / σ)²,  P onto [A, C_B(s)]

σ is the noise of the present log; sums are scaled to its length. Half of a separation is what
blocks of held-out errors would show, in their standard errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.diagnose.allowed import allowed
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.quiet import quiet
from ident.diagnose.screen import Screen, orthonormal
from ident.diagnose.search import Candidate
from ident.diagnose.trials import Trial
from ident.effects import Correcting, Effect
from ident.equations.samples import reduced as in_independent
from ident.equations.terms import unbalanced
from ident.errors import IdentError
from ident.fit.table import Table
from ident.motion import Experiment, Motion, complete
from ident.motion.place import reduced

SMALL = 1e-3  # share of a joint's torque that is never trusted
WORSE = 10.0  # times the present log's largest ‖K⁺‖: nearer no trial goes to a singular position


@dataclass(frozen=True, eq=False)
class Probe:
    """A trial with its rows, the model projected out."""

    trial: Trial
    table: Table
    screen: Screen
    memo: dict[str, list[np.ndarray]] = field(default_factory=dict)
    spans: dict[str, list[np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of(cls, d: Diagnosis, trial: Trial) -> Probe | None:
        """None where the mechanism cannot follow, or exceeds limits that it keeps now."""
        fit = d.fit
        try:
            motion = complete(fit.mechanism, trial.logs, cutoff=None, torques=False)
            runs = [_loaded(d, _with_extra(e, fit.motion)) for e in motion.experiments]
            motion = replace(motion, experiments=tuple(runs), independent=fit.motion.independent)
            if not allowed(fit.mechanism, fit.motion, motion):
                return None
            table = Table.of(fit.mechanism, fit.columns, motion, fit.point)
            use = quiet(table)
            rows = np.maximum(use.sum(axis=0), 1)
            sigma = _noise(d, table) * np.sqrt(rows / _length(fit.motion))
            held = np.zeros(len(fit.columns), dtype=bool)
            return cls(trial, table, Screen.of(table, use, sigma, held))
        except (IdentError, np.linalg.LinAlgError, ValueError, ArithmeticError):
            return None

    def columns(self, effect: Effect, shapes: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """Weighted columns (M, unknowns) of an effect at shapes given and at its usual starts."""
        if effect.label not in self.memo:
            if isinstance(effect, Correcting):
                zero = {each.name: effect.values.get(each.name, 0.0) for each in effect.shapes}
                names = [each.name for each in effect.searched]
                x = np.stack([self.table.sensitivity(effect, zero, n) for n in names], axis=-1)
                self.memo[effect.label] = [self.screen.taken(x)]
            else:
                tried = [*shapes, *(self.table.starts(effect) if effect.searched else [])] or [{}]
                felt, u = self.table.felt(effect), len(effect.unknowns)
                order = np.argsort(felt)
                x = self.table.with_effect(effect, tried)[:, order]
                C = self.screen.taken(x, felt[order])
                self.memo[effect.label] = [C[:, i : i + u] for i in range(0, C.shape[1], u)]
        return self.memo[effect.label]

    def separation(self, a: Candidate, b: Candidate) -> tuple[float, float]:
        """Standard errors by which two rivals differ after refitting, and that as a share of what
        they explain: the lesser of both ways, unless one can always do what the other does.
        """
        if a.parameters != b.parameters and a.effect.joints == b.effect.joints:
            a, b = sorted((a, b), key=lambda each: -each.parameters)
            return self._left(a, b)
        found = [self._left(a, b), self._left(b, a)]
        return min(one for one, _ in found), min(share for _, share in found)

    def _left(self, a: Candidate, b: Candidate) -> tuple[float, float]:
        C = self.columns(a.effect, [a.shape])[0]
        names = a.effect.unknowns or a.effect.searched
        signal = self.screen.projected(C @ a.judged.theta[: len(names)])
        size = float(np.linalg.norm(signal))
        left = min(float(np.linalg.norm(signal - Q @ (Q.T @ signal))) for Q in self._spans(b))
        return left, left / max(size, 1e-300)

    def _spans(self, b: Candidate) -> list[np.ndarray]:
        """Orthonormal columns (M, ≤ unknowns) beside the model, at every shape."""
        if b.effect.label not in self.spans:
            columns = self.columns(b.effect, [b.shape])
            self.spans[b.effect.label] = [orthonormal(self.screen.projected(C)) for C in columns]
        return self.spans[b.effect.label]

    def visible(self, effect: Effect) -> float:
        """The largest share of an effect's columns that the model does not have."""
        shares = [0.0]
        for C in self.columns(effect, []):
            size = float(np.linalg.norm(C))
            if size > 1e-9 * float(np.sqrt(len(C))):
                shares.append(self.screen.judge(C).visible)
        return max(shares)


def _with_extra(e: Experiment, now: Motion) -> Experiment:
    """The log's other columns, at rest at what they usually are."""
    seen = now.experiments[0].extra
    usual = {name: np.full(len(e), float(np.median(x))) for name, x in seen.items()}
    return replace(e, extra={**usual, **e.extra})


def _loaded(d: Diagnosis, e: Experiment) -> Experiment:
    """With the torques that the fitted model predicts, in the diagnosis's own coordinates."""
    mechanism, names = d.fit.mechanism, d.fit.motion.independent
    if mechanism.closures:
        e, _, said = reduced(mechanism, e, names)
        worst = max(float(_size(each).max()) for each in d.fit.motion.experiments)
        if said or float(_size(e).max()) > WORSE * worst:
            raise ValueError("near a singular position")
    needed = -unbalanced(in_independent(mechanism, e, slice(None), d.fit.point), d.fit.point)
    if e.leverage is None:
        return replace(e, tau=needed[:, [mechanism.joint(n).index for n in mechanism.driven]])
    L = e.leverage[:, [mechanism.joint_index[name] for name in mechanism.driven]]
    return replace(e, tau=np.einsum("ndj,nd->nj", np.linalg.pinv(L, rcond=1e-6), needed))


def _size(e: Experiment) -> np.ndarray:
    assert e.pinv is not None
    return np.linalg.norm(e.pinv[e.usable], axis=(1, 2))


def _noise(d: Diagnosis, table: Table) -> np.ndarray:
    """(d,) of the present log's rows, more where the trial's torque is larger [N m | N]."""
    found = []
    for u, name in enumerate(d.fit.motion.independent):
        torque = float(np.sqrt(np.mean(table.tau[:, u] ** 2)))
        error = d.fit.train[name]
        now = error.rms / error.relative if error.relative else torque
        found.append(max(d.floor[name] * max(1.0, torque / max(now, 1e-300)), SMALL * torque))
    return np.maximum(np.array(found), 1e-12)


def _length(motion: Motion) -> float:
    """Rows of the present log that are worth an independent one."""
    samples = [float(e.usable.sum()) for e in motion.experiments]
    if motion.band.cutoff is None:
        return sum(samples)
    cut = 2 * motion.band.cutoff
    return sum(n * min(1.0, cut / e.rate) for n, e in zip(samples, motion.experiments, strict=True))
