"""Former place of names that stand in `ident.equations.motion_noise` now."""

from ident.equations.motion_noise import STICKING, EliminatedRun, Linear, linear, rows_cutoff

Run = EliminatedRun

__all__ = ["STICKING", "Linear", "Run", "linear", "rows_cutoff"]
