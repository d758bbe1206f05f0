"""Former place of names that stand in `ident.motion.spline` now."""

from ident.motion.spline import Smooth, fitted, residuals  # noqa: F401
