"""The first lines of a result: what it is, how sure, the error of every joint, what to do next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields

from ident.assess.assessment import Assessment
from ident.assess.errors import JointErrors, joint_errors, times_noise
from ident.information.blocks import Error
from ident.request import PYTHON, Request, Step
from ident.show.error_axis import KEY_BEFORE, KEY_NOISE, KEY_NOW, ErrorAxis
from ident.show.headline import good_enough_words, headline, values_words
from ident.show.next_step import step_words
from ident.show.repairs import repair_lines
from ident.text import percent, places, significant, width, wrapped

STRIP = 34  # shown: characters of the axis of errors in a terminal that has room for it
LONG = 240  # shown: characters of a command, from which a page folds it
BARS = 8  # shown: joints that a terminal shows at most


@dataclass(frozen=True)
class Bar(JointErrors):
    """The error of one joint as it is drawn: before, now, and what noise alone would leave."""

    @classmethod
    def of(cls, errors: JointErrors) -> Bar:
        """Return the bar of the errors of a joint."""
        return cls(*(getattr(errors, field.name) for field in fields(errors)))

    @property
    def relative(self) -> bool:
        """Whether the error is known as a share of the torque, so that it can be drawn."""
        return bool(self.before.relative is not None and self.before.rms)

    @property
    def marks(self) -> tuple[float | None, float, float | None]:
        """What is drawn as before, now and noise; before only where there is a change."""
        before, now, noise = self.sizes
        return before if self.after else None, now, noise

    @property
    def words(self) -> str:
        """The error in numbers."""
        both = [self.before, *([self.after] if self.after else [])]
        if self.before.relative is None:
            return " → ".join(f"{significant(error.rms)} {error.unit}" for error in both)
        noise = self.sizes[2]
        suffix = " (larger)" * self.rises
        suffix += "" if noise is None else f", noise {percent(noise)}"
        return " → ".join(percent(error.relative) for error in both) + suffix


def bars_of(
    before: Mapping[str, Error], now: Mapping[str, Error], noise: Mapping[str, float | None]
) -> tuple[Bar, ...]:
    """Return the bars of errors now, with those before where they are known."""
    return tuple(map(Bar.of, joint_errors(before, now, noise)))


@dataclass(frozen=True)
class Card:
    """The first lines of a result: what it is, how sure, the error by joint, what to do next.

    Attributes:
        line, sure: sentences; bars: of the joints, in the mechanism's order.
        command: the one to be copied; then: what it does, or what to do in its place; how: more on
            that, folded where it can be.
        change: what the errors before and after are of, as `of a → of b`.
        most: bars in a terminal; first: joint whose bar is always one of them.
        step: what the command does, for a button.
        ladder: lines between the errors and the command, for a terminal.
    """

    line: str
    sure: str = ""
    bars: tuple[Bar, ...] = ()
    command: str = ""
    then: str = ""
    change: str = ""
    most: int = BARS
    first: str = ""
    step: Step = field(default_factory=Step)
    ladder: str = ""
    how: str = ""

    @property
    def shown(self) -> list[Bar]:
        """The bars that a terminal shows, in order: the first joint's and the loudest."""

        def rank(bar: Bar) -> tuple[bool, float]:
            worst = max(
                times_noise(error, bar.noise) for error in (bar.before, bar.after or bar.before)
            )
            return bar.joint != self.first, -worst

        most = self.most + (len(self.bars) == self.most + 1)  # a line says as much as the joint
        chosen = sorted(self.bars, key=rank)[:most]
        return [bar for bar in self.bars if bar in chosen]

    @property
    def summary(self) -> str:
        """What stands for a command that a page folds; empty of one that is not long."""
        if len(self.command) < LONG:
            return ""
        effects, verb = self.command.count("--with "), self.command.split(maxsplit=2)[:2]
        return f"{' '.join(verb)} …{f' with {effects} effects' * bool(effects)}"

    @property
    def pasted(self) -> list[str]:
        """The lines to paste into files before the command."""
        return repair_lines(self.step)

    @property
    def axis(self) -> ErrorAxis:
        """The axis on which the errors of all joints are drawn."""
        return ErrorAxis.of(size for bar in self.bars for size in bar.sizes)

    def key(self, bars: Sequence[Bar]) -> str:
        """Return what the marks of some bars mean: before and now, or now alone, and noise."""
        changes, noise = any(bar.after for bar in bars), any(bar.sizes[2] for bar in bars)
        marks = [KEY_BEFORE] * changes + [KEY_NOW] + [KEY_NOISE] * noise
        return ", ".join(marks)

    def text(self) -> list[str]:
        """Return the lines for a terminal."""
        lines = [*wrapped(self.line, "  "), *wrapped(self.sure, "  ")]
        if bars := self.shown:
            key = self.key(bars).replace(" ", "\u00a0").replace(",\u00a0", ", ")
            legend = wrapped(f"error {self.change}".rstrip() + f": {key}", "  ")
            lines += ["", *(line.replace("\u00a0", " ") for line in legend)]
            wide = max(len(bar.joint) for bar in bars)
            rest = width() - wide - max(len(bar.words) for bar in bars) - 6
            cells, axis = max(STRIP // 4, min(STRIP, rest)), self.axis
            if any(bar.relative for bar in bars):
                lines.append(" " * (wide + 4) + axis.ruler(cells))
            for bar in bars:
                strip = axis.strip(cells, *bar.marks) if bar.relative else " " * cells
                lines.append(f"  {bar.joint:<{wide}}  {strip}  {bar.words}")
        if (more := len(self.bars) - len(bars)) > 0:
            increased = [bar.joint for bar in self.bars if bar.rises and bar not in bars]
            larger = f", larger in {places(increased)}" * bool(increased)
            lines.append(f"  and {more} joint{'s' * (more > 1)} more{larger}")
        lines += ["", *self.ladder.splitlines()] if self.ladder else []
        words = f"Next: {self.then} {_sentence(self.how)}".rstrip()
        lines += ["", *wrapped(words, "  ")] if self.then else []
        lines += ["", *(f"  {line}" for line in self.pasted)] if self.pasted else []
        return [*lines, *(["", f"  {self.command}"] if self.command else [])]


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def card_of(
    a: Assessment,
    request: Request = PYTHON,
    *,
    line: str = "",
    sentences: Iterable[str] = (),
    then: str = "",
) -> Card:
    """Return the card of an assessment: its headline, whether that is good enough, further
    `sentences`, the errors by joint, and the next step in the language of its reader.
    """
    change = " → ".join(filter(None, a.compared))
    then = then or step_words(a.next, fits=a.good_enough.fits, validated=bool(a.good_enough.logs))
    values = values_words(a.causes)
    words = [
        good_enough_words(a.good_enough) * bool(a.errors),
        *sentences,
        f"Values: {values}." if values else "",
    ]
    return Card(
        line or headline(a),
        " ".join(filter(None, words)),
        tuple(map(Bar.of, a.errors)),
        request.line(a.next) if a.next else "",
        then,
        change,
        first=a.worst,
        step=a.next,
    )
