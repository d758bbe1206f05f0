"""The DFKI double pendulum: on what joint 1's unexplained torque depends, in and across logs.

    python benchmarks/dfki.py

The script looks for the logs in $IDENT_DATA, or ../shared/data beside the checkout; see
docs/real_logs.md.
"""

import os
import tempfile
from itertools import product
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import butter, csd, sosfiltfilt

import ident

DATA = Path(os.environ.get("IDENT_DATA", Path(__file__).resolve().parents[2] / "shared/data"))
A0, C1 = ["A0_11", "A0_12", "A0_13"], ["C1_154220", "C1_154548"]  # A0_swingup_11.csv, ...
CUTOFFS: tuple[float | str, ...] = ("auto", 12.0, 8.0, 6.0)
TEACH = {A0[0]: A0[1:], C1[0]: C1[1:], C1[1]: C1[:1]}  # 12 and 13 teach nothing of joint 1
OUT = ("viscous", "coulomb", "rotor_inertia", "temperature_friction", "end_stop", "coupling")
CANDIDATES = [f"{name}:Joint{j}" for name, kind in ident.effects.items() for j in (1, 2)
              if name not in OUT and kind.sits in ("joint", "driven")]  # fmt: skip
CANDIDATES += ["coupling:Joint1,Joint2", "gravity_tilt"]
NAMES = (("q", "pos"), ("v", "vel"), ("tau", "tau"))
COLUMNS = {f"{a}.Joint{j}": ident.Column(f"{b}_meas{j}") for a, b in NAMES for j in (1, 2)}
COLUMNS["t"] = ident.Column("time")


def pendulum(design: str) -> ident.Mechanism:
    """Rigid bodies, viscous and Coulomb friction, rotor inertia; C1's URDF is made from A0's."""
    urdf = (DATA / "dfki_double_pendulum/double_pendulum_A0.urdf").read_text()
    if design == "C1":
        lines = (DATA / "dfki_double_pendulum/C1_model_1.0.yml").read_text().split("\n")
        p = {key: float(x) for key, x in (line.split(":") for line in lines if line)}
        I1, I2 = (p[f"I{k}"] - p[f"m{k}"] * p[f"r{k}"] ** 2 for k in "12")
        old = ("0.0522 0 -0.3", "-0.27401315789473685", "0.16634950840469392", "0.608", "0.6306")
        new = (f"0.0522 0 {-p['l1']}", -p["r1"], p["r2"], p["m1"], p["m2"])
        for a, b in zip((*old, "0.05472", "0.02522"), (*new, I1, I2), strict=True):
            urdf = urdf.replace(a, str(b))
    with tempfile.TemporaryDirectory() as folder:
        (urdf_file := Path(folder) / "pendulum.urdf").write_text(urdf)
        model = ident.load(urdf_file)
    return model.with_effect("viscous").with_effect("coulomb").with_effect("rotor_inertia")


def main() -> None:
    if not (DATA / "dfki_double_pendulum").is_dir():
        print(f"no dfki_double_pendulum in {DATA}; set IDENT_DATA to the folder that holds it")
        return
    for account in (diagnosed, spectra, across, played):
        account()


def given(logs: list[str], cutoff: float | str, play: float = -1.0) -> tuple:
    files = [DATA / f"dfki_double_pendulum/{log.replace('_', '_swingup_')}.csv" for log in logs]
    read = [without_play(ident.read_log(file, COLUMNS), play) for file in files]
    return (model := pendulum(logs[0][:2])), ident.complete(model, read, cutoff=cutoff)


def diagnosed() -> None:
    """Error of joint 1 by cut-off, what `diagnose` says, and on what the residual depends."""
    rows = [["joint 1 of", "below", "N m", "of torque", "verdict", "depends on; stands out"]]
    for logs, cutoff in product([*([log] for log in A0 + C1), A0, C1], CUTOFFS):
        found = ident.diagnose(fit := ident.identify(*given(logs, cutoff)))
        (where,) = (each for each in found.where if each.joint == "Joint1")
        named = " or ".join(effect.label for effect in (found.best, *found.rivals) if effect)
        row = ["+".join(logs), f"{fit.motion.band.cutoff:.3g} Hz", f"{where.rms:.3f}"]
        row += [f"{where.relative or np.nan:.0%}", f"{found.verdict} {named}"]
        rows.append([*row, "; ".join(map(str, where.depends_on))])
    show(rows)


