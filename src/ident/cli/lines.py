"""A step as a line of the shell: what goes on from the command that runs, as it can be copied."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from ident.request import Request, Step

# options of the model that a verb takes: with a value, and without one
WITH, PAIRS, FLAGS = "--with", ("--lock", "--unmeasured"), ("--absolute", "--allow-code")
NO_BASIS = {"--basis", "--spacing"}  # options that `monitor` does not have
OTHER, NEXT = "OTHER.csv", "NEXT.csv"  # a log that is still to be named
MOTION, GROWN, FIT = "next.csv", "grown", "fit"  # names for what a command writes


@dataclass(frozen=True)
class ShellRequest(Request):
    """What a command was asked for; a step becomes the command that goes on from it."""

    def line(self, step: Step) -> str:
        """Return a step as a command; empty where the verb does not take the options given."""
        if step.verb == "compare" and not self.folder:
            step = replace(step, verb="identify", grown=False)  # which writes the fit
        words = self._words(step) if step else []
        return shlex.join(["ident", step.verb, *words]) if words else ""

    def _words(self, step: Step) -> list[str]:
        from ident.mechanism.load import has_identified  # which takes half a second to import

        verb, mechanism = step.verb, self.mechanism
        if verb == "add":
            return [mechanism, *self._added(step)]
        if step.grown and self.folder and verb in ("explore", "compare"):
            options = self._options(step, *PAIRS, *FLAGS, effects=False)
            if verb == "explore":
                return [self.folder, *self.logs, *options]
            return [self.folder, OTHER, "--fit", f"{self.folder}/fit.json", *options]
        every = self._options(step)
        if verb == "monitor":
            if NO_BASIS & {*self.options}:
                return []
            like = [word for log in self.like or self.logs for word in ("--like", log)]
            if step.grown and self.folder:  # which has the effects
                options = self._options(step, *PAIRS, *FLAGS, effects=False)
                return [self.folder, NEXT, *like, *options]
            return [mechanism, NEXT, *like, *every]
        if verb == "compare":  # with a log that was not fitted
            fit = ["--fit", f"{self.folder}/fit.json"]
            return [mechanism, OTHER, *fit, *self._options(step, *PAIRS, *FLAGS, effects=False)]
        if verb == "excite":
            return [mechanism, *self._excited(step), "--out", self.unused(MOTION)]
        if verb == "grow":  # from what is unknown in it
            if has_identified(Path(mechanism).parent):
                mechanism = str(Path(mechanism).parent)
            return [mechanism, *self.logs, *every, "--out", self.unused(GROWN)]
        if verb == "identify":
            out = self.unused(self.folder or FIT)
            consistent = ["--consistent"] * step.consistent
            return [mechanism, *self.logs, *every, *consistent, "--out", out]
        if verb == "diagnose":
            if has_identified(Path(mechanism)):
                mechanism += "/identified"  # with known bodies a load can be the cause
            elif step.known and self.fit:  # effects are in it, with their values
                options = self._options(step, *PAIRS, *FLAGS, effects=False)
                return [f"{self.fit}/identified", *self.logs, *options]
        return [mechanism, *self.logs, *every]

    def _options(self, step: Step, *names: str, effects: bool = True) -> list[str]:
        """Return the options that the running command was given, all or those of some names, and
        the effects of a step.
        """
        given = [*self.options]
        if names:
            given = []
            for name, value in pairwise((*self.options, "")):
                if name in names:
                    given += [name, value] if name in (WITH, *PAIRS) else [name]
        present = {value for name, value in pairwise(given) if name == WITH}
        labels = [label for label in step.effects if label not in present] if effects else []
        return [
            *given,
            *(word for label in labels for word in (WITH, label)),
            *(word for joint in step.unmeasured for word in ("--unmeasured", joint)),
        ]

    def _added(self, step: Step) -> list[str]:
        """Return effects and files to be added: first those that the running command was given
        `--with`, which are no part of the mechanism yet.
        """
        words = [word for name, word in pairwise(self.options) if name == WITH]
        files = [f"{self.folder or 'DIR'}/{name}" for name in step.files]
        code = ["--allow-code"] * bool(files or "--allow-code" in self.options)
        return [*dict.fromkeys([*words, *step.effects, *files, *code])]

    def _excited(self, step: Step) -> list[str]:
        options = self._options(step, WITH, *PAIRS, "--allow-code")
        options += ["--separate", *step.separate] if step.separate else []
        if step.separate or step.range or step.speed:  # from the middle of what was logged
            options += ["--around", self.logs[0]] if self.logs else []
        for joint, low, high in step.range:
            options += ["--range", f"{joint}={low:.4g}:{high:.4g}"]
        for joint, speed in step.speed:
            options += ["--speed", f"{joint}={speed:.3g}"]
        return options

    def unused(self, name: str) -> str:
        """Return a name for a file or folder, numbered where it would overwrite another one."""
        path, number = Path(name), 1
        while (self.folder and path == Path(self.folder)) or path.exists():
            number += 1
            path = Path(name).with_name(f"{Path(name).stem}_{number}{Path(name).suffix}")
        return str(path)


def place_of(mechanism_path: Path | None, urdf: Path) -> str:
    """Return the mechanism as commands take it: the folder of its mechanism.toml, or its URDF."""
    place = mechanism_path.parent if mechanism_path else urdf
    return shlex.quote(str(place)) if mechanism_path or place != Path() else "MECHANISM"


def partly_done(request: Request, rest: Sequence[Path], most: int) -> str:
    """Return the command that goes on with the logs of a diagnosis that are not done yet."""
    words = ["ident", "diagnose", request.mechanism, *map(str, rest), *request.options]
    return shlex.join(words) if len(rest) <= most else f"the logs from {rest[0]} on"
