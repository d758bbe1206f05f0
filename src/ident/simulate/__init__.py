"""Logs of the model itself: torques of a given motion, and the motion of given forces."""

from ident.simulate.drives import PD, ComputedTorque, Torques
from ident.simulate.integrate import Run, integrate
from ident.simulate.integration import Transition
from ident.simulate.inverse import Noise, simulate
from ident.simulate.replay import Replay, replay

__all__ = [
    "PD",
    "ComputedTorque",
    "Noise",
    "Replay",
    "Run",
    "Torques",
    "Transition",
    "integrate",
    "replay",
    "simulate",
]
