"""How `demo` talks: a calm terminal, plain text where it is none."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.text import Text

from ident.demo import Puzzle
from ident.diagnose import Diagnosis
from ident.effects import Effect
from ident.fit import Fit
from ident.fit.values import BaseValue, Value
from ident.tables import percent

WIDTH, BAR = 96, 40  # characters


class Teller:
    """Titles, commands, facts and words, to standard output."""

    def __init__(self) -> None:
        self._console = Console(highlight=False, soft_wrap=True)

    def title(self, text: str) -> None:
        """A heading."""
        self._line(f"\n{text}", "bold")

    def step(self, number: int, text: str, command: str) -> None:
        """A heading with its number, and the command that does it."""
        self.title(f"{number}. {text}")
        self.command(command)

    def command(self, text: str) -> None:
        """What one would type."""
        self._line(f"   $ {text}", "cyan")

    def fact(self, text: str, style: str = "") -> None:
        """What was found."""
        self._line(f"     {text}", style)

    def words(self, text: str) -> None:
        """A paragraph."""
        for line in textwrap.wrap(text, WIDTH, break_on_hyphens=False, break_long_words=False):
            self._line(line, "")

    def _line(self, text: str, style: str) -> None:
        self._console.print(Text(text, style))


def listed(words: Sequence[str], last: str = "and") -> str:
    """`a, b and c`."""
    return f" {last} ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def valued(value: Value | BaseValue) -> str:
    """`coulomb.elbow.Fc = 0.0501 ± 0.0001 N m`."""
    return str(value).removesuffix(" 1")


def described_effect(effect: Effect) -> str:
    """`coulomb:elbow (dry friction: constant against the direction of motion)`."""
    what = effect.summary()
    return f"{effect.label} ({what})"


def understood(fit: Fit) -> str:
    """Mechanism and motion, from the fit that has both."""
    m, (e,) = fit.mechanism, fit.motion.experiments
    return (
        f"{len(m.joints)} joints, of which {listed(m.driven)} are driven; the loop leaves "
        f"{len(fit.motion.independent)} degrees of freedom, and the other joints follow from it. "
        f"Of {len(m.unknown)} inertial parameters this motion can tell the "
        f"{fit.rank - sum(len(effect.unknowns) for effect in m.effects)} combinations that torques "
        f"feel. {len(e.t)} samples in {e.t[-1] - e.t[0]:.0f} s."
    )


def bars(tell: Teller, fits: Mapping[str, Fit]) -> None:
    """Held-out errors of the drives, a row a joint and fit."""
    errors = {
        (joint, name): fit.held_out[joint].relative or 0.0
        for joint in next(iter(fits.values())).held_out
        for name, fit in fits.items()
    }
    longest = max(errors.values()) or 1.0
    for (joint, name), error in errors.items():
        bar = "█" * max(1, round(BAR * error / longest))
        tell.fact(f"{joint:<6} {name:<6} {percent(error):>7} {bar}")


def sought(made: Puzzle) -> str:
    """The answer in one line."""
    units = dict(zip(made.answer.names, made.answer.units, strict=True))
    said = [
        f"{name} = {value:.4g} {units[name]}".removesuffix(" 1")
        for name, value in made.truth.items()
    ]
    return f"{described_effect(made.answer)}: {listed(said)}"


def answered(made: Puzzle, found: Diagnosis, after: Fit | None) -> str:
    """The truth beside what was found, right or wrong."""
    hidden = f"Hidden was {sought(made)}."
    if after is None or found.best is None:
        return f"{hidden} The diagnosis gave no name: {found.verdict}."
    label, rivals = made.answer.label, [rival.label for rival in found.rivals]
    if found.best.label == label:
        values = listed([valued(after[name]) for name in made.truth])
        sure = " among rivals that fit as well" if rivals else ""
        return f"{hidden} Found{sure}: {values}."
    if label in rivals:
        return (
            f"{hidden} The diagnosis put {found.best.label} first and said that {label}, which it "
            "is, explains this log as well: the set of rivals is the answer, not its first name."
        )
    if found.best.kind in made.answer.nested_in and found.best.joints == made.answer.joints:
        return (
            f"{hidden} The diagnosis named {found.best.label}, which contains it: beside what they "
            "have in common its parameters should be zero within their errors."
        )
    return f"{hidden} The diagnosis named {found.best.label}: wrong this time."
