"""The DFKI double pendulum: what joint 1's unexplained torque depends on, log by log and across logs.

    python benchmarks/dfki.py

The logs are not in this repository: they are looked for in $IDENT_DATA, or ../shared/data beside the
checkout (dfki_double_pendulum/*.csv). docs/dfki.md is the account in words.
"""

import os
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import butter, csd, sosfiltfilt, welch

import ident

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("IDENT_DATA", ROOT.parent / "shared" / "data")) / "dfki_double_pendulum"
LOGS = {"A0": ("A0_swingup_11", "A0_swingup_12", "A0_swingup_13"),
        "C1": ("C1_swingup_154220", "C1_swingup_154548")}  # fmt: skip
BOTH = [(design, log) for design, logs in LOGS.items() for log in logs]
TEACH = ("A0_swingup_11", *LOGS["C1"])  # in 12 and 13 joint 1 has no torque: nothing to learn from
CUTOFFS = ("auto", 12.0, 8.0, 6.0)
COLUMNS = {"q": "pos", "v": "vel", "tau": "tau"}
JOINTS = ("Joint1", "Joint2")
EACH = ("torque_gain", "delay", "elasticity", "backlash", "hysteresis", "stribeck", "load_friction",
        "drag", "cable", "spring", "ripple", "torque_offset", "drift", "encoder_offset")  # fmt: skip
CANDIDATES = [f"{kind}:{joint}" for kind in EACH for joint in JOINTS]
CANDIDATES += ["coupling:Joint1,Joint2", "gravity_tilt"]


def pendulum(design: str, folder: Path) -> ident.Mechanism:
    """Rigid bodies, viscous and Coulomb friction, rotor inertia; C1's URDF is made from A0's."""
    urdf = (DATA / "double_pendulum_A0.urdf").read_text()
    if design == "C1":
        lines = (DATA / "C1_model_1.0.yml").read_text().split("\n")
        p = {key: float(x) for key, x in (line.split(":") for line in lines if ":" in line)}
        urdf = urdf.replace('xyz="0.0522 0 -0.3"', f'xyz="0.0522 0 {-p["l1"]}"')
        for k, side in ((1, -1), (2, 1)):  # link 2's frame is turned over
            inertia = p[f"I{k}"] - p[f"m{k}"] * p[f"r{k}"] ** 2
            head, tail = urdf.split(f'<link\n    name="Link{k}">', 1)
            tail = re.sub('xyz="[^"]*"', f'xyz="0 0 {side * p[f"r{k}"]}"', tail, count=1)
            tail = re.sub(r'mass\s+value="[^"]*"', f'mass value="{p[f"m{k}"]}"', tail, count=1)
            for axis in "xyz":
                tail = re.sub(f'i{axis}{axis}="[^"]*"', f'i{axis}{axis}="{inertia}"', tail, count=1)
            urdf = f'{head}<link\n    name="Link{k}">{tail}'
    (folder / "pendulum.urdf").write_text(urdf)
    columns = [f'"{a}.Joint{j}" = {{ column = "{b}_meas{j}" }}'
               for a, b in COLUMNS.items() for j in (1, 2)]  # fmt: skip
    toml = ['urdf = "pendulum.urdf"', "[log]", 't = { column = "time" }', *columns]
    (folder / "mechanism.toml").write_text("\n".join(toml))
    mechanism = ident.load(folder)
    for kind in ("viscous", "coulomb", "rotor_inertia"):
        mechanism = mechanism.with_effect(kind)
    return mechanism


def main() -> None:
    if not (DATA / f"{LOGS['A0'][0]}.csv").is_file():
        print(f"no measurements at {DATA}; set IDENT_DATA to the folder of dfki_double_pendulum")
        sys.exit(0)
    with tempfile.TemporaryDirectory() as made:
        models = {}
        for design in LOGS:
            (folder := Path(made) / design).mkdir()
            models[design] = pendulum(design, folder)
        diagnosed(models)
        spectra(models)
        across(models)
        play(models)


