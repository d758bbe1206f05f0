"""The first lines of a result: what it is, how sure, the error of every joint, what to do next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ident.display import acceptable, folder, inputs
from ident.effects import Effect
from ident.faults.data_checks import Health
from ident.faults.fault import UNITS
from ident.finding import Finding
from ident.fit.findings import DRIVING
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.information.chance import LEAVES
from ident.information.estimate import MATERIAL
from ident.mechanism.load import has_identified
from ident.mechanism.mechanism import Mechanism
from ident.show.error_axis import KEY_BEFORE, KEY_NOISE, KEY_NOW, ErrorAxis
from ident.text import percent, places, rounded, significant, some, two_digits, width, wrapped

# options of the model
PAIRS, FLAGS = ("--with", "--lock", "--unmeasured"), ("--absolute", "--allow-code")
STRIP = 34  # shown: characters of the axis of errors in a terminal that has room for it
BARS = 8  # joints that a terminal shows at most
NOISY = 1.5  # times the noise of the sensors, in good logs 0.5 to 1.3, from which it is more
CLEAR = 1000.0  # times the noise of the sensors, beyond which the number says no more
SAME = 0.005  # of an error: a change below is none, since both are printed with three digits
BODIES = 0.3  # difference of logarithms that the masses of a URDF make


@dataclass(frozen=True)
class Bar:
    """The error of one joint: before, after, and what noise alone would leave [N m | N]."""

    joint: str
    before: Error
    after: Error | None = None
    noise: float | None = None

    @property
    def sizes(self) -> tuple[float, float, float | None]:
        """Before, after and noise as shares of the measured torque; 0 where there is none. After
        and noise are those of one log, which may be another than that of before.
        """
        before, after = self.before, self.after or self.before
        if not before.relative or not before.rms:
            return 0.0, 0.0, None
        torque = after.rms / after.relative if after.relative else before.rms / before.relative
        share = after.rms / torque if after.relative is None else after.relative
        return before.relative, share, self.noise / torque if self.noise else None

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
    def rises(self) -> bool:
        """Whether the error is larger after."""
        before, after = self.before, self.after or self.before
        if before.relative is None or after.relative is None:
            return after.rms > (1 + SAME) * before.rms
        return after.relative > (1 + SAME) * before.relative

    @property
    def words(self) -> str:
        """The error in numbers."""
        both = [self.before, *([self.after] if self.after else [])]
        if self.before.relative is None:
            return " → ".join(f"{significant(error.rms)} {error.unit}" for error in both)
        noise = self.sizes[2]
        beside = " (larger)" * self.rises
        beside += "" if noise is None else f", noise {percent(noise)}"
        return " → ".join(percent(error.relative) for error in both) + beside


def bars_of(
    before: Mapping[str, Error], now: Mapping[str, Error], noise: Mapping[str, float | None]
) -> tuple[Bar, ...]:
    """Return the bars of errors now, with those before where they are known."""
    return tuple(
        Bar(j, before.get(j, e), e if j in before else None, noise[j])
        for j, e in now.items()
        if not e.unmeasured
    )


def good_enough(
    errors: Mapping[str, Error],
    floor: Mapping[str, float],
    away: Mapping[str, float] | None = None,
    searched: bool = False,
    logs: Sequence[str] = (),
    doubts: Sequence[Finding] = (),
) -> str:
    """Return a sentence on whether the errors of all joints are noise, or too small to matter.

    Args:
        errors, floor: by joint, of the model and what noise of the sensors makes [N m | N].
        away: rms away from reversals of joints with dry friction, as
            `Residual.errors_away_from_reversals`.
        searched: whether nothing that is missing was found.
        logs: other ones than those that were fitted; doubts: on the data.
    """
    own = acceptable.get()
    least = MATERIAL if own is None else own  # share of the torque that is acceptable
    judged = {j: e for j, e in errors.items() if own is not None or floor.get(j)}
    ask = f"Good enough on {some([*logs], 2)}?" if logs else "Good enough?"
    if not judged:
        return ""
    times = {j: _times(e, floor.get(j)) for j, e in judged.items()}
    loud, most = too_large(judged, floor, least), max(times.values())
    if loud and own is not None:
        words = [f"{j} ({Bar(j, errors[j]).words})" for j in loud]
        return f"{ask} Not in {some(words, 2)}: more than {percent(own)} and than noise."
    if loud:
        rest = max((away or {}).get(j, math.inf) / floor[j] for j in loud)
        turns = ", but only near reversals, where a smoothed speed misses the jump of dry friction"
        turns = f"{turns}: elsewhere {rest:.1f} times" * (rest <= NOISY)
        words = [f"{j} ({_multiple(times[j])} times)" for j in loud]
        words[0] = words[0].replace("times)", "times the noise of the sensors)")
        worst = max(times, key=lambda j: times[j])
        how = "As good as this data can show"
        how += f", at {_multiple(most)} times the noise of the sensors in {worst}"
        return f"{ask} {how if searched else f'Not in {some(words, 2)}'}{turns}."
    share = {j: e.relative or 0.0 for j, e in judged.items()}
    noise = {j: x * floor.get(j, 0.0) / max(judged[j].rms, 1e-300) for j, x in share.items()}
    worst = max(judged, key=lambda j: max(share[j], noise[j]))  # a cause could hide there
    if max(share[worst], noise[worst]) > max(LEAVES, least):
        size = f"{percent(noise[worst])} of the torque of {worst}"
        return f"{ask} These logs cannot show it: noise is {size}."
    beside = f", or below {percent(least)} of the torque" * (most > NOISY)
    how = f"noise of the sensors{beside}" if beside else f"at most {most:.1f} times the noise"
    fits = f"in every joint the error is {how}"
    if scale_doubts(doubts):
        return f"{ask} Doubtful: {fits}, but the size of the torques looks wrong."
    return f"{ask} Yes: {fits}."


OTHER = "is this a log of this machine, with its load and units?"


def scale_doubts(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings on the size of torques: a fit follows them, whatever their unit is."""
    return [each for each in findings if each.code == "magnitude"]


