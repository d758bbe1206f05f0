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
from ident.progress import folder, inputs
from ident.text import listed, percent, places, some, wrapped

MONITOR = {"--with", "--absolute", "--allow-code", "--cutoff", "--smoothing"}  # it takes
STRIP = 32  # characters of the longest bar in a terminal
BARS = 8  # joints that a terminal shows at most
NOISY = 1.5  # times the noise of the sensors, in good logs 0.5 to 1.3, from which it is more
SAME = 0.005  # of an error: a change below is none, since both are printed with three digits
SURE = ((8.0, "beyond doubt"), (4.0, "very sure"), (2.5, "sure"), (-1e9, "fairly sure"))
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
        noise = self.noise / torque if self.noise else None
        return error.relative, after.rms / torque, noise

    @property
    def rises(self) -> bool:
        """Whether the error is larger after."""
        return self.after is not None and self.after.rms > (1 + SAME) * self.before.rms

    @property
    def words(self) -> str:
        """The error in numbers."""
        both = [self.before, *([self.after] if self.after else [])]
        if self.before.relative is None:
            return " → ".join(f"{error.rms:.3g} {error.unit}" for error in both)
        noise = self.sizes[2]
        beside = " (larger)" * self.rises
        beside += "" if noise is None else f", noise {percent(noise)}"
        return " → ".join(percent(error.relative) for error in both) + beside


def sure(z: float) -> str:
    """Return how sure so many standard errors make."""
    return next(words for least, words in SURE if z >= least)


def good_enough(
    errors: Mapping[str, Error], floor: Mapping[str, float], searched: bool = False
) -> str:
    """Return a sentence on whether the errors of all joints are noise, or too small to matter.

    Args:
        errors, floor: by joint, of the model and what noise of the sensors makes [N m | N].
        searched: whether nothing that is missing was found.
    """
    times = {joint: e.rms / floor[joint] for joint, e in errors.items() if floor.get(joint)}
    if not times:
        return ""
    above = sorted((j for j, x in times.items() if x > NOISY), key=lambda j: -times[j])
    if loud := [j for j in above if (errors[j].relative or 1.0) > TRIFLE]:
        if searched:
            most = f"{max(times.values()):.1f} times the noise of the sensors"
            return f"Good enough? As good as this data can show, at {most}."
        words = [f"{j} ({float(f'{times[j]:.2g}'):g} times)" for j in loud]
        words[0] = words[0].replace("times)", "times the noise of the sensors)")
        return f"Good enough? Not in {some(words, 2)}."
    most = max(times, key=lambda j: errors[j].relative or 0.0)
    if (left := errors[most].relative or 0.0) > LEAVES:
        size = f"{percent(left * floor[most] / errors[most].rms)} of the torque of {most}"
        return f"Good enough? These logs cannot show it: noise is {size}."
    if above:
        return (
            "Good enough? Yes: in every joint the error is noise of the sensors, or below "
            f"{percent(TRIFLE)} of the torque."
        )
    return f"Good enough? Yes: at most {max(times.values()):.1f} times the noise of the sensors."


@dataclass(frozen=True)
class Card:
    """The first lines of a result: what it is, how sure, the error by joint, what to do next.

    Attributes:
        line, sure: sentences; bars: of the joints, `most` of them in a terminal.
        command: to be copied; then: a sentence on what to do after it, or in its place.
    """

    line: str
    sure: str = ""
    bars: tuple[Bar, ...] = ()
    command: str = ""
    then: str = ""
    most: int = BARS

    def shares(self, bar: Bar) -> tuple[float, float, float | None]:
        """Return before, after and noise of a bar over the longest of all bars."""
        longest = max(size or 0.0 for each in self.bars for size in each.sizes) or 1.0
        before, after, noise = bar.sizes
        return before / longest, after / longest, None if noise is None else noise / longest

    def key(self, change: str, rise: str, noise: str) -> str:
        """Return the words for what the bars have: a change, a rise, the mark of noise, or none."""
        has = (
            any(bar.after for bar in self.bars),
            any(bar.rises for bar in self.bars),
            any(bar.sizes[2] is not None for bar in self.bars),
        )
        words = [text for text, there in zip((change, rise, noise), has, strict=True) if there]
        return ": " * bool(words) + ", ".join(words)

    def text(self) -> list[str]:
        """Return the lines for a terminal."""
        lines = [*wrapped(self.line, "  "), *wrapped(self.sure, "  ")]
        rows = [[bar.joint, self._strip(bar), bar.words] for bar in self.bars[: self.most]]
        if rows:
            lines += ["", f"error{self.key('█ stays, ░ goes', '▒ comes', '| noise')}"]
            width = max(len(row[0]) for row in rows)
            lines += [f"  {joint:<{width}}  {strip}  {words}" for joint, strip, words in rows]
        if (more := len(self.bars) - self.most) > 0:
            lines.append(f"  and {more} joint{'s' * (more > 1)} more")
        lines += ["", f"  {self.command}"] if self.command else []
        return [*lines, *([""] if self.then else []), *wrapped(self.then, "  ")]

    def _strip(self, bar: Bar) -> str:
        before, after, noise = self.shares(bar)
        cells = "█" * round(STRIP * min(before, after))
        change = round(STRIP * max(before, after)), "▒" if bar.rises else "░"
        cells = cells.ljust(*change).ljust(STRIP + 1)
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


def place_of(mechanism: Mechanism) -> str:
    """Return the mechanism as commands take it."""
    place = mechanism.toml.parent if mechanism.toml else mechanism.urdf
    return shlex.quote(str(place)) if place != Path() else "MECHANISM"


def add_command(mechanism: Mechanism, effects: Iterable[Effect]) -> str:
    """Return the command that adds effects to a mechanism, ready to be copied."""
    return " ".join(["ident add", place_of(mechanism), *(effect.label for effect in effects)])


def next_command(verb: str) -> str:
    """Return the command that goes on with a verb from the one that runs, ready to be copied.

    Nothing outside of a command, or where the verb does not take the options of the model.
    """
    if (given := inputs.get()) is None:
        return ""
    options, out = given.options, folder.get()
    if verb == "monitor" and {o for o in options if o[:2] == "--"} - MONITOR:
        return ""
    if verb == "compare" and not out:
        verb = "identify"  # which writes the fit
    words = {
        "compare": ["OTHER.csv", "--fit", f"{out}/fit.json"],  # on a log that was not fitted
        "diagnose": [*given.logs, *options],
        "excite": ["--out", "next.csv"],
        "identify": [*given.logs, *options, "--out", out or "DIR"],
        "monitor": ["NEXT.csv", *(w for log in given.logs for w in ("--like", log)), *options],
    }
    return shlex.join(["ident", verb, given.mechanism, *words[verb]])
