"""Tasks spread over this process, local processes or a Dask cluster; knows no robot."""

from ident.pool.spread import Done, cores, spread

__all__ = ["Done", "cores", "spread"]
