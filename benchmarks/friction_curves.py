"""Friction of single joints: published predictions beside those of models from these logs.

    python benchmarks/friction_curves.py [--data DIR] [NAME …]

Looks in DIR and in $IDENT_DATA for a clone of longshike/NNFM-A-Novel-Neural-Network-Modeling-
Approach-for-Robot-Flexible-Joints-Friction at a343d3a, of which the logs that are stored are read:
q, v and friction torque of one joint (inertia and gravity removed by the authors) with what eight
published models predict. Ours are identified from the first half of a joint's logs, with a joint
that has no inertia of its own, and judged on the second half; so are the published ones, which were
identified from other logs of the same joints. Errors are rms in N m of torques below 10 Hz (zero
phase, Butterworth of order 4), as the authors compute them.
"""

from __future__ import annotations

import argparse
import io
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from machines import Checkout, located
from scipy.signal import butter, sosfiltfilt

import ident

ROOT = Path(__file__).resolve().parents[1]
SOURCE = (
    "longshike/NNFM-A-Novel-Neural-Network-Modeling-Approach-for-Robot-Flexible-Joints-Friction"
)
COMMIT = "a343d3a"
CUTOFF = 10.0  # of the errors [Hz]
THEIRS = ("CV", "Dahl", "Stribeck", "LuGre", "SVM", "Light_Transformer", "PINN", "NNFM")
OURS = ("viscous + Coulomb", "grown", "with curve or law")
FRANKA, FAIRINO = "Comparative data/Franka Robot/{}.csv", "Comparative data/FAIRINO Robot/{}.csv"
JOINTS = {  # logs of one joint, and seconds of a unit of their time
    "franka_2": ([FRANKA.format(f"case3_{x}") for x in ("slow", "middle", "high")], 1.0),
    # dq is twice the derivative of q by their stamps
    "franka_7": ([FRANKA.format(f"case4_{x}") for x in ("slow", "middle", "high")], 0.5),
    "fairino_line": ([FAIRINO.format("verify_robot_zhixian_slow_processed")], 1.0),
    "fairino_arc": ([FAIRINO.format("verify_robot_yuanhu_slow_processed")], 1.0),
    "fairino_spiral": ([FAIRINO.format("verify_robot_luoxuan_slow_processed")], 1.0),
    "fairino_s": ([FAIRINO.format("verify_robot_S_slow_processed")], 1.0),
}
URDF = """<robot name="joint"><link name="base"/><link name="rotor"><inertial><mass value="1e-9"/>
<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint" type="revolute"><parent link="base"/><child link="rotor"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" effort="999" velocity="99"/></joint></robot>
"""
MOST = 3  # curves or laws that are added one after the other


@dataclass(frozen=True)
class Recorded:
    """One log: t (n,), columns q, v, torque (n, 3), and published predictions (n, 8)."""

    name: str
    t: np.ndarray
    columns: np.ndarray
    theirs: np.ndarray

    def log(self, half: slice) -> ident.Log:
        """A half of it, for ident."""
        q, v, tau = self.columns[half].T
        return ident.Log.from_arrays(
            self.name, self.t[half], {"q.joint": q, "v.joint": v, "tau.joint": tau}
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=f"of {', '.join(JOINTS)}; default: all")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    options = parser.parse_args()
    places = [*options.data, Path(os.environ.get("IDENT_DATA", ROOT.parent / "shared" / "data"))]
    source = located(SOURCE, places)
    if source is None:
        raise SystemExit(f"error: no {SOURCE} in {', '.join(map(str, places))}")
    print(f"| log | torque | {' | '.join((*THEIRS, *OURS))} |")
    print("|" + "---|" * (2 + len(THEIRS) + len(OURS)), flush=True)
    models = []
    for name in options.names or JOINTS:
        paths, second = JOINTS[name]
        recorded = [read(Checkout(source, COMMIT), path, second) for path in paths]
        fits, described = identified(recorded)
        for each in recorded:
            row = " | ".join(f"{x:.3g}" for x in errors(each, fits))
            print(f"| {name} {each.name} | {row} |", flush=True)
        models.append(f"{name}: {described}")
    print("\n" + "\n\n".join(models))


def read(checkout: Checkout, path: str, second: float) -> Recorded:
    """One of their files."""
    text = checkout.read(path).decode().splitlines()
    head = text[0].rstrip(",").split(",")
    rows = np.genfromtxt(io.StringIO("\n".join(text[1:])), delimiter=",")[:, : len(head)]
    at = [next(i for i, name in enumerate(head) if name == each) for each in THEIRS]
    name = Path(path).stem.removesuffix("_processed").rpartition("robot_")[2]
    return Recorded(name, second * rows[:, 0], rows[:, [1, 2, 4]], rows[:, at])


def identified(recorded: list[Recorded]) -> tuple[list[ident.Fit], str]:
    """Models from the first halves, in the order of `OURS`, and the last one in words."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "joint.urdf").write_text(URDF)
        (Path(folder) / "mechanism.toml").write_text(
            'urdf = "joint.urdf"\n[parameters]\nunknown = []\n'
        )
        bare = ident.load(folder)
    motion = ident.complete(bare, [r.log(slice(0, len(r.t) // 2)) for r in recorded])
    plain = bare.with_effect("viscous:joint").with_effect("coulomb:joint")
    history = ident.grow(plain, motion)
    last, diagnosis, laws = history.fit, history.diagnosis, []
    for _ in range(MOST):
        if diagnosis.laws:
            last, name = diagnosis.laws[0].fit, diagnosis.laws[0].formula
        elif diagnosis.curves:
            effect = diagnosis.curves[0].effect
            last, name = ident.identify(last.mechanism + effect, motion), effect.label
        else:
            break
        laws.append(name)
        diagnosis = ident.diagnose(last)
    added = ", ".join(effect.label for effect in history.added) or "nothing"
    words = f"grown with {added}; then {', '.join(laws) or 'nothing'}; verdict {diagnosis.verdict}"
    return [ident.identify(plain, motion), history.fit, last], words


def errors(recorded: Recorded, fits: list[ident.Fit]) -> list[float]:
    """rms of the torque and of the errors of `THEIRS` and `OURS` on the second half [N m]."""
    half = slice(len(recorded.t) // 2, None)
    t, tau = recorded.t[half], recorded.columns[half, 2]
    rate = 1 / float(np.mean(np.diff(t)))
    band = butter(4, min(CUTOFF, 0.45 * rate), fs=rate, output="sos")

    def rms(x: np.ndarray) -> float:
        finite = np.isfinite(x).all()
        return float(np.sqrt(np.mean(sosfiltfilt(band, x) ** 2))) if finite else np.nan

    motion = ident.complete(fits[0].mechanism, recorded.log(half))
    ours = []
    for fit in fits:
        (found,) = fit.predict(motion)
        ours.append(rms(np.interp(t, found.t, found.predicted[:, 0]) - tau))
    with np.errstate(over="ignore"):
        theirs = [rms(np.clip(x, -1e9, 1e9) - tau) for x in recorded.theirs[half].T]
    return [rms(tau), *theirs, *ours]


if __name__ == "__main__":
    main()
