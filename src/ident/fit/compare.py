"""Models against measurement on one motion, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from ident.errors import FitError
from ident.files import Written
from ident.fit.files import Saved
from ident.fit.prediction import Prediction, predict
from ident.fit.residual import Charted, Failure, Residual, residual_of
from ident.fit.result import Fit
from ident.information.blocks import Error
from ident.motion import Motion
from ident.progress import Progress


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Charted, Written):
    """One or several models on the same motion. Made by `ident.compare`.

    Attributes:
        residuals: residual of each model, by its name.
        fitted: errors of each model's own fit, by name: `train`, `held out`, and logs it was
            validated on; by joint.
    """

    residuals: Mapping[str, Residual]
    fitted: Mapping[str, Mapping[str, Mapping[str, Error]]]

    @property
    def errors(self) -> dict[str, dict[str, Error]]:
        """Errors on this motion, by model, then joint."""
        return {name: residual.errors for name, residual in self.residuals.items()}

    @property
    def where(self) -> dict[str, tuple[Failure, ...]]:
        """Where each model fails, the joint with the largest share first."""
        return {name: residual.where for name, residual in self.residuals.items()}

    @cached_property
    def predictions(self) -> dict[str, list[Prediction]]:
        """Predictions of each model, one an experiment, at full rate and unfiltered."""
        return {
            name: predict(r.model.mechanism, r.motion, r.model.point)
            for name, r in self.residuals.items()
        }

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the independent joints' torques."""
        return next(iter(self.residuals.values())).units


def compare(
    *models: Fit | Saved, motion: Motion | None = None, progress: Progress | None = None
) -> Comparison:
    """Compare models with measurement on one motion.

    Args:
        models: fits, or fit.json files read back.
        motion: on which to compare; default: the one that the first fit was made from.
        progress: called with (what is being done, share done).

    Raises:
        FitError: if there is no model, or no motion to compare on.
    """
    if not models:
        raise FitError("nothing to compare; give one fit or several")
    for model in models:
        if not isinstance(model, Fit | Saved):
            kind = type(model).__name__
            raise FitError(f"compare needs fits, given: {kind}; a motion goes by name: motion=…")
    motion = models[0].motion if motion is None else motion
    residuals: dict[str, Residual] = {}
    fitted: dict[str, Mapping[str, Mapping[str, Error]]] = {}
    for i, model in enumerate(models):
        name = f"fit {i + 1}" if isinstance(model, Fit) and len(models) > 1 else ""
        residual = residual_of(model, motion, name=name)
        residuals[residual.name] = residual
        fitted[residual.name] = model.errors
        if progress:
            progress(f"where {residual.name} fails", (i + 0.5) / len(models))
    return Comparison(residuals, fitted)
