"""Runs spread over processes; which process makes a run changes nothing of it."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import cloudpickle
from joblib import Parallel, delayed, parallel_config

from ident.errors import IdentError
from ident.montecarlo.sample import Outcome, Plan, outcomes
from ident.progress import Told


def made(
    plan: Plan, tasks: list[tuple[float, int]], jobs: int | None, progress: Told | None
) -> list[Outcome]:
    """The outcomes of all (SNR, run), in the order of tasks, whoever is done first.

    Args:
        plan: of all runs; tasks: (SNR [dB], run).
        jobs: processes; None: one a core that this process may use; 1: this one alone.
        progress: called with (what is being done, share done).

    Raises:
        IdentError: if mechanism or estimators cannot be sent to other processes.
    """
    jobs = min(cores() if jobs is None else jobs, len(tasks))
    found: dict[tuple[float, int], list[Outcome]] = {}
    for key, done in _here(plan, tasks) if jobs == 1 else _spread(plan, tasks, jobs):
        found[key] = done
        if progress:
            progress(f"run {len(found)} of {len(tasks)}", len(found) / len(tasks))
    return [outcome for key in tasks for outcome in found[key]]


def cores() -> int:
    """That this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


Done = tuple[tuple[float, int], list[Outcome]]


def _here(plan: Plan, tasks: list[tuple[float, int]]) -> Iterator[Done]:
    for snr, run in tasks:
        yield (snr, run), list(outcomes(plan, snr, run))


def _spread(plan: Plan, tasks: list[tuple[float, int]], jobs: int) -> Iterator[Done]:
    try:  # `replace` leaves compiled functions behind, which no process can send
        packed = cloudpickle.dumps(replace(plan, mechanism=replace(plan.mechanism)))
    except Exception as error:
        raise IdentError(
            f"{plan.mechanism.name} or an estimator cannot be sent to other processes "
            f"({type(error).__name__}: {error}); use one process: jobs=1"
        ) from None
    # one thread of linear algebra each: two processes with two threads on two cores are slower
    with parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
        yield from parallel(delayed(_there)(packed, snr, run) for snr, run in tasks)


def _there(packed: bytes, snr: float, run: int) -> Done:
    return (snr, run), list(outcomes(_unpacked(packed), snr, run))


@lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> Plan:
    """Once a process: its functions are compiled with the first run."""
    plan = pickle.loads(packed)
    assert isinstance(plan, Plan)
    return plan
