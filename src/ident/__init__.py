"""ident finds out what is true of a mechanism from logged data.

mechanism = ident.load("robots/slider_crank")
motion = ident.complete(mechanism, ident.read_log("run.csv"))
fit = ident.identify(mechanism, motion)
print(fit)
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from ident.display import set_loader
from ident.files import version as _version

if TYPE_CHECKING:
    from ident.public import *  # noqa: F403
    from ident.public import __all__ as __all__

    __version__: str

VERBS = frozenset(
    ("effects", "excite", "export", "simulate")
)  # packages that are functions' names, too


class _Ident(ModuleType):
    """Names are imported when the first of them is used, so that `ident --help` need not wait."""

    def __getattr__(self, name: str) -> object:
        if name == "__version__":
            return _version()
        if name.startswith("__") and name != "__all__":
            raise AttributeError(name)
        public = import_module("ident.public")
        if name != "__all__" and name not in public.__all__:
            raise AttributeError(f"module 'ident' has no attribute '{name}'")
        return getattr(public, name)

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in VERBS and isinstance(value, ModuleType)):
            super().__setattr__(name, value)

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return import_module, (self.__name__,)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *import_module("ident.public").__all__, "__version__"})


def _load_renderers(kind: type) -> None:
    import_module("ident.show").load(kind)


set_loader(_load_renderers)
sys.modules[__name__].__class__ = _Ident
