"""Monte Carlo: what noise of a log does to parameters, estimator beside estimator."""

from ident.montecarlo.estimators import ESTIMATORS, Estimator, paper
from ident.montecarlo.many import Studies, monte_carlo_each
from ident.montecarlo.montecarlo import MonteCarlo
from ident.montecarlo.run import monte_carlo

__all__ = [
    "ESTIMATORS",
    "Estimator",
    "MonteCarlo",
    "Studies",
    "monte_carlo",
    "monte_carlo_each",
    "paper",
]
