"""The machine of hidden_effect.ipynb, and what it keeps to itself. Reading on spoils the fun.

The model is robots/arm with friction in every joint. The machine differs from it in all inertias,
and in some more effects that are drawn at random: which, where, and how large.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ident

# relative, so that what is printed shows no folder of whoever ran it
ARM = Path(os.path.relpath(Path(__file__).resolve().parents[1])) / "robots" / "arm"
SEED = 3
EFFECTS = 3
SECONDS, STEP = 15.0, 0.004
NOISE = (ident.Noise("q", 2e-5), ident.Noise("tau", 0.01, relative=True))  # rad; of each torque
FRICTION = {"viscous": {"Fv": 0.15}, "coulomb": {"Fc": 0.25}}  # [rms of the torque / rms of column]
SIZE = (0.02, 0.12)  # of an effect's torque: share of the joint's
KINDS = (
    "stribeck", "load_friction", "hysteresis", "drag", "spring", "end_stop", "rotor_inertia",
    "coupling", "ripple", "torque_offset", "torque_gain",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Machine:
    """Made by `machine`.

    Attributes:
        seed: of everything that is random; model: what its owner believes; log: what was logged.
        hidden: the effects that it has beyond the model; values: of all parameters, by full name.
    """

    seed: int
    model: ident.Mechanism
    log: ident.Log
    hidden: tuple[ident.Effect, ...]
    values: dict[str, float]

    def reveal(self) -> dict[str, dict[str, float]]:
        """The hidden effects and their true values."""
        return {
            effect.label: {name: self.values[name] for name in effect.names}
            for effect in self.hidden
        }


def machine(seed: int = SEED) -> Machine:
    """A machine and a log of it."""
    rng = np.random.default_rng(seed)
    arm = ident.load(ARM)
    model = arm.with_effect("viscous").with_effect("coulomb")
    model = model.with_calibration("exact")  # as its owner believes
    pi = arm.prior * np.repeat(rng.uniform(0.85, 1.2, len(arm.prior) // 10), 10)
    motion = _motion(rng)
    _, rigid = ident.simulate(arm, motion, pi=pi)
    torque = dict(zip(rigid.joints, np.sqrt((rigid.predicted**2).mean(axis=0)), strict=True))
    true, values = model, dict(zip(arm.unknown, pi.tolist(), strict=True))
    for effect in model.effects:
        (share,) = FRICTION[effect.kind].values()
        values |= _sized(arm, effect, {}, motion, pi, share * torque[effect.joints[0]])
    for kind in rng.choice(KINDS, EFFECTS, replace=False):
        joints = rng.choice(arm.driven, 2 if kind == "coupling" else 1, replace=False)
        effect = ident.effect(str(kind), ",".join(sorted(joints, key=arm.driven.index)))
        size = rng.uniform(*SIZE) * min(torque[joint] for joint in joints)
        shapes = _shapes(str(kind), motion.columns[f"q.{joints[0]}"], rng)
        values |= _sized(arm, effect, shapes, motion, pi, size)
        true += effect
    planted = {name: values[name] for effect in true.effects for name in effect.names}
    log, _ = ident.simulate(
        true, motion, values=planted, pi=pi, noise=NOISE, seed=seed, columns=("q", "tau")
    )
    log = ident.Log.from_arrays("run.csv", log.t, log.columns)
    return Machine(seed, model, log, true.effects[len(model.effects) :], values)


def _motion(rng: np.random.Generator) -> ident.Log:
    """Four sines a joint with one common period."""
    t = np.arange(0.0, SECONDS, STEP)
    w = 2 * np.pi * np.array([0.2, 0.4, 0.6, 1.0])[:, None]
    ranges = {"yaw": (0, 1.2), "shoulder": (-0.6, 0.7), "elbow": (1.1, 0.9), "wrist": (0, 1.4)}
    q = {}
    for joint, (middle, half) in ranges.items():
        x = np.array([1.0, 0.8, 0.5, 0.35]) @ np.sin(w * t + rng.uniform(0, 2 * np.pi, (4, 1)))
        q[f"q.{joint}"] = middle + half * x / np.abs(x).max()
    return ident.Log.from_arrays("planned", t, q)


def _shapes(kind: str, q: np.ndarray, rng: np.random.Generator) -> dict[str, float]:
    """What the torque is not linear in."""
    if kind == "end_stop":
        side = float(rng.choice([-1, 1]))
        return {"side": side, "q1": float(np.quantile(q, 0.5 + side * rng.uniform(0.3, 0.42)))}
    drawn = {
        "stribeck": {"vs": rng.uniform(0.2, 0.6)},
        "hysteresis": {"z0": rng.uniform(0.02, 0.1)},
        "ripple": {"N": rng.uniform(8.0, 24.0)},
    }
    return {name: float(x) for name, x in drawn.get(kind, {}).items()}


def _sized(
    arm: ident.Mechanism, effect: ident.Effect, shapes: dict[str, float], motion: ident.Log,
    pi: np.ndarray, size: float,
) -> dict[str, float]:  # fmt: skip
    """All values by full name, so that the torque's rms is `size` [N m] at the first joint."""
    given = dict(zip((each.name for each in effect.parameters), effect.names, strict=True))
    fixed = {given[name]: x for name, x in shapes.items()}
    free = [name for name in effect.names if name not in fixed]
    unit = dict(zip(free, np.linspace(1.0, 0.5, len(free)).tolist(), strict=True))
    _, prediction = ident.simulate(arm + effect, motion, values=fixed | unit, pi=pi)
    at = prediction.joints.index(effect.joints[0])
    rms = float(np.sqrt((prediction.parts[effect.label][:, at] ** 2).mean()))
    return fixed | {name: x * float(size) / rms for name, x in unit.items()}


def main() -> None:
    """What becomes of the effects of twenty machines; some minutes."""
    for seed in range(20):
        made = machine(seed)
        history = ident.grow(made.model, ident.complete(made.model, made.log))
        named = {effect.label for effect in history.added}
        unseen = {each.effect.label for each in history.diagnosis.invisible}
        fates = {
            label: "named" if label in named else "invisible" if label in unseen else "missed"
            for label in made.reveal()
        }
        wrong = sorted(named - set(fates))
        print(seed, history.diagnosis.verdict, fates, *(["wrong:", *wrong] if wrong else []))


if __name__ == "__main__":
    main()
