"""Forty-eight further kinds of mistakes: classes of torques, loggers, URDFs of exporters."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from kinds import EXCITED, GEOMETRY, UNIT, mistake, position, tau, with_q, with_tau
from subjects import Case

import ident
from ident import Log

CHANNEL = r"command|measure|computed|values alone|held|noise|publish|extreme|zero"
OFFSET = r"offset|drift|changed|from t ="
LATE = r"late|early|delay|clock|filter"
JUMPS = r"jump|publish|stays|frozen|gap|lost|left out|uneven"


def of_urdf(c: Case, *, gravity_only: bool = False) -> dict[str, np.ndarray]:
    """Torques that the URDF's bodies need in the log's motion, or at rest in it."""
    mechanism = replace(c.truth, effects=())
    motion = {n: x for n, x in c.subject.moving(lambda joint: 1.0).items() if n != "t"}
    if gravity_only:
        motion = {n: x if n.startswith("q.") else 0.0 * x for n, x in motion.items()}
    made, _ = ident.simulate(mechanism, Log.from_arrays("run.csv", c.columns["t"], motion))
    return {n: x for n, x in made.columns.items() if n.startswith("tau.")}


def weightless(c: Case) -> dict[str, np.ndarray]:
    """The gravity of the URDF's bodies in the log's motion: their torques with it less without."""
    still = replace(c.truth, effects=())
    model = still.model.copy()
    model.gravity.linear = np.zeros(3)
    motion = {n: x for n, x in c.subject.moving(lambda joint: 1.0).items() if n != "t"}
    log = Log.from_arrays("run.csv", c.columns["t"], motion)
    both = (still, still.with_same_kinematics(model=model))
    heavy, light = (ident.simulate(m, log)[0].columns for m in both)
    return {n: x - light[n] for n, x in heavy.items() if n.startswith("tau.")}


def mean_of(x: np.ndarray, samples: int) -> np.ndarray:
    """Means of the last samples."""
    padded = np.concatenate([np.full(samples - 1, x[0]), x])
    return np.convolve(padded, np.ones(samples) / samples, "valid")


def levels(x: np.ndarray) -> np.ndarray:
    largest = np.abs(x).max() or 1.0
    return largest * np.sign(np.round(2 * x / largest))


def second_half(c: Case) -> np.ndarray:
    return np.arange(len(c.columns["t"])) >= len(c.columns["t"]) // 2


# --- what a torque channel is --------------------------------------------------------------------


@mistake("all torques computed by the URDF's model", r"computed|measure")
def _(c: Case) -> Case:
    return c.logged(**of_urdf(c))


@mistake("all torques less the gravity of the URDF's bodies", r"gravity|compensat")
def _(c: Case) -> Case:
    gravity = weightless(c)
    return c.logged(**{n: c.columns[n] - x for n, x in gravity.items()})


@mistake("one torque less the gravity of the URDF's bodies", r"gravity|compensat")
def _(c: Case) -> Case:
    return with_tau(c, tau(c) - weightless(c)[f"tau.{c.subject.one}"])


mistake("one torque commanded in three values", CHANNEL)(lambda c: with_tau(c, levels(tau(c))))
mistake("all torques commanded in three values", CHANNEL)(lambda c: c.each("tau.", levels))
mistake("one torque in means of 20 ms", LATE)(lambda c: with_tau(c, mean_of(tau(c), 4)))
mistake("all torques in means of 60 ms", LATE)(lambda c: c.each("tau.", lambda x: mean_of(x, 12)))
mistake("one torque saturates on one side", CHANNEL)(
    lambda c: with_tau(c, np.minimum(tau(c), np.quantile(tau(c), 0.7)))
)
mistake("one torque with a dead band", CHANNEL)(
    lambda c: with_tau(c, np.where(np.abs(tau(c)) < 0.3 * np.abs(tau(c)).max(), 0.0, tau(c)))
)


@mistake("one torque of two publishers in turn", JUMPS)
def _(c: Case) -> Case:
    turn = np.arange(len(tau(c))) % 2 == 0
    return with_tau(c, np.where(turn, tau(c), tau(c) + 2.0 * tau(c).std()))


@mistake("one torque as signed integers that wrap at 16 bits", JUMPS + "|sign")
def _(c: Case) -> Case:
    raw = np.rint(20_000 * tau(c) / np.abs(tau(c)).max())
    return with_tau(c, np.where(raw < 0, raw + 65_536, raw))


@mistake("one torque in sign and magnitude", r"sign")
def _(c: Case) -> Case:
    raw = np.rint(1000 * tau(c) / np.abs(tau(c)).max())
    return with_tau(c, np.where(raw < 0, 1024 - raw, raw))


mistake("the square of one torque, with its sign", UNIT)(
    lambda c: with_tau(c, tau(c) * np.abs(tau(c)) / np.abs(tau(c)).max())
)


@mistake("one torque that of two joints together", r"exchang|sum|couple|motor")
def _(c: Case) -> Case:
    return with_tau(c, tau(c) + c.columns[f"tau.{c.subject.other}"])


@mistake("two torques as sum and difference, as of a differential", r"exchang|couple|motor")
def _(c: Case) -> Case:
    a, b = f"tau.{c.subject.one}", f"tau.{c.subject.other}"
    x, y = c.columns[a], c.columns[b]
    return c.logged(**{a: (x + y) / 2, b: (x - y) / 2})


@mistake("two torques exchanged, one with the other sign", r"exchang|sign")
def _(c: Case) -> Case:
    a, b = f"tau.{c.subject.one}", f"tau.{c.subject.other}"
    return c.logged(**{a: -c.columns[b], b: c.columns[a]})


@mistake("half of one torque's rms as white noise", r"noise")
def _(c: Case) -> Case:
    noise = np.random.default_rng(6).normal(size=len(tau(c)))
    return with_tau(c, tau(c) + 0.5 * tau(c).std() * noise)


mistake("one torque drifts by a third of its range", OFFSET)(
    lambda c: with_tau(c, tau(c) + np.linspace(0.0, 0.33 * np.ptp(tau(c)), len(tau(c))))
)
mistake("one torque has another zero from the middle on", OFFSET)(
    lambda c: with_tau(c, tau(c) + 0.3 * np.ptp(tau(c)) * second_half(c))
)
mistake("one torque is half as large again from the middle on", r"changed|from t =|gain")(
    lambda c: with_tau(c, tau(c) * np.where(second_half(c), 1.5, 1.0))
)


@mistake("torques by a clock 2 % slower than that of positions", LATE)
def _(c: Case) -> Case:
    t = c.columns["t"]
    return c.each("tau.", lambda x: np.interp(t, t / 0.98, x))


@mistake("all torques negative where they were positive, rectified by the drive", r"sign|negative")
def _(c: Case) -> Case:
    return c.each("tau.", lambda x: -np.abs(x))


@mistake("one torque of zero for the first second, before the drive was on", CHANNEL + "|stays")
def _(c: Case) -> Case:
    return with_tau(c, np.where(c.columns["t"] < 1.0, 0.0, tau(c)))


@mistake("all torques of zero for the last 0.7 s, after a stop", CHANNEL + "|stays|from t =")
def _(c: Case) -> Case:
    end = c.columns["t"][-1] - 0.7
    return c.each("tau.", lambda x: np.where(c.columns["t"] > end, 0.0, x))


# --- positions, rates and time -------------------------------------------------------------------


@mistake("one position of two publishers in turn", JUMPS)
def _(c: Case) -> Case:
    turn = np.arange(len(tau(c))) % 2 == 0
    x = c.columns[position(c)]
    return with_q(c, np.where(turn, x, x + 0.1))


mistake("one position twice as large: another gear ratio", UNIT)(
    lambda c: with_q(c, 2 * c.columns[position(c)])
)
mistake("one position that is the velocity", r"column|position|scale|noise|sign|exchang")(
    lambda c: with_q(c, np.gradient(c.columns[position(c)], c.columns["t"]))
)
mistake("one position drifts by 0.3 rad", OFFSET + "|encoder|zero")(
    lambda c: with_q(c, c.columns[position(c)] + np.linspace(0.0, 0.3, len(tau(c))))
)
mistake("an encoder off centre: 0.05 rad once a turn", r"encoder|eccentric|position")(
    lambda c: with_q(c, c.columns[position(c)] + 0.05 * np.sin(c.columns[position(c)] + 0.4))
)
mistake("one velocity in revolutions a minute", r"unit|disagree|rpm|factor", rates=True)(
    lambda c: c.logged(**{f"v.{c.subject.one}": 60 / 2 / np.pi * c.columns[f"v.{c.subject.one}"]})
)
mistake("all velocities in °/s", r"unit|disagree|degrees|factor|°", rates=True)(
    lambda c: c.each("v.", lambda x: 180 / np.pi * x)
)
mistake("all velocities 15 ms late", LATE, rates=True)(
    lambda c: c.each("v.", lambda x: np.concatenate([np.full(3, x[0]), x[:-3]]))
)


@mistake("stamps rounded to 10 ms", r"repeat|uneven|stamp")
def _(c: Case) -> Case:
    return c.logged(t=np.round(c.columns["t"], 2))


@mistake("rows that arrive in bursts of five", r"uneven|stamp|jitter|repeat")
def _(c: Case) -> Case:
    t = c.columns["t"]
    late = t[np.minimum(np.arange(len(t)) // 5 * 5 + 4, len(t) - 1)]
    return c.logged(t=late + 1e-4 * (np.arange(len(t)) % 5))


@mistake("every second row from the middle on", r"uneven|rate|gap|left out")
def _(c: Case) -> Case:
    n = len(tau(c))
    return c.rows(np.r_[0 : n // 2, n // 2 : n : 2])


@mistake("a gap of 0.5 s filled with the last row", JUMPS)
def _(c: Case) -> Case:
    rows = np.arange(len(tau(c)))
    rows[400:500] = 400
    return c.rows(rows).logged(t=c.columns["t"])


# --- URDFs as exporters leave them ---------------------------------------------------------------


def numbers(pattern: str, change: Callable[[float], float]) -> Callable[[str], str]:
    """Change the numbers of an attribute."""

    def changed(urdf: str) -> str:
        def new(match: re.Match[str]) -> str:
            values = " ".join(f"{change(float(x)):.9g}" for x in match[2].split())
            return f"{match[1]}{values}{match[3]}"

        return re.sub(pattern, new, urdf)

    return changed


INERTIAS = r'(i[xyz][xyz]=")([^"]*)(")'
MASSES = r'(<mass value=")([^"]*)(")'
CENTRES = r'(<inertial>\s*<origin xyz=")([^"]*)(")'


def urdf(name: str, names: str, change: Callable[[str], str], **hidden: str) -> None:
    mistake(name, names, **hidden)(lambda c: c.described(urdf=change(c.subject.urdf)))


BODY = r"radius of gyration|centre of mass|mass in g|kg mm|g mm|placeholder|times what"
urdf("inertias of the URDF in kg mm²", BODY, numbers(INERTIAS, lambda x: 1e6 * x))
urdf("inertias of the URDF in g mm²", BODY, numbers(INERTIAS, lambda x: 1e9 * x))
urdf("centres of mass of the URDF in mm", BODY, numbers(CENTRES, lambda x: 1e3 * x))
urdf("inertias of 1 kg m² in the URDF", BODY, numbers(INERTIAS, lambda x: 1.0 if x else 0.0))
urdf("masses of 1 kg in the URDF", BODY, numbers(MASSES, lambda x: 1.0))
urdf("inertias of the URDF negative", r"possible|negative|inertia", numbers(INERTIAS, lambda x: -x))
urdf("centres of mass of the URDF mirrored", GEOMETRY, numbers(CENTRES, lambda x: -x))
urdf("masses of the URDF zero", r"massless|mass", numbers(MASSES, lambda x: 0.0))

mistake("gravity in cm/s²", r"gravity|unit")(
    lambda c: c.described(
        toml=re.sub(r"gravity = .*\n", "", c.subject.toml).replace(
            'urdf = "robot.urdf"', 'urdf = "robot.urdf"\ngravity = [0.0, 0.0, -981.0]', 1
        )
    )
)


@mistake("a spring of 2 N m/rad on one joint", r"spring|missing|poor|where")
def _(c: Case) -> Case:
    q = c.columns[position(c)]
    return with_tau(c, tau(c) + 4.0 * tau(c).std() * (q - q.mean()) / np.ptp(q))


@mistake("friction of one joint larger by half in one direction", r"direction|friction|offset")
def _(c: Case) -> Case:
    v = np.gradient(c.columns[position(c)], c.columns["t"])
    return with_tau(c, tau(c) + 0.4 * tau(c).std() * (v > 0))


@mistake("one joint moves by its noise alone", EXCITED + "|noise|never")
def _(c: Case) -> Case:
    x = c.columns[position(c)]
    noise = np.random.default_rng(8).normal(size=len(x))
    return with_q(c, x.mean() + 2e-5 * noise)
