"""Former place of names that are in `ident.log.read` now."""

from ident.log.read import expanded, is_folder_of_logs, logs_in, names_of

__all__ = ["expanded", "is_folder_of_logs", "logs_in", "names_of"]
