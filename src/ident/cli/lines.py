"""A step as a line of the shell: what goes on from the command that runs, as it can be copied."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from ident.request import Request, Step, planned_limits

# options of the model that a verb takes: with a value, and without one
WITH, PAIRS, FLAGS = "--with", ("--lock", "--unmeasured"), ("--absolute", "--allow-code")
NO_BASIS = {"--basis", "--spacing"}  # options that `monitor` does not have
DRIVE, GAINS = "--drive", {"kp", "kd", "gain", "kb"}  # drives of a command, which no file has
DRIVES = ("servo", "motor_current", "motor_voltage", "motor_duty")  # their effects
# names for what a command writes
MOTION, GROWN, FIT, KEPT = "next.csv", "grown", "fit", "diagnosis"


@dataclass(frozen=True)
class ShellRequest(Request):
    """What a command was asked for; a step becomes the command that goes on from it."""

    def line(self, step: Step) -> str:
        """Return a step as a command; empty where the verb does not take the options given, or
        needs a log that is not known yet.
        """
        if step.files and not self.folder:  # the diagnosis writes them where it has a place
            words = [*self._words(Step("diagnose")), "--out", self.unused(KEPT)]
            return shlex.join(["ident", "diagnose", *words])
        if step.verb == "add" and DRIVE in self.options and not step.files:
            drives = [label for label in step.effects if label.partition(":")[0] in DRIVES]
            effects = tuple(label for label in step.effects if label not in drives)
            joints = {label.partition(":")[2] for label in drives}
            request = self._with_free_gains(joints)
            return request.line(replace(step, verb="identify", effects=effects))
        words = self._words(step) if step else []
        return shlex.join(["ident", step.verb, *words]) if words else ""

    def _words(self, step: Step) -> list[str]:
        from ident.mechanism.load import has_identified  # which takes half a second to import

        verb, mechanism = step.verb, self.mechanism
        if step.repairs:  # from the mechanism as given, with what is put right in its folder
            return self._repaired(step)._words(replace(step, repairs=()))
        if step.grown:  # its effects are in the folder that was written, or else named
            if self.folder:
                known = replace(self, mechanism=self.folder, options=self._model_options)
                return known._words(replace(step, grown=()))
            return self._words(replace(step, effects=(*step.grown, *step.effects), grown=()))
        if verb == "add":
            return [mechanism, *self._added(step)]
        every = self._options(step)
        if verb == "monitor":  # a log that was held back is compared with normal running
            if NO_BASIS & {*self.options} or not self.validate:
                return []
            like = [word for log in self.like or self.logs for word in ("--like", log)]
            return [mechanism, self.validate[0], *like, *every]
        if verb == "compare":  # with the logs that were fitted
            fit = ["--fit", f"{self.folder}/fit.json"]
            options = self._options(step, *PAIRS, *FLAGS, effects=False)
            return [mechanism, *self.logs, *fit, *options]
        if verb == "excite":
            return [mechanism, *self._excited(step), "--out", self.unused(MOTION)]
        if verb == "grow":  # from what is unknown in it
            if has_identified(Path(mechanism).parent):
                mechanism = str(Path(mechanism).parent)
            out = ["--out", self.unused(GROWN)]
            return [mechanism, *self.logs, *every, *self._held_back, *out]
        if verb == "identify":
            out = ["--out", self.unused(self.folder or FIT)]
            of_fit = [*self.of_fit]
            of_fit += ["--consistent"] * (step.consistent and "--consistent" not in of_fit)
            return [mechanism, *self.logs, *every, *of_fit, *self._held_back, *out]
        if verb == "diagnose":
            if has_identified(Path(mechanism)):
                mechanism += "/identified"  # with known bodies a load can be the cause
            elif step.known and self.fit:  # effects are in it, with their values
                options = self._options(step, *PAIRS, *FLAGS, effects=False)
                return [f"{self.fit}/identified", *self.logs, *options]
        return [mechanism, *self.logs, *every]

    def _repaired(self, step: Step) -> ShellRequest:
        """Return the request without the effects in whose place something is put right, for the
        folder where a URDF's mechanism.toml has to be made.
        """
        put_right, options = {repair.effect for repair in step.repairs}, list[str]()
        for word in self.options:
            if word in put_right and options and options[-1] == WITH:
                options.pop()
            else:
                options.append(word)
        folder = any(repair.file for repair in step.repairs)
        place = str(Path(self.mechanism).parent) if folder else self.mechanism
        return replace(self, mechanism=place, options=tuple(options))

    def _with_free_gains(self, joints: Collection[str]) -> ShellRequest:
        """Return the request without the given gains of the drives of some joints, which are to be
        identified: `--drive elbow:kp=20,limit=3` becomes `elbow:limit=3`.
        """
        options = [*self.options]
        for i, (name, text) in enumerate(pairwise(self.options), start=1):
            joint, colon, rest = text.partition(":")
            if name == DRIVE and colon and joint in joints:
                parts = [x for x in rest.split(",") if x.partition("=")[0].strip() not in GAINS]
                options[i] = f"{joint}:{','.join(parts) or 'source=servo'}"
        return replace(self, options=tuple(options))

    @property
    def _held_back(self) -> list[str]:
        return [word for log in self.validate for word in ("--validate", log)]

    @property
    def _model_options(self) -> tuple[str, ...]:
        """Those options that a folder which has the effects is read with, too."""
        return tuple(self._options(Step(), *PAIRS, *FLAGS, effects=False))

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
        files = [f"{self.folder}/{name}" for name in step.files]
        code = ["--allow-code"] * bool(files or "--allow-code" in self.options)
        return [*dict.fromkeys([*words, *step.effects, *files, *code])]

    def _excited(self, step: Step) -> list[str]:
        options = self._options(step, WITH, *PAIRS, "--allow-code")
        options += ["--separate", *step.separate] if step.separate else []
        options += ["--around", self.logs[0]] if self.logs and step.around else []
        options += ["--as-logged"] * (step.as_logged and bool(self.logs))
        ranges, speeds = planned_limits(step)
        for joint, (low, high) in ranges.items():
            options += ["--range", f"{joint}={low:g}:{high:g}"]
        for joint, speed in speeds.items():
            options += ["--speed", f"{joint}={speed:g}"]
        options += ["--duration", f"{step.duration:g}"] if step.duration else []
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
