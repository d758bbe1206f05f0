"""What goes on from a result, and what was asked for: a next step is data until somebody reads it.

A `Step` names a verb and what it takes. A `Request` states of what a result is the answer, and
writes a step in the language of its reader: Python here, a line of the shell in `ident.cli`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from typing import Any

DIGITS = 3  # shown: of the limits of a motion that is planned


@dataclass(frozen=True)
class Repair:
    """What is put right in a log or in a mechanism's file, in place of an effect.

    Attributes:
        effect: label of the effect in whose place it is done.
        kind: `offset` or `scale` of a column, its `delay`, a `length`, or `gravity`.
        where: the channel, or the place of a length.
        number: what is wrong: the true coordinate minus the logged one [rad | m], the torque that
            is read over the true one, the time by which it is late [s], the displacement [m], or
            the angle of the base [rad]; unit: its unit.
        column: of the file of the log.
        now: what to write: the column's scale and offset, the length before and after [m], or
            gravity (3,) [m/s²]; empty where no number of a file is known.
        file: name of the URDF, where no mechanism.toml names it yet that could have the line.
    """

    effect: str
    kind: str
    where: str
    number: float
    unit: str
    column: str = ""
    now: tuple[float, ...] = ()
    file: str = ""


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
        duration: of a planned motion [s]; 0 for the usual one.
        around: whether it begins in the middle of what was logged.
        as_logged: whether joints without a range and speed of their own move as they did.
        grown: labels of effects that `grow` has added, which are in the folder that it has written.
        consistent: whether bodies must be possible.
        repairs: what is put right by hand before, in place of effects that go.
    """

    verb: str = ""
    effects: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    separate: tuple[str, ...] = ()
    range: tuple[tuple[str, float, float], ...] = ()
    speed: tuple[tuple[str, float], ...] = ()
    unmeasured: tuple[str, ...] = ()
    duration: float = 0.0
    around: bool = False
    as_logged: bool = False
    known: bool = False
    grown: tuple[str, ...] = ()
    consistent: bool = False
    repairs: tuple[Repair, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.verb)

    @property
    def arguments(self) -> dict[str, Any]:
        """Those that are not the default."""
        given = ((field.name, getattr(self, field.name)) for field in fields(self)[1:])
        return {name: value for name, value in given if value}

    def json(self) -> dict[str, Any]:
        """Return the step for a file."""
        arguments = self.arguments
        if self.repairs:
            arguments |= {"repairs": [asdict(repair) for repair in self.repairs]}
        return {"verb": self.verb, "arguments": arguments}


@dataclass(frozen=True)
class Request:
    """What was asked for; the default is that of Python, where nouns are in the user's variables.

    Attributes:
        mechanism, logs: paths as given; options: of the model, as words.
        of_fit: options of the verb `identify` alone, as words.
        like: logs of normal running; fit: folder of an earlier fit that is compared with the logs.
        validate: logs that were held back.
        folder: where files of the result are written; empty where they are not.
        acceptable: share of a joint's torque that is good enough; None where none is stated.
        command: the command line that asked, for reports; empty where there is none.
        noun: variable of Python in which the fit is that a step goes on from.
    """

    mechanism: str = ""
    logs: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    like: tuple[str, ...] = ()
    fit: str = ""
    folder: str = ""
    acceptable: float | None = None
    command: str = ""
    of_fit: tuple[str, ...] = ()
    validate: tuple[str, ...] = ()
    noun: str = "fit"

    def line(self, step: Step) -> str:
        """Return a step as the reader of the result can run it; empty where none can be run."""
        return python_line(step, self.noun) if step else ""


PYTHON = Request()


def with_noun(request: Request, noun: str) -> Request:
    """Return the request of Python with another variable for the fit, any other as it is."""
    return replace(request, noun=noun) if request == PYTHON else request


def python_line(step: Step, noun: str = "fit") -> str:
    """Return a step in Python; `noun` is the variable in which the fit is that it goes on from.

    >>> python_line(Step("identify", effects=("coulomb:elbow",)), "better")
    'ident.identify(better.mechanism.with_effect("coulomb:elbow"), better.motion)'
    """
    if step.repairs:  # by hand, before the log and the mechanism are read again
        return ""
    added = "".join(f'.with_effect("{label}")' for label in step.effects)
    model, motion = f"{noun}.mechanism{added}", f"{noun}.motion"
    if step.files:
        laws = noun.removesuffix(".fit") if noun.endswith(".fit") else "diagnosis"
        return f"ident.identify({noun}.mechanism + {laws}.laws[0], {motion})"
    if step.verb in ("add", "identify"):
        consistent = ", consistent=True" * step.consistent
        return f"ident.identify({model}, {motion}{consistent})"
    return {
        "diagnose": f"ident.diagnose({noun})",
        "explore": f"ident.explore({model}, {motion})",
        "grow": f"ident.grow({model}, {motion})",
        "excite": f"ident.excite({model}{_planned(step, motion)})",
        "monitor": f"ident.Monitor.of({noun}, {motion})",
    }.get(step.verb, "")


def planned_limits(step: Step) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Return the ranges and speeds of a step with three digits, rounded inwards: no limit of the
    machine is exceeded by what is printed.
    """
    ranges = {
        name: (rounded_inwards(low, ROUND_CEILING), rounded_inwards(high, ROUND_FLOOR))
        for name, low, high in step.range
    }
    return ranges, {name: rounded_inwards(speed, ROUND_FLOOR) for name, speed in step.speed}


def rounded_inwards(x: float, direction: str) -> float:
    """Return x with three digits, rounded in a direction of `decimal`.

    >>> rounded_inwards(2.0999, ROUND_FLOOR), rounded_inwards(-0.7, ROUND_CEILING)
    (2.09, -0.7)
    """
    exact = Decimal(f"{x:.12g}")  # without the error of its last bits
    if exact == 0:
        return 0.0
    step = Decimal(1).scaleb(exact.adjusted() + 1 - DIGITS)
    return float(exact.quantize(step, rounding=direction))


def _planned(step: Step, motion: str) -> str:
    """Return the arguments of a motion that is planned."""
    ranges, speeds = planned_limits(step)
    limits = [f"range={ranges}"] * bool(ranges) + [f"speed={speeds}"] * bool(speeds)
    words = [f"separate={step.separate}"] * bool(step.separate)
    words += [f"limits=ident.Limits({', '.join(limits)})"] * bool(limits)
    words += [f"around={motion}"] * step.around + ["as_logged=True"] * step.as_logged
    words += [f"duration={step.duration:g}"] * bool(step.duration)
    return "".join(f", {word}" for word in words)