def spoiling(health: Health) -> list[Finding]:
    """Return the faults of data that explain a log, as does another unit of several torques."""
    units = [
        each
        for each in scale_doubts(health.findings)
        if each.number
        and each.where[1:]
        and any(abs(abs(math.log(each.number)) - math.log(unit)) < BODIES for unit in UNITS)
    ]
    return [*health.faults, *units]


def doubts_of(health: Health, findings: Iterable[Finding]) -> tuple[list[str], bool]:
    """Return in words what looks wrong in the data of a fit, and whether that explains the log."""
    turned = [  # torques: driving friction, the negative of what the URDF's bodies need
        each
        for each in (*health.findings, *findings)
        if each.code == DRIVING or (each.code == "unlike" and (each.threshold or 0.0) < 0)
    ]
    wrong = [f"The data look wrong: {each}." for each in health.faults]
    wrong += [f"The size looks wrong of {each}." for each in scale_doubts(health.findings)]
    wrong += [f"The sign looks wrong of {each}." for each in turned]
    return wrong, bool(spoiling(health))


def enough(
    errors: Mapping[str, Error], floor: Mapping[str, float], doubts: Sequence[Finding] = ()
) -> bool:
    """Return whether `good_enough` says yes."""
    return "? Yes: " in good_enough(errors, floor, doubts=doubts)


def too_large(errors: Mapping[str, Error], floor: Mapping[str, float], least: float) -> list[str]:
    """Return the joints, the loudest first, whose error is above a share `least` of the torque, and
    above the noise of the sensors. Noise that is not known is no excuse.
    """
    times = {joint: _times(e, floor.get(joint)) for joint, e in errors.items()}
    loud = [
        j
        for j, e in errors.items()
        if times[j] > NOISY and (1.0 if e.relative is None else e.relative) > least
    ]
    return sorted(loud, key=lambda joint: -times[joint])


def _multiple(times: float) -> str:
    """Return a multiple of noise in words; noise of a filtered log is not known to be smaller."""
    return two_digits(times) if times < CLEAR else f"more than {CLEAR:.0f}"


def _times(error: Error, noise: float | None) -> float:
    """Return an error as a multiple of the noise of the sensors."""
    return error.rms / noise if noise else math.inf


@dataclass(frozen=True)
class Card:
    """The first lines of a result: what it is, how sure, the error by joint, what to do next.

    Attributes:
        line, sure: sentences; bars: of the joints, in the mechanism's order.
        command: to be copied; then: a sentence on what to do after it, or in its place.
        change: what the errors before and after are of, as `of a → of b`.
        most: bars in a terminal; first: joint whose bar is always one of them.
    """

    line: str
    sure: str = ""
    bars: tuple[Bar, ...] = ()
    command: str = ""
    then: str = ""
    change: str = ""
    most: int = BARS
    first: str = ""

    @property
    def shown(self) -> list[Bar]:
        """The bars that a terminal shows, in order: the first joint's and the loudest."""

        def rank(bar: Bar) -> tuple[bool, float]:
            worst = max(_times(error, bar.noise) for error in (bar.before, bar.after or bar.before))
            return bar.joint != self.first, -worst

        chosen = sorted(self.bars, key=rank)[: self.most]
        return [bar for bar in self.bars if bar in chosen]

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
        if (more := len(self.bars) - self.most) > 0:
            risen = [bar.joint for bar in self.bars if bar.rises and bar not in bars]
            larger = f", larger in {places(risen)}" * bool(risen)
            lines.append(f"  and {more} joint{'s' * (more > 1)} more{larger}")
        lines += ["", f"  {self.command}"] if self.command else []
        return [*lines, *([""] if self.then else []), *wrapped(self.then, "  ")]


