"""Mistakes in a log, a model or an experiment: functions of a case, each with what names it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from subjects import Case, positions_only, recorded

import ident
from ident import Log

UNIT = r"magnitude|unit|factor|times what|degrees|gear|scale"
CLOCK = r"clock|time|\bt\b|fast|slow"
GRAVITY = r"gravity"
GEOMETRY = r"length|geometry|frame|URDF|closure"
EXCITED = r"this motion|equations|excit|cannot tell|stand|move"


@dataclass(frozen=True)
class Mistake:
    """One kind.

    Attributes:
        name: in words; make: changes a case; names: a pattern of text that says what is wrong.
        rates: whether the log has velocities and accelerations.
        hidden: by machine (or `*`), why no log of that motion can show it.
    """

    name: str
    make: Callable[[Case], Case]
    names: str
    rates: bool = False
    hidden: Mapping[str, str] = field(default_factory=dict)

    def of(self, case: Case) -> Case:
        """The case with the mistake."""
        return self.make(case if self.rates else positions_only(case))


MADE: list[Mistake] = []


def mistake(name: str, names: str, rates: bool = False, **hidden: str):
    """Register a function of a case as a kind of mistake."""

    def register(make: Callable[[Case], Case]) -> Callable[[Case], Case]:
        MADE.append(Mistake(name, make, names, rates, hidden))
        return make

    return register


def tau(c: Case) -> np.ndarray:
    return c.columns[f"tau.{c.subject.one}"]


def with_tau(c: Case, x: np.ndarray) -> Case:
    return c.logged(**{f"tau__{c.subject.one}": x})


def position(c: Case) -> str:
    """The position that is wrong: of `one`."""
    return f"q.{c.subject.one}"


def with_q(c: Case, x: np.ndarray) -> Case:
    return c.logged(**{position(c): x})


def smooth(x: np.ndarray, samples: int) -> np.ndarray:
    kernel = np.hanning(samples + 2)[1:-1]
    wide = np.pad(x, samples, mode="edge")
    return np.convolve(wide, kernel / kernel.sum(), "same")[samples:-samples]


def late(x: np.ndarray, samples: int) -> np.ndarray:
    return np.concatenate([np.full(samples, x[0]), x[:-samples]])


def another(c: Case, seed: int = 3) -> Case:
    """A log of the same machine in another motion."""
    scale = np.random.default_rng(seed)
    factors = {joint: scale.uniform(0.5, 0.9) for joint in c.subject.driven}
    motion = c.subject.moving(factors.__getitem__, slower=0.77)
    return recorded(c.subject, c.truth, motion, seed)


# --- units and signs of torques ----------------------------------------------------------------

for _text, _factor in (
    ("all torques in N mm", 1e3),
    ("all torques in lb in", 8.8507),
    ("all torques in kgf cm", 10.197),
    ("all torques in kN m", 1e-3),
):
    mistake(_text, UNIT)(lambda c, f=_factor: c.each("tau.", lambda x: f * x))
for _text, _factor in (
    ("one torque in N mm", 1e3),
    ("one torque in lb in", 8.8507),
    ("one torque without its gear ratio of 101", 1 / 101),
    ("one torque with a gear ratio of 36.4 too many", 36.4),
    ("one torque by a wrong torque constant, 2.6 times", 2.6),
):
    mistake(_text, UNIT)(lambda c, f=_factor: with_tau(c, f * tau(c)))


@mistake("all torques in A, each with a constant of its own", UNIT)
def _(c: Case) -> Case:
    names = [n for n in c.columns if n.startswith("tau.")]
    constants = np.random.default_rng(2).uniform(3.0, 40.0, len(names))
    return c.logged(**{n: c.columns[n] / k for n, k in zip(names, constants, strict=True)})


@mistake("sign of one torque", r"sign|negative")
def _(c: Case) -> Case:
    return with_tau(c, -tau(c))


@mistake("sign of all torques", r"sign|negative")
def _(c: Case) -> Case:
    return c.each("tau.", lambda x: -x)


@mistake("one torque without its sign (absolute value)", r"sign|negative")
def _(c: Case) -> Case:
    return with_tau(c, np.abs(tau(c)))


# --- other torques -----------------------------------------------------------------------------


@mistake("two torques exchanged", r"exchang")
def _(c: Case) -> Case:
    a, b = f"tau.{c.subject.one}", f"tau.{c.subject.other}"
    return c.logged(**{a: c.columns[b], b: c.columns[a]})


@mistake("one torque twice: that of another joint", r"column|copy|same|exchang")
def _(c: Case) -> Case:
    return with_tau(c, c.columns[f"tau.{c.subject.other}"])


@mistake("all torques of another run", r"another run|other run|belong|motion")
def _(c: Case) -> Case:
    run = another(c).columns
    return c.logged(**{n: x for n, x in run.items() if n.startswith("tau.")})


@mistake("one torque of another run", r"another run|other run|belong|motion")
def _(c: Case) -> Case:
    return with_tau(c, another(c).columns[f"tau.{c.subject.one}"])


@mistake("a command instead of one torque: the URDF's, without friction", r"command|measure|noise")
def _(c: Case) -> Case:
    motion = {n: x for n, x in c.subject.moving(lambda joint: 1.0).items() if n != "t"}
    log = Log.from_arrays("run.csv", c.columns["t"], motion)
    computed, _ = ident.simulate(replace(c.truth, effects=()), log)
    return with_tau(c, computed.columns[f"tau.{c.subject.one}"])


@mistake("one torque without its mean (high-passed)", r"offset|mean|constant")
def _(c: Case) -> Case:
    return with_tau(c, tau(c) - tau(c).mean())


@mistake("offset on one torque", r"offset|constant")
def _(c: Case) -> Case:
    return with_tau(c, tau(c) + 0.3 * np.ptp(tau(c)))


@mistake("all torques 20 ms late", r"late|delay|clock")
def _(c: Case) -> Case:
    return c.each("tau.", lambda x: late(x, 4))


@mistake("all torques 60 ms late", r"late|delay|clock")
def _(c: Case) -> Case:
    return c.each("tau.", lambda x: late(x, 12))


@mistake("all torques 0.5 s late", r"late|delay|clock|another run|belong")
def _(c: Case) -> Case:
    return c.each("tau.", lambda x: late(x, 100))


@mistake("one torque 25 ms late", r"late|delay")
def _(c: Case) -> Case:
    return with_tau(c, late(tau(c), 5))


@mistake("positions 25 ms late", r"early|late|delay|clock")
def _(c: Case) -> Case:
    return c.each("q.", lambda x: late(x, 5))


# --- broken channels ---------------------------------------------------------------------------

DEAD = r"always|constant|no measurement|zero"
mistake("one torque always zero", DEAD)(lambda c: with_tau(c, 0 * tau(c)))
mistake("all torques zero", DEAD)(lambda c: c.each("tau.", lambda x: 0 * x))
mistake("one torque constant", DEAD)(lambda c: with_tau(c, 0 * tau(c) + 0.3))


@mistake("one torque is noise", r"noise|measure")
def _(c: Case) -> Case:
    return with_tau(c, 0.1 * tau(c).std() * np.random.default_rng(4).normal(size=len(tau(c))))


@mistake("one torque clipped at 60 %", r"extreme|clip|range|limit")
def _(c: Case) -> Case:
    limit = 0.6 * np.abs(tau(c)).max()
    return with_tau(c, np.clip(tau(c), -limit, limit))


@mistake("all torques clipped at 50 %", r"extreme|clip|range|limit")
def _(c: Case) -> Case:
    return c.each("tau.", lambda x: np.clip(x, -0.5 * np.abs(x).max(), 0.5 * np.abs(x).max()))


@mistake("one torque frozen for 0.6 s", r"stays|frozen")
def _(c: Case) -> Case:
    x = tau(c).copy()
    x[400:520] = x[400]
    return with_tau(c, x)


@mistake("one torque held for 16 samples at a time", r"held")
def _(c: Case) -> Case:
    return with_tau(c, tau(c)[np.arange(len(tau(c))) // 16 * 16])


@mistake("one torque low-passed at 1 Hz", r"late|filter|low-pass|delay|noise")
def _(c: Case) -> Case:
    return with_tau(c, smooth(tau(c), 200))


@mistake("all torques low-passed, causally, by 60 ms", r"late|filter|low-pass|delay")
def _(c: Case) -> Case:
    def passed(x: np.ndarray) -> np.ndarray:
        y, out = x[0], np.empty_like(x)
        for i, value in enumerate(x):
            y += (value - y) / 12.0
            out[i] = y
        return out

    return c.each("tau.", passed)


@mistake("one torque in coarse steps", r"steps")
def _(c: Case) -> Case:
    step = 0.3 * tau(c).std()
    return with_tau(c, np.round(tau(c) / step) * step)


@mistake("one torque of 1e20 N m in a cell", r"no measurement|1e\+20|left out")
def _(c: Case) -> Case:
    x = tau(c).copy()
    x[500] = 1e20
    return with_tau(c, x)


@mistake("spikes in one torque", r"no measurement|spike|left out|outlier|lone")
def _(c: Case) -> Case:
    x = tau(c).copy()
    x[::97] += 40 * x.std()
    return with_tau(c, x)


@mistake("a block of all torques empty", r"empty|no sample|left out")
def _(c: Case) -> Case:
    gap = (np.arange(len(c.columns["t"])) // 120) % 4 == 1
    return c.each("tau.", lambda x: np.where(gap, np.nan, x))


# --- time --------------------------------------------------------------------------------------

LIGHT = "gravity does no work here: time scales inertia, which is unknown"
FEW_KNOWN = "three moments and friction are unknown: they take up the scale of time"


def at_rate(factor: float) -> Callable[[Case], Case]:
    return lambda c: c.logged(t=factor * c.columns["t"])


mistake("time in ms", CLOCK)(at_rate(1e3))
mistake("time in µs", CLOCK)(at_rate(1e6))
mistake("time in minutes", CLOCK + "|filter|noise", five_bar=LIGHT)(at_rate(1 / 60))
mistake("time in samples", CLOCK)(at_rate(200.0))
mistake("200 Hz taken for 100 Hz", CLOCK, five_bar=LIGHT)(at_rate(2.0))
mistake("200 Hz taken for 1 kHz", CLOCK, five_bar=LIGHT)(at_rate(0.2))
mistake("clock 10 % slow", CLOCK, five_bar=LIGHT)(at_rate(0.9))
mistake("clock 10 % fast", CLOCK, five_bar=LIGHT)(at_rate(1.1))
mistake("clock 10 % slow, rates logged", CLOCK, rates=True)(at_rate(0.9))


@mistake("stamps that jitter by 2 ms", r"uneven|jitter")
def _(c: Case) -> Case:
    t = c.columns["t"]
    return c.logged(t=t + 0.002 * np.random.default_rng(1).uniform(-1, 1, len(t)))


@mistake("one row of ten lost, t counted on", r"clock|lost|jump")
def _(c: Case) -> Case:
    keep = np.random.default_rng(1).uniform(size=len(c.columns["t"])) > 0.1
    short = c.rows(np.flatnonzero(keep))
    return short.logged(t=c.columns["t"][: keep.sum()])


@mistake("one row of ten lost", r"uneven|gap|left out")
def _(c: Case) -> Case:
    return c.rows(np.flatnonzero(np.random.default_rng(1).uniform(size=len(tau(c))) > 0.1))


@mistake("a gap of 0.6 s", r"gap|no sample|left out|run")
def _(c: Case) -> Case:
    return c.rows(np.r_[0:420, 540 : len(tau(c))])


@mistake("a gap of 0.6 s, t counted on", r"jump|gap|clock")
def _(c: Case) -> Case:
    rows = np.r_[0:420, 540 : len(tau(c))]
    return c.rows(rows).logged(t=c.columns["t"][: len(rows)])


@mistake("rows shuffled", r"backward")
def _(c: Case) -> Case:
    return c.rows(np.random.default_rng(0).permutation(len(tau(c))))


@mistake("rows shuffled, t counted on", r"noise|jump|clock|shuffl")
def _(c: Case) -> Case:
    t = c.columns["t"]
    return c.rows(np.random.default_rng(0).permutation(len(t))).logged(t=t)


@mistake("a clock that starts again", r"backward")
def _(c: Case) -> Case:
    t = c.columns["t"]
    return c.logged(t=np.where(t > 2.5, t - 2.5, t))


@mistake("the log backwards, t counted on", CLOCK + "|sign|negative|backward")
def _(c: Case) -> Case:
    return c.rows(np.arange(len(tau(c)))[::-1]).logged(t=c.columns["t"])


@mistake("every row twice", r"repeated")
def _(c: Case) -> Case:
    return c.rows(np.repeat(np.arange(len(tau(c))), 2))


@mistake("every row twice, t counted on", r"repeat|held|twice|clock|steps")
def _(c: Case) -> Case:
    rows = np.repeat(np.arange(len(tau(c))), 2)
    return c.rows(rows).logged(t=np.arange(len(rows)) / 200.0)


@mistake("the log twice, one after the other", r"jump|repeat|gap|twice|again")
def _(c: Case) -> Case:
    n = len(tau(c))
    return c.rows(np.r_[0:n, 0:n]).logged(t=np.arange(2 * n) / 200.0)


@mistake("halves of the log exchanged", r"jump|gap")
def _(c: Case) -> Case:
    n = len(tau(c))
    return c.rows(np.r_[n // 3 : n, 0 : n // 3]).logged(t=c.columns["t"])


# --- positions ---------------------------------------------------------------------------------

DEG = 180 / np.pi
TURNED = "a mirrored motion closes as well, and obeys the same equations"
mistake("all positions in degrees", UNIT)(lambda c: c.each("q.", lambda x: DEG * x))
mistake("one position in degrees", UNIT)(lambda c: with_q(c, DEG * c.columns[position(c)]))
mistake("one position of the motor, before its gears", UNIT)(
    lambda c: with_q(c, 101 * c.columns[position(c)])
)
mistake("sign of one position", r"sign|axis|turned|negative")(
    lambda c: with_q(c, -c.columns[position(c)])
)
mistake("sign of all positions", r"sign|axis|turned|negative")(lambda c: c.each("q.", lambda x: -x))
mistake("zero of one position 0.3 rad off", r"encoder_offset|zero|offset")(
    lambda c: with_q(c, c.columns[position(c)] + 0.3)
)
mistake("zero of one position a right angle off", r"encoder_offset|zero|offset")(
    lambda c: with_q(c, c.columns[position(c)] + np.pi / 2)
)


@mistake("two positions exchanged", r"exchang")
def _(c: Case) -> Case:
    a, b = position(c), f"q.{c.subject.other}"
    return c.logged(**{a: c.columns[b], b: c.columns[a]}) if b in c.columns else c


@mistake("one position that of another joint", r"exchang|same|copy|column")
def _(c: Case) -> Case:
    b = f"q.{c.subject.other}"
    return with_q(c, c.columns[b]) if b in c.columns else c


@mistake("one position counted from the world, the URDF's from the link before", r"counted from")
def _(c: Case) -> Case:
    b = f"q.{c.subject.other}"
    return with_q(c, c.columns[position(c)] + c.columns[b]) if b in c.columns else c


@mistake("one position of another run", r"another run|belong|motion")
def _(c: Case) -> Case:
    return with_q(c, another(c).columns[position(c)])


@mistake("one position frozen for 0.6 s", r"stays|frozen")
def _(c: Case) -> Case:
    x = c.columns[position(c)].copy()
    x[400:520] = x[400]
    return with_q(c, x)


@mistake("one position always the same", r"stand|move|constant")
def _(c: Case) -> Case:
    return with_q(c, 0 * c.columns[position(c)] + 0.4)


@mistake("one position in steps of 1°", r"steps|noise")
def _(c: Case) -> Case:
    return with_q(c, np.round(DEG * c.columns[position(c)]) / DEG)


@mistake("one position jumps by 0.2 rad (a lost count)", r"jump|position|offset")
def _(c: Case) -> Case:
    return with_q(c, c.columns[position(c)] + 0.2 * (c.columns["t"] > 2.0))


@mistake("one position wrapped within half a turn", r"jump|wrap|turn|unwrapped")
def _(c: Case) -> Case:
    x = c.columns[position(c)] * 3
    moved = with_q(c, x)
    return with_q(moved, (x - x.mean() + 1.0) % 2.0 - 1.0 + x.mean())


@mistake("one sample of 100 rad", r"no measurement|100|left out")
def _(c: Case) -> Case:
    x = c.columns[position(c)].copy()
    x[300] = 100.0
    return with_q(c, x)


@mistake("a fifth of one position's cells empty", r"empty|interpolated")
def _(c: Case) -> Case:
    x = c.columns[position(c)].copy()
    x[np.random.default_rng(1).uniform(size=len(x)) < 0.2] = np.nan
    return with_q(c, x)


@mistake("one position low-passed by 0.1 s", r"late|delay|filter|noise")
def _(c: Case) -> Case:
    return with_q(c, smooth(late(c.columns[position(c)], 10), 20))


@mistake("one position 25 ms late", r"late|early|delay")
def _(c: Case) -> Case:
    return with_q(c, late(c.columns[position(c)], 5))


# --- rates -------------------------------------------------------------------------------------


def _rate(letter: str, change: Callable[[Case, np.ndarray], np.ndarray]) -> Callable[[Case], Case]:
    def make(c: Case) -> Case:
        name = f"{letter}.{c.subject.one}"
        return c.logged(**{name: change(c, c.columns[name])})

    return make


def _of_other(letter: str) -> Callable[[Case, np.ndarray], np.ndarray]:
    def change(c: Case, x: np.ndarray) -> np.ndarray:
        other = next((j for j in c.subject.driven if j != c.subject.one), "")
        return c.columns[f"{letter}.{other}"] if other else x[::-1]

    return change


DISAGREE = r"disagree|differ|contradict|column|noise|residual"
mistake("one velocity in °/s", DISAGREE, True)(_rate("v", lambda c, x: DEG * x))
mistake("sign of one velocity", DISAGREE, True)(_rate("v", lambda c, x: -x))
mistake("velocity of another joint", DISAGREE, True)(_rate("v", _of_other("v")))
mistake("one velocity zero", DISAGREE, True)(_rate("v", lambda c, x: 0 * x))
mistake("one velocity 25 ms late", DISAGREE + "|late", True)(_rate("v", lambda c, x: late(x, 5)))
mistake("one velocity 1.3 times", DISAGREE, True)(_rate("v", lambda c, x: 1.3 * x))
mistake("one acceleration of another joint", DISAGREE, True)(_rate("a", _of_other("a")))
mistake("one acceleration in g", DISAGREE, True)(_rate("a", lambda c, x: x / 9.81))
mistake("acceleration instead of one velocity", DISAGREE, True)(
    _rate("v", lambda c, x: c.columns[f"a.{c.subject.one}"])
)


# --- the model ---------------------------------------------------------------------------------


def gravity(x: float, y: float, z: float) -> Callable[[Case], Case]:
    def make(c: Case) -> Case:
        text = re.sub(r"gravity = \[.*?\]", f"gravity = [{x}, {y}, {z}]", c.subject.toml)
        return c.described(toml=text)

    return make


PLANE = "gravity is across the plane of motion"
FLAT = "gravity along the plane would be seen, across it not"
mistake("gravity upside down", GRAVITY, five_bar=PLANE)(gravity(0, 0, 9.81))
mistake("gravity along x", GRAVITY)(gravity(-9.81, 0, 0))
mistake("gravity along y", GRAVITY)(gravity(0, -9.81, 0))
mistake("gravity zero", GRAVITY, five_bar=PLANE)(gravity(0, 0, 0))
mistake("gravity in g", GRAVITY, five_bar=PLANE)(gravity(0, 0, -1))


def joint_edit(pattern: str, change: Callable[[re.Match[str]], str]) -> Callable[[Case], Case]:
    """Edit what a pattern finds in the URDF's element of the joint `one`."""

    def make(c: Case) -> Case:
        def edit(m: re.Match[str]) -> str:
            return re.sub(pattern, change, m[0], count=1, flags=re.S)

        element = rf'<joint name="{re.escape(c.subject.one)}" type=.*?</joint>'
        return c.described(urdf=re.sub(element, edit, c.subject.urdf, flags=re.S))

    return make


