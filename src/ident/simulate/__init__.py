"""Logs of the model itself."""

from ident.simulate.inverse import Noise, simulate

__all__ = ["Noise", "simulate"]
