"""Old name of `ident.show.charts`, until all callers use the new one."""

from ident.show.charts import *  # noqa: F403
