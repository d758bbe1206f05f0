"""What `ident` says of a case, held against what is true.

A formula is evaluated by its text, constants and the true signals alone, so that nothing of the
library decides whether it is right. With P the projection on the complement of the model's columns
(rigid bodies, known friction; rows weighted by 1/rms of each drive's torque) at the samples of the
log, and f, f̂ the torques of the law and of the formula as the drives feel them. An effect of
BESIDE that the diagnosis names beside the formula is one of the model's columns:

    apart  = ‖P(f̂ − f)‖ / ‖P f‖              what is wrong of the law, up to what the model makes
    closed = 1 − e²(with f̂)/e²(without)      e: error of the prediction of another log, whose motion
                                             is within the range of the first, by the model fitted
                                             to the noisy torques of the first with and without f̂
"""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from law_cases import Case, full
from law_logs import Complement, Made, Motion, make, value
from scipy.optimize import least_squares

import ident

Result = dict[str, Any]
SAME = 0.001  # of `apart` after its constants were fitted to the truth: algebraically equal
BESIDE = {"torque_offset": "1", "viscous": "v", "coulomb": "sign(v)"}
FEW = 1  # constants more than the law's that an algebraically equal formula may have
KEYS = {
    "curves": {"joint", "signals", "error_before", "error_after", "explained", "absorbable"},
    "laws": {"joint", "signals", "formula", "parameters", "error_after", "complexity", "nearest",
             "effect", "rivals"},
}  # fmt: skip


def judge(case: Case) -> Result:
    """Runs ident on the case; whatever goes wrong is a result too."""
    result: Result = {"name": case.name, "machine": case.machine, "noise": case.noise}
    if case.law:
        result |= {"law": case.law.name, "joint": case.law.joint, "kind": case.law.kind}
    try:
        made = make(case)
        begin = time.process_time()
        told = diagnosed(made)
        result |= {"seconds": round(time.process_time() - begin, 1), **told}
        result["contract"] = broken(told)
        if made.law is not None and not made.law.kind:
            kind, _, joint = (told["best"] or "").partition(":")
            beside = ((joint, BESIDE[kind]),) if told["laws"] and kind in BESIDE else ()
            made = replace(made, beside=beside)
            result |= compared(made, told["curves"], told["laws"])
    except Exception:  # a crash must not end the battery; it counts as not found
        result["error"] = traceback.format_exc(limit=-3)
    return result


def diagnosed(made: Made) -> Result:
    """What the diagnosis says, as written to diagnosis.json."""
    log = {name: x for name, x in made.log.items() if name != "t"}
    with tempfile.TemporaryDirectory() as place:
        mechanism = ident.load(made.folder(Path(place)))
        motion = ident.complete(mechanism, ident.Log.from_arrays("run.csv", made.log["t"], log))
        told = ident.diagnose(ident.identify(mechanism, motion)).json()
    best = told["best"] or {}
    return {
        "verdict": told["verdict"],
        "best": f"{best['effect']}:{','.join(best['joints'])}" if best else None,
        "where": [[w["joint"], w["relative"]] for w in told["where"][:3]],
        "curves": told.get("curves") or [],
        "laws": told.get("laws") or [],
    }


def broken(told: Result) -> list[str]:
    """Fields of the contract that entries of `curves` and `laws` do not have."""
    return sorted(
        {f"{what}.{key}" for what, keys in KEYS.items() for entry in told[what]
         for key in keys - set(entry)}
    )  # fmt: skip


def compared(made: Made, curves: list[Result], laws: list[Result]) -> Result:
    """Variables, form and prediction of the first curve and the first law; the best of all laws."""
    law, P = made.law, Complement(made)
    assert law is not None
    true = made.motion.torque(law.joint, law.formula, law.constants)
    left = P.of(true)
    size = float(np.linalg.norm(left))
    result: Result = {
        "visible": size / float(np.linalg.norm(P.rows(true))),
        "loudness": size / np.sqrt(len(left)) / made.case.noise,
    }
    right = (law.signals, *law.also)
    # a law of a cut joint is at another place than the true one: no formula of the right joint
    names = {joint.name for joint in made.motion.machine.joints}
    laws = [each for each in laws if each["joint"] in names]
    for what, found in (("curve", curves), ("formula", laws)):
        if found:
            signals = variables(found[0], made.motion)
            result[f"{what}_variables"] = found[0]["joint"] == law.joint and signals in right
    if curves:
        result["explained"] = curves[0].get("explained")
    if laws:
        distances = [apart(made, each, P, true) for each in laws]
        result |= {"apart": distances[0], "apart_of_set": min(distances)}
        result["equal"] = equal(made, laws[0], P, true)
        result["closed"] = closed(made, laws[0])
    return result