def lengths(factor: float, only: bool = False) -> Callable[[Case], Case]:
    """All lengths of joints (of closures too) times a factor; or that of one joint after `one`."""

    def scaled(m: re.Match[str]) -> str:
        return m[1] + " ".join(repr(factor * float(x)) for x in m[2].split()) + m[3]

    def make(c: Case) -> Case:
        def edit(m: re.Match[str]) -> str:
            return re.sub(r'(xyz=")([^"]*)(")', scaled, m[0])

        parent = next_parent(c)
        inside = r"<origin[^>]*>"
        inner = r"(?:(?!</joint>).)*"
        head = rf'<joint name="[^"]*" type={inner}?<parent link="{parent}"{inner}</joint>'
        whole = head if only else r'<joint name="[^"]*" type=.*?</joint>'
        urdf = re.sub(whole, lambda m: re.sub(inside, edit, m[0]), c.subject.urdf, flags=re.S)

        def listed(m: re.Match[str]) -> str:
            return m[1] + ", ".join(repr(factor * float(x)) for x in m[2].split(",")) + m[3]

        toml = c.subject.toml if only else re.sub(r"(xyz = \[)([^\]]*)(\])", listed, c.subject.toml)
        return c.described(urdf, toml)

    return make


def next_parent(c: Case) -> str:
    """The link that the joint `one` moves."""
    element = re.search(
        rf'<joint name="{re.escape(c.subject.one)}" type=.*?</joint>', c.subject.urdf, re.S
    )
    assert element
    child = re.search(r'<child link="([^"]+)"', element[0])
    assert child
    return child[1]


