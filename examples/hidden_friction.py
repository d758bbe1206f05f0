"""Which bearing is dry? A closed loop that hides it, and the motion that shows it.

A four-bar is driven at its crank; position and torque of the crank are all that is logged. One of
its four bearings has dry friction that the model lacks. Run it from anywhere:

    python examples/hidden_friction.py          (half a minute)

The same with pictures: notebooks/hidden_friction.ipynb.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

import ident

FOUR_BAR = Path(__file__).resolve().parents[1] / "robots" / "four_bar"
UPRIGHT = np.pi / 2  # of the crank [rad]


def main() -> None:
    """The story; every claim of it is asserted."""
    mechanism = ident.load(FOUR_BAR)

    # First a careful motion: ±15° about the upright crank. There every bearing turns in a nearly
    # fixed ratio to the crank, so dry friction in any of them asks for nearly the same torque.
    careful = machine(swing(np.deg2rad(15), speed=1.1, seconds=10), "careful.csv", seed=0)
    motion = ident.complete(mechanism, careful)
    rigid = ident.identify(mechanism, motion)
    print(ident.compare(rigid).summary)

    # Something is missing, that is plain. But where? An answer that named one joint would be a
    # guess, however much the error fell: it falls with friction in any of these.
    diagnosis = ident.diagnose(rigid)
    assert diagnosis.best is not None
    error, floor = rigid.held_out["crank"].rms, diagnosis.floor["crank"]
    print(f"\nheld out {error:.4f} N m, where noise alone would leave {floor:.4f} N m")
    tell(diagnosis)
    falls = {each.effect.label: each.fall for each in diagnosis.candidates}
    for joint in ("crank", "rocker"):
        if (label := f"coulomb:{joint}") in falls:
            print(f"the held-out misfit falls by {100 * falls[label]:.1f} % with {label}")
    say("next experiment", diagnosis.next_experiment)
    assert error > 3 * floor
    assert len(joints(diagnosis)) > 1
    assert "rocker" in joints(diagnosis)
    assert "full turn" in diagnosis.next_experiment

    # So the crank turns in full, there and back, at the speed and for the time that are asked for.
    # The ratios of the bearings now change, each in its own way; so does their friction's torque.
    full = machine(swing(np.pi, speed=1.1, seconds=60), "full_turn.csv", seed=1)
    motion = ident.complete(mechanism, full)
    before = ident.identify(mechanism, motion)
    diagnosis = ident.diagnose(before)
    tell(diagnosis)
    assert diagnosis.best is not None
    assert diagnosis.best.label == "coulomb:rocker"
    assert joints(diagnosis) == {"rocker"}  # of another kind, perhaps; elsewhere, no

    # With it in the model, what is left is noise.
    after = ident.identify(mechanism + diagnosis.best, motion)
    end = ident.diagnose(after)
    errors = [fit.held_out["crank"].rms for fit in (before, after)]
    floor = end.floor["crank"]
    print(
        f"held out {errors[0]:.4f} N m before, {errors[1]:.4f} N m after; noise alone: {floor:.4f} "
        f"N m\ndiagnosed again: {end.verdict}"
    )
    assert errors[0] > 3 * floor
    assert errors[1] < 1.1 * floor
    assert end.verdict == "nothing"

    found, true = after["coulomb.rocker.Fc"], FRICTION["coulomb.rocker.Fc"]
    assert found.stderr is not None
    print(f"\ncoulomb.rocker.Fc = {found.value:.4f} ± {found.stderr:.4f} N m; in truth {true} N m")
    assert abs(found.value - true) < 3 * found.stderr < 0.1 * true


def joints(diagnosis: ident.Diagnosis) -> set[str]:
    """Where the missing effect may sit, as far as this log tells."""
    named = [diagnosis.best, *diagnosis.rivals] if diagnosis.best else []
    return {joint for effect in named for joint in effect.joints}


def tell(diagnosis: ident.Diagnosis) -> None:
    """The verdict, and what cannot be told from the best."""
    log = diagnosis.fit.motion.experiments[0].name
    print(f"\n{log}: {diagnosis.verdict}, best {diagnosis.best.label if diagnosis.best else '-'}")
    say("not to be told from", ", ".join(effect.label for effect in diagnosis.rivals) or "nothing")
    print(f"so it is in {' or '.join(sorted(joints(diagnosis)))}")


def say(head: str, words: str) -> None:
    """A paragraph that fits into a terminal."""
    print(textwrap.fill(f"{head}: {words}", 100, subsequent_indent="  ", break_on_hyphens=False))


def swing(half: float, *, speed: float, seconds: float, rate: float = 200.0) -> ident.Log:
    """The crank about upright, within ±half [rad], no faster than speed [rad/s]."""
    t = np.arange(0.0, seconds, 1 / rate)
    w = speed / half / (0.75 + 0.25 * 2.3)
    q = UPRIGHT + half * (0.75 * np.sin(w * t) + 0.25 * np.sin(2.3 * w * t + 0.4))
    return ident.Log.from_arrays("swing", t, {"q.crank": q})


# The machine itself: what a reader of its logs does not know. Dry friction in the rocker's bearing,
# and links 15 % heavier, 15 % lighter and 30 % heavier than the URDF says.
FRICTION = {"coulomb.rocker.Fc": 0.06}  # N m
HEAVIER = [1.15, 0.85, 1.3]  # crank, coupler, rocker
NOISE = [ident.Noise("q", 2e-5), ident.Noise("tau", 0.02)]  # rad, N m


def machine(motion: ident.Log, name: str, *, seed: int) -> ident.Log:
    """What the machine would have logged, moved like this: q.crank and tau.crank."""
    true = ident.load(FOUR_BAR).with_effect("coulomb:rocker")
    pi = true.prior * np.repeat(HEAVIER, 10)
    made, _ = ident.simulate(
        true, motion, values=FRICTION, pi=pi, noise=NOISE, seed=seed, columns=("q", "tau")
    )
    return ident.Log.from_arrays(name, made.t, made.columns)


if __name__ == "__main__":
    main()
