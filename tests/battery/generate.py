"""Logs of a case: simulated once and kept, then corrupted and given noise.

python tests/battery/generate.py NAME FOLDER     one case: mechanism folder, logs, truth.json
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import pickle
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from calibrate import resolve
from cases import Case, Hidden, every_case
from mechanisms import MACHINES
from reference import reference
from rigid import toml, urdf, write_folder
from sensors import Columns, columns, noisy, sizes
from simulate import Known, Run, simulate
from torques import SENSORS

EXPERIMENTS = 2
FRICTION = (0.03, 0.07)  # share of each arm joint's torque, of viscous and of Coulomb friction
FULL = (0.08, 0.14)  # share of a hidden effect of size 1


def cache() -> Path:
    """`$IDENT_BATTERY_CACHE`, else a folder for temporary files."""
    place = os.environ.get("IDENT_BATTERY_CACHE")
    folder = Path(place) if place else Path(tempfile.gettempdir()) / "ident_battery"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@dataclass(frozen=True, eq=False)
class Made:
    """A case's logs and all that is true of them.

    Attributes:
        logs, twins: with noise; the twins have the same noise and no hidden effect.
        hidden: with values; known: effects of which the model knows, with their true values.
    """

    case: Case
    logs: Sequence[Columns]
    twins: Sequence[Columns]
    hidden: Sequence[Known]
    known: Sequence[Known]

    @property
    def truth(self) -> Mapping[str, float]:
        """Values by ident's names."""
        return {
            ".".join([e.kind, *([",".join(e.joints)] if e.joints else []), name]): x
            for e in self.hidden
            for name, x in e.values.items()
        }

    def folder(self, place: Path) -> Path:
        """The mechanism folder with a wrong prior."""
        effects = {(e.kind, ",".join(e.joints)): {} for e in self.known}
        return write_folder(MACHINES[self.case.mechanism], place, effects, self.case.seed)


def make(case: Case) -> Made:
    """Everything of a case; the costly part is kept in `cache()`."""
    machine = MACHINES[case.mechanism]
    plain = baseline(case.mechanism, case.motion, ())
    friction = arm_friction(case.mechanism, case.motion)
    known = tuple(e for e in friction if (e.kind, e.joints) not in [
        (h.kind, h.joints) for h in case.hidden])  # fmt: skip
    hidden = tuple(
        resolve(machine, plain, h.kind, h.joints, case.size * full_share(case, h),
                case.motion, known)
        for h in case.hidden
    )  # fmt: skip
    truth = tuple(e for e in hidden if e.kind not in SENSORS)
    runs = experiments(case.mechanism, case.motion, (*known, *truth)) if truth else baseline(
        case.mechanism, case.motion, known)  # fmt: skip
    warm = any(h.kind == "temperature_friction" for h in case.hidden)
    logs = [columns(machine, run, hidden) for run in runs]
    twins = [columns(machine, run, (), warm) for run in baseline(case.mechanism, case.motion,
                                                                  known)]  # fmt: skip
    size = sizes(logs, case.noise, case.encoder)
    both = (noisy(some, size, case.seed, case.coloured) for some in (logs, twins))
    return Made(case, *both, hidden, known)


def full_share(case: Case, hidden: Hidden) -> float:
    """The share of an effect of size 1, drawn by the case."""
    rng = np.random.default_rng([13, case.motion, *map(ord, hidden.kind)])
    return float(rng.uniform(*FULL))


@lru_cache(maxsize=32)
def arm_friction(name: str, motion: int) -> tuple[Known, ...]:
    """Viscous and Coulomb friction of every joint of an arm; loops have none."""
    machine = MACHINES[name]
    if machine.closures:
        return ()
    rng = np.random.default_rng([17, motion])
    plain = baseline(name, motion, ())
    found = []
    for joint in machine.driven:
        k = machine.driven.index(joint)
        rms = np.sqrt(np.mean([np.mean(run.tau[:, k] ** 2) for run in plain]))
        speed = np.sqrt(np.mean([np.mean(run.v[:, k] ** 2) for run in plain]))
        for kind, value, size in (("viscous", "Fv", rms / speed), ("coulomb", "Fc", rms)):
            share = rng.uniform(*FRICTION)
            found.append(Known(kind, (joint,), {value: float(f"{share * size:.3g}")}))
    return tuple(found)


def baseline(name: str, motion: int, effects: tuple[Known, ...]) -> tuple[Run, ...]:
    """Experiments that several cases share."""
    return experiments(name, motion, effects)


def experiments(name: str, motion: int, effects: Sequence[Known]) -> tuple[Run, ...]:
    """Simulated, or read back where the same simulation was done before."""
    machine = MACHINES[name]
    told = [(e.kind, e.joints, sorted(e.values.items())) for e in effects]
    source = "".join(
        ast.dump(ast.parse((Path(__file__).parent / f"{part}.py").read_text()))  # no comments
        for part in ("simulate", "torques", "reference", "rigid")
    )
    text = repr((toml(machine, {}), urdf(machine, None), machine, motion, told, source))
    place = cache() / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:24]}.pickle"
    if place.exists():
        return pickle.loads(place.read_bytes())  # its own, written below
    runs = tuple(
        simulate(machine, reference(machine, motion, number), effects)
        for number in range(EXPERIMENTS)
    )
    part = place.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(runs))
    part.replace(place)
    return runs


def write_log(log: Columns, place: Path) -> Path:
    """As CSV."""
    np.savetxt(place, np.stack(list(log.values()), axis=1), "%.12g", ",", header=",".join(log),
               comments="")  # fmt: skip
    return place


def main() -> None:
    name, place = sys.argv[1], Path(sys.argv[2])
    case = next(case for case in every_case() if case.name == name)
    made = make(case)
    made.folder(place)
    for number, log in enumerate(made.logs):
        write_log(log, place / f"log_{number + 1}.csv")
    for number, log in enumerate(made.twins):
        write_log(log, place / f"twin_{number + 1}.csv")
    (place / "truth.json").write_text(json.dumps(made.truth, indent=1))
    print(case, dict(made.truth))


if __name__ == "__main__":
    main()