mistake("all lengths of the URDF in mm", GEOMETRY + "|m\\b")(lengths(1e3))
mistake("a URDF of a machine 20 % smaller", GEOMETRY, five_bar="similar loops move alike")(
    lengths(0.8)
)
mistake("one length 10 % too long", GEOMETRY)(lengths(1.1, only=True))
mistake("one length twice", GEOMETRY)(lengths(2.0, only=True))


def _negated(m: re.Match[str]) -> str:
    return m[1] + " ".join(repr(-float(x)) for x in m[2].split()) + m[3]


def _rolled(m: re.Match[str]) -> str:
    x = m[2].split()
    return m[1] + " ".join([x[2], x[0], x[1]]) + m[3]


AXIS = r"axis|turned|sign|negative"
mistake("the axis of one joint turned round", AXIS)(
    joint_edit(r'(<axis xyz=")([^"]*)(")', _negated)
)
mistake("the axis of one joint along another direction", AXIS + "|" + GEOMETRY)(
    joint_edit(r'(<axis xyz=")([^"]*)(")', _rolled)
)


@mistake("two joints' names exchanged in the log", r"exchang")
def _(c: Case) -> Case:
    a, b = c.subject.one, c.subject.other
    swapped = {}
    for name, x in c.columns.items():
        prefix, _, joint = name.partition(".")
        swapped[f"{prefix}.{ {a: b, b: a}.get(joint, joint) }" if joint else name] = x
    return Case(c.subject, swapped, c.values, c.truth)


