"""The public names, each from where it is defined; `ident` has them all.

Long work shows a bar, if it is not given `display`.
"""

from ident.assess.exploration import Exploration
from ident.diagnosis import Diagnosis, Health, History, diagnose, grow, health
from ident.effects import KINDS as effects
from ident.effects import Effect, read_user_effect, user_effect
from ident.effects import create as effect
from ident.errors import FitError, IdentError, LogError, MechanismError, MotionError
from ident.excite import Excitation, Limits, PosePlan, excite, excite_poses
from ident.export import Export, export
from ident.fit import Fit, identify
from ident.fit.files import Saved, read_fit, write_fit
from ident.fit.identify import Comparison, compare
from ident.fit.residual import Residual, residual_of, where
from ident.log import Column, Log, read_log
from ident.mechanism import Consistency, Mechanism, Multipliers, load
from ident.mechanism.load import absolute
from ident.montecarlo import MonteCarlo, monte_carlo
from ident.motion import Motion, complete
from ident.show.board import explore
from ident.show.progress import watched
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
from ident.streams.gather import Gathered, gather
from ident.streams.many_logs import Verdicts, diagnose_each
from ident.streams.monitor import Alarm, Monitor
from ident.streams.online import Online, Snapshot

compare, complete, diagnose = watched(compare), watched(complete), watched(diagnose)
diagnose_each, excite, explore = watched(diagnose_each), watched(excite), watched(explore)
export = watched(export)
gather, grow, identify = watched(gather), watched(grow), watched(identify)
integrate, monte_carlo, replay = watched(integrate), watched(monte_carlo), watched(replay)

__all__ = [
    "PD", "Alarm", "Column", "Comparison", "ComputedTorque", "Consistency", "Diagnosis", "Effect",
    "Excitation", "Exploration", "Export", "Fit", "FitError", "Gathered", "Health", "History",
    "IdentError", "Limits", "Log", "LogError", "Mechanism", "MechanismError", "Monitor",
    "MonteCarlo", "Motion", "MotionError", "Multipliers", "Noise", "Online", "PosePlan",
    "Replay", "Residual", "Run", "Saved", "Snapshot", "Torques", "Verdicts", "absolute",
    "compare", "complete", "diagnose",
    "diagnose_each", "effect", "effects", "excite", "excite_poses", "explore", "export", "gather",
    "grow", "health", "identify", "integrate", "load", "monte_carlo", "read_fit", "read_log",
    "read_user_effect", "replay", "residual_of", "simulate", "user_effect", "where", "write_fit",
]  # fmt: skip
