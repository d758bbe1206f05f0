"""Small pieces of language that texts and tables of a diagnosis share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from ident.diagnose.evidence import Evidence
from ident.effects import Effect
from ident.fit.values import Value
from ident.residual import Failure
from ident.residual.error import Error
from ident.text import percent, rounded

if TYPE_CHECKING:
    from ident.diagnose.diagnosis import Diagnosis

MOST = 4  # names or numbers that are listed; the others are counted
NEAR = 2.0  # times the noise floor, from which what is left beside a verdict is spoken of
REPEATED = 0.6  # correlation of a residual between periods, from which it is no noise
LOUDER = 1.25  # times the noise floor, from which a residual is no noise
SIGNALS = {
    "q": "position",
    "v": "speed",
    "a": "acceleration",
    "load": "load",
    "sign(v)": "direction of motion",
}
SURE = ((8.0, "beyond doubt"), (4.0, "very sure"), (2.5, "sure"), (-1e9, "fairly sure"))


def listed(names: Iterable[str], word: str = "and") -> str:
    """`a, b and c`.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    *first, last = list(names) or ["none"]
    return f"{', '.join(first)} {word} {last}" if first else last


def some(names: Sequence[str], most: int = MOST) -> str:
    """The first few, the others counted.

    >>> some(["a", "b", "c"], 2)
    'a, b and 1 more'
    """
    if len(names) <= most:
        return listed(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def signal(name: str) -> str:
    """A signal as a person says it.

    >>> signal("v.elbow")
    'the speed of elbow'
    """
    kind, dot, joint = name.partition(".")
    return f"the {SIGNALS.get(kind, kind)} of {joint}" if dot else "time"


def sure(z: float) -> str:
    """How sure so many standard errors make."""
    return next(words for least, words in SURE if z >= least)


def closure(found: Evidence) -> str:
    """Share of the gap between residual and noise that a candidate closes."""
    return f"{100 * found.closure:.0f} %"


def numbers(parameters: Sequence[Value], most: int = MOST) -> str:
    """`Fc = 0.312 ± 0.004 N m`, several of them; what the data do not determine says so."""
    said = []
    for v in parameters:
        short = v.name.rpartition(".")[2]
        unit = "" if v.unit == "1" else f" {v.unit}"
        said.append(f"{short} = {rounded(v.value, v.stderr)}{unit}")
    return some(said, most)


def what(effect: Effect) -> str:
    """What an effect is, to stand within a sentence."""
    return effect.summary()


def labels(effects: Iterable[Effect], word: str = "and") -> str:
    """Effects as commands take them."""
    return listed([effect.label for effect in effects], word)


def error_text(error: Error) -> str:
    """`0.065 N m (2.1 %)`."""
    relative = "" if error.relative is None else f" ({percent(error.relative)})"
    return f"{error.rms:.3g} {error.unit}{relative}"


def remaining(d: Diagnosis) -> list[str]:
    """Joints in which clearly more is left than noise, or what comes back with every period."""
    errors = d.fit.held_out or d.fit.train
    loud = [name for name, e in errors.items() if e.rms > NEAR * d.floor[name]]
    again = [] if d.periods is None else [n for n, rho in d.periods.rho.items() if rho > REPEATED]
    return list(dict.fromkeys([*loud, *(name for name in again if name in errors)]))


def failing(d: Diagnosis) -> list[Failure]:
    """Joints in which more than noise is left, the worst first; of a clean model none."""
    if d.verdict == "nothing":
        return []
    mended = {d.candidates[0].joint} if d.verdict == "missing" else set()
    found = [
        each
        for each in d.where
        if each.joint in mended or not each.white or each.rms > LOUDER * d.floor[each.joint]
    ]
    return found or list(d.where[:1])