@mistake("columns in the order of the alphabet, names in that of the URDF", r"exchang|order")
def _(c: Case) -> Case:
    names = c.subject.driven
    if len(names) < 3:
        return c
    moved = {}
    for prefix in ("q", "tau"):
        for name, source in zip(names, [*names[1:], names[0]], strict=True):
            moved[f"{prefix}.{name}"] = c.columns[f"{prefix}.{source}"]
    return c.logged(**moved)


@mistake("ten times the mass of one link, known", r"mass|known|URDF|prior")
def _(c: Case) -> Case:
    link = c.subject.link

    def ten(m: re.Match[str]) -> str:
        return re.sub(
            r'(<mass value=")([^"]*)(")', lambda k: f"{k[1]}{10 * float(k[2])}{k[3]}", m[0]
        )

    urdf = re.sub(rf'<link name="{link}">.*?</link>', ten, c.subject.urdf, flags=re.S)
    unknown = [n for n in c.truth.unknown if not n.startswith(f"{link}.")]
    text = "[parameters]\nunknown = [" + ", ".join(f'"{n}"' for n in unknown) + "]\n"
    if not unknown:
        return c.described(urdf=urdf)
    toml = re.sub(r"\[parameters\]\n.*?\n", "", c.subject.toml, flags=re.S)
    return c.described(urdf, toml + "\n" + text)


