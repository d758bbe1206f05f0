"""Old name of `ident.show.view3d`, until all callers use the new one."""

from ident.show.view3d import *  # noqa: F403
