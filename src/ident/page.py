"""Old name of `ident.show.html`, until all callers use the new one."""

from ident.show.html import *  # noqa: F403
