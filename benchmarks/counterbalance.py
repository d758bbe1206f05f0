"""The KR300's counterbalance: what is found of a2 beside its authors' formula.

    python benchmarks/counterbalance.py [--data DIR]

Reads `kuka_kr300` (logs A and B) in DIR or $IDENT_DATA, identifies from one log and judges on the
other, and identifies from both. f is the authors' formula of the torque, f̂ what was found.

The first table is of free rigid bodies with viscous and Coulomb friction. P is the projection on
the complement of the model's columns (rows weighted by 1/rms of each joint's residual):

    visible    ‖P f‖/‖f‖: what the model's own columns cannot make of the formula
    amplitude  α of α f beside the model's columns in least squares; the formula is right at 1 or −1
    apart      ‖P(f̂ − f)‖/‖P f‖
    gravity    min over c, d of ‖f̂ − f + c sin a2 + d cos a2‖/‖f‖; it is near 0 for f̂ = 0 as well
               where the arm's own gravity can take the formula's place

The second table is of the bodies that the authors publish: only what a6 turns is free (prior: their
load of 200 kg), friction and the rotors' inertias. Nothing can take the formula's place then:

    apart      ‖f̂ − f‖/‖f‖, without a constant, and gravity as above

The lines below it are what a diagnosis says of the model without f̂.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
from machines import kr300, located

import ident
from ident.effects.formula import Formula, Scale, Term
from ident.text import rounded

ROOT = Path(__file__).resolve().parents[1]
JOINT = "a2"
COLUMNS = ("from", "found", "visible", "amplitude", "apart", "gravity", "gravity, f̂ = 0",
           "a2 on the other log", "with it")  # fmt: skip
KNOWN = ("from", "a2 as", "held out", "on the other log", "apart", "but a constant", "gravity",
         "constants")  # fmt: skip
EFFECTS = ("viscous", "coulomb")
ANGLE, SHARE = Scale("b", "angle"), Scale("c", "share")
LAWS = {  # of a2, beside the published bodies
    "spring": f"spring:{JOINT}",
    "curve": f"curve:{JOINT}:q:pieces=3",
    "k sin(q + b)/√(1 + c cos(q + b))": Term(
        ("sin(q + b)/sqrt(1 + c*cos(q + b))",), (ANGLE, SHARE), "gas_spring"
    ),
    "k₁ sin q + k₂ cos q": Term(("sin(q)", "cos(q)"), (), "weight_counterbalance"),
}


def formula(a2: np.ndarray) -> np.ndarray:
    """Torque [N m] of the hydraulic counterbalance, as its authors state it (Weigand et al., 2021).

    Args:
        a2: angle [rad] of the URDF's joint, which is theirs from the vertical, and 90°.
    """
    far, near = 0.8, 0.2  # distances of the cylinder's ends from the joint's axis [m]
    area, volume = np.pi * (0.055**2 - 0.030**2) / 4, 2 * 0.00048  # [m²], [m³]
    gas = 1.01 * 296.8 * 328 * 2 * 0.0795  # Z R T m [J]
    angle = a2 + np.deg2rad(95 - 90)
    length = np.sqrt(far**2 + near**2 - 2 * far * near * np.cos(angle))
    lever = far * near * np.sin(angle) / length
    return lever * area * gas / (volume - (length - (far - near)) * area)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    options = parser.parse_args()
    places = [*options.data, Path(os.environ.get("IDENT_DATA", ROOT.parent / "shared" / "data"))]
    source = located(kr300.SOURCE, places)
    if source is None:
        raise SystemExit(f"error: no {kr300.SOURCE} in {', '.join(map(str, places))}")
    header(COLUMNS)
    model, bare = pin.buildModelFromUrdf(str(source / "kr300.urdf")), ident.load(source)
    for train, fit, judge in fits(bare, EFFECTS, source):
        print_rows(train, model, fit, judge)
    with tempfile.TemporaryDirectory() as folder:
        bare = ident.load(kr300.with_bodies(source, Path(folder)))
    said = []
    print()
    header(KNOWN)
    for train, fit, judge in fits(bare, (*EFFECTS, "rotor_inertia"), source):
        print_known(train, fit, judge)
        d = ident.diagnose(fit)
        best = (d.best, *d.rivals) if d.verdict == "missing" else ()
        named = " or ".join(e.label for e in best if e is not None) or "nothing named"
        said.append(f"{train}: {d.verdict}, {named}")
        said += [f"  law of {law.joint}: {law.formula} ({law.nearest})" for law in d.laws]
        said += [f"  does as well: {e.formula.text} ({e.formula.terms[0].known_as})"
                 for e in d.relatives]  # fmt: skip
    print("", *said, sep="\n")


def header(columns: tuple[str, ...]) -> None:
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}", flush=True)


def fits(
    mechanism: ident.Mechanism, effects: tuple[str, ...], source: Path
) -> Iterator[tuple[str, ident.Fit, ident.Motion | None]]:
    """Logs, their fit, and the other log's motion: from A, from B, and from both."""
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    for train, other in (("A", "B"), ("B", "A"), ("AB", "")):
        motion, judge = (
            ident.complete(mechanism, [ident.read_log(source / f"{log}.csv") for log in logs])
            if logs
            else None
            for logs in (train, other)
        )
        yield train, ident.identify(mechanism, motion), judge


