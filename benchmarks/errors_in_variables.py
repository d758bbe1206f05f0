"""What to do about noise in the motion: rivals on the paper's slider-crank, the same noise for all.

Least squares on the smooth motion; instruments, p = (A₁ᵀA₂ + A₂ᵀA₁)⁻¹ (A₁ᵀb₂ + A₂ᵀb₁), from
splines of even and of odd samples, whose noise is independent; one step of the likelihood (the
default); the likelihood, converged. Prints bias ± standard deviation in percent of the truth.

    python benchmarks/errors_in_variables.py [--runs 20]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import ident
from ident.equations.rows import Scene
from ident.equations.unknowns import Columns
from ident.simulate.inverse import noisy, random_of

FOLDER = Path(__file__).resolve().parents[1] / "robots" / "slider_crank"
TRUTH = {"rod.Ixx": 4e-3, "rod.Iyy": 4e-4, "rod.Izz": 4e-3}  # kg m²
STEINER = np.array([0.5 * 0.15**2, 0.0, 0.5 * 0.15**2])  # kg m², of the rod about its joint


def instruments(mechanism: ident.Mechanism, log: ident.Log) -> np.ndarray:
    """Moments of inertia (3,) from halves of the samples that instrument each other."""
    (whole,) = ident.complete(mechanism, log, cutoff=None).experiments
    assert whole.smooth is not None
    halves = []
    for odd in (0, 1):
        columns = {name: x.copy() for name, x in log.columns.items()}
        for name in columns:
            if name.startswith(("q.", "v.", "a.")):
                columns[name][1 - odd :: 2] = np.nan
        half = ident.Log.from_arrays(log.name, log.t, columns)
        motion = ident.complete(mechanism, half, cutoff=None, smoothing=whole.smooth.spacing)
        (e,) = motion.experiments
        rows = Scene.of(mechanism, Columns.of(mechanism), e).terms(slice(0, len(e)))
        halves.append((rows.A[:, 0], rows.b[:, 0]))
    n = min(len(b) for _, b in halves)
    (A, b), (C, d) = ((A[:n], b[:n]) for A, b in halves)
    return np.asarray(np.linalg.solve(A.T @ C + C.T @ A, A.T @ d + C.T @ b)) - STEINER


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args().runs
    mechanism, log = ident.load(FOLDER), ident.read_log(FOLDER / "run.csv")
    true = np.array(list(TRUTH.values()))
    for snr in (40, 30, 20):
        found: dict[str, list[np.ndarray]] = {}
        for run in range(runs):
            made = noisy(log, snr, list(log.columns), random_of(1, snr, run))
            motion = ident.complete(mechanism, made)
            for estimator in ("least-squares", "auto", "likelihood"):
                fit = ident.identify(mechanism, motion, estimator=estimator)
                values = np.array([fit[name].value for name in TRUTH])
                found.setdefault(estimator, []).append(values)
            found.setdefault("instruments", []).append(instruments(mechanism, made))
        for name, values in found.items():
            off = 100 * (np.array(values) / true - 1)
            shown = ", ".join(
                f"{p} {m:+.2f} ± {s:.2f} %"
                for p, m, s in zip(TRUTH, off.mean(axis=0), off.std(axis=0), strict=True)
            )
            print(f"{snr} dB  {name:14} {shown}")


if __name__ == "__main__":
    main()
