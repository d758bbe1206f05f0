"""Faults that begin while a machine runs: are they seen, how soon, and what are they called?

    python benchmarks/faults.py [--small] [--seed N] [--hours H] [machine …]

Each run is a log with a motion and noise of its own, 100 Hz. Torques are exact (inverse dynamics of
the planted model on the motion), those of the faulted model from a random time on; then noise is
added, white, 1.5 % of a usual torque, and 2e-5 rad in positions. The reference was identified from
another noisy log of a minute, and normal running learnt from eight more. Beside the faults: normal
running in pieces of two minutes, every piece with a motion and noise of its own.

A name is right if it is the effect that was planted, at its place. `one of` may hold it. Faults
come in full size (half to all of what is there, percents of a usual torque) and a quarter of that.
Seeds from 1000 on: the code was made with seeds below 100.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]

import ident  # noqa: E402
from ident import Log, Mechanism  # noqa: E402

RATE = 100.0  # Hz
REFERENCE, NORMAL, REFERENCES = 60.0, 8, 2  # s; logs of normal running; references a machine
AFTER, PIECE = 40.0, 120.0  # s after a fault began; s of a piece of normal running
SCALES, RUNS = (1.0, 0.25), 3
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Fault:
    """An effect that begins: `kind:place`, and the sizes of its parameters, from … to.

    Attributes:
        same: effects that no motion tells from it, because their columns are the same.
        foreign: whether the monitor does not know it: then the right verdict is `cannot tell`.
    """

    label: str
    sizes: Mapping[str, tuple[float, float]]
    same: tuple[str, ...] = ()
    foreign: bool = False


@dataclass(frozen=True)
class Machine:
    """A robot of robots/, its friction, its motions and its faults."""

    name: str
    friction: Mapping[str, float]
    motion: Mapping[str, tuple[float, float]]
    torque: Mapping[str, float]
    faults: tuple[Fault, ...]


def one(label: str, name: str, low: float, high: float) -> Fault:
    return Fault(label, {name: (low, high)})


def foreign(label: str, sizes: Mapping[str, tuple[float, float]]) -> Fault:
    return Fault(label, sizes, foreign=True)


MACHINES = {
    "slider_crank": Machine(
        "slider_crank",
        {"viscous:theta": 0.01, "coulomb:theta": 0.03, "viscous:s": 0.1, "coulomb:s": 0.3},
        {"theta": (0.0, 1.0)},
        {"theta": 0.2, "s": 0.5},
        (
            one("coulomb:theta", "Fc", 0.015, 0.03),
            one("coulomb:s", "Fc", 0.15, 0.3),
            one("viscous:theta", "Fv", 0.005, 0.01),
            one("viscous:s", "Fv", 0.3, 0.6),
            one("torque_offset:theta", "c", 0.01, 0.02),
            replace(one("torque_offset:s", "c", 0.15, 0.3), same=("gravity_tilt",)),
            one("torque_gain:theta", "g", 0.08, 0.2),
            Fault("payload:piston", {"m": (0.2, 0.6)}, ("payload:cross",)),
            one("closure_compliance:ball", "C", 5e-5, 1e-4),
            foreign("spring:theta", {"k": (0.005, 0.01)}),
            foreign("ripple:theta", {"A": (0.01, 0.02), "N": (7, 7)}),
        ),
    ),
    "five_bar": Machine(
        "five_bar",
        {"viscous:left": 0.03, "viscous:right": 0.03, "coulomb:left": 0.05, "coulomb:right": 0.05},
        {"left": (2.1, 0.4), "right": (1.04, 0.4)},
        {"left": 0.15, "right": 0.15},
        (
            one("coulomb:left", "Fc", 0.025, 0.05),
            one("viscous:right", "Fv", 0.015, 0.03),
            one("coulomb:left_elbow", "Fc", 0.01, 0.03),
            one("coulomb:right_elbow", "Fc", 0.01, 0.03),
            one("torque_offset:right", "c", 0.01, 0.02),
            one("torque_gain:left", "g", 0.08, 0.2),
            one("encoder_offset:left", "delta", 0.02, 0.04),
            Fault("payload:left_distal", {"m": (0.1, 0.3), "mx": (0.1, 0.2), "my": (0.03, 0.06)}),
            one("closure_compliance:tip", "C", 5e-4, 1e-3),
            foreign("drag:right", {"Fd": (0.005, 0.01)}),
            foreign("ripple:left", {"A": (0.005, 0.01), "N": (20, 20)}),
        ),
    ),
    "arm": Machine(
        "arm",
        {"viscous:yaw": 0.5, "viscous:shoulder": 0.8, "viscous:elbow": 0.4, "viscous:wrist": 0.05,
         "coulomb:yaw": 1.0, "coulomb:shoulder": 1.5, "coulomb:elbow": 0.8, "coulomb:wrist": 0.1},
        {"yaw": (0.0, 1.3), "shoulder": (-0.55, 0.5), "elbow": (0.9, 0.7), "wrist": (0.2, 1.4)},
        {"yaw": 4.0, "shoulder": 4.0, "elbow": 2.0, "wrist": 0.4},
        (
            Fault("payload:hand", {"m": (0.1, 0.4), "mx": (0.05, 0.12), "my": (0.01, 0.03),
                                   "mz": (-0.03, 0.03)}),
            Fault("payload:forearm", {"m": (0.2, 0.6), "mx": (0.05, 0.15), "my": (-0.03, 0.03),
                                      "mz": (0.03, 0.06)}),
            one("coulomb:shoulder", "Fc", 0.7, 1.5),
            one("coulomb:wrist", "Fc", 0.05, 0.1),
            one("viscous:elbow", "Fv", 0.2, 0.4),
            one("viscous:yaw", "Fv", 0.25, 0.5),
            one("torque_offset:elbow", "c", 0.1, 0.3),
            one("torque_gain:yaw", "g", 0.05, 0.15),
            one("encoder_offset:shoulder", "delta", 0.01, 0.03),
            one("encoder_offset:elbow", "delta", 0.01, 0.03),
            foreign("spring:elbow", {"k": (0.5, 1.5)}),
            foreign("hysteresis:elbow", {"sigma": (5.0, 10.0), "z0": (0.05, 0.05)}),
        ),
    ),
}  # fmt: skip


# --- logs ----------------------------------------------------------------------------------------


def mechanism_of(machine: Machine) -> tuple[Mechanism, dict[str, float]]:
    """The robot with friction in all drives, and the true values of its effects."""
    mechanism = replace(
        ident.load(ROOT / "robots" / machine.name), multipliers=ident.Multipliers("free")
    )
    mechanism = mechanism.with_effect("viscous").with_effect("coulomb")
    values = {
        name: machine.friction[effect.label]
        for effect in mechanism.effects
        for name in effect.names
    }
    return mechanism, values


def motion_of(machine: Machine, rng: np.random.Generator, seconds: float) -> Log:
    """A motion of its own: sines in every joint, or a crank that turns there and back."""
    t = np.arange(round(seconds * RATE)) / RATE
    turns = machine.name == "slider_crank"
    columns: Columns = {}
    for joint, (centre, half) in machine.motion.items():
        share = rng.uniform(0.5, 1.0, 3)
        share = np.array([8.0, 0.9, 0.5]) * share if turns else half * share / share.sum()
        x = np.full(len(t), centre)
        for a, f in zip(share, (0.13, 0.46, 0.74) if turns else (0.3, 0.62, 1.06), strict=True):
            x = x + a * np.sin(2 * np.pi * (f * rng.uniform(0.85, 1.15) * t + rng.uniform()))
        columns[f"q.{joint}"] = x
    if turns:  # the second drive pushes in its own time
        columns["tau.s"] = 0.7 * np.sin(2 * np.pi * 0.8 * rng.uniform(0.9, 1.1) * t)
    return Log.from_arrays(f"{machine.name}.csv", t, columns)


def noisy(machine: Machine, log: Log, rng: np.random.Generator) -> Log:
    """1.5 % of a usual torque, and 2e-5 rad."""
    columns = {}
    for name, x in log.columns.items():
        channel, _, joint = name.partition(".")
        sigma = 0.015 * machine.torque[joint] if channel == "tau" else 2e-5
        columns[name] = x + sigma * rng.standard_normal(len(x))
    return Log.from_arrays(log.name, log.t, columns)


def clean_log(machine: Machine, rng: np.random.Generator, seconds: float) -> Log:
    """Normal running."""
    mechanism, values = mechanism_of(machine)
    log, _ = ident.simulate(
        mechanism, motion_of(machine, rng, seconds), values=values, columns=("q", "tau")
    )
    return noisy(machine, log, rng)


def faulted_log(
    machine: Machine,
    fault: Fault,
    rng: np.random.Generator,
    begins: float,
    seconds: float,
    scale: float = 1.0,
) -> Log:
    """Normal running that changes at the time `begins` [s], by `scale` times its usual size."""
    mechanism, values = mechanism_of(machine)
    motion = motion_of(machine, rng, seconds)
    clean, _ = ident.simulate(mechanism, motion, values=values, columns=("q", "tau"))
    size = {name: rng.uniform(*span) for name, span in fault.sizes.items()}
    kind, _, place = fault.label.partition(":")
    if kind == "payload":
        size = load_of({**size, "m": scale * size["m"]})
    else:
        size = {n: x if n in ("N", "z0") else scale * x for n, x in size.items()}  # shapes stay
    changed, extra = mechanism, {}
    if fault.label in machine.friction:
        extra = {name: values[name] + size[name.rpartition(".")[2]] for name in values
                 if name.startswith(f"{kind}.{place}.")}  # fmt: skip
    elif kind != "torque_offset":
        given = ident.effect(kind, place)
        whole = {each.name: size.get(each.name, 0.0) for each in given.parameters}
        changed = mechanism.with_effect(fault.label, whole)
    faulty, _ = ident.simulate(changed, motion, values={**values, **extra}, columns=("q", "tau"))
    columns: Columns = {}
    n = min(len(clean.t), len(faulty.t))
    t = clean.t[:n]
    after = t >= t[0] + begins
    for name, x in clean.columns.items():
        columns[name] = np.where(after, faulty.columns[name][:n], x[:n])
        if kind == "torque_offset" and name == f"tau.{place}":
            columns[name] = columns[name] + size["c"] * after
    return noisy(machine, Log.from_arrays(clean.name, t, columns), rng)


def load_of(size: Mapping[str, float]) -> dict[str, float]:
    """Ten parameters of a compact load: `m` [kg] at mx, my, mz [m], 4 cm wide."""
    m = size["m"]
    c = np.array([size.get(axis, 0.0) for axis in ("mx", "my", "mz")])
    L = m * ((c @ c + 0.02**2) * np.eye(3) - np.outer(c, c))
    named = {"m": m, "mx": m * c[0], "my": m * c[1], "mz": m * c[2]}
    return named | {
        "Lxx": L[0, 0], "Lxy": L[0, 1], "Lyy": L[1, 1], "Lxz": L[0, 2], "Lyz": L[1, 2],
        "Lzz": L[2, 2],
    }  # fmt: skip


# --- runs ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Trained:
    """A monitor with normal running learnt, and how its logs are completed."""

    machine: Machine
    mechanism: Mechanism
    monitor: ident.Monitor
    cutoff: float
    smoothing: float

    @classmethod
    def of(cls, name: str, seed: int) -> Trained:
        machine, rng = MACHINES[name], np.random.default_rng(seed)
        mechanism, _ = mechanism_of(machine)
        first = ident.complete(mechanism, clean_log(machine, rng, REFERENCE))
        fit = ident.identify(mechanism, first)
        cutoff, smooth = first.band.cutoff, first.experiments[0].smooth
        assert cutoff is not None
        assert smooth is not None
        normal = ident.complete(
            mechanism,
            [clean_log(machine, rng, REFERENCE) for _ in range(NORMAL)],
            cutoff=cutoff,
            smoothing=smooth.spacing,
        )
        return cls(machine, mechanism, ident.Monitor.of(fit, normal), cutoff, smooth.spacing)

    def fresh(self) -> Trained:
        """With a monitor that has seen nothing yet."""
        return replace(self, monitor=self.monitor.fresh())

    def alarms(self, log: Log) -> list[ident.Alarm]:
        motion = ident.complete(self.mechanism, log, cutoff=self.cutoff, smoothing=self.smoothing)
        return self.monitor.watch(motion)


@dataclass(frozen=True)
class Outcome:
    """What became of one fault."""

    machine: str
    fault: Fault
    scale: float
    delay: float | None
    named_after: float | None
    verdict: str
    suspects: tuple[str, ...]
    before: int
    after: int

    @property
    def first(self) -> bool:
        """The likeliest is right."""
        return self.suspects[:1] == (self.fault.label,)

    @property
    def held(self) -> bool:
        return self.fault.label in self.suspects

    @property
    def wrong(self) -> bool:
        """A name or a set, and the truth is not in it."""
        return bool(self.suspects) and not self.held


def faulted(trained: Trained, fault: Fault, seed: int, scale: float) -> Outcome:
    rng, name = np.random.default_rng(seed), trained.machine.name
    begins = float(rng.uniform(10.0, 30.0))
    fresh = trained.fresh()
    log = faulted_log(trained.machine, fault, rng, begins, begins + AFTER, scale)
    alarms = fresh.alarms(log) + fresh.monitor.finish()
    begins += float(log.t[0])
    before = sum(each.detected < begins for each in alarms)
    mine = [each for each in alarms if each.detected >= begins]
    if not mine:
        return Outcome(name, fault, scale, None, None, "not seen", (), before, 0)
    seen, called = mine[0].detected - begins, mine[0].named - begins
    verdict, suspects = mine[0].verdict, mine[0].suspects
    return Outcome(name, fault, scale, seen, called, verdict, suspects, before, len(mine) - 1)


@dataclass(frozen=True)
class Result:
    """Faults of one machine, and its alarms in so many hours of normal running."""

    outcomes: list[Outcome]
    alarms: int
    hours: float


def watched(name: str, seed: int, runs: int, scales: Sequence[float], hours: float) -> Result:
    found: list[Outcome] = []
    trained = [Trained.of(name, seed + k) for k in range(min(runs, REFERENCES))]
    each = seed + 100
    for fault in MACHINES[name].faults:
        for scale in scales:
            for run in range(runs):
                found.append(faulted(trained[run % len(trained)], fault, each, scale))
                each += 1
    alarms, seconds = 0, 0.0
    for k in range(round(3600 * hours / PIECE)):
        own = trained[k % len(trained)]
        log = clean_log(own.machine, np.random.default_rng(each + k), PIECE)
        alarms += len(own.alarms(log))
        seconds += float(log.t[-1] - log.t[0])
    return Result(found, alarms, seconds / 3600)


# --- the table -----------------------------------------------------------------------------------


def row(head: Mapping[str, object], mine: Sequence[Outcome]) -> dict[str, object]:
    """Some outcomes as one row."""
    seen = [o.delay for o in mine if o.delay is not None]
    called = [o.named_after for o in mine if o.named_after is not None]
    return {
        **head,
        "runs": len(mine),
        "seen": len(seen),
        "delay [s]": float(np.median(seen)) if seen else None,
        "to its name [s]": float(np.median(called)) if called else None,
        "first name right": sum(o.first for o in mine),
        "in the set": sum(o.held for o in mine),
        "wrong": sum(o.wrong for o in mine),
        "cannot tell": sum(o.verdict == "cannot tell" for o in mine),
        "set": float(np.mean([len(o.suspects) for o in mine if o.suspects] or [0])),
        "alarms after": sum(o.after for o in mine),
    }


def table(
    small: bool = False,
    seed: int = 1000,
    hours: float | None = None,
    machines: Sequence[str] = tuple(MACHINES),
) -> list[dict[str, object]]:
    """Every fault, all together, and normal running.

    Args:
        small: one run a fault, in full size, and two minutes of normal running, for a first look.
        seed: of the first log.
        hours: of normal running of each machine.
        machines: which.
    """
    hours = (1 / 30 if small else 1.0) if hours is None else hours
    runs, scales = (1, SCALES[:1]) if small else (RUNS, SCALES)
    with ProcessPoolExecutor(2) as pool:
        jobs = [pool.submit(watched, name, seed + 10_000 * i, runs, scales, hours)
                for i, name in enumerate(machines)]  # fmt: skip
        results = dict(zip(machines, (job.result() for job in jobs), strict=True))
    outcomes = [o for result in results.values() for o in result.outcomes]
    rows = []
    for machine, fault, scale in dict.fromkeys(
        (o.machine, o.fault.label, o.scale) for o in outcomes
    ):
        mine = [
            o for o in outcomes if (o.machine, o.fault.label, o.scale) == (machine, fault, scale)
        ]
        same = mine[0].fault.same
        name = f"{fault} (same as {', '.join(same)})" if same else fault
        name = f"{fault}, not known" if mine[0].fault.foreign else name
        rows.append(row({"machine": machine, "fault": name, "size": scale}, mine))
    kinds: dict[str, Callable[[Fault], bool]] = {
        "known": lambda fault: not fault.foreign,
        "known, not the same as another": lambda fault: not (fault.foreign or fault.same),
        "not known": lambda fault: fault.foreign,
    }
    for scale in scales:
        for name, belongs in kinds.items():
            mine = [o for o in outcomes if o.scale == scale and belongs(o.fault)]
            rows.append(row({"machine": "all", "fault": name, "size": scale}, mine))
    for name, result in results.items():
        said = (
            f"none, {result.hours:.2f} h: {result.alarms} alarms, stated ≤ {0.1 * result.hours:.2g}"
        )
        rows.append({"machine": name, "fault": said})
    ahead = sum(o.before for o in outcomes)
    rows.append(
        {"machine": "all", "fault": f"before it began: {ahead} alarms", "runs": len(outcomes)}
    )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("machines", nargs="*", default=list(MACHINES))
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--hours", type=float)
    given = parser.parse_args()
    rows = table(given.small, given.seed, given.hours, given.machines)
    names = list(rows[0])
    lines = [names, ["---"] * len(names), *([shown(each.get(n)) for n in names] for each in rows)]
    sys.stdout.write("\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n")


def shown(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "" if value is None else str(value)


if __name__ == "__main__":
    main()
