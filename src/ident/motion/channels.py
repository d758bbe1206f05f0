"""Former place of names that stand in `ident.motion.signals` now."""

from ident.motion.signals import Channel, Smoothed, channels_of, grain, periods  # noqa: F401
