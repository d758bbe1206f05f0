"""Logs of the model itself: torques of a given motion, and the motion that forces make."""

from ident.simulate.drives import PD, ComputedTorque, Torques
from ident.simulate.integrate import integrate
from ident.simulate.inverse import simulate
from ident.simulate.noise import Noise
from ident.simulate.replay import replay
from ident.simulate.replayed import Replay
from ident.simulate.run import Run
from ident.simulate.trace import Transition

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