@mistake("masses of the URDF in grams", r"mass|URDF")
def _(c: Case) -> Case:
    return c.described(
        urdf=re.sub(
            r'(<mass value=")([^"]*)(")',
            lambda k: f"{k[1]}{1e3 * float(k[2])}{k[3]}",
            c.subject.urdf,
        )
    )


@mistake("a closure 10 mm off", GEOMETRY)
def _(c: Case) -> Case:
    return c.described(
        toml=re.sub(
            r"(b = \{ link = \"[^\"]*\", xyz = \[)([^,]*), ([^,]*),",
            lambda m: f"{m[1]}{float(m[2])}, {float(m[3]) + 0.01},",
            c.subject.toml,
        )
    )


@mistake("a closure 0.1 m off", GEOMETRY)
def _(c: Case) -> Case:
    return c.described(
        toml=re.sub(
            r"(b = \{ link = \"[^\"]*\", xyz = \[)([^,]*), ([^,]*),",
            lambda m: f"{m[1]}{float(m[2])}, {float(m[3]) - 0.1},",
            c.subject.toml,
        )
    )


@mistake("the other branch of the loop", r"branch|closure|start")
def _(c: Case) -> Case:
    toml = c.subject.toml
    for joint in ("left_elbow", "right_elbow", "alpha", "s"):
        toml = re.sub(rf"(\b{joint} = )(-?[\d.]+)", lambda m: f"{m[1]}{-float(m[2])}", toml)
    return c.described(toml=toml)


