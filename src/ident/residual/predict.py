"""Old names of `ident.fit.residual`, until all callers have moved."""

from ident.fit.residual import NOTHING, Prediction, generalised, predict

__all__ = ["NOTHING", "Prediction", "generalised", "predict"]
