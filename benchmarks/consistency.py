"""A hundred deliberately poor logs: is every consistent fit possible, and what does it cost?

    python benchmarks/consistency.py [cases]

Short, small, noisy motions of few joints, with priors that are wrong or of no possible body, of
serial arms and closed loops. The truth is a possible machine; every fit's bodies are looked at by
their eigenvalues, in the URDF that is written too, and errors are compared with the same fit
without limits: held out, and on another log of the machine's free motion that no fit has seen.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

import ident
from ident.errors import IdentError

ROOT = Path(__file__).resolve().parents[1]
REST = {  # where each driven joint moves around [rad]
    "arm": {"yaw": 0.0, "shoulder": -0.6, "elbow": 1.0, "wrist": 0.0},
    "five_bar": {"left": 2.1, "right": 1.04},
    "four_bar": {"crank": 1.0},
    "slider_crank": {"theta": 0.6},
}
REACH = {"arm": 0.8, "five_bar": 0.25, "four_bar": 3.0, "slider_crank": 1.0}
FLAWS = (
    "short",
    "small",
    "noisy torque",
    "noisy position",
    "few joints",
    "wrong prior",
    "impossible prior",
)


@dataclass(frozen=True)
class Outcome:
    """Of one case: what was poor, and how the consistent fit compares.

    Attributes:
        possible: whether all eigenvalues of all bodies are positive, in the fit and in its URDF.
        train, held_out, elsewhere: errors over those of the fit without limits; elsewhere is the
            log that no fit has seen.
        truth: the error that the true parameters leave on the poor log, over the held-out one of
            the fit without limits: above 1, that fit has learnt noise, held out or not.
        before: bodies that the fit without limits makes impossible; bodies: how many there are.
        seconds: that the limits took.
    """

    name: str
    flaws: tuple[str, ...]
    possible: bool
    train: float
    held_out: float
    elsewhere: float
    truth: float
    before: int
    bodies: int
    seconds: float


@dataclass(frozen=True, eq=False)
class Case:
    """The mechanism as it is believed, a poor log, another log, true values, what is poor."""

    mechanism: ident.Mechanism
    log: ident.Log
    other: ident.Log
    truth: dict[str, float]
    flaws: tuple[str, ...]


def poor(number: int) -> Case:
    """Case `number`."""
    rng = np.random.default_rng(number)
    name = list(REST)[number % len(REST)]
    flaws = tuple(rng.choice(FLAWS, size=rng.integers(2, 5), replace=False))
    believed = ident.load(ROOT / "robots" / name)
    believed = replace(
        believed, effects=(), unknown=believed.bodies.names, multipliers=ident.Multipliers()
    )
    believed = believed.with_effect("viscous").with_effect("coulomb")
    pi = np.concatenate([shaken(rng, body, 0.3) for body in believed.prior.reshape(-1, 10)])
    values = {n: float(rng.uniform(0.02, 0.3)) for e in believed.effects for n in e.names}
    noise = [
        ident.Noise("tau", 0.3 if "noisy torque" in flaws else 0.03, relative=True),
        ident.Noise("q", 1e-3 if "noisy position" in flaws else 2e-5),
    ]
    moving = list(REST[name])
    if "few joints" in flaws:
        moving = moving[: max(1, len(moving) // 2)]
    size = REACH[name] * (0.1 if "small" in flaws else 1.0)
    log = made(
        believed, pi, values, motion(rng, name, moving, size, "short" in flaws), noise, number
    )
    full = motion(rng, name, list(REST[name]), REACH[name], False)
    other = made(believed, pi, values, full, [], number)
    if "wrong prior" in flaws:
        believed = with_bodies(
            believed, lambda body: shaken(rng, body, 1.0) * rng.uniform(0.3, 3.0)
        )
    if "impossible prior" in flaws:
        believed = with_bodies(believed, lambda body: bent(rng, body))
    truth = values | dict(zip(believed.bodies.names, pi, strict=True))
    return Case(believed, log, other, truth, flaws)


def motion(
    rng: np.random.Generator, name: str, moving: list[str], size: float, short: bool
) -> ident.Log:
    """Two sines a joint around its rest."""
    t = np.arange(0.0, 2.2 if short else 5.0, 0.005)
    columns = {}
    for joint, rest in REST[name].items():
        angle = np.full_like(t, rest)
        if joint in moving:
            for _ in range(2):
                f, phase = rng.uniform(0.3, 1.6), rng.uniform(0, 2 * np.pi)
                angle += size / 2 * (np.sin(2 * np.pi * f * t + phase) - np.sin(phase))
        columns[f"q.{joint}"] = angle
    return ident.Log.from_arrays("poor", t, columns)


def made(
    mechanism: ident.Mechanism,
    pi: np.ndarray,
    values: dict[str, float],
    log: ident.Log,
    noise: list[ident.Noise],
    seed: int,
) -> ident.Log:
    columns = ("q", "tau")
    return ident.simulate(
        mechanism, log, values=values, pi=pi, noise=noise, seed=seed, columns=columns
    )[0]


def shaken(rng: np.random.Generator, body: np.ndarray, by: float) -> np.ndarray:
    """Another possible body: its mass distribution stretched, sheared, moved and rescaled."""
    m, moments, L = body[0], body[1:4], symmetric(body[4:])
    P = np.block(
        [[np.trace(L) / 2 * np.eye(3) - L, moments[:, None]], [moments[None], np.array([[m]])]]
    )
    size = np.sqrt(max(np.trace(L), 1e-6) / max(m, 1e-9))
    A = np.eye(4) + by / 2 * rng.normal(size=(4, 4))
    A[:3, 3] *= size
    A[3, :3] = 0.0
    A[3, 3] = np.exp(by * rng.normal() / 2)
    P = A @ P @ A.T
    S = P[:3, :3]
    L = np.trace(S) * np.eye(3) - S
    return np.array([P[3, 3], *P[:3, 3], L[0, 0], L[0, 1], L[1, 1], L[0, 2], L[1, 2], L[2, 2]])


def bent(rng: np.random.Generator, body: np.ndarray) -> np.ndarray:
    """No possible body: moments of inertia that no distribution of mass has."""
    worse = body.copy()
    i = int(rng.choice([0, 2, 5]))  # of Lxx, Lyy, Lzz: more than the two others together
    worse[4 + i] = 2.0 * (body[4] + body[6] + body[9])
    return worse


def symmetric(L: np.ndarray) -> np.ndarray:
    xx, xy, yy, xz, yz, zz = L
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def with_bodies(mechanism: ident.Mechanism, change) -> ident.Mechanism:
    """The mechanism with other inertias as its prior."""
    model = mechanism.model.copy()
    for i in range(1, model.njoints):
        body = model.inertias[i].toDynamicParameters()
        if body[0] <= 0:
            continue
        body = change(body)
        c = body[1:4] / body[0]
        shift = body[0] * (c @ c * np.eye(3) - np.outer(c, c))
        model.inertias[i] = pin.Inertia(body[0], c, symmetric(body[4:]) - shift)
    return mechanism.with_same_kinematics(model=model)


def eigenvalues(bodies: np.ndarray) -> np.ndarray:
    """(bodies,) smallest eigenvalue of each pseudo-inertia, in its own largest."""
    found = []
    for body in bodies.reshape(-1, 10):
        L = symmetric(body[4:])
        P = np.block(
            [
                [np.trace(L) / 2 * np.eye(3) - L, body[1:4, None]],
                [body[None, 1:4], np.array([[body[0]]])],
            ]
        )
        e = np.linalg.eigvalsh(P)
        found.append(e[0] / max(np.abs(e).max(), 1e-300))
    return np.array(found)


def outcome(number: int) -> Outcome:
    """One case, fitted without and with limits."""
    case = poor(number)
    mechanism = case.mechanism
    moved = ident.complete(mechanism, case.log)
    unseen = ident.complete(mechanism, case.other, cutoff=moved.band.cutoff)
    free = ident.identify(mechanism, moved, validate=unseen)
    start = time.perf_counter()
    fit = ident.identify(mechanism, moved, validate=unseen, consistent=True)
    seconds = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as folder:
        path = fit.write_urdf(Path(folder) / "identified.urdf")
        written = ident.load(path).prior
    assert fit.binding is not None
    bodies = np.concatenate([fit.dynamic_parameters, written])
    return Outcome(
        mechanism.name,
        case.flaws,
        bool((eigenvalues(bodies) > 0).all())
        and all(v.value >= 0 for e in fit.effects for v in e.parameters),
        1 + fit.binding.rise,
        1 + (fit.binding.held_out_rise or 0.0),
        _ratio(fit, free),
        _true_error(free, case.truth),
        int((eigenvalues(free.dynamic_parameters) < 0).sum()),
        len(mechanism.bodies.links),
        seconds,
    )


def _ratio(fit: ident.Fit, free: ident.Fit) -> float:
    """Of the errors on the log that no fit has seen, relative to each joint's torque."""
    errors = [next(iter(each.validation.values())) for each in (fit, free)]
    new, old = (np.sqrt(sum((e.relative or 0) ** 2 for e in x.values())) for x in errors)
    return float(new / old)


