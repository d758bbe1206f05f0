"""One case through ident: what it says, as plain data that can be kept and scored again."""

from __future__ import annotations

import json
import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cases import Case, Hidden
from generate import Made, make
from sensors import Columns

import ident

Result = dict[str, Any]
REFITTED = ("visible", "loop", "quarter", "two", "parallelogram")  # the true effect can be added


def judge(case: Case, whole: bool = True) -> Result:
    """Runs ident on the case; whatever goes wrong is a result too.

    Args:
        case: the logs.
        whole: whether to make also what the category's first score does not need: the fits with the
            true effect, and, of two effects, the diagnosis before the first is added.
    """
    result: Result = {
        "name": case.name,
        "category": case.category,
        "mechanism": case.mechanism,
        "noise": case.noise,
        "encoder": case.encoder,
        "hidden": [told(h.kind, h.joints) for h in case.hidden],
    }
    try:
        made = make(case)
        begin = time.perf_counter()
        result["truth"] = dict(made.truth)
        with tempfile.TemporaryDirectory() as place:
            result |= asked(made, Path(place), whole)
        result["seconds"] = round(time.perf_counter() - begin, 1)
    except Exception:  # a crash must not end the battery; it counts as a miss
        result["error"] = traceback.format_exc(limit=-3)
    return result


def told(kind: str, joints: Sequence[str]) -> Result:
    return {"effect": kind, "joints": list(joints)}


def asked(made: Made, place: Path, whole: bool) -> Result:
    """Diagnosis, growth for two effects, and, of the whole, the fit with the true effect."""
    mechanism = ident.load(made.folder(place))
    motion = ident.complete(mechanism, read(made.logs))
    result: Result = {}
    if made.case.category == "two":
        history = ident.grow(mechanism, motion)  # type: ignore[attr-defined]
        result["added"] = [told(e.kind, e.joints) for e in history.added]
        result["grown"] = history.diagnosis.json()["verdict"]
        if not whole:
            return result
    fit = ident.identify(mechanism, motion)
    diagnosis = ident.diagnose(fit).json()  # type: ignore[attr-defined]
    diagnosis = json.loads(diagnosis) if isinstance(diagnosis, str) else diagnosis
    result |= {
        "verdict": diagnosis["verdict"],
        "best": diagnosis.get("best"),
        "candidates": diagnosis["candidates"][:8],
        "invisible": diagnosis["invisible"],
        "text": diagnosis["text"],
    }
    if whole and made.case.category in REFITTED:
        result |= refitted(made, mechanism, motion)
    return result


def refitted(made: Made, mechanism: ident.Mechanism, motion: ident.Motion) -> Result:
    """The true effect added: its parameters, and held-out errors beside those of the clean twin."""
    for hidden in made.case.hidden:
        mechanism = mechanism.with_effect(label(hidden))
    fit = ident.identify(mechanism, motion)
    twin = ident.load(made.folder(Path(tempfile.mkdtemp())))
    clean = ident.identify(twin, ident.complete(twin, read(made.twins), cutoff=motion.band.cutoff))
    found = {p.name: p for effect in fit.effects for p in effect.parameters}
    return {
        "parameters": {
            name: [true, float(found[name].value), float(found[name].stderr or 0.0)]
            for name, true in made.truth.items()
            if name in found
        },
        "held_out": {
            joint: [error.rms, clean.held_out[joint].rms]
            for joint, error in fit.held_out.items()
            if joint in clean.held_out
        },
    }


def label(hidden: Hidden) -> str:
    return ":".join([hidden.kind, *([",".join(hidden.joints)] if hidden.joints else [])])


def read(logs: Sequence[Columns]) -> list[ident.Log]:
    return [
        ident.Log.from_arrays(f"log_{k + 1}.csv", log["t"], without_time(log))
        for k, log in enumerate(logs)
    ]


def without_time(log: Mapping[str, Any]) -> dict[str, Any]:
    return {name: x for name, x in log.items() if name != "t"}
