"""The mechanism: read from a URDF and a mechanism.toml, with closures as CasADi functions."""

from ident.mechanism.consistency import Consistency
from ident.mechanism.load import load, multipliers
from ident.mechanism.mechanism import Joint, Mechanism, Multipliers

__all__ = ["Consistency", "Joint", "Mechanism", "Multipliers", "load", "multipliers"]