def _true_error(free: ident.Fit, truth: dict[str, float]) -> float:
    """Of the true parameters on the fitted log, over the held-out error; joints weighed alike."""
    x = np.array([truth[name] for name in free.columns.names])
    error, _, rows = free.information.squares(x).counted
    true = np.sqrt(error / np.maximum(rows, 1))
    held_out = np.array([error.rms for error in free.held_out.values()])
    return float(np.sqrt(np.mean((true / held_out) ** 2)))


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    found: list[Outcome] = []
    number = -1
    while len(found) < count:
        number += 1
        try:
            found.append(outcome(number))
        except IdentError as error:
            print(f"{number:3d} no fit, with limits or without: {error}")
            continue
        o = found[-1]
        print(
            f"{number:3d} {o.name:13s} {'yes' if o.possible else 'NO ':3s} train {o.train:6.4f}"
            f"  held out {o.held_out:6.4f} (truth {o.truth:.3g})  elsewhere {o.elsewhere:6.3f}"
            f"  impossible without limits {o.before}/{o.bodies}  {', '.join(o.flaws)}"
        )
    held = np.array([o.held_out for o in found])
    unseen = np.array([o.elsewhere for o in found])
    print(f"\npossible: {sum(o.possible for o in found)} of {len(found)}")
    print(f"impossible without limits: {sum(o.before > 0 for o in found)} fits")
    for what, x in (("held out", held), ("elsewhere", unseen)):
        q = np.quantile(x, [0, 0.1, 0.5, 0.9, 1])
        print(
            f"{what}: error over that without limits: least {q[0]:.3f}, 10 % {q[1]:.3f}, "
            f"median {q[2]:.3f}, 90 % {q[3]:.3f}, most {q[4]:.3f}; above 1.05: {(x > 1.05).sum()}"
        )


if __name__ == "__main__":
    main()
