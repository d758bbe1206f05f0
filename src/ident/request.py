"""What goes on from a result, and what was asked for: a next step is data until somebody reads it.

A `Step` names a verb and what it takes. A `Request` states of what a result is the answer, and
writes a step in the language of its reader: Python here, a line of the shell in `ident.cli`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True)
class Step:
    """A verb that goes on from a result, and its arguments.

    Attributes:
        verb: of the library and of the command line; empty where nothing is to be done.
        effects: labels, as `viscous:elbow`, or kinds, as `viscous`, that the model gets.
        files: user effects that it gets, as `law_elbow.py:law:elbow`, in the folder of the result.
        separate: two labels that a planned motion is to tell apart.
        range: joints of a planned motion with their lowest and highest position [rad | m].
        speed: joints of it with their largest speed [rad/s | m/s].
        unmeasured: further joints without a torque sensor.
        known: whether the bodies of an earlier fit are known, which names the cause of a change.
        grown: whether the model is the one that `grow` has written.
        consistent: whether bodies must be possible.
    """

    verb: str = ""
    effects: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    separate: tuple[str, ...] = ()
    range: tuple[tuple[str, float, float], ...] = ()
    speed: tuple[tuple[str, float], ...] = ()
    unmeasured: tuple[str, ...] = ()
    known: bool = False
    grown: bool = False
    consistent: bool = False

    def __bool__(self) -> bool:
        return bool(self.verb)

    @property
    def arguments(self) -> dict[str, Any]:
        """Those that are not the default."""
        given = ((field.name, getattr(self, field.name)) for field in fields(self)[1:])
        return {name: value for name, value in given if value}

    def json(self) -> dict[str, Any]:
        """Return the step for a file."""
        return {"verb": self.verb, "arguments": self.arguments}


@dataclass(frozen=True)
class Request:
    """What was asked for; the default is that of Python, where nouns are in the user's variables.

    Attributes:
        mechanism, logs: paths as given; options: of the model, as words.
        like: logs of normal running; fit: folder of an earlier fit that is compared with the logs.
        folder: where files of the result are written; empty where they are not.
        acceptable: share of a joint's torque that is good enough; None where none is stated.
        command: the command line that asked, for reports; empty where there is none.
    """

    mechanism: str = ""
    logs: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    like: tuple[str, ...] = ()
    fit: str = ""
    folder: str = ""
    acceptable: float | None = None
    command: str = ""

    def line(self, step: Step) -> str:
        """Return a step as the reader of the result can run it; empty where none can be run."""
        return python_line(step) if step else ""


PYTHON = Request()


def python_line(step: Step) -> str:
    """Return a step in Python, with `mechanism`, `motion` and `fit` for the nouns at hand.

    >>> python_line(Step("identify", effects=("viscous", "coulomb:elbow")))
    'ident.identify(mechanism.with_effect("viscous").with_effect("coulomb:elbow"), motion)'
    """
    model = "mechanism" + "".join(f'.with_effect("{label}")' for label in step.effects)
    other = 'ident.complete(mechanism, ident.read_log("OTHER.csv"))'
    if step.files:
        return "ident.identify(mechanism + diagnosis.laws[0], motion)"
    if step.verb in ("add", "identify"):
        consistent = ", consistent=True" * step.consistent
        return f"ident.identify({model}, motion{consistent})"
    return {
        "compare": f"ident.compare(fit, motion={other})",
        "diagnose": "ident.diagnose(fit)",
        "explore": f"ident.explore({model}, motion)",
        "grow": f"ident.grow({model}, motion)",
        "excite": f"ident.excite({model}{_separate(step.separate)})",
        "monitor": "ident.Monitor.of(fit, motion)",
    }.get(step.verb, "")


def _separate(labels: Sequence[str]) -> str:
    return f", separate={tuple(labels)}" if labels else ""
