"""One model tried by hand, with all that is known of it so far."""

from __future__ import annotations

from dataclasses import dataclass

from ident.diagnose import Diagnosis
from ident.diagnose.explanation import errors_of, fall_of
from ident.diagnose.grow import Step
from ident.effects import Effect
from ident.explore.announce import Announced
from ident.fit import Fit
from ident.residual.error import Error

START = "as given"
GROWN = 1.05  # times, from which a joint's error has grown


@dataclass(frozen=True, eq=False)
class Rung:
    """A rung of the ladder.

    Attributes:
        added, removed: what was changed; neither on the first rung.
        fit: everything refitted.
        announced: the fall that was announced for this change, as a share; None if none was.
        delivered: the fall that the refit brought, in the same rows; None where they are others.
        fall: of the held-out squares on all rows, as on the ladder of `grow`.
        candidates: what is announced for the next change; None before that has been worked out.
        diagnosis: None before it was asked for.
    """

    added: Effect | None
    removed: Effect | None
    fit: Fit
    announced: float | None = None
    delivered: float | None = None
    fall: float = 0.0
    candidates: tuple[Announced, ...] | None = None
    diagnosis: Diagnosis | None = None

    @classmethod
    def after(
        cls, before: Rung, fit: Fit, *, added: Effect | None = None, removed: Effect | None = None,
        announced: float | None = None, delivered: float | None = None,
    ) -> Rung:  # fmt: skip
        """The rung after another."""
        fall = fall_of(errors_of(before.fit), errors_of(fit))
        return cls(added, removed, fit, announced, delivered, fall)

    @property
    def name(self) -> str:
        """`+ viscous:elbow`."""
        if self.added is not None:
            return f"+ {self.added.label}"
        return START if self.removed is None else f"− {self.removed.label}"

    @property
    def errors(self) -> dict[str, Error]:
        """Held out, by joint; of the fitted data where the log is too short for that."""
        return errors_of(self.fit)

    def risen(self, before: Rung) -> list[str]:
        """What is to be said of joints whose error has grown though another's has fallen."""
        said = []
        for joint, error in self.errors.items():
            old = before.errors.get(joint)
            if old is not None and error.rms > GROWN * old.rms:
                said.append(
                    f"{self.name}: the held-out error of {joint} has grown from {old.rms:.3g} to "
                    f"{error.rms:.3g} {error.unit}; {self._why_risen(joint)}"
                )
        return said

    def _why_risen(self, joint: str) -> str:
        """Weights are a reason only where several joints share them."""
        alone, gone = len(self.errors) == 1, self.removed
        if gone is not None and (alone or joint in gone.joints or not gone.joints):
            return f"what {gone.label} explained is left now"
        if gone is not None:
            return "what it explained may be left there, or joints weigh otherwise than before"
        if alone:
            return "what the effect follows in some stretches of time does not hold in the others"
        return (
            "every joint weighs by what is left in it, so those that fit better now count for more"
        )

    @property
    def step(self) -> Step:
        """As `grow` has it."""
        removed = () if self.removed is None else (self.removed,)
        return Step(self.added, removed, (), self.fit, self.fall, self.errors)
