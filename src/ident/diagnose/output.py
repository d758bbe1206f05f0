"""diagnosis.json, report.html, and the grown mechanism's folder; each set whole or not at all."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.diagnose.explanation import name_of
from ident.diagnose.report import diagnosis_html, history_html
from ident.errors import IdentError
from ident.files import write_all
from ident.fit import Fit
from ident.fit.output import multipliers_csv
from ident.fit.saved import fit_json
from ident.mechanism import Mechanism
from ident.mechanism.write import folder_files
from ident.show.html import Section

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis
    from ident.diagnose.grow import History

SCHEMA = "ident.diagnosis/1"
SUGGESTION = "suggestion.py"


def diagnosis_json(d: Diagnosis) -> dict[str, Any]:
    """The content of diagnosis.json; what is not finite is None."""
    found: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "mechanism": d.fit.mechanism.name,
            "logs": [e.name for e in d.fit.motion.experiments],
            "effects": [name_of(effect) for effect in d.fit.mechanism.effects],
            "verdict": d.verdict,
            "where": [{**each.json, "floor": d.floor[each.joint]} for each in d.where],
            "candidates": [each.json() for each in d.candidates],
            "best": None if d.best is None else name_of(d.best),
            "invisible": [each.json() for each in d.invisible],
            "unsupported": [each.json() for each in d.unsupported],
            "suggestion": None if d.suggestion is None else d.suggestion.json(),
            "health": d.health.json(),
            "judged": len(d.choice.evidence),
            "next_experiment": d.next_experiment,
            "text": d.text,
        }
    )
    return found


def plain(value: Any) -> Any:
    """As JSON can hold it: numbers of Python, None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def write_diagnosis(
    d: Diagnosis,
    folder: str | Path,
    more: Mapping[str, bytes] | None = None,
    sections: Sequence[Section] = (),
) -> list[Path]:
    """diagnosis.json, report.html, and suggestion.py where there is a suggestion.

    Args:
        d: what to write.
        folder: made if it is not there.
        more: further files by name.
        sections: at the beginning of the report.

    Returns:
        The files written, all of them or none.

    Raises:
        IdentError: if the folder cannot be written.
    """
    report = diagnosis_html(d, sections)
    return write_all(Path(folder), {**_data(d), **(more or {}), "report.html": report})


def write_history(history: History, folder: str | Path) -> list[Path]:
    """The grown mechanism's folder, with the last fit, diagnosis and a report of the ladder.

    What was unknown is unknown in it as well: values are in fit.json.

    Returns:
        The files written, all of them or none.

    Raises:
        IdentError: if it is the folder of the mechanism itself, or cannot be written.
    """
    refuse_own(history.mechanism, Path(folder))
    data = {**_data(history.diagnosis), "report.html": history_html(history)}
    return write_all(Path(folder), model_files(history.fit) | data)


def model_files(fit: Fit) -> dict[str, bytes]:
    """The folder of a fit's mechanism, unknown what was unknown, with fit.json and multipliers."""
    mechanism = fit.mechanism
    effects = [(effect, effect.values) for effect in mechanism.effects]
    files = folder_files(mechanism, mechanism.urdf.read_bytes(), effects, unknown=None)
    return files | {"fit.json": _json(fit_json(fit)), "multipliers.csv": multipliers_csv(fit)}


def refuse_own(mechanism: Mechanism, folder: Path) -> None:
    """What a program has grown must not replace what a person wrote.

    Raises:
        IdentError: if `folder` holds the mechanism's own files.
    """
    own = [path for path in (mechanism.toml, mechanism.urdf) if path is not None]
    for path in own:
        if path.parent.resolve() == folder.resolve():
            raise IdentError(
                f"{folder}: holds {path.name} of the mechanism itself, which is not overwritten; "
                "name another folder, or change it with `ident add`"
            )


def _data(d: Diagnosis) -> dict[str, bytes]:
    files = {"diagnosis.json": _json(diagnosis_json(d))}
    if d.suggestion is not None:
        files[SUGGESTION] = d.suggestion.code.encode()
    return files


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False).encode() + b"\n"
