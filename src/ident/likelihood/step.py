"""Former place of names that stand in `ident.equations.motion_noise` now."""

from ident.equations.motion_noise import STICKING, Linear, Run, linear, rows_cutoff  # noqa: F401
