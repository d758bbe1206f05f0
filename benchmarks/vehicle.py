"""Cornering stiffness of a car from a slalom: position, heading, steering and wheel speed.

    python benchmarks/vehicle.py [--seeds N]

A bicycle model (1200 kg, known) is integrated by Runge and Kutta (2 ms) at 12 m/s, 16 s at 100 Hz;
noise of 5 mm, 1 mrad of heading, 1 mrad of steering, 0.01 rad/s of the wheel. Front and rear
stiffness, the longitudinal one, Izz and the centre of mass are unknown. The last row has tyres that
bend after Pacejka, to 0.6 to 1 of their peak, fitted by lines and with `tyre_saturation`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

import ident

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests" / name) for name in ("", "truth")]
from test_frame_forces import C_FRONT, C_REAR, C_X, car, log_of, slalom  # noqa: E402

TRUE = {"tyre.front.C": C_FRONT, "tyre.rear.C": C_REAR, "tyre_slip.rear.Cx": C_X}
AMPLITUDE, BENT, BEND = 0.08, 0.12, 12.0  # rad of steering; Pacejka's B [1/rad]


def main() -> None:
    """Print errors of each value over the seeds, and what a bent slope is found to be."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    seeds = parser.parse_args().seeds
    with tempfile.TemporaryDirectory() as folder:
        mechanism = car(Path(folder)).with_calibration("exact")
        rows, errors = slalom(AMPLITUDE), {name: list[tuple[float, float]]() for name in TRUE}
        for seed in range(seeds):
            motion = ident.complete(mechanism, log_of(rows, seed))
            fit = ident.identify(mechanism, motion)
            for x in (x for e in fit.effects for x in e.parameters):
                errors[x.name].append((x.value / TRUE[x.name] - 1, x.stderr / TRUE[x.name]))
        for name, pairs in errors.items():
            e, s = np.array(pairs).T
            held = int((np.abs(e) <= 1.96 * s).sum())
            spread, largest = 100 * np.sqrt((e**2).mean()), 100 * np.abs(e).max()
            print(
                f"{name:18} mean error {100 * e.mean():+.2f} %, rms {spread:.2f} %, largest "
                f"{largest:.2f} %, standard error {100 * s.mean():.2f} %, {held} of {len(e)} "
                "intervals of 95 % hold",
                flush=True,
            )
        motion = ident.complete(mechanism, log_of(slalom(BENT, BEND), 0))
        fit = ident.identify(mechanism, motion)
        found = ident.diagnose(fit).group
        print(f"bent: lines leave {rms(fit)}; named: {[x.label for x in found]}", flush=True)
        both = mechanism
        for place in ("front", "rear"):
            both = both.with_effect(f"tyre_saturation:{place}")
        fit = ident.identify(both, motion)
        values = [f"{x.name} {x.value:.4g}" for e in fit.effects for x in e.parameters]
        print(f"bent, with saturation: leave {rms(fit)}; {', '.join(values)}")


def rms(fit: ident.Fit) -> str:
    """Return what is left in words."""
    return ", ".join(f"{name} {x.rms:.3g} {x.unit}" for name, x in fit.train.items() if x.rms)


if __name__ == "__main__":
    main()