def place_of(mechanism: Mechanism) -> str:
    """Return the mechanism as commands take it."""
    place = mechanism.toml.parent if mechanism.toml else mechanism.urdf
    return shlex.quote(str(place)) if mechanism.toml or place != Path() else "MECHANISM"


def add_command(mechanism: Mechanism, effects: Iterable[Effect], files: Iterable[str] = ()) -> str:
    """Return the command that adds effects, and laws in files, to a mechanism: first those that
    the running command was given `--with`, which are no part of it yet.
    """
    options, files = getattr(inputs.get(), "options", ()), [*files]
    words = [word for name, word in pairwise(options) if name == "--with"]
    words += [*(effect.label for effect in effects), *files]
    code = ["--allow-code"] if files or "--allow-code" in options else []
    return f"ident add {place_of(mechanism)} {shlex.join([*dict.fromkeys(words), *code])}"


def unused(name: str) -> str:
    """Return a name for a file or folder, with a number where it would overwrite another one."""
    path, taken, n = Path(name), folder.get(), 1
    while (taken and path == Path(taken)) or path.exists():
        path = Path(name).with_name(f"{Path(name).stem}_{(n := n + 1)}{Path(name).suffix}")
    return str(path)


def next_command(
    verb: str,
    added: Iterable[Effect] = (),
    separate: Sequence[str] = (),
    known: bool = False,
    unmeasured: Iterable[str] = (),
) -> str:
    """Return the command that goes on with a verb from the one that runs; nothing outside of one.

    `separate`: two labels that excite is to tell apart. `known`: with the bodies of an earlier fit.
    `unmeasured`: further joints without a torque sensor.
    """
    if (given := inputs.get()) is None:
        return ""
    more = [word for effect in added for word in ("--with", effect.label)]
    more += [word for name in unmeasured for word in ("--unmeasured", name)]
    options, out = (*given.options, *more), folder.get()

    def own(*names: str) -> list[str]:
        pairs = (pair for pair in pairwise((*options, "")) if pair[0] in names)
        return [w for name, w in pairs for w in ([name, w] if name in PAIRS else [name])]

    if verb == "monitor" and {"--basis", "--spacing"} & {*options}:  # it has none
        return ""
    if verb == "compare" and not out:
        verb = "identify"  # which writes the fit
    words = {
        # on a log that was not fitted
        "compare": ["OTHER.csv", "--fit", f"{out}/fit.json", *own(*PAIRS[1:], *FLAGS)],
        "diagnose": [*given.logs, *options],
        "explore": [*given.logs, *options],
        "excite": [
            *own(*PAIRS, "--allow-code"), *(["--separate", *separate] if separate else []),
            "--out", unused("next.csv"),
        ],
        "grow": [*given.logs, *options, "--out", unused("grown")],  # from what is unknown in it
        "identify": [*given.logs, *options, "--out", unused(out) if out else "DIR"],
        "monitor": [
            "NEXT.csv", *(w for log in given.like or given.logs for w in ("--like", log)), *options,
        ],
    }  # fmt: skip
    mechanism = given.mechanism
    if verb == "grow" and has_identified(Path(mechanism).parent):
        mechanism = str(Path(mechanism).parent)
    elif verb == "diagnose" and has_identified(Path(mechanism)):
        mechanism += "/identified"  # with known bodies a load can be the cause
    elif verb == "diagnose" and known and given.fit:  # effects are in it, with their values
        mechanism, words[verb] = f"{given.fit}/identified", [*given.logs, *own(*PAIRS[1:], *FLAGS)]
    return shlex.join(["ident", verb, mechanism, *words[verb]])


def body_words(parameters: Sequence[Value]) -> str:
    """Return mass and centre of mass of a body by its ten parameters, of the centre what the data
    determine. Its errors are the sums of those of the moment and of the mass.
    """
    own = {v.name.rpartition(".")[2]: v for v in parameters}
    moments = {axis: own[f"m{axis}"] for axis in "xyz" if f"m{axis}" in own}
    known = {axis: v for axis, v in moments.items() if v.stderr is not None}
    if len(moments) < 3 or len(known) < 2 or "m" not in own or own["m"].stderr is None:
        return ""
    m, error = own["m"].value, own["m"].stderr or 0.0
    if abs(m) <= 2 * error:
        return ""
    centre = []
    for axis, v in known.items():
        c = v.value / m
        size = ((v.stderr or 0.0) + abs(c) * error) / abs(m)
        centre.append(f"{axis} = {rounded(c, size)}")
    return f"mass {rounded(m, error)} kg, its centre at {', '.join(centre)} m in the link's axes"
