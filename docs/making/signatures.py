"""A picture of each effect's signature: what a model that lacks it leaves, by simulation.

One motion, simulated with the effect and without; the difference of the torques is what a residual
would show. It goes through the same code as every log, so a picture cannot say what is not so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ident
from ident.effects import kind_of
from ident.show.charts import RESIDUAL, Chart, Level, Line, Panel, Points

ROBOTS = Path(__file__).resolve().parents[2] / "robots"
NOISE = 0.03  # of the residual's largest value: a residual without noise would look like a drawing


@dataclass(frozen=True)
class Shown:
    """Where an effect is put to be seen, how large, and against what.

    Attributes:
        site: after the colon of `kind:site`.
        values: of its parameters.
        against: q, v, a (or another joint's, q.elbow), torque, slope or bend (the torque's first
            and second derivative), sum (of two joints' speeds) or t.
        joints: whose residuals are drawn.
        robot: which of the shipped ones has it.
        moves: the joints that move; all, where none is named.
        pace: how many times as fast as else.
    """

    site: str
    values: Mapping[str, float]
    against: str
    joints: tuple[str, ...] = ("elbow",)
    robot: str = "arm"
    moves: tuple[str, ...] = ()
    pace: float = 1.0


BODY = {"m": 0.5, "mx": 0.03, "my": 0.0, "mz": 0.0, "Lxx": 1e-4, "Lyy": 2e-3, "Lzz": 2e-3,
        "Lxy": 0.0, "Lxz": 0.0, "Lyz": 0.0}  # fmt: skip
HUMP = {f"x{i}": 0.4 + 0.28 * i for i in range(6)} | {
    f"c{i}": c for i, c in enumerate((0.0, 0.1, 0.5, 0.9, 0.4, 0.1, 0.2, 0.6))
}
SHOWN: Mapping[str, Shown] = {
    "viscous": Shown("elbow", {"Fv": 0.5}, "v"),
    "coulomb": Shown("elbow", {"Fc": 0.9}, "v"),
    "stribeck": Shown("elbow", {"Fs": 0.6, "vs": 0.4}, "v"),
    "friction_width": Shown("elbow", {"Fw": 0.9, "w": 0.4}, "v"),
    "load_friction": Shown("elbow", {"mu": 0.1}, "v"),
    "hysteresis": Shown("elbow", {"sigma": 8.0, "z0": 0.1}, "q"),
    "direction_friction": Shown("elbow", {"dFc": 0.3, "dFv": 0.2}, "v"),
    "position_friction": Shown("elbow", {"F1": 0.2, "F2": 0.3}, "q"),
    "drag": Shown("elbow", {"Fd": 0.2}, "v"),
    "spring": Shown("elbow", {"k": 2.0, "b": -1.0}, "q"),
    "cable": Shown("elbow", {"k0": 0.5, "k1": -2.0, "k2": 0.5, "k3": 0.9}, "q"),
    "end_stop": Shown("elbow", {"k": 10.0, "q1": 1.5, "side": 1.0}, "q"),
    "rotor_inertia": Shown("elbow", {"Ia": 0.05}, "a"),
    "coupling": Shown(
        "elbow,wrist", {"Im": 0.01, "Fvm": 0.05, "Fcm": 0.5}, "sum", ("elbow", "wrist")
    ),
    "ripple": Shown("elbow", {"A": 0.4, "B": 0.1, "N": 12.0}, "q"),
    "torque_offset": Shown("elbow", {"c": 0.5}, "v"),
    "torque_gain": Shown("elbow", {"g": 0.05}, "torque"),
    "delay": Shown("elbow", {"d": 0.008}, "slope"),
    "position_delay": Shown("elbow", {"d": 0.008}, "v", ("elbow", "shoulder"), moves=("elbow",)),
    "encoder_offset": Shown(
        "elbow", {"delta": 0.03}, "q.elbow", ("elbow", "shoulder"), moves=("elbow",)
    ),
    "gravity_tilt": Shown("", {"x": 0.03, "y": 0.02}, "q", ("yaw",), moves=("yaw",)),
    "gravity_compensation": Shown("", {"k": 1.0}, "q", ("shoulder",), moves=("shoulder",)),
    "payload": Shown("hand", BODY, "q.elbow", ("elbow", "shoulder"), moves=("elbow",)),
    "elasticity": Shown(
        "yaw", {"compliance": 4e-4, "damping": 1.0}, "bend", ("yaw",), moves=("yaw",), pace=4
    ),
    "backlash": Shown("yaw", {"width": 0.01}, "torque", ("yaw",), moves=("yaw",), pace=4),
    "geometry": Shown("elbow.x", {"Delta": 0.02}, "torque", ("shoulder",), moves=("shoulder",)),
    "closure_compliance": Shown("pin", {"C": 5e-5}, "t", ("crank",), "four_bar"),
    "temperature_friction": Shown("elbow", {"kappa": -0.01}, "v"),
    "drift": Shown("elbow", {"c": 0.1}, "t"),
    "curve": Shown("elbow:q", HUMP, "q"),
}


def picture(kind: str) -> Chart:
    """Against the signal that shows it, and against time.

    Raises:
        IdentError: if the effect cannot be simulated there.
    """
    shown = SHOWN[kind]
    with_it, without = _simulated(kind, shown)
    signature = kind_of(kind).signature
    telling, plain = [], []
    for number, joint in enumerate(shown.joints):
        residual = with_it.columns[f"tau.{joint}"] - without.columns[f"tau.{joint}"]
        noise = np.random.default_rng(number).normal(size=len(residual))
        residual = residual + NOISE * np.abs(residual).max() * noise
        label = joint if len(shown.joints) > 1 else ""
        colour = number if len(shown.joints) > 1 else RESIDUAL
        x = _signal(shown, joint, without)
        if shown.against != "t":
            some = slice(None, None, 2)
            telling.append(Points(x[some], residual[some], label=label, colour=colour))
        plain.append(Line(without.t, residual, label=label, colour=colour, width=0.9))
    panels = [Panel((Level(), *plain), x="t [s]", y="residual [N m]", height=2.4)]
    if telling:
        x_label = LABELS[shown.against]
        panels.insert(0, Panel((Level(), *telling), x=x_label, y="residual [N m]", height=2.4))
    where = " and ".join(shown.joints)
    return Chart(f"Residual torque of {where}: {signature}.", (tuple(panels),), shared_y=True)


LABELS = {
    "q": "q [rad]",
    "q.elbow": "q of the elbow [rad]",
    "v": "v [rad/s]",
    "a": "a [rad/s²]",
    "torque": "torque of the model [N m]",
    "slope": "slope of the torque [N m/s]",
    "bend": "second derivative of the torque [N m/s²]",
    "sum": "sum of both speeds [rad/s]",
}


def _simulated(kind: str, shown: Shown) -> tuple[ident.Log, ident.Log]:
    """The same motion with the effect and without."""
    mechanism = ident.load(ROBOTS / shown.robot)
    base = {}
    if kind == "temperature_friction":
        mechanism = mechanism.with_effect("viscous:elbow")
        base = {"viscous.elbow.Fv": 0.8}
    if kind == "friction_width":
        mechanism = mechanism.with_effect("coulomb:elbow")
        base = {"coulomb.elbow.Fc": 0.9}
    call = f"{kind}:{shown.site}" if shown.site else kind
    true = mechanism.with_effect(call)
    values = {
        full: shown.values[parameter.name]
        for full, parameter in zip(true.effects[-1].names, true.effects[-1].parameters, strict=True)
    }
    motion = _motion(shown)
    with_it, _ = ident.simulate(true, motion, values=base | values)
    without, _ = ident.simulate(mechanism, motion, values=base)
    return with_it, without


def _motion(shown: Shown) -> ident.Log:
    """A typical one: every drive by some sines, for 12 s."""
    t = np.arange(0.0, 12.0, 0.01)
    if shown.robot == "four_bar":
        return ident.Log.from_arrays("turn", t, _sampled({"crank": (0.0, 3.0)}, t, shown.pace))
    ways = {"yaw": (0.0, 0.9), "shoulder": (-0.6, 0.5), "elbow": (1.1, 0.7), "wrist": (0.0, 1.2)}
    if shown.moves:
        ways = {j: (at, half if j in shown.moves else 0.0) for j, (at, half) in ways.items()}
    warm = 25.0 + 30.0 * (1.0 - np.exp(-t / 5.0))  # °C
    columns = _sampled(ways, t, shown.pace) | {"temperature.elbow": warm}
    return ident.Log.from_arrays("typical", t, columns)


def _sampled(
    ways: Mapping[str, tuple[float, float]], t: np.ndarray, pace: float
) -> dict[str, np.ndarray]:
    """q, v and a of joints that move by about half [rad] around a middle."""
    found = {}
    for number, (joint, (middle, half)) in enumerate(ways.items()):
        w = 2 * np.pi * np.array([1.0, 2.0, 5.0])[:, None] / 12.0 * (1 + number % 2) * pace
        c = half * np.array([0.6, 0.35, 0.12])
        phase = np.array([[0.3], [1.1], [2.0]]) + number
        found[f"q.{joint}"] = middle + c @ np.sin(w * t + phase)
        found[f"v.{joint}"] = c @ (w * np.cos(w * t + phase))
        found[f"a.{joint}"] = c @ (-(w**2) * np.sin(w * t + phase))
    return found


def _signal(shown: Shown, joint: str, log: ident.Log) -> np.ndarray:
    """What the residual of a joint is drawn against, (n,)."""
    torque = log.columns[f"tau.{joint}"]
    slope = np.gradient(torque, log.t)
    derived = {"torque": torque, "slope": slope, "bend": np.gradient(slope, log.t), "t": log.t}
    if shown.against in derived:
        return derived[shown.against]
    if shown.against == "sum":
        return np.sum([log.columns[f"v.{each}"] for each in shown.joints], axis=0)
    return log.columns[shown.against if "." in shown.against else f"{shown.against}.{joint}"]
