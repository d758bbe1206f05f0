"""Ports of pages that are served on this machine and nowhere else."""

from __future__ import annotations

import errno
import os
import socket

from ident.errors import IdentError

HOST = "127.0.0.1"


def free_port(port: int) -> int:
    """Return the port asked for if it is free, or any that is for 0.

    Raises:
        IdentError: if it cannot be had.
    """
    if not 0 <= port <= 65535:
        raise IdentError(f"port {port}: there is none; valid: 1 to 65535, or 0 for a free one")
    with socket.socket() as trial:
        if os.name == "posix":  # elsewhere it would let two programs share a port
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, port))
        except OSError as error:
            raise refused(port, error) from None
        return int(trial.getsockname()[1])


def refused(port: int, error: OSError | None = None) -> IdentError:
    """Return the error of a port that cannot be had, or that somebody else was faster to take."""
    taken = error is None or error.errno == errno.EADDRINUSE
    why = "is taken" if taken else f"cannot be had: {error}"
    return IdentError(f"port {port}: {why} on {HOST}; give another one, or none for a free one")
