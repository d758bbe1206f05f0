"""What the log's channels do to the truth: offset, gain, lag, drift, clipping, then noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rigid import Machine
from scipy.signal import lfilter
from simulate import BEFORE, RATE, Known, Run
from torques import temperature

Columns = dict[str, np.ndarray]
CORRELATION = 0.95  # of coloured noise from sample to sample
JITTER = 1e-3  # s rms between a row and its stamp


def columns(machine: Machine, run: Run, effects: Sequence[Known], warm: bool = False) -> Columns:
    """The log without noise: t, positions and torques of the driven joints."""
    names = [joint.name for joint in machine.joints]
    log: Columns = {"t": run.t.copy()}
    log |= {f"q.{j}": run.q[:, names.index(j)].copy() for j in machine.driven}
    log |= {f"tau.{j}": run.tau[:, k].copy() for k, j in enumerate(machine.driven)}
    for effect in effects:
        corrupt(machine, run, effect, log)
    if warm or any(effect.kind == "temperature_friction" for effect in effects):
        log |= {f"temperature.{j}": np.vectorize(temperature)(run.t) for j in machine.driven}
    return log


def corrupt(machine: Machine, run: Run, effect: Known, log: Columns) -> None:
    """One channel's error, in place; kinds that are no sensor's leave the log alone."""
    if not effect.joints or effect.joints[0] not in machine.driven:
        return
    joint, p = effect.joints[0], effect.values
    q, tau = log[f"q.{joint}"], log[f"tau.{joint}"]
    if effect.kind == "torque_offset":
        tau += p["c"]
    elif effect.kind == "drift":
        tau += p["c"] * run.t
    elif effect.kind == "torque_gain":
        tau *= 1 + p["g"]
    elif effect.kind == "saturation":
        np.clip(tau, -p["limit"], p["limit"], out=tau)
    elif effect.kind == "encoder_offset":
        q -= p["delta"]  # delta: true minus logged
    elif effect.kind == "elasticity":
        q += p["compliance"] * tau
    elif effect.kind == "delay":
        tau[:] = late(machine, run, machine.driven.index(joint), p["d"])


def late(machine: Machine, run: Run, k: int, by: float) -> np.ndarray:
    """A drive's torque `by` seconds ago, from before the log as well."""
    at = np.arange(len(run.early)) * machine.step - BEFORE
    return np.interp(np.arange(len(run.t)) / RATE - by, at, run.early[:, k])


def sizes(logs: Sequence[Columns], torque: float, encoder: float) -> dict[str, float]:
    """Standard deviation of the noise by column: shares of a position's std, a torque's rms."""
    result = {}
    for name in logs[0]:
        all_of_it = np.concatenate([log[name] for log in logs])
        if name.startswith("q."):
            result[name] = encoder * float(all_of_it.std())
        elif name.startswith("tau."):
            result[name] = torque * float(np.sqrt((all_of_it**2).mean()))
    return result


def noisy(
    logs: Sequence[Columns], size: dict[str, float], seed: int, coloured: bool = False
) -> list[Columns]:
    """The logs with white noise; the same seed gives the same draws whatever the signal.

    coloured: the torques' noise is correlated from sample to sample, the stamps jitter.
    """
    result = []
    for number, log in enumerate(logs):
        rng = np.random.default_rng([11, seed, number])
        late = log["t"] + (JITTER * rng.standard_normal(len(log["t"])) if coloured else 0.0)
        made = {"t": log["t"].copy()}
        for name in [name for name in log if name != "t"]:
            made[name] = np.interp(late, log["t"], log[name]) if coloured else log[name].copy()
            if name in size:
                noise = rng.standard_normal(len(late))
                if coloured and name.startswith("tau."):
                    noise = lfilter([np.sqrt(1 - CORRELATION**2)], [1, -CORRELATION], noise)
                made[name] += size[name] * noise
        result.append(made)
    return result
