"""What the residual would be if nothing were missing: logs of the fitted model, the same pipeline.

The model's smooth motion and the torques it predicts are logged again, with the noise that the real
channels have, and completed, filtered and compared like the real log. What such logs show (noise in
positions that enters the columns, filters, smoothing) is no effect, however significant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.diagnose.screen import Screen
from ident.equations.samples import reduced
from ident.equations.terms import unbalanced
from ident.fit.table import Table
from ident.log import Log
from ident.motion.derive import derive
from ident.motion.measure import measure
from ident.motion.place import again
from ident.progress import Progress

REPLICAS = 8


@dataclass(frozen=True, eq=False)
class Null:
    """Residuals of logs in which nothing is missing.

    Attributes:
        R: (M, replicas) projected, in the screen's rows.
        floor, ceiling: (d,) rms of a held-out residual of nothing but noise [weighted]: the
            median and the largest.
    """

    R: np.ndarray
    floor: np.ndarray
    ceiling: np.ndarray


def null(table: Table, screen: Screen, seed: int = 0, told: Progress | None = None) -> Null:
    """Replicas of the log as the fitted model makes it; reproducible by the seed."""
    random = np.random.default_rng(seed)
    found = []
    torques = [_torques(table, number) for number in range(len(table.scenes))]
    for i in range(REPLICAS):
        if told:
            told("logs of the model itself", i / REPLICAS)
        residual = [
            _residual(table, number, torques[number], random) for number in range(len(torques))
        ]
        found.append(np.concatenate(residual))
    R = screen.projected(screen.taken(np.stack(found, axis=-1)))
    LR = screen.left_out(R)
    squares = np.stack([screen.sums(x**2).sum(axis=0) for x in LR.T])
    rms = np.sqrt(squares / np.maximum(screen.rows, 1))
    return Null(R, np.median(rms, axis=0), rms.max(axis=0))


def _torques(table: Table, number: int) -> np.ndarray:
    """(n, driven) the measured torques, less what the model does not explain of them."""
    s = table.samples(number)
    r = np.empty(s.shape)
    for start in range(0, len(s), 4096):
        part = replace(s, part=slice(start, start + 4096))
        r[start : start + 4096] = unbalanced(part, table.point)
    e, driven = s.e, table.mechanism.driven
    if e.leverage is None:
        at = [table.mechanism.joint(name).index for name in driven]
        return e.tau - r[:, at]
    L = e.leverage[:, [table.mechanism.joint_index[name] for name in driven]]
    return e.tau - np.einsum("ndj,nd->nj", np.linalg.pinv(L, rcond=1e-6), r)


def _log(table: Table, number: int, tau: np.ndarray, random: np.random.Generator) -> Log:
    """The experiment as its own model would have logged it."""
    e = table.scenes[number].e
    columns: dict[str, np.ndarray] = {}
    for name in e.logged:
        at = table.mechanism.joint_index[name]
        for channel, x in (("q", e.y), ("v", e.yd), ("a", e.ydd)):
            if f"{channel}.{name}" in e.noise:
                sigma = e.noise[f"{channel}.{name}"]
                columns[f"{channel}.{name}"] = x[:, at] + sigma * random.standard_normal(len(e))
    for j, name in enumerate(table.mechanism.driven):
        sigma = e.noise.get(f"tau.{name}", 0.0)
        columns[f"tau.{name}"] = tau[:, j] + sigma * random.standard_normal(len(e))
    columns |= {name: x for name, x in e.extra.items() if not name.startswith("tau.")}
    return Log.from_arrays(e.name, e.t, columns)


def _residual(
    table: Table, number: int, tau: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """b − A x (N_e, d) of a replica at the model's parameters, in the table's rows."""
    scene, band = table.scenes[number], table.motion.band
    mechanism, e = scene.mechanism, scene.e
    log = _log(table, number, tau, random)
    signals = measure(mechanism, log)
    before = [x[:, [mechanism.joint_index[name] for name in e.logged]] for x in (e.y, e.yd, e.ydd)]
    spacing = e.smooth.spacing if e.smooth else None
    derived = derive(signals, e.logged, band, spacing).known
    every = table.every(number)
    off = {
        name: tuple((derived[:, :, j] - [x[:, j] for x in before])[:, ::every])
        for j, name in enumerate(e.logged)
    }
    smooth = replace(e, tau=tau).thinned(every)
    again_ = again(mechanism, smooth, off)
    s = reduced(mechanism, again_, slice(None), table.point)
    noise = np.stack([log.columns[f"tau.{n}"] for n in mechanism.driven], axis=1) - tau
    full = reduced(mechanism, replace(e, tau=noise), slice(None), table.point)
    r = table.refined(number, unbalanced(s, table.point)) + full.measured(mechanism.driven)
    return table.filtered(number, r)