@mistake("a passive joint taken for a driven one", r"driven|passive|column")
def _(c: Case) -> Case:
    return c.described(toml=re.sub(r'passive = \["[^"]*", ', "passive = [", c.subject.toml))


@mistake("a driven joint taken for a passive one", r"passive|driven")
def _(c: Case) -> Case:
    toml, one = c.subject.toml, c.subject.one
    if "passive = [" in toml:
        return c.described(toml=re.sub(r"passive = \[", f'passive = ["{one}", ', toml))
    return c.described(toml=toml.replace("[joints]\n", f'[joints]\npassive = ["{one}"]\n'))


@mistake("a log of another machine with the same names", r"another|URDF|length|geometry")
def _(c: Case) -> Case:
    random = np.random.default_rng(9)

    def other(m: re.Match[str]) -> str:
        return (
            m[1] + " ".join(repr(float(x) * random.uniform(0.5, 1.8)) for x in m[2].split()) + m[3]
        )

    def edit(m: re.Match[str]) -> str:
        return re.sub(r'(<origin[^>]*xyz=")([^"]*)(")', other, m[0], count=1)

    return c.described(
        urdf=re.sub(r'<joint name="[^"]*" type=.*?</joint>', edit, c.subject.urdf, flags=re.S)
    )


# --- forces from outside -----------------------------------------------------------------------


