"""The verb `explore`: a page in Jupyter or a browser on which effects are added by hand."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ident.errors import MechanismError
from ident.explore.exploration import Exploration
from ident.explore.needed import check_panel, load_in_jupyter, without_network
from ident.log import Log
from ident.mechanism import Mechanism
from ident.motion import Motion, complete

if TYPE_CHECKING:
    from ident.explore.board import Board

File = str | os.PathLike[str]
Logs = Log | File | Sequence[Log | File]


def explore(mechanism: Mechanism, log: Motion | Logs) -> Board:
    """Effects added and removed by a click, while the error falls.

    Args:
        mechanism: to start from.
        log: one or several, or their files, or the completed motion.

    Returns:
        A widget, which Jupyter shows as it is; `widget.exploration` is what was found by hand.

    Raises:
        MechanismError: if it is given no mechanism.
        IdentError: for a log that does not fit the mechanism, or if Panel is not installed.
    """
    if not isinstance(mechanism, Mechanism):
        raise MechanismError(
            f"explore needs a mechanism, given: {type(mechanism).__name__}; write "
            "ident.explore(ident.load(folder), log)"
        )
    check_panel()
    motion = log if isinstance(log, Motion) else complete(mechanism, log)
    load_in_jupyter()
    from ident.explore.board import Board

    return without_network(Board(Exploration.of(mechanism, motion).screened()))
