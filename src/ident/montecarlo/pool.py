"""Runs spread over processes; which process makes a run changes nothing of it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing

from ident.errors import IdentError
from ident.montecarlo.sample import Outcome, Plan, outcomes
from ident.pool import spread
from ident.progress import Told

Task = tuple[int, float, int]  # number of the plan, SNR [dB], run


def made(
    plans: Sequence[Plan],
    runs: Sequence[tuple[float, int]],
    jobs: int | None,
    scheduler: str | None,
    progress: Told | None,
) -> list[list[Outcome]]:
    """For each plan the outcomes of all runs, in their order, whoever is done first.

    Args:
        plans: one a log.
        runs: (SNR [dB], run) that each of them gets.
        jobs, scheduler: as `ident.pool.spread` takes them.
        progress: called with (what is being done, share done).

    Raises:
        IdentError: if mechanism or estimators cannot be sent to other processes, or a run fails
            otherwise than an estimator may.
    """
    tasks = [(number, snr, run) for number in range(len(plans)) for snr, run in runs]
    found: dict[int, list[Outcome]] = {}
    ended = spread(_outcomes, tasks, common=tuple(plans), jobs=jobs, scheduler=scheduler)
    with closing(ended):
        for done in ended:
            if done.error is not None:
                number, snr, run = tasks[done.index]
                raise IdentError(f"{plans[number].log.name}: run {run} at {snr:g} dB: {done.error}")
            found[done.index] = done.value
            if progress:
                progress(f"run {len(found)} of {len(tasks)}", len(found) / len(tasks))
    each = len(runs)
    return [
        [outcome for index in range(number * each, (number + 1) * each) for outcome in found[index]]
        for number in range(len(plans))
    ]


def _outcomes(plans: Sequence[Plan], task: Task) -> list[Outcome]:
    number, snr, run = task
    return list(outcomes(plans[number], snr, run))
