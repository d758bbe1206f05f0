"""ident finds out what is true of a mechanism from logged data.

mechanism = ident.load("robots/slider_crank")
motion = ident.complete(mechanism, ident.read_log("run.csv"))
fit = ident.identify(mechanism, motion)
print(fit)
"""

from importlib.metadata import PackageNotFoundError, version

from ident.diagnose import Diagnosis, History, diagnose, grow
from ident.effects import KINDS as effects
from ident.effects import Effect, read_user_effect, user_effect
from ident.effects import create as effect
from ident.errors import FitError, IdentError, LogError, MechanismError, MotionError
from ident.excite import Excitation, Limits, excite
from ident.fit import Fit, identify
from ident.fit.output import write_fit
from ident.fit.saved import Saved, read_fit
from ident.health import Health, health
from ident.log import Column, Log, read_log
from ident.mechanism import Consistency, Mechanism, Multipliers, load
from ident.mechanism.absolute import absolute
from ident.montecarlo import MonteCarlo, monte_carlo
from ident.motion import Motion, complete
from ident.residual import Comparison, Residual, compare, residual_of, where
from ident.simulate import (
    PD,
    ComputedTorque,
    Noise,
    Replay,
    Run,
    Torques,
    integrate,
    replay,
    simulate,
)

try:
    __version__ = version("ident")
except PackageNotFoundError:  # run from a checkout that is not installed
    __version__ = "0"

__all__ = [
    "PD",
    "Column",
    "Comparison",
    "ComputedTorque",
    "Consistency",
    "Diagnosis",
    "Effect",
    "Excitation",
    "Fit",
    "FitError",
    "Health",
    "History",
    "IdentError",
    "Limits",
    "Log",
    "LogError",
    "Mechanism",
    "MechanismError",
    "MonteCarlo",
    "Motion",
    "MotionError",
    "Multipliers",
    "Noise",
    "Replay",
    "Residual",
    "Run",
    "Saved",
    "Torques",
    "absolute",
    "compare",
    "complete",
    "diagnose",
    "effect",
    "effects",
    "excite",
    "grow",
    "health",
    "identify",
    "integrate",
    "load",
    "monte_carlo",
    "read_fit",
    "read_log",
    "read_user_effect",
    "replay",
    "residual_of",
    "simulate",
    "user_effect",
    "where",
    "write_fit",
]
