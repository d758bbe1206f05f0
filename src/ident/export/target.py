"""The noun that a target is: what it can hold, and how it is written; found as readers are.

A target of one's own is an entry point `export.<name>` of the group `ident.formats` that names a
`Target`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from ident.display import Progress, no_progress
from ident.errors import IdentError, MechanismError, one_of
from ident.export.laws import Translation, Vocabulary, translate
from ident.export.machine import Machine
from ident.files import GROUP
from ident.motion import Motion

TARGETS = {
    "mjcf": "ident.export.mjcf_target:MJCF",
    "urdf": "ident.export.urdf:URDF",
    "sdf": "ident.export.sdf:SDF",
    "drake": "ident.export.urdf:DRAKE",
    "usd": "ident.export.usd:USD",
    "c": "ident.export.c:C",
    "fmu": "ident.export.fmu:FMU",
}


@dataclass(frozen=True, eq=False)
class Job:
    """What is asked of a target.

    Attributes:
        machine: to be written.
        motion: over which losses are measured; None: a nominal one.
        out: path of the file.
        step: of the simulator [s]; None: the target's own default, or that of `like`.
        like: a file of the user, which is changed as little as can be.
        fitted: whether numbers are fitted to the target's laws, where its simulator is installed.
        settings: of the target alone, such as `float` or `fmi`.
    """

    machine: Machine
    motion: Motion | None
    out: Path
    step: float | None = None
    like: Path | None = None
    fitted: bool = True
    settings: Mapping[str, object] = field(default_factory=dict)
    progress: Progress = no_progress


@dataclass(frozen=True, eq=False)
class Product:
    """What a target makes of a job: files by name, first the one that was asked for."""

    files: Mapping[str, bytes]
    translation: Translation
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Target:
    """A form in which a machine can be written.

    Attributes:
        name, title: in commands, and as a noun.
        suffix: of its file.
        words: what it can hold.
        write: makes its files.
        likes: suffixes of files that it can change in place.
        settings: names of its own settings.
    """

    name: str
    title: str
    suffix: str
    words: Vocabulary
    write: Callable[[Job], Product]
    likes: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()


def target_of(name: str) -> Target:
    """Return the target of a name.

    Raises:
        IdentError: if there is none, with the valid names.
    """
    from importlib.metadata import entry_points

    if name in TARGETS:
        module, _, target = TARGETS[name].partition(":")
        result: Target = getattr(import_module(module), target)
        return result
    others = {
        entry_point.name.partition(".")[2]: entry_point
        for entry_point in entry_points(group=GROUP)
        if entry_point.name.startswith("export.")
    }
    if name in others:
        loaded: Target = others[name].load()
        return loaded
    raise IdentError(f"--to {name}: {one_of(name, [*TARGETS, *others])}")


def translated(job: Job, words: Vocabulary) -> Translation:
    """Return the machine of a job in a target's words; refuse loops that it cannot hold."""
    for closure in job.machine.mechanism.closures:
        if closure.kind not in words.closures:
            valid = ", ".join(words.closures) or "none"
            raise MechanismError(
                f"{job.machine.name}: closure '{closure.name}' is of kind {closure.kind}, and this "
                f"target can hold: {valid}; export to mjcf or c, or lock a joint and open the loop"
            )
    return translate(job.machine, words, job.motion)
