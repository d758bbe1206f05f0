"""The installed version of ident."""


def version() -> str:
    """Return the version of ident, "0" of a checkout that is not installed."""
    from importlib import metadata  # `ident --help` need not wait for it

    try:
        return metadata.version("ident")
    except metadata.PackageNotFoundError:
        return "0"
