"""Logs of the model itself: torques of a given motion, and the motion of given forces."""

from ident.simulate.integrate import PD, ComputedTorque, Run, Torques, integrate
from ident.simulate.inverse import Noise, simulate
from ident.simulate.replay import Replay, replay

__all__ = [
    "PD",
    "ComputedTorque",
    "Noise",
    "Replay",
    "Run",
    "Torques",
    "integrate",
    "replay",
    "simulate",
]
