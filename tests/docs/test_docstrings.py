"""Every argument of a public name is spoken of in its docstring, and every field of a noun."""

import dataclasses
import inspect
import re

import pytest

import ident

OBVIOUS = {"self", "cls", "args", "kwargs", "options"}


def subjects() -> list:
    """(name, docstring, names it must speak of) of every public callable and its methods."""
    found = []
    for name in ident.__all__:
        thing = getattr(ident, name)
        if not callable(thing):
            continue
        if not inspect.isclass(thing):
            found.append(pytest.param(inspect.getdoc(thing), _arguments(thing), id=name))
        elif not issubclass(thing, BaseException):
            if dataclasses.is_dataclass(thing):
                fields = [f.name for f in dataclasses.fields(thing) if f.repr]
                found.append(pytest.param(inspect.getdoc(thing), fields, id=name))
            found += _methods(name, thing)
    return found


def _methods(name: str, kind: type) -> list:
    return [
        pytest.param(inspect.getdoc(member), _arguments(member), id=f"{name}.{each}")
        for each, member in inspect.getmembers(kind)
        if not each.startswith("_")
        and (inspect.isfunction(member) or inspect.ismethod(member))
        and member.__module__.startswith("ident")
    ]


def _arguments(function) -> list[str]:
    return [name for name in inspect.signature(function).parameters if name not in OBVIOUS]


@pytest.mark.parametrize(("doc", "names"), subjects())
def test_every_argument_is_spoken_of(doc, names):
    assert doc, "no docstring"
    silent = [name for name in names if not re.search(rf"(?<![\w.]){re.escape(name)}\b", doc)]
    assert not silent, f"{silent} in: {doc}"


def test_all_that_raises_says_so():
    """A verb that reads what users wrote names its error."""
    for name in ("load", "read_log", "complete", "identify", "diagnose", "simulate", "excite"):
        assert "Raises:" in inspect.getdoc(getattr(ident, name)), name
