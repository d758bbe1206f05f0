"""`--out DIR`: everything a fit has to say, as files."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
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
from ident.show.html import Section

if TYPE_CHECKING:
    from ident.fit.fit import Fit


def write_fit(
    fit: Fit,
    folder: str | Path,
    reactions: Reactions | None = None,
    multipliers: Path | None = None,
    more: Mapping[str, bytes] | None = None,
    sections: Sequence[Section] = (),
) -> list[Path]:
    """fit.json, multipliers.csv, identified.urdf, report.html and the folder identified/.

    Args:
        fit: what to write.
        folder: made if it is not there.
        reactions: known ones, which the report draws beside the multipliers.
        multipliers: a file in the folder that becomes multipliers.csv, where the fit's motion is
            an excerpt.
        more: further files by name.
        sections: after the errors in the report.

    Returns:
        The files written, all of them or none.

    Raises:
        IdentError: if the folder cannot be written.
        FitError: if a body's identified inertia cannot be said in a URDF.
    """
    urdf = identified_urdf(fit)
    files: dict[str, bytes | Path] = {
        "fit.json": json.dumps(fit_json(fit), indent=1, ensure_ascii=False).encode() + b"\n",
        "multipliers.csv": multipliers or multipliers_csv(fit),
        "identified.urdf": urdf,
        "report.html": report_html(fit, reactions, sections),
        **(more or {}),
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
    several = len(fit.motion.experiments) > 1
    return b"".join(
        multipliers_rows(names, t, values, e.name if several else None, header=not number)
        for number, (e, (t, values)) in enumerate(
            zip(fit.motion.experiments, fit.multipliers, strict=True)
        )
    )


def multipliers_rows(
    names: Sequence[str], t: np.ndarray, values: np.ndarray, log: str | None, header: bool
) -> bytes:
    """Rows of multipliers.csv: t (n,) [s] and values (n, m); `log` is the name of theirs, if there
    are several.
    """
    columns: dict[str, np.ndarray | list[str]] = {"t": t}
    columns |= {name: values[:, i] for i, name in enumerate(names)}
    if log is not None:
        columns["log"] = [log] * len(t)
    stream = io.BytesIO()
    pl.DataFrame(columns).fill_nan(None).write_csv(stream, include_header=header)
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
