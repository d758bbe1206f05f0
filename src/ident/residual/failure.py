"""How a model fails in one joint: how much, when, in which regime, and on what that depends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ident.display import Displayed
from ident.residual.noise import Memory
from ident.residual.regimes import Regime
from ident.residual.windows import Window


@dataclass(frozen=True)
class Dependence:
    """A signal on which a residual depends.

    Attributes:
        signal: `q.<joint>`, `v.`, `a.`, `load.`, `sign(v).` or `t`.
        r2: what it adds to the share of the residual's variance that is explained, held out.
        seen: what a person sees when the residual is drawn against it.
    """

    signal: str
    r2: float
    seen: str

    def __str__(self) -> str:
        return f"{self.signal} (R² {self.r2:.2f}: {self.seen})"


@dataclass(frozen=True, repr=False)
class Failure(Displayed):
    """How the model fails in one joint.

    Attributes:
        joint: an independent one; unit: of its torque.
        rms, relative: of the residual; share: of the weighted sum of squares over all joints.
        offset: mean of the residual [N m | N].
        worst: stretches of time that stand out, the worst first.
        regimes: of the joint's motion, the most conspicuous first.
        depends_on: signals, the most important first.
        memory: autocorrelation beyond the filter's reach, and its threshold.
        repeats: correlation of the residual between periods of the motion, if the log has any.
        threshold: R² below which a signal explains no more than it would of noise.
        white: whether the residual is noise: no memory, no signal above the threshold, and nothing
            that repeats with the motion.
    """

    joint: str
    unit: str
    rms: float
    relative: float | None
    share: float
    offset: float
    worst: tuple[Window, ...]
    regimes: tuple[Regime, ...]
    depends_on: tuple[Dependence, ...]
    memory: Memory
    repeats: float | None
    threshold: float
    white: bool

    @property
    def stands_out(self) -> tuple[Regime, ...]:
        """The regimes in which the residual is larger than elsewhere."""
        return tuple(regime for regime in self.regimes if regime.stands_out)

    @property
    def json(self) -> dict[str, Any]:
        """As `where` of diagnosis.json has it, and the figures behind."""
        return {
            "joint": self.joint,
            "rms": self.rms,
            "relative": self.relative,
            "unit": self.unit,
            "share": self.share,
            "offset": self.offset,
            "depends_on": [each.signal for each in self.depends_on],
            "r2": [each.r2 for each in self.depends_on],
            "seen": [each.seen for each in self.depends_on],
            "r2_threshold": self.threshold,
            "worst": [[each.start, each.stop] for each in self.worst],
            "worst_log": [each.experiment for each in self.worst],
            "regimes": {each.name: each.ratio for each in self.regimes},
            "stands_out": [each.name for each in self.stands_out],
            "autocorrelation": self.memory.value,
            "autocorrelation_threshold": self.memory.threshold,
            "repeats": self.repeats,
            "white": self.white,
        }
