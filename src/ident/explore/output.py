"""The present model of an exploration as files; all of them or none."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from ident.diagnose import History
from ident.diagnose.output import refuse_own, write_history
from ident.explore.rung import Rung
from ident.files import write_all
from ident.fit.output import multipliers_csv
from ident.fit.saved import fit_json
from ident.mechanism.write import folder_files


def write_exploration(rungs: Sequence[Rung], folder: str | Path) -> list[Path]:
    """What `ident grow --out` writes if the present model is judged, else mechanism and fit.

    Raises:
        IdentError: if it is the folder of the mechanism itself, or cannot be written.
    """
    now, folder = rungs[-1], Path(folder)
    if now.diagnosis is not None:
        return write_history(History(tuple(rung.step for rung in rungs), now.diagnosis), folder)
    mechanism = now.fit.mechanism
    refuse_own(mechanism, folder)
    effects = [(effect, effect.values) for effect in mechanism.effects]
    files = folder_files(mechanism, mechanism.urdf.read_bytes(), effects, unknown=None)
    content = json.dumps(fit_json(now.fit), indent=1, ensure_ascii=False, allow_nan=False)
    files |= {
        "fit.json": content.encode() + b"\n",
        "multipliers.csv": multipliers_csv(now.fit),
    }
    return write_all(folder, files)
