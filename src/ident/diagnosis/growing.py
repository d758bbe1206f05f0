"""Finished rounds of `grow` in a file, from which an interrupted run goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ident.effects import Effect
from ident.errors import FitError
from ident.files import json_bytes, write_all
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.version import version

NAME = "growing.json"
SCHEMA = "ident.growing/1"


@dataclass(eq=False)
class SavedRounds:
    """Rounds of `grow`, each written as soon as it is fitted.

    Attributes:
        folder: where they are written; None: nowhere.
        key: of all that they depend on.
        rounds: by round the `rungs` as (added, removed, rivals, errors), effects by label, and the
            `start` of the fit's shapes, and the sets `visited` so far.
    """

    folder: Path | None
    key: str
    rounds: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def of(
        cls, folder: Path | None, mechanism: Mechanism, motion: Motion, rule: Any, resume: bool
    ) -> SavedRounds:
        """Return what an earlier run has left there, with `resume`; else nothing.

        Raises:
            FitError: if there is nothing, or what is there belongs to other inputs.
        """
        files = [path for path in (mechanism.urdf, mechanism.toml) if path and path.is_file()]
        effects = [(effect.label, dict(effect.values)) for effect in mechanism.effects]
        words = [version(), effects, motion.band.cutoff, motion.samples, str(rule)]
        digest = hashlib.sha256(repr(words).encode())
        for path in files:
            digest.update(path.read_bytes())
        for log in motion.logs:
            digest.update((log.sha256 or log.name).encode())
        saved = cls(folder, digest.hexdigest())
        if not resume:
            return saved
        file = None if folder is None else folder / NAME
        if file is None or not file.is_file():
            raise FitError(
                f"resume: there is no {file or NAME} of an interrupted run; give the folder of its "
                "--out, or leave --resume out to begin anew"
            )
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            known, saved.rounds = content["key"], list(content["rounds"])
        except (ValueError, KeyError, TypeError):
            raise FitError(f"{file}: is broken; leave --resume out to begin anew") from None
        if known != saved.key:
            raise FitError(
                f"{file}: was made with other logs, another model, other options or another "
                "version; give the same ones, or leave --resume out to begin anew"
            )
        return saved

    def add(
        self,
        rungs: Collection[Any],
        start: Mapping[str, float],
        visited: Collection[frozenset[str]],
    ) -> None:
        """Write a further round: its steps, its fit's start, and all sets that were searched."""
        words = [
            {
                **{
                    name: [effect.label for effect in getattr(step, name)]
                    for name in ("added", "removed", "rivals")
                },
                "errors": {joint: asdict(error) for joint, error in step.errors.items()},
            }
            for step in rungs
        ]
        sets = sorted(map(sorted, visited))
        self.rounds.append({"rungs": words, "start": dict(start), "visited": sets})
        if self.folder is not None:
            content = {"schema": SCHEMA, "key": self.key, "rounds": self.rounds}
            write_all(self.folder, {NAME: json_bytes(content)})

    def remove(self) -> None:
        """Remove the file, which is of no use once all is done."""
        if self.folder is not None:
            (self.folder / NAME).unlink(missing_ok=True)


def by_label(effects: Collection[Effect]) -> dict[str, Effect]:
    """Return effects by their labels."""
    return {effect.label: effect for effect in effects}