def variables(found: Mapping[str, Any], motion: Motion) -> frozenset[str]:
    """Signals by full name, `q.elbow`; time is `t` whatever the joint."""
    names = {joint.name for joint in motion.machine.joints}
    whole = (s if s.partition(".")[2] in names else full(s, found["joint"])
             for s in found["signals"])  # fmt: skip
    return frozenset("t" if s.partition(".")[0] == "t" else s for s in whole)


def constants(found: Mapping[str, Any]) -> dict[str, float]:
    """Values by the names that the formula uses."""
    return {p["name"].rpartition(".")[2]: float(p["value"]) for p in found["parameters"]}


def torque_of(found: Mapping[str, Any], motion: Motion) -> np.ndarray:
    """(n, driven): the formula's torque as the drives feel it."""
    return motion.torque(found["joint"], found["formula"], constants(found))


def apart(made: Made, found: Mapping[str, Any], P: Complement, true: np.ndarray) -> float:
    """‖P(f̂ − f)‖ / ‖P f‖; not a number where the formula is not."""
    off = P.of(torque_of(found, made.motion) - true)
    return float(np.linalg.norm(off) / np.linalg.norm(P.of(true)))


def equal(made: Made, found: Mapping[str, Any], P: Complement, true: np.ndarray) -> bool:
    """Whether some constants make the formula the law: fitted to it without noise."""
    assert made.law is not None
    start = constants(found)
    if len(start) > len(made.law.constants) + FEW:
        return False
    signals = made.motion.signals(found["joint"])
    goal = P.of(true)
    size = np.linalg.norm(goal)

    def off(x: np.ndarray) -> np.ndarray:
        f = value(found["formula"], signals, dict(zip(start, x, strict=True)))
        left = (P.of(made.motion.felt(found["joint"], f)) - goal) / size
        return np.where(np.isfinite(left), left, 1e3)

    x = np.array(list(start.values()))
    fit = least_squares(off, x, x_scale=np.maximum(np.abs(x), 1e-3), max_nfev=60)
    return bool(np.linalg.norm(off(fit.x)) < SAME)


def closed(made: Made, found: Mapping[str, Any]) -> float:
    """Share of the squared error on the other log that the formula removes."""
    drives = made.motion.machine.driven
    noisy = np.stack([made.log[f"tau.{j}"] for j in drives], axis=1)
    weight = 1 / np.sqrt(np.mean(made.tau**2, axis=0))
    X, other = made.columns(made.motion), made.columns(made.judge)
    errors = []
    for f, g in ((0.0, 0.0), (torque_of(found, made.motion), torque_of(found, made.judge))):
        y = ((noisy - f) * weight).ravel()
        A = (X * weight[:, None]).reshape(len(y), -1)
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-12)
        x = np.linalg.lstsq(A / scale, y, rcond=1e-9)[0] / scale
        errors.append(np.sum(((other @ x + g - made.judge_tau) * weight) ** 2))
    return float(1 - errors[1] / errors[0])


def attainable(case: Case) -> float:
    """`apart` of the law's own form with its constants fitted to the noisy log, from the truth."""
    made = make(case)
    law, P = made.law, Complement(made)
    assert law is not None
    drives = made.motion.machine.driven
    goal = P.of(np.stack([made.log[f"tau.{j}"] for j in drives], axis=1))
    x = np.array(list(law.constants.values()))

    def torque(x: np.ndarray) -> np.ndarray:
        return made.motion.torque(law.joint, law.formula, dict(zip(law.constants, x, strict=True)))

    fit = least_squares(lambda x: P.of(torque(x)) - goal, x, x_scale=np.abs(x), max_nfev=60)
    true = P.of(torque(x))
    return float(np.linalg.norm(P.of(torque(fit.x)) - true) / np.linalg.norm(true))
