"""Γ under its former name."""

from ident.motion.regressor import regressor, supports

__all__ = ["regressor", "supports"]
