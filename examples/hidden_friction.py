"""Which bearing is dry? A closed loop that hides it, and the motion that shows it.

A four-bar is driven at its crank; the position and torque of the crank are all that is logged. One
of its four bearings has dry friction, which the model lacks. Run it from anywhere; the same with
pictures is in notebooks/hidden_friction.ipynb.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

import ident

FOUR_BAR = Path(__file__).resolve().parents[1] / "robots" / "four_bar"


def main() -> None:
    """The story; every claim of it is asserted."""
    mechanism = ident.load(FOUR_BAR)

    # First a careful motion: ±15° about the upright crank. There every bearing turns in a nearly
    # fixed ratio to the crank, so dry friction in any of them asks for nearly the same torque.
    # (Where the ratios change faster, or with less noise, ±15° may be enough to tell them apart.)
    careful = machine(swing(np.deg2rad(15), speed=2.2, seconds=10), "careful.csv", seed=0)
    rigid = ident.identify(mechanism, ident.complete(mechanism, careful))
    print(ident.compare(rigid).summary)

    # Something is missing, that is plain. But where? The error falls with friction in any bearing,
    # so to name the one with which it falls most would be a guess.
    diagnosis = ident.diagnose(rigid)
    tell(diagnosis)
    for each in diagnosis.candidates:
        if each.effect.kind == "coulomb":
            print(f"  with {each.effect.label} the squared error falls by {100 * each.fall:.1f} %")
    say("next experiment", diagnosis.next_experiment)
    assert rigid.held_out["crank"].rms > 3 * diagnosis.floor["crank"]
    assert diagnosis.verdict == "missing"
    assert len(joints(diagnosis)) > 1
    assert "rocker" in joints(diagnosis)
    assert "crank through a full turn" in diagnosis.next_experiment

    # So the crank turns in full, there and back, at the speed that is asked for and longer than is
    # asked for. The ratios of the bearings now change, each in its own way.
    full = machine(swing(np.pi, speed=2.2, seconds=60), "full_turn.csv", seed=1)
    motion = ident.complete(mechanism, full)
    before = ident.identify(mechanism, motion)
    diagnosis = ident.diagnose(before)
    tell(diagnosis)
    assert diagnosis.best is not None
    assert diagnosis.best.label == "coulomb:rocker"
    assert joints(diagnosis) == {"rocker"}  # of another kind, perhaps, but in no other bearing

    # With it in the model, what is left is noise.
    after = ident.identify(mechanism + diagnosis.best, motion)
    end = ident.diagnose(after)
    tell(end)
    floor = end.floor["crank"]
    assert before.held_out["crank"].rms > 3 * floor
    assert after.held_out["crank"].rms < 1.1 * floor
    assert end.verdict == "nothing"

    found, true = after["coulomb.rocker.Fc"], FRICTION["coulomb.rocker.Fc"]
    assert found.stderr is not None
    print(f"\n{found.name} = {found.value:.4f} ± {found.stderr:.4f} N m; the truth: {true} N m")
    assert abs(found.value - true) < 3 * found.stderr < 0.1 * true


def joints(diagnosis: ident.Diagnosis) -> set[str]:
    """Where the missing effect may be, as far as the log tells."""
    named = [diagnosis.best, *diagnosis.rivals] if diagnosis.best else []
    return {joint for effect in named for joint in effect.joints}


def tell(diagnosis: ident.Diagnosis) -> None:
    """The verdict in short; `print(diagnosis)` has all of it."""
    error, floor = diagnosis.fit.held_out["crank"].rms, diagnosis.floor["crank"]
    print(f"\n{diagnosis.fit.motion.experiments[0].name}: {diagnosis.verdict}")
    print(f"  held-out error {error:.4f} N m; noise alone would leave {floor:.4f} N m")
    if diagnosis.best:
        say("  the best", " or ".join(e.label for e in (diagnosis.best, *diagnosis.rivals)))
        say("  so it is in", " or ".join(sorted(joints(diagnosis))))


def say(head: str, words: str) -> None:
    """A paragraph that fits into a terminal."""
    print(textwrap.fill(f"{head}: {words}", 100, subsequent_indent="    ", break_on_hyphens=False))


def swing(half: float, *, speed: float, seconds: float) -> ident.Log:
    """The crank about upright, by at most half [rad] and at most at speed [rad/s]."""
    t = np.arange(0.0, seconds, 0.005)
    w = speed / half / (0.75 + 0.25 * 2.3)
    q = np.pi / 2 + half * (0.75 * np.sin(w * t) + 0.25 * np.sin(2.3 * w * t + 0.4))
    return ident.Log.from_arrays("swing", t, {"q.crank": q})


# The machine itself, of which the model above knows nothing but the logs: dry friction in the
# rocker's bearing; crank 15 % heavier, coupler 15 % lighter, rocker 30 % heavier than in the URDF.
FRICTION = {"coulomb.rocker.Fc": 0.06}  # N m
HEAVIER = [1.15, 0.85, 1.3]
NOISE = [ident.Noise("q", 2e-5), ident.Noise("tau", 0.02)]  # rad, N m


def machine(motion: ident.Log, name: str, *, seed: int) -> ident.Log:
    """What it logs when it is moved like this: q.crank and tau.crank at 200 Hz."""
    true = ident.load(FOUR_BAR).with_effect("coulomb:rocker")
    pi = true.prior * np.repeat(HEAVIER, 10)
    log, _ = ident.simulate(
        true, motion, values=FRICTION, pi=pi, noise=NOISE, seed=seed, columns=("q", "tau")
    )
    return ident.Log.from_arrays(name, log.t, log.columns)


if __name__ == "__main__":
    main()
