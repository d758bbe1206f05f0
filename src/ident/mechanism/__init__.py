"""The mechanism: read from a URDF and a mechanism.toml, with closures as CasADi functions."""

from ident.mechanism.load import load
from ident.mechanism.mechanism import Joint, Mechanism, Multipliers, multipliers
from ident.mechanism.parameters import Consistency

__all__ = ["Consistency", "Joint", "Mechanism", "Multipliers", "load", "multipliers"]