def diagnosed(models: dict[str, ident.Mechanism]) -> None:
    """Error of joint 1 by cut-off, what `diagnose` says, and on what the residual depends."""
    rows = [["log", "cut-off", "N m", "of the torque", "verdict", "depends on; stands out"]]
    for design, logs in [(d, [log]) for d, log in BOTH] + [(d, list(x)) for d, x in LOGS.items()]:
        for cutoff in CUTOFFS:
            motion = complete(models[design], [ident.read_log(DATA / f"{log}.csv",
                              models[design].columns) for log in logs], cutoff)  # fmt: skip
            found = ident.diagnose(fit := ident.identify(models[design], motion))
            error = fit.train["Joint1"]
            where = next(each for each in found.where if each.joint == "Joint1")
            named = [found.best, *found.rivals] if found.best else []
            said = " ".join([found.verdict, " or ".join(effect.label for effect in named)])
            seen = [f"{each.signal} {each.r2:.2f}" for each in where.depends_on]
            seen += [str(each) for each in where.stands_out]
            name = logs[0] if len(logs) == 1 else f"{design}, all"
            hz = f"{motion.band.cutoff:.3g} Hz"
            cells = [f"{error.rms:.3f}", f"{100 * (error.relative or np.nan):.0f} %"]
            rows.append([name, hz, *cells, said, "; ".join(seen)])
    show(rows)


def spectra(models: dict[str, ident.Mechanism]) -> None:
    """Predicted to measured torque of joint 1; parameters of one log at 8 Hz, signals unfiltered."""
    hz = (1, 2, 3, 4, 6, 8, 12, 20)
    rows = [["log", "", *(f"{f} Hz" for f in hz)]]
    for design, logs in LOGS.items():
        for log in logs:
            learnt = logs[0] if design == "A0" else log
            fit = ident.identify(models[design], motion_of(models[design], learnt, 8.0))
            found = ident.compare(fit, motion=motion_of(models[design], log, 30.0))
            (trace,) = found.residuals[0].traces
            rate = found.residuals[0].rate
            m, p = trace.measured[:, 0], trace.predicted[:, 0]
            f, Smm = welch(m, rate, nperseg=int(rate))
            Spp, Spm = welch(p, rate, nperseg=int(rate))[1], csd(p, m, rate, nperseg=int(rate))[1]
            at = [int(np.argmin(abs(f - x))) for x in hz]
            coherence = abs(Spm) ** 2 / (Smm * Spp)
            rows.append([log, "coherence", *(f"{coherence[i]:.2f}" for i in at)])
            rows.append(["", "measured/predicted", *(f"{np.sqrt(Smm / Spp)[i]:.2f}" for i in at)])
    show(rows)


def across(models: dict[str, ident.Mechanism]) -> None:
    """Every candidate fitted on one log: change of joint 1's rms there and on the others [%]."""
    for cutoff in (12.0, 8.0):
        pairs = [(a, b) for a in TEACH for b in LOGS[a[:2]] if a != b]
        rows = [[f"{cutoff:g} Hz, on", *(a[-6:] for a in TEACH)]]
        rows[0] += [f"{a[-6:]} to {b[-6:]}" for a, b in pairs]
        rows[0] += [f"value of {a[-6:]}" for a in TEACH]
        table: dict[str, list[list[str]]] = {label: [[], [], []] for label in CANDIDATES}
        for log in TEACH:
            model = models[log[:2]]
            motion = motion_of(model, log, cutoff)
            others = [ident.read_log(DATA / f"{b}.csv", model.columns) for a, b in pairs if a == log]
            tested = complete(model, others, cutoff)
            plain = ident.identify(model, motion, validate=tested)
            for label, (own, cross, values) in table.items():
                with_it = model.with_effect(label)
                fit = ident.identify(with_it, motion, validate=tested, start=plain.point)
                own.append(change(fit.train["Joint1"].rms, plain.train["Joint1"].rms))
                for name, errors in (fit.validation or {}).items():
                    before = (plain.validation or {})[name]["Joint1"].rms
                    cross.append(change(errors["Joint1"].rms, before))
                found = fit.effects[-1].parameters
                values.append(", ".join(f"{v.value:.2g}" for v in found[:1]))
        show([*rows, *([label, *a, *b, *c] for label, (a, b, c) in table.items())])