def pushed(sign: float, along: int = 0) -> Callable[[Case], Case]:
    def make(c: Case) -> Case:
        link, t = c.subject.link, c.columns["t"]
        force = 20 * np.sin(2 * np.pi * 0.7 * t)
        names = [f"wrench.{link}.f{axis}" for axis in "xyz"]
        motion = c.subject.moving(lambda joint: 1.0)
        motion |= dict.fromkeys(names, 0 * t) | {names[0]: force}
        made = positions_only(recorded(c.subject, c.truth, motion))
        shown = dict.fromkeys(names, 0 * t) | {names[along]: sign * force}
        return made.logged(**shown)

    return make


mistake("a wrench with the wrong sign", r"wrench")(pushed(-1.0))
mistake("a wrench along another axis", r"wrench")(pushed(1.0, 1))


@mistake("a payload picked up in the middle", r"change|payload|disagree|differ|half")
def _(c: Case) -> Case:
    values = {n: x * (2.0 if n.startswith(f"{c.subject.link}.") else 1.0)
              for n, x in c.values.items()}  # fmt: skip
    usual = c.subject.moving(lambda joint: 1.0)
    log = Log.from_arrays("run.csv", usual["t"], {k: x for k, x in usual.items() if k != "t"})
    heavy, _ = ident.simulate(c.truth, log, values=values)
    light, _ = ident.simulate(c.truth, log, values=c.values)
    after = c.columns["t"] > 2.5
    return c.logged(**{
        n: x + np.where(after, heavy.columns[n] - light.columns[n], 0.0)
        for n, x in c.columns.items() if n.startswith("tau.")
    })  # fmt: skip


# --- the experiment ----------------------------------------------------------------------------


def experiment(scale: Callable[[Case, str], float], slower: float = 1.0) -> Callable[[Case], Case]:
    def make(c: Case) -> Case:
        motion = c.subject.moving(lambda joint: scale(c, joint), slower)
        return positions_only(recorded(c.subject, c.truth, motion))

    return make


mistake("standing still", EXCITED)(experiment(lambda c, joint: 0.0))
mistake("one joint moved alone", EXCITED)(
    experiment(lambda c, joint: float(joint == c.subject.one))
)
mistake("tiny motions, ±0.02 rad", EXCITED)(experiment(lambda c, joint: 0.02))
mistake("very slow motion", EXCITED)(experiment(lambda c, joint: 0.3, 8.0))
mistake("0.5 s of a log", EXCITED)(lambda c: c.rows(np.arange(100)))
mistake("12 rows of a log", EXCITED)(lambda c: c.rows(np.arange(12)))


# --- what comes and goes within a log ------------------------------------------------------------

LATER = r"change|drift|time|half|differ|friction"


def rubbing(joints: Callable[[Case], list[str]]) -> Callable[[Case], Case]:
    """The friction of some joints rises by 80 % in the course of the log."""

    def make(c: Case) -> Case:
        t, speed, found = c.columns["t"], c.subject.moving(lambda joint: 1.0), {}
        for joint in joints(c):
            v, name = speed[f"v.{joint}"], f"tau.{joint}"
            Fv, Fc = (c.values.get(f"{k}.{joint}.F{k[0]}", 0.0) for k in ("viscous", "coulomb"))
            if name in c.columns:
                found[name] = c.columns[name] + 0.8 * t / t[-1] * (Fv * v + Fc * np.sign(v))
        return c.logged(**found)

    return make


mistake("friction of one joint rises by 80 %", LATER)(rubbing(lambda c: [c.subject.one]))
mistake("friction of all joints rises by 80 %", LATER)(rubbing(lambda c: c.subject.driven))


def half(c: Case) -> np.ndarray:
    """Whether a sample is in the second half."""
    return c.columns["t"] > c.columns["t"].mean()


