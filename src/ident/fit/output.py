"""`--out DIR`: everything a fit has to say, as files."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ident.errors import FitError
from ident.files import write_all
from ident.fit.reactions import Reactions
from ident.fit.report import report_html
from ident.fit.saved import fit_json
from ident.fit.urdf import identified_urdf
from ident.mechanism.write import folder_files

if TYPE_CHECKING:
    from ident.fit.fit import Fit


def write_fit(fit: Fit, folder: str | Path, reactions: Reactions | None = None) -> list[Path]:
    """fit.json, multipliers.csv, identified.urdf, report.html and the folder identified/.

    Args:
        fit: what to write.
        folder: made if it is not there.
        reactions: known ones, which the report draws beside the multipliers.

    Returns:
        The files written, all of them or none.

    Raises:
        IdentError: if the folder cannot be written.
        FitError: if a body's identified inertia cannot be said in a URDF.
    """
    urdf = identified_urdf(fit)
    files = {
        "fit.json": json.dumps(fit_json(fit), indent=1, ensure_ascii=False).encode() + b"\n",
        "multipliers.csv": multipliers_csv(fit),
        "identified.urdf": urdf,
        "report.html": report_html(fit, reactions),
    }
    known = [
        (effect, {u.name: float(v) for u, v in zip(effect.parameters, values, strict=True)})
        for effect, values in fit.effect_solution
    ]
    inside = folder_files(fit.mechanism, urdf, known, unknown=[])
    files |= {f"identified/{name}": content for name, content in inside.items()}
    return write_all(Path(folder), files)


def multipliers_csv(fit: Fit) -> bytes:
    """`t` and one column a multiplier, empty where it is not determined; of several logs, one below
    the other with a column `log`. A tree has no multipliers and no rows.
    """
    names = fit.mechanism.kinematics.multipliers
    if not names:
        return b"t\n"
    frames = []
    several = len(fit.motion.experiments) > 1
    for experiment, (t, values) in zip(fit.motion.experiments, fit.multipliers, strict=True):
        columns: dict[str, np.ndarray | list[str]] = {"t": t}
        columns |= {name: values[:, i] for i, name in enumerate(names)}
        if several:
            columns["log"] = [experiment.name] * len(t)
        frames.append(pl.DataFrame(columns).fill_nan(None))
    stream = io.BytesIO()
    pl.concat(frames).write_csv(stream)
    return stream.getvalue()


def write_urdf(fit: Fit, path: str | Path) -> Path:
    """identified.urdf alone.

    Raises:
        FitError: if a body's identified inertia cannot be said in a URDF.
    """
    path = Path(path)
    if path.suffix.lower() not in (".urdf", ".xml"):
        raise FitError(f"{path}: give a name that ends in .urdf")
    return write_all(path.parent, {path.name: identified_urdf(fit)})[0]
