"""Exported MuJoCo models against the machine: motions that no number was fitted to.

    python benchmarks/replay_export.py [--data DIR]… [NAME …]

Shipped robots, UR5, Panda (example-robot-data) and xArm7 (robosuite), DIR as for `like.py`; with
all effects that MuJoCo holds: viscous and dry friction and rotors everywhere, in random joints a
spring, drag and a torque offset, an encoder offset of the second one and a payload, of sizes in
proportion to the inertia that each joint feels. *File*: largest rms over joints of its motion less
that of `ident` at the same values, in mrad (mm of sliding joints), under a controller of 5 Hz along
another motion than the fitted one, 3 s (2 s of loops), step 1 ms: physical values, fitted with the
default softness of the file kept, and fitted. *Replay*: the effects are identified from a noisy log
of the machine, whose bodies are known, and exported; windows of 0.5 s of another log of the same
machine, `ident` and MuJoCo, largest rms over joints, and the ratio.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from like import EXAMPLE, ROBOSUITE, content
from machines import arguments, located

import ident
from ident import Log, Mechanism
from ident.export.export import export
from ident.export.fitted import bare, error_of, exact_motion, fit_numbers
from ident.export.laws import felt_inertia, nominal_motion
from ident.export.machine import machine_of
from ident.export.mjcf import STEP, WORDS, Numbers, write_mjcf
from ident.export.target import Job, translated
from ident.simulate.inverse import Noise

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
SHIPPED = ("arm", "servo_arm", "four_bar", "five_bar", "slider_crank")
PUBLIC = {
    "UR5": (EXAMPLE, "ur_description/urdf/ur5_robot.urdf"),
    "Panda": (EXAMPLE, "panda_description/urdf/panda.urdf"),
    "xArm7": (ROBOSUITE, "xarm7"),
}
SIZES = {  # times the inertia that a joint feels, SI
    "viscous": 1.5, "coulomb": 3.0, "rotor_inertia": 0.3, "spring.k": 10.0, "spring.b": 1.0,
    "drag": 0.4, "torque_offset": 2.0,
}  # fmt: skip
OFFSET = 0.02  # [rad | m] of an encoder
NOISE = (Noise("tau", 0.01, relative=True), Noise("q", 2e-5))


def main() -> None:
    names, places = arguments(__doc__, (*SHIPPED, *PUBLIC))
    print("| robot | file: physical | softness kept | fitted | replay: ident | MuJoCo | ratio |")
    print("|---|---|---|---|---|---|---|")
    for name, _, model, values in robots(names, places):
        cells = files(model, values)
        print(f"| {name} | {' | '.join(cells)} |", end="", flush=True)
        print(f" {' | '.join(replays(model, values))} |", flush=True)


def robots(
    names: Sequence[str], places: list[Path]
) -> Iterator[tuple[str, Mechanism, Mechanism, dict[str, float]]]:
    """Yield name, robot, robot with effects and their values; a row for those that are not here."""
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            mechanism = robot(name, places, Path(folder))
            if mechanism is None:
                print(f"| {name} | not in --data |", flush=True)
                continue
            yield name, mechanism, *with_effects(mechanism, np.random.default_rng(len(name)))


def robot(name: str, places: list[Path], folder: Path) -> Mechanism | None:
    """A robot whose bodies are known, fingers held."""
    if name in SHIPPED:
        mechanism = ident.load(ROBOTS / name)
        for effect in mechanism.effects:
            mechanism = mechanism.without(effect.label)
        return replace(mechanism, unknown=())
    (source, commit, pattern), model = PUBLIC[name]
    if (place := located(source, places)) is None:
        return None
    path = folder / Path(pattern.format(model)).name
    path.write_bytes(content(place, commit, pattern.format(model)))
    fingers = [joint for joint in ident.load(path).joint_index if "finger" in joint]
    return replace(ident.load(path, locked=dict.fromkeys(fingers, 0.0)), unknown=())


def with_effects(
    mechanism: Mechanism, random: np.random.Generator
) -> tuple[Mechanism, dict[str, float]]:
    """The mechanism with all effects that MuJoCo holds, and their values."""
    inertia = felt_inertia(machine_of(mechanism))
    driven, values = [x for x in mechanism.driven if x in inertia], {}
    for kind in ("viscous", "coulomb", "rotor_inertia"):
        for joint in driven:
            mechanism = mechanism.with_effect(f"{kind}:{joint}")
    for kind in ("spring", "drag", "torque_offset", "encoder_offset"):
        # about a vertical axis no motion shows an encoder's offset
        joint = driven[random.integers(len(driven))]
        joint = driven[min(1, len(driven) - 1)] if kind == "encoder_offset" else joint
        if kind != "encoder_offset" or not mechanism.closures:
            mechanism = mechanism.with_effect(f"{kind}:{joint}")
    link = mechanism.bodies.links[-1]
    if not mechanism.closures:
        mechanism = mechanism.with_effect(f"payload:{link}")
    body = mechanism.prior[mechanism.bodies.columns(link)]
    for effect in mechanism.effects:
        if effect.kind == "payload":
            values |= dict(zip(effect.names, 0.3 * body, strict=True))
            continue
        joint, sizes = effect.joints[0], {}
        for name in effect.names:
            size = SIZES.get(f"{effect.kind}.{name.rpartition('.')[2]}", SIZES.get(effect.kind))
            sizes[name] = OFFSET if size is None else size * inertia[joint]
        values |= {name: x * random.uniform(0.7, 1.3) for name, x in sizes.items()}
    return mechanism, values


def other(mechanism: Mechanism) -> Log:
    """Positions of the drives along the nominal motion, backwards and, of trees, half as wide."""
    (e,) = nominal_motion(mechanism).experiments
    columns, share = {}, 1.0 if mechanism.closures else 0.5
    for name in mechanism.driven:
        x = e.y[::-1, mechanism.joint_index[name]]
        columns[f"q.{name}"] = x[0] + share * (x - x[0])
    return Log.from_arrays("other", e.t, columns)


def training(mechanism: Mechanism) -> Log:
    """Two sines a drive in the range of the nominal motion: one alone hides springs in inertias."""
    (e,) = nominal_motion(mechanism).experiments
    t, columns = np.arange(0.0, 10.0, 0.004), {}
    for i, name in enumerate(e.independent if mechanism.closures else mechanism.driven):
        x = e.y[:, mechanism.joint_index[name]]
        series = np.zeros((3, len(t)))
        series[0] = (x.max() + x.min()) / 2
        for size, f in ((0.55, 0.4 + 0.1 * i), (0.4, 1.1 + 0.13 * i)):
            w, size = 2 * np.pi * f, size * np.ptp(x) / 2
            series += size * np.stack([np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)])
        columns |= {f"{c}.{name}": y for c, y in zip("qva", series, strict=True)}
    return Log.from_arrays("training", t, columns)


def files(mechanism: Mechanism, values: dict[str, float]) -> list[str]:
    """Largest errors of the file's motion: physical, softness kept, fitted."""
    machine = machine_of(mechanism, values)
    job = Job(machine, None, Path("x.xml"))
    translation = translated(job, WORDS)
    seconds = 2.0 if mechanism.closures else 3.0
    reference = other(bare(machine))
    exact, test = exact_motion(machine), exact_motion(machine, reference, seconds)
    stiff, default = Numbers(STEP, 2 * STEP), Numbers(STEP)
    kept = fit_numbers(translation, default, exact, soft=False)
    fitted = fit_numbers(translation, stiff, exact)
    tries = ((translation, default), (kept.translation, kept.numbers),
             (fitted.translation, fitted.numbers))  # fmt: skip
    errors = [max(error_of(write_mjcf(x, n), x.laws, machine, test).values()) for x, n in tries]
    return [f"{1e3 * error:.3f}" for error in errors]


def replays(mechanism: Mechanism, values: dict[str, float]) -> list[str]:
    """Errors of `ident` and MuJoCo on another log of the machine than the identified one."""
    reference = training(mechanism)
    made, _ = ident.simulate(mechanism, reference, values=values, noise=NOISE, columns=("q", "tau"))
    fit = ident.identify(mechanism, ident.complete(mechanism, made), consistent=True)
    run = ident.integrate(
        mechanism, ident.PD(other(mechanism)), duration=3.0, rate=1000.0, values=values
    )
    logged = {n: x for n, x in run.log.columns.items() if n.startswith(("q.", "tau."))}
    motion = ident.complete(mechanism, Log.from_arrays("other", run.log.t, logged))
    models = export(fit, "mjcf", log=motion, replayed=True).replays.runs
    own, mujoco = (max(x.rms for x in models[n][0].errors.values()) for n in ("ident", "MuJoCo"))
    return [f"{1e3 * own:.3f}", f"{1e3 * mujoco:.3f}", f"{mujoco / own:.2f}"]


if __name__ == "__main__":
    main()
