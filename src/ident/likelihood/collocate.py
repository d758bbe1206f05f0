"""Former place of names that stand in `ident.equations.motion_noise` now."""

from ident.equations.motion_noise import TorqueRows, weighed  # noqa: F401
