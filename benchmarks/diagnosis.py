"""A six-joint log of 10,000 samples, the whole library diagnosed: seconds, and where they go.

    python benchmarks/diagnosis.py [samples]

Rigid bodies with viscous and Coulomb friction known to be there, all 72 parameters unknown; once
the coupling of joints 5 and 6 is hidden, once nothing, once a torque that no effect of the library
has. One process, BLAS on one thread.
"""

import os
import platform
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import arm6
import numpy as np

import ident

TARGET = 4.0  # s of the processor, of `diagnose`
WITH_LAW = 20.0  # s of it, where it ends in a formula
LAW = "tanh((q - q0)/x0)"  # of the third joint
STAGES = {  # by the first words of the progress messages
    "columns": "rows, columns of all candidates",
    "noise": "noise of the sensors, null distribution",
    "set": "search of the set",
    "refitting": "refits",
    "formulas": "search of formulas",
    "where it fails": "residual, data checks",
}


class Clock:
    """Adds up the time between progress messages."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self.stage, self.since = "", time.process_time()

    def __call__(self, what: str, share: float) -> None:
        now = time.process_time()
        if self.stage:
            self.spent[self.stage] = self.spent.get(self.stage, 0.0) + now - self.since
        self.stage = next((name for word, name in STAGES.items() if what.startswith(word)), what)
        self.since = now


def main() -> None:
    samples = int(sys.argv[1]) if sys.argv[1:] else 10_000
    print(f"{platform.machine()}, Python {platform.python_version()}, one process, one BLAS thread")
    model = arm6.mechanism()
    good = [one(model, samples, hidden) for hidden in (arm6.HIDDEN, None, LAW)]
    sys.exit(0 if all(good) else 1)


def one(model: ident.Mechanism, samples: int, hidden: str | None) -> bool:
    log = arm6.log(model, samples, None if hidden == LAW else hidden)
    if hidden == LAW:
        joint = model.driven[2]
        torque = (
            0.3
            * np.std(log.columns[f"tau.{joint}"])
            * np.tanh((log.columns[f"q.{joint}"] - 0.2) / 0.3)
        )
        columns = {**log.columns, f"tau.{joint}": log.columns[f"tau.{joint}"] + torque}
        log = ident.Log.from_arrays(log.name, log.t, columns)
    times = {}
    start = time.process_time()
    motion = ident.complete(model, log)
    times["complete"], start = time.process_time() - start, time.process_time()
    fit = ident.identify(model, motion)
    times["identify"] = time.process_time() - start
    clock, start = Clock(), time.process_time()
    diagnosis = ident.diagnose(fit, progress=clock)
    times["diagnose"] = time.process_time() - start
    clock("", 1.0)
    start = time.process_time()
    assert diagnosis.text
    times["text, next experiment"] = time.process_time() - start
    tried = len(diagnosis.selection.first.gains)
    cutoff = motion.band.cutoff or 0.0
    rivals = ", ".join(effect.label for effect in diagnosis.rivals) or "none"
    print(f"\nhidden: {hidden or 'nothing'}")
    print(f"found: {diagnosis.verdict}, {diagnosis.best or 'no name'}, rivals: {rivals}")
    print(
        f"{samples} samples, filter at {cutoff:.3g} Hz, {fit.rows} rows a joint, "
        f"{len(fit.columns)} unknowns, {tried} effects and curves judged, "
        f"{sum(each.fit is not None for each in diagnosis.candidates)} of them refitted"
    )
    for name, seconds in times.items():
        print(f"  {name:<40} {seconds:7.2f} s")
    for name, seconds in sorted(clock.spent.items(), key=lambda pair: -pair[1]):
        print(f"    {name:<38} {seconds:7.2f} s  {100 * seconds / times['diagnose']:3.0f} %")
    spent = times["diagnose"]
    print(f"in all {sum(times.values()):.1f} s")
    target = WITH_LAW if hidden == LAW else TARGET
    print(f"diagnose {spent:.1f} s; target {target:g} s: {'met' if spent <= target else 'MISSED'}")
    for law in diagnosis.laws:
        print(law)
    right = {
        None: diagnosis.verdict == "nothing",
        LAW: any(LAW in law.formula for law in diagnosis.laws),
    }.get(hidden, diagnosis.best is not None and diagnosis.best.label == hidden)
    return spent <= target and right


if __name__ == "__main__":
    main()
