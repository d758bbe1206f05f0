"""Monte Carlo studies: how noise of a log changes parameters, estimator beside estimator."""

from ident.montecarlo.estimators import ESTIMATORS, Estimator, paper
from ident.montecarlo.montecarlo import MonteCarlo, Studies, monte_carlo, monte_carlo_each

__all__ = [
    "ESTIMATORS",
    "Estimator",
    "MonteCarlo",
    "Studies",
    "monte_carlo",
    "monte_carlo_each",
    "paper",
]