def print_known(train: str, fit: ident.Fit, judge: ident.Motion | None) -> None:
    """One row without a law of a2, and one for each law."""
    k = fit.mechanism.driven.index(JOINT)
    a2 = np.concatenate([e.q[:, k] for e in fit.motion.experiments])
    f = formula(a2)

    def apart(f_hat: np.ndarray, *free: np.ndarray) -> str:
        off = f_hat - f
        if free:
            X = np.stack(free, axis=1)
            off = off - X @ np.linalg.lstsq(X, off, rcond=None)[0]
        return f"{np.linalg.norm(off) / np.linalg.norm(f):.1%}"

    for name, law in {"nothing": None, **LAWS}.items():
        found, f_hat, constants = fit, 0 * f, ""
        if law is not None:
            mechanism = (
                fit.mechanism.with_effect(law)
                if isinstance(law, str)
                else fit.mechanism + Formula((JOINT,), terms=(law,))
            )
            found = ident.identify(mechanism, fit.motion)
            added = found.effects[-1]
            f_hat = np.concatenate([p.parts[added.effect.label][:, k] for p in found.predict()])
            constants = ", ".join(
                f"{v.name.rpartition('.')[2]} = {rounded(v.value, v.stderr)}"
                for v in added.parameters
                if name != "curve"
            )
        cells = (
            train, name, relative(found, None), relative(found, judge) if judge else "–",
            apart(f_hat), apart(f_hat, np.ones_like(f)), apart(f_hat, np.sin(a2), np.cos(a2)),
            constants,
        )  # fmt: skip
        print(f"| {' | '.join(cells)} |", flush=True)


def print_rows(train: str, model: pin.Model, fit: ident.Fit, judge: ident.Motion | None) -> None:
    """One row for what is found of a2, each."""
    states, known = fit.motion.experiments, fit.mechanism.effects
    a2 = np.concatenate([e.q[:, fit.mechanism.driven.index(JOINT)] for e in states])
    tau = np.concatenate([e.tau for e in states])
    X = np.concatenate([columns(model, e) for e in states])
    measured = np.concatenate([each.residual for each in fit.predict()])
    weight = 1 / np.sqrt(np.mean(measured**2, axis=0))
    U, s, _ = np.linalg.svd(scaled(weighted(X, weight)), full_matrices=False)
    U = U[:, s > 1e-8 * s[0]]
    k = fit.mechanism.driven.index(JOINT)

    def left(x: np.ndarray) -> np.ndarray:
        """P of a torque of a2 (n,)."""
        whole = np.zeros_like(tau)
        whole[:, k] = x
        rows = weighted(whole, weight)
        return rows - U @ (U.T @ rows)

    f = formula(a2)
    seen, size = left(f), float(np.linalg.norm(f)) * weight[k]
    y = weighted(tau, weight)
    amplitude = float(seen @ y / (seen @ seen))
    gravity = np.stack([np.sin(a2), np.cos(a2)], axis=1)
    sign = np.sign(amplitude)

    def beside_gravity(x: np.ndarray) -> float:
        off = x - sign * f
        off = off - gravity @ np.linalg.lstsq(gravity, off, rcond=None)[0]
        return float(np.linalg.norm(off) / np.linalg.norm(f))

    for name, found in proposed(fit):
        label = next(iter({e.label for e in found.mechanism.effects} - {e.label for e in known}))
        f_hat = np.concatenate([p.parts[label][:, k] for p in found.predict()])
        off = float(np.linalg.norm(left(f_hat - sign * f)) / np.linalg.norm(seen))
        cells = (
            train, name, f"{np.linalg.norm(seen) / size:.2%}", f"{amplitude:.2f}", f"{off:.1f}",
            f"{beside_gravity(f_hat):.1%}", f"{beside_gravity(0 * f):.1%}",
            relative(fit, judge), relative(found, judge),
        )  # fmt: skip
        print(f"| {' | '.join(cells)} |", flush=True)


def proposed(fit: ident.Fit) -> list[tuple[str, ident.Fit]]:
    """A curve of a2, and the formulas that a diagnosis proposes for a2, each refitted."""
    curve = f"curve:{JOINT}:q"
    found = [(curve, ident.identify(fit.mechanism.with_effect(curve), fit.motion))]
    for law in ident.diagnose(fit).laws:
        if law.joint == JOINT:
            found.append((f"{law.nearest}: {law.formula}", law.fit))
    return found


def columns(model: pin.Model, e: ident.motion.State) -> np.ndarray:
    """(n, joints, columns) of rigid bodies, viscous and Coulomb friction."""
    data = model.createData()
    n, joints = e.q.shape
    bodies = [
        pin.computeJointTorqueRegressor(model, data, *x).copy()
        for x in zip(e.q, e.v, e.a, strict=True)
    ]
    friction = np.zeros((n, joints, 2 * joints))
    for j in range(joints):
        friction[:, j, j] = e.v[:, j]
        friction[:, j, joints + j] = np.where(np.abs(e.v[:, j]) < e.still[j], 0, np.sign(e.v[:, j]))
    return np.concatenate([np.array(bodies), friction], axis=2)


def weighted(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n joints, …) of (n, joints, …)."""
    return (x * weight.reshape(-1, *(1,) * (x.ndim - 2))).reshape(-1, *x.shape[2:])


def scaled(x: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(x, axis=0)
    return x[:, size > 0] / size[size > 0]


def relative(fit: ident.Fit, judge: ident.Motion | None) -> str:
    """Error of a2 on the other log, or held out in time without one."""
    if judge is None:
        return f"{fit.held_out[JOINT].relative:.1%}"
    (errors,) = ident.compare(fit, motion=judge).errors.values()
    return f"{errors[JOINT].relative:.1%}"


if __name__ == "__main__":
    main()
