"""Monte Carlo studies: how noise of a log changes parameters, estimator beside estimator."""

from ident.montecarlo.montecarlo import MonteCarlo, Studies, monte_carlo, monte_carlo_each
from ident.montecarlo.trial import ESTIMATORS, Estimator, paper

__all__ = [
    "ESTIMATORS",
    "Estimator",
    "MonteCarlo",
    "Studies",
    "monte_carlo",
    "monte_carlo_each",
    "paper",
]
