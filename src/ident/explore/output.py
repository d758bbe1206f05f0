"""The present model of an exploration as files; all of them or none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ident.diagnose import History
from ident.diagnose.output import model_files, refuse_own, write_history
from ident.explore.rung import Rung
from ident.files import write_all


def write_exploration(rungs: Sequence[Rung], folder: str | Path) -> list[Path]:
    """What `ident grow --out` writes if the present model is judged, else mechanism and fit.

    Raises:
        IdentError: if it is the folder of the mechanism itself, or cannot be written.
    """
    now, folder = rungs[-1], Path(folder)
    if now.diagnosis is not None:
        return write_history(History(tuple(rung.step for rung in rungs), now.diagnosis), folder)
    refuse_own(now.fit.mechanism, folder)
    return write_all(folder, model_files(now.fit))
