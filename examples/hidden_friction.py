"""Which bearing has dry friction? One motion of a four-bar cannot tell, another one can.

A four-bar is driven at its crank; only the position and torque of the crank are logged. One of its
four bearings has dry friction, which the model lacks. The script runs from any folder;
notebooks/hidden_friction.ipynb shows the same with charts.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

import ident

FOUR_BAR = Path(__file__).resolve().parents[1] / "robots" / "four_bar"


def main() -> None:
    """Run all steps; every result is asserted."""
    mechanism = ident.load(FOUR_BAR)

    # First a small motion: ±15° about the upright crank. There every bearing turns in a nearly
    # fixed ratio to the crank, so dry friction in any of them requires nearly the same torque.
    careful = machine(swing(np.deg2rad(15), speed=2.2, seconds=10), "careful.csv", seed=0)
    rigid = ident.identify(mechanism, ident.complete(mechanism, careful))
    print(ident.compare(rigid))

    # An effect is missing, but the error falls with friction in any bearing, so the one with which
    # it falls most is not necessarily the cause.
    diagnosis = ident.diagnose(rigid)
    report(diagnosis)
    for each in diagnosis.candidates:
        if each.effect.kind == "coulomb":
            print(f"  with {each.effect.label} the error falls by {100 * each.fall:.1f} %")
    paragraph("next experiment", diagnosis.next_experiment)
    assert rigid.held_out["crank"].rms > 3 * diagnosis.floor["crank"]
    assert diagnosis.verdict == "missing"
    assert len(joints(diagnosis)) > 1
    assert "rocker" in joints(diagnosis)
    assert "crank through a full turn" in diagnosis.next_experiment

    # So the crank makes full turns in both directions, at the proposed speed. Now the ratios of the
    # bearings change, each in its own way.
    full = machine(swing(np.pi, speed=2.2, seconds=60), "full_turn.csv", seed=1)
    motion = ident.complete(mechanism, full)
    before = ident.identify(mechanism, motion)
    diagnosis = ident.diagnose(before)
    report(diagnosis)
    assert diagnosis.best is not None
    assert diagnosis.best.label == "coulomb:rocker"
    assert joints(diagnosis) == {"rocker"}  # perhaps another kind, but no other bearing

    # With this effect in the model the residual is noise.
    after = ident.identify(mechanism + diagnosis.best, motion)
    end = ident.diagnose(after)
    report(end)
    floor = end.floor["crank"]
    assert before.held_out["crank"].rms > 3 * floor
    assert after.held_out["crank"].rms < 1.1 * floor
    assert end.verdict == "nothing"

    found, true = after["coulomb.rocker.Fc"], FRICTION["coulomb.rocker.Fc"]
    assert found.stderr is not None
    print(f"\n{found.name} = {found.value:.4f} ± {found.stderr:.4f} N m; the truth: {true} N m")
    assert abs(found.value - true) < 3 * found.stderr < 0.1 * true


def joints(diagnosis: ident.Diagnosis) -> set[str]:
    """Return the joints in which the missing effect may be."""
    named = [diagnosis.best, *diagnosis.rivals] if diagnosis.best else []
    return {joint for effect in named for joint in effect.joints}


def report(diagnosis: ident.Diagnosis) -> None:
    """Print the verdict; `print(diagnosis)` has all details."""
    error, floor = diagnosis.fit.held_out["crank"].rms, diagnosis.floor["crank"]
    print(f"\n{diagnosis.fit.motion.experiments[0].name}: {diagnosis.verdict}")
    print(f"  held-out error {error:.4f} N m; noise alone would leave {floor:.4f} N m")
    if diagnosis.best:
        paragraph("  the best", " or ".join(e.label for e in (diagnosis.best, *diagnosis.rivals)))
        paragraph("  so it is in", " or ".join(sorted(joints(diagnosis))))


def paragraph(head: str, words: str) -> None:
    """Print a paragraph in the width of a terminal."""
    print(textwrap.fill(f"{head}: {words}", 100, subsequent_indent="    ", break_on_hyphens=False))


def swing(half: float, *, speed: float, seconds: float) -> ident.Log:
    """Return a motion of the crank about upright, at most by half [rad] and at speed [rad/s]."""
    t = np.arange(0.0, seconds, 0.005)
    w = speed / half / (0.75 + 0.25 * 2.3)
    q = np.pi / 2 + half * (0.75 * np.sin(w * t) + 0.25 * np.sin(2.3 * w * t + 0.4))
    return ident.Log.from_arrays("swing", t, {"q.crank": q})


# The simulated machine: dry friction in the rocker's bearing; crank 15 % heavier, coupler 15 %
# lighter, rocker 30 % heavier than in the URDF, which the model above does not know.
FRICTION = {"coulomb.rocker.Fc": 0.06}  # N m
HEAVIER = [1.15, 0.85, 1.3]
NOISE = [ident.Noise("q", 2e-5), ident.Noise("tau", 0.02)]  # rad, N m


def machine(motion: ident.Log, name: str, *, seed: int) -> ident.Log:
    """Return the log of a motion of the machine: q.crank and tau.crank at 200 Hz."""
    true = ident.load(FOUR_BAR).with_effect("coulomb:rocker")
    pi = true.prior * np.repeat(HEAVIER, 10)
    log, _ = ident.simulate(
        true, motion, values=FRICTION, pi=pi, noise=NOISE, seed=seed, columns=("q", "tau")
    )
    return ident.Log.from_arrays(name, log.t, log.columns)


if __name__ == "__main__":
    main()
