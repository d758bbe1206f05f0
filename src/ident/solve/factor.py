"""Old names of `ident.information.triangle`."""

from ident.information.triangle import Array, Triangle
from ident.information.triangle import Triangle as Factor

__all__ = ["Array", "Factor", "Triangle"]
