"""Predictions of edited machines: how often their 95 % bands hold the motion of the true ones.

python benchmarks/edits.py [--draws 40] [--first 0] [--samples 2500]

A draw is an arm of its own friction, payload and masses, whose log has 1 % torque noise and encoder
noise. Its fit is edited (the payload taken off, all friction halved, the moon's gravity, a forearm
of a fifth more mass), and a replay of the edited fit is held against the motion of the edited true
machine under other torques, logged at 1 kHz without noise, so that the replay itself is right to
0.01 mrad. Edits of what the fit's log determines only together with other parameters are named by
`ident export`: the last column says how often; they count in no band.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import ident
from ident.export.band import band, covariance_of, inseparable
from ident.export.machine import machine_of, shares_of
from ident.fit.files import Saved
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.simulate.inverse import Noise
from ident.simulate.replay import replay

ARM = Path(__file__).resolve().parent.parent / "robots" / "arm"
NOISE = (Noise("tau", 0.01, relative=True), Noise("q", 2e-5))
FRICTION = {"yaw": (1.2, 2.0), "shoulder": (1.5, 2.5), "elbow": (0.5, 0.9), "wrist": (0.02, 0.04)}
WINDOW, SECONDS, RATE = 0.5, 1.0, 1000.0  # [s], [s], [Hz] of the second log
MOON = (0.0, 0.0, -1.62)  # [m/s²]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--samples", type=int, default=2500, help="of the fitted log")
    given = parser.parse_args()
    shares: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    named: dict[str, int] = {}
    for seed in range(given.first, given.first + given.draws):
        for edit, share, error, doubtful in held(seed, given.samples):
            shares.setdefault(edit, []).append(share)
            errors.setdefault(edit, []).append(error)
            named[edit] = named.get(edit, 0) + doubtful
    print("| edit | in the band | error, share of the way | named as not to be vouched for |")
    print("|---|---|---|---|")
    for edit, values in shares.items():
        print(
            f"| {edit} | {100 * np.mean(values):.1f} % | {100 * np.median(errors[edit]):.3f} % | "
            f"{named[edit]} of {len(values)} |"
        )
    vouched = [x for edit, v in shares.items() if not named[edit] for x in v]
    print(f"| all that are not named | {100 * np.mean(vouched):.1f} % | | |")


def held(seed: int, samples: int) -> list[tuple[str, float, float, bool]]:
    """Return (edit, share of the true motion in its band, error over the way, whether it is named
    as beyond what the fit can tell) for all edits.
    """
    random = np.random.default_rng(seed)
    bare = ident.load(ARM).with_calibration("exact")
    log = ident.read_log(ARM / "run.csv")
    bodies = bare.with_effect("viscous").with_effect("coulomb")
    held_bodies = _known(bodies).with_effect("payload:hand")
    results = []
    for mechanism, edits in (
        (bodies, ("friction halved", "the moon", "heavier forearm")),
        (held_bodies, ("payload off",)),
    ):
        truth = {
            f"{kind}.{joint}.{name}": size * random.uniform(0.7, 1.3)
            for joint, sizes in FRICTION.items()
            for kind, name, size in zip(("viscous", "coulomb"), ("Fv", "Fc"), sizes, strict=True)
        }
        m = random.uniform(0.3, 0.8)
        x, y, z = random.uniform(-0.04, 0.06, 3)
        payload = dict(zip(
            ("m", "mx", "my", "mz", "Lxx", "Lyy", "Lzz", "Lxy", "Lxz", "Lyz"),
            (m, m * x, m * y, m * z, m * (y * y + z * z) + 4e-4, m * (x * x + z * z) + 4e-4,
             m * (x * x + y * y) + 4e-4, -m * x * y, -m * x * z, -m * y * z), strict=True,
        ))  # fmt: skip
        truth |= {
            name: payload[name.rpartition(".")[2]]
            for effect in mechanism.effects
            if effect.kind == "payload"
            for name in effect.names
        }
        reference = _positions(log, samples)
        made, _ = ident.simulate(mechanism, reference, values=truth, noise=NOISE, seed=seed)
        fit = ident.identify(mechanism, ident.complete(mechanism, made))
        other = _positions(log, samples, turned=True)
        for edit in edits:
            shares: dict[str, float] = {}  # of the identified values, as a user would give them
            without: tuple[str, ...] = ()
            gravity = None
            if edit == "friction halved":
                shares = dict.fromkeys(truth, 0.5)
            elif edit == "heavier forearm":
                shares = {"forearm.m": 1.2}
            elif edit == "payload off":
                without = ("payload:hand",)
            else:
                gravity = MOON
            present = mechanism
            for label in without:
                present = present.without(label)
            names = {full for effect in present.effects for full in effect.names}
            wanted = {name: x for name, x in truth.items() if name in names}
            for name, share in shares.items():
                of_body = float(dict(zip(bare.bodies.names, bare.prior, strict=True)).get(name, 0))
                wanted[name] = share * wanted.get(name, of_body)
            true = machine_of(mechanism, wanted, without, gravity)
            run = ident.integrate(
                true.mechanism, ident.PD(other),
                duration=SECONDS, values={n: x for n, x in true.point.values.items() if n in names},
                pi=true.point.pi, rate=RATE,
            )  # fmt: skip
            logged = {n: x for n, x in run.log.columns.items() if n.startswith(("q.", "tau."))}
            motion = ident.complete(true.mechanism, Log.from_arrays("edited", run.log.t, logged))
            edited = machine_of(fit, shares_of(fit, shares), without, gravity)
            errors = covariance_of(fit)
            assert errors is not None
            widths = band(edited, errors, motion, shares, WINDOW)
            saved = Saved("ident", edited.mechanism, edited.point)
            (ours,) = (
                replay(saved, motion=motion, window=WINDOW).with_band("ident", widths).runs["ident"]
            )
            size = [error.relative or 0.0 for error in ours.errors.values()]
            named = bool(inseparable(fit, shares, without))
            results.append((edit, float(np.mean(list(ours.within.values()))), max(size), named))
    return results


def _known(mechanism: Mechanism) -> Mechanism:
    """The mechanism with all bodies known, so that a payload is its own."""
    from dataclasses import replace

    return replace(mechanism, unknown=())


def _positions(log: Log, samples: int, turned: bool = False) -> Log:
    columns = {}
    for name, x in log.columns.items():
        if name.startswith("q."):
            x = x[:samples]
            columns[name] = x.mean() + 0.8 * (x[::-1] - x.mean()) if turned else x
    return Log.from_arrays("turned" if turned else "run", log.t[:samples], columns)


if __name__ == "__main__":
    main()
