"""The top of a result: what it is, how sure, the error of every joint, and what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ident.effects import Effect
from ident.fit.channel_fits import LEAVES
from ident.information.blocks import Error
from ident.mechanism.mechanism import Mechanism
from ident.text import listed, percent, places, some, wrapped

STRIP = 32  # characters of the longest bar in a terminal
BARS = 8  # joints that a terminal shows at most
NOISY = 1.5  # times the noise of the sensors, in good logs 0.5 to 1.3, from which it is more
SURE = ((8.0, "beyond doubt"), (4.0, "very sure"), (2.5, "sure"), (-1e9, "fairly sure"))
ADVICE = "; `ident diagnose` looks for what is missing"
TRIFLE = 0.003  # of the torque: what a diagnosis takes to be too small to matter


@dataclass(frozen=True)
class Bar:
    """The error of one joint: before, after, and what noise alone would leave [N m | N]."""

    joint: str
    before: Error
    after: Error | None = None
    noise: float | None = None

    @property
    def sizes(self) -> tuple[float, float, float | None]:
        """Before, after and noise as shares of the measured torque; 0 where there is none."""
        error = self.before
        if not error.relative or not error.rms:
            return 0.0, 0.0, None
        torque = error.rms / error.relative
        after = error if self.after is None else self.after
        noise = None if self.noise is None else self.noise / torque
        return error.relative, after.rms / torque, noise

    @property
    def words(self) -> str:
        """The error in numbers."""
        both = [self.before, *([self.after] if self.after else [])]
        if self.before.relative is None:
            return " → ".join(f"{error.rms:.3g} {error.unit}" for error in both)
        noise = self.sizes[2]
        beside = "" if noise is None else f", noise {percent(noise)}"
        return " → ".join(percent(error.relative) for error in both) + beside


def sure(z: float) -> str:
    """Return how sure so many standard errors make."""
    return next(words for least, words in SURE if z >= least)


def good_enough(
    errors: Mapping[str, Error], floor: Mapping[str, float], more: float = NOISY, advice: str = ""
) -> str:
    """Return a sentence on whether the errors of all joints are noise, or too small to matter.

    Args:
        errors, floor: by joint, of the model and what noise of the sensors makes [N m | N].
        more: times the noise from which an error is more than that.
        advice: what to do where it is not good enough.
    """
    times = {joint: e.rms / floor[joint] for joint, e in errors.items() if floor.get(joint)}
    if not times:
        return ""
    above = sorted((j for j, x in times.items() if x > more), key=lambda j: -times[j])
    if loud := [j for j in above if (errors[j].relative or 1.0) > TRIFLE]:
        words = [f"{j} ({float(f'{times[j]:.2g}'):g} times)" for j in loud]
        words[0] = words[0].replace("times)", "times the noise of the sensors)")
        return f"Good enough? Not in {some(words, 2)}{advice}."
    most = max(times, key=lambda j: errors[j].relative or 0.0)
    if (left := errors[most].relative or 0.0) > LEAVES:
        size = f"{percent(left)} of the torque of {most}"
        return f"Good enough? These logs cannot show it: noise is {size}."
    if above:
        return (
            "Good enough? Yes: in every joint the error is noise of the sensors, or below "
            f"{percent(TRIFLE)} of the torque."
        )
    return f"Good enough? Yes: at most {max(times.values()):.1f} times the noise of the sensors."


@dataclass(frozen=True)
class Card:
    """The first lines of a result: what it is, how sure, the error by joint, what to do next."""

    line: str
    sure: str = ""
    bars: tuple[Bar, ...] = ()
    command: str = ""
    most: int = BARS  # bars in a terminal

    def shares(self, bar: Bar) -> tuple[float, float, float | None]:
        """Return before, after and noise of a bar over the longest of all bars."""
        longest = max(size or 0.0 for each in self.bars for size in each.sizes) or 1.0
        before, after, noise = bar.sizes
        return before / longest, after / longest, None if noise is None else noise / longest

    def key(self, change: str, noise: str) -> str:
        """Return the words for what the bars have: a change, the mark of noise, or neither."""
        has = any(bar.after for bar in self.bars), any(b.sizes[2] is not None for b in self.bars)
        words = [text for text, there in zip((change, noise), has, strict=True) if there]
        return ": " * bool(words) + ", ".join(words)

    def text(self) -> list[str]:
        """Return the lines for a terminal: █ stays, ░ goes, | is the noise."""
        lines = [*wrapped(self.line, "  "), *wrapped(self.sure, "  ")]
        rows = [[bar.joint, self._strip(bar), bar.words] for bar in self.bars[: self.most]]
        if rows:
            lines += ["", f"error{self.key('█ stays, ░ goes', '| noise')}"]
            width = max(len(row[0]) for row in rows)
            lines += [f"  {joint:<{width}}  {strip}  {words}" for joint, strip, words in rows]
        if (more := len(self.bars) - self.most) > 0:
            lines.append(f"  and {more} joint{'s' * (more > 1)} more")
        return [*lines, *(["", f"  {self.command}"] if self.command else [])]

    def _strip(self, bar: Bar) -> str:
        before, after, noise = self.shares(bar)
        cells = ("█" * round(STRIP * after)).ljust(round(STRIP * before), "░").ljust(STRIP + 1)
        at = STRIP + 1 if noise is None else round(STRIP * noise)
        return f"{cells[:at]}|{cells[at + 1 :]}" if at <= STRIP else cells


def by_kind(effects: Iterable[Effect]) -> list[list[Effect]]:
    """Return effects of one kind together, in the order of the first of each."""
    found: dict[str, list[Effect]] = {}
    for effect in effects:
        found.setdefault(effect.kind, []).append(effect)
    return list(found.values())


def named(effects: Iterable[Effect], word: str = "and") -> str:
    """Return `coulomb:elbow` of one effect, `coulomb in a3 to a7` of several of a kind."""
    return listed(
        [
            group[0].label
            if len(group) == 1
            else f"{group[0].kind} in {places(','.join(each.joints) for each in group)}"
            for group in by_kind(effects)
        ],
        word,
    )


def add_command(mechanism: Mechanism, effects: Iterable[Effect]) -> str:
    """Return the command that adds effects to a mechanism, ready to be copied."""
    place = mechanism.toml.parent if mechanism.toml else mechanism.urdf
    folder = shlex.quote(str(place)) if place != Path() else "MECHANISM"
    return " ".join(["ident add", folder, *(effect.label for effect in effects)])