def spectra() -> None:
    """Predicted against measured torque of joint 1, with parameters fitted below 8 Hz."""
    hz = (1, 2, 3, 4, 6, 8, 12, 20)
    rows = [["joint 1 of", "", *(f"{f} Hz" for f in hz)]]
    for log in A0 + C1:
        fit = ident.identify(*given([A0[0] if log in A0 else log], 8.0))
        residual = ident.residual_of(fit, motion=given([log], 30.0)[1])
        n, (trace,) = int(residual.rate), residual.traces  # windows of a second
        m, p = trace.measured[:, 0], trace.predicted[:, 0]
        mm, pp, pm = (csd(a, b, n, nperseg=n)[1] for a, b in ((m, m), (p, p), (p, m)))
        alike, size = abs(pm) ** 2 / abs(mm * pp), abs(mm / pp) ** 0.5
        rows.append([log, "coherence", *(f"{alike[f]:.2f}" for f in hz)])
        rows.append(["", "measured/predicted", *(f"{size[f]:.2f}" for f in hz)])
    show(rows)


def across() -> None:
    """Each candidate fitted on one log: its change of joint 1's rms on others, its value."""
    for cutoff in (12.0, 8.0):
        head, rows = [f"below {cutoff:g} Hz"], {label: [label] for label in CANDIDATES}
        for log, others in TEACH.items():
            (model, motion), (_, tested) = given([log], cutoff), given(others, cutoff)
            plain = ident.identify(model, motion, validate=tested).validation
            head += [*(f"{log} to {x}" for x in others), "value"]
            for label in CANDIDATES:
                fit = ident.identify(model.with_effect(label), motion, validate=tested)
                for name, error in fit.validation.items():
                    rows[label].append(
                        f"{error['Joint1'].rms / plain[name]['Joint1'].rms - 1:+.0%}"
                    )
                rows[label].append(f"{fit.effects[-1].parameters[0].value:.2g}")
        show([head, *rows.values()])


def played() -> None:
    """Joint 1's rms once play of a width is taken out of the positions of both logs."""
    rows = [["joint 1, rms [N m]", *(f"{w} mrad" for w in range(6))]]
    for hz, log in product((12.0, 8.0), TEACH):
        for other in (log, *TEACH[log]):
            rows.append([f"{log} to {other}, {hz:g} Hz"])
            for w in np.arange(6) / 1000:
                fit = ident.identify(*given([log], hz, w), validate=given([other], hz, w)[1])
                rows[-1] += [f"{x['Joint1'].rms:.3f}" for x in fit.validation.values()]
    show(rows)


def without_play(log: ident.Log, width: float) -> ident.Log:
    """The link ahead of the encoder by half the play; 46 ms at each reversal are bridged."""
    if width < 0:  # as logged
        return log
    u, n, last = np.arange(log.t[0], log.t[-1], 0.002), np.arange(21), 0
    x = np.interp(u, log.t, log.columns["q.Joint1"])
    v = np.gradient(sosfiltfilt(butter(2, 10, fs=500, output="sos"), x), 0.002)
    link, half = x.copy(), 0 * x
    for k in map(int, np.flatnonzero((v[:-1] * v[1:] < 0) & (abs(np.diff(v)) > 0.003))):
        i, j = k - 3, k + 20
        if last + 20 < i and j + 21 < len(u):
            left, right = np.polyfit(n - 20, x[i - 20 : i + 1], 2), np.polyfit(n, x[j : j + 21], 2)
            side, ends = np.sign(x[j + 15] - x[j]) * width / 2, np.c_[left, right]
            link[i : j + 1] = CubicHermiteSpline([i, j], ends[2], ends[1])(np.arange(i, j + 1))
            half[last:i], half[i:j], half[j:] = -side, side * np.linspace(-1, 1, j - i), side
            last = j
    moved = log.columns["q.Joint1"] + np.interp(log.t, u, link + half - x)
    kept = {name: y for name, y in log.columns.items() if not name.startswith("v.")}
    return ident.Log.from_arrays(log.name, log.t, {**kept, "q.Joint1": moved})


def show(rows: list[list[str]]) -> None:
    width = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in [[""] * len(width), *rows]:
        print("  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip())


if __name__ == "__main__":
    main()
