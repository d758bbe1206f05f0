"""Former place of names of `ident.mechanism.description` and `ident.mechanism.urdf`."""

from typing import Any

NAMES = {"Source": "Description", "read_source": "read_description", "source_of": "description_of"}


def moved(name: str) -> Any:
    """Return what a name stands for; imported when it is asked for."""
    from ident.mechanism import description, urdf

    if name.startswith("__"):
        raise AttributeError(name)
    name = NAMES.get(name, name)
    return getattr(description if hasattr(description, name) else urdf, name)
