"""Every form that a module of `show` registers is found from the class alone."""

from importlib import import_module
from pkgutil import iter_modules

import ident.show
from ident import display


def test_no_form_depends_on_what_else_was_imported():
    for module in iter_modules(ident.show.__path__):
        import_module(f"ident.show.{module.name}")
    lost = []
    for (kind, form), renderer in display._renderers.items():
        package = kind.__module__.removeprefix("ident.").partition(".")[0]
        module = renderer.__module__.removeprefix("ident.show").lstrip(".").partition(".")[0]
        below = not renderer.__module__.startswith("ident.show")
        known = below or not module or module in ident.show.MODULES.get(package, ())
        beside = renderer.__module__ == kind.__module__  # which is there with the class
        lost += [] if known or beside else [(kind, form, renderer.__module__)]
    assert not lost