mistake("one torque in N mm from the middle on", UNIT + "|change")(
    lambda c: with_tau(c, np.where(half(c), 1e3, 1.0) * tau(c))
)
mistake("sign of one torque turned from the middle on", r"sign|negative|change")(
    lambda c: with_tau(c, np.where(half(c), -1.0, 1.0) * tau(c))
)
mistake("one torque of zero in every tenth cell, where none was read", r"zero|without a value")(
    lambda c: with_tau(c, np.where(np.arange(len(tau(c))) % 10 == 3, 0.0, tau(c)))
)
mistake("-999 in every fiftieth cell of one torque", r"no measurement|-999|left out|lone")(
    lambda c: with_tau(c, np.where(np.arange(len(tau(c))) % 50 == 7, -999.0, tau(c)))
)


@mistake("one torque wraps at 60 % of its range (an overflow)", r"jump|wrap|extreme|range")
def _(c: Case) -> Case:
    limit = 0.6 * np.abs(tau(c)).max()
    return with_tau(c, (tau(c) + limit) % (2 * limit) - limit)


mistake("one torque without its negative values", r"zero|sign|extreme|negative")(
    lambda c: with_tau(c, np.maximum(tau(c), 0.0))
)


@mistake("a fifth of another joint's torque in one torque (crosstalk)", r"crosstalk|another joint")
def _(c: Case) -> Case:
    return with_tau(c, tau(c) + 0.2 * c.columns[f"tau.{c.subject.other}"])


@mistake("hum of 50 Hz on one torque", r"hum|noise|50 Hz|vibrat")
def _(c: Case) -> Case:
    return with_tau(c, tau(c) + 0.3 * tau(c).std() * np.sin(2 * np.pi * 50.0 * c.columns["t"] + 1))


@mistake("one torque saturates softly", r"extreme|clip|range|limit|linear")
def _(c: Case) -> Case:
    limit = np.abs(tau(c)).max()
    return with_tau(c, limit * np.tanh(tau(c) / limit))


@mistake("a clock that slows by 10 % in the course of the log", CLOCK)
def _(c: Case) -> Case:
    t = c.columns["t"]
    return c.logged(t=t + 0.05 * t**2 / t[-1])


mistake("one position 5 % too large", GEOMETRY + "|scale|gear|position")(
    lambda c: with_q(c, 1.05 * c.columns[position(c)])
)


@mistake("backlash of 0.02 rad between one joint and its encoder", r"backlash|position|encoder")
def _(c: Case) -> Case:
    x, held = c.columns[position(c)], []
    y = float(x[0])
    for value in x:
        y = float(np.clip(y, value - 0.01, value + 0.01))
        held.append(y)
    return with_q(c, np.array(held))


mistake("gravity 10° off (a base on a slope)", GRAVITY)(
    gravity(-9.81 * np.sin(np.pi / 18), 0, -9.81 * np.cos(np.pi / 18))
)


@mistake("a joint locked that moves", r"locked")
def _(c: Case) -> Case:
    toml, one = c.subject.toml, c.subject.one
    old = re.search(r"locked = \{(.*?)\}", toml)
    if old:
        return c.described(toml=toml.replace(old[0], f"locked = {{{old[1]}, {one} = 0.4 }}"))
    return c.described(toml=toml.replace("[joints]\n", f"[joints]\nlocked = {{ {one} = 0.4 }}\n"))


# --- what one angle cannot show ------------------------------------------------------------------

ONE_ANGLE = (
    "one drive and one angle: moments and inertia of unknown bodies, not unlike the URDF's, take "
    "it up, and what is left is noise, or no more than coloured noise leaves"
)
TAKEN_UP = {
    "parallelogram": (
        "one torque without its mean (high-passed)",
        "200 Hz taken for 100 Hz",
        "200 Hz taken for 1 kHz",
        "zero of one position 0.3 rad off",
        "gravity 10° off (a base on a slope)",
        "a URDF of a machine 20 % smaller",
        "one position 5 % too large",
    ),
    "crank_slider": (
        "one torque by a wrong torque constant, 2.6 times",
        "200 Hz taken for 1 kHz",
        "clock 10 % fast",
        "gravity in g",
        "a URDF of a machine 20 % smaller",
        "one length twice",
        "a log of another machine with the same names",
    ),
}
MADE = [
    replace(
        each,
        hidden={**{name: ONE_ANGLE for name, some in TAKEN_UP.items() if each.name in some},
                **each.hidden},
    )
    for each in MADE
]  # fmt: skip
