"""A six-joint log of 10,000 samples, the whole library diagnosed: seconds, and where they go.

    python benchmarks/diagnosis.py [samples]

Rigid bodies with viscous and Coulomb friction known to be there, all 72 parameters unknown; once
the coupling of joints 5 and 6 is hidden, once nothing. One process, BLAS on one thread.
"""

import os
import platform
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import arm6

import ident

TARGET = 60.0  # s, on two cores
STAGES = {  # by the first words of what progress says
    "rows": "rows in memory",
    "logs of the model itself": "clean logs",
    "judging": "candidates judged",
    "refitting": "refits of the best",
    "looking for an expression": "an expression sought",
    "where it fails": "where, health, next experiment, words",
}


class Clock:
    """Adds up the time between what progress says."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self.stage, self.since = "", time.perf_counter()

    def __call__(self, what: str, share: float) -> None:
        now = time.perf_counter()
        if self.stage:
            self.spent[self.stage] = self.spent.get(self.stage, 0.0) + now - self.since
        self.stage = next((name for word, name in STAGES.items() if what.startswith(word)), what)
        self.since = now


def main() -> None:
    samples = int(sys.argv[1]) if sys.argv[1:] else 10_000
    print(f"{platform.machine()}, Python {platform.python_version()}, one process, one BLAS thread")
    model = arm6.mechanism()
    good = [one(model, samples, hidden) for hidden in (arm6.HIDDEN, None)]
    sys.exit(0 if all(good) else 1)


def one(model: ident.Mechanism, samples: int, hidden: str | None) -> bool:
    log = arm6.log(model, samples, hidden)
    times = {}
    start = time.perf_counter()
    motion = ident.complete(model, log)
    times["complete"], start = time.perf_counter() - start, time.perf_counter()
    fit = ident.identify(model, motion)
    times["identify"] = time.perf_counter() - start
    clock, start = Clock(), time.perf_counter()
    diagnosis = ident.diagnose(fit, progress=clock)
    times["diagnose"] = time.perf_counter() - start
    clock("", 1.0)
    tried = len(diagnosis.choice.evidence)
    cutoff = motion.band.cutoff or 0.0
    rivals = ", ".join(effect.label for effect in diagnosis.rivals) or "none"
    print(f"\nhidden: {hidden or 'nothing'}")
    print(f"found: {diagnosis.verdict}, {diagnosis.best or 'no name'}, rivals: {rivals}")
    print(
        f"{samples} samples, filter at {cutoff:.3g} Hz, {fit.rows} rows a joint, "
        f"{len(fit.columns)} unknowns, {tried} candidates judged, "
        f"{len(diagnosis.candidates)} of them refitted"
    )
    for name, seconds in times.items():
        print(f"  {name:<40} {seconds:7.2f} s")
    for name, seconds in sorted(clock.spent.items(), key=lambda pair: -pair[1]):
        print(f"    {name:<38} {seconds:7.2f} s  {100 * seconds / times['diagnose']:3.0f} %")
    total = sum(times.values())
    print(f"in all {total:.1f} s; target {TARGET:.0f} s: {'met' if total <= TARGET else 'MISSED'}")
    right = diagnosis.best is not None and diagnosis.best.label == hidden
    return total <= TARGET and (right or (hidden is None and diagnosis.verdict == "nothing"))


if __name__ == "__main__":
    main()
