"""Faults of the data: wrong signs, units, columns, clocks, delays; logs that disagree.

Below `fit`: each fault is a hypothesis in the rows of a problem and its estimate.
"""

from ident.faults.data_checks import DataChecks, Health

__all__ = ["DataChecks", "Health"]
