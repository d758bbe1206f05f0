"""How sure the motion of a machine is, that of an edited one most of all.

    half width at t  =  t₀.₉₇₅ · std of q(t) over draws of the identified values

Values are drawn from the fit's covariance, in directions that its log determined, and each draw is
replayed as the model itself is: from the same states, under the same torques. What a log determines
only together with other values cannot be edited alone; such edits are named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.display import Progress
from ident.errors import IdentError
from ident.export.machine import Machine
from ident.fit.files import Saved
from ident.fit.result import Fit
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Covariance
from ident.motion import Motion
from ident.simulate.inverse import point_of
from ident.simulate.replay import replay

DRAWS = 12  # work: replays of a band; the quantile is Student's for as many
WINDOWS = 8  # work: of a log, evenly over it, that are replayed for the band
LEVEL = 0.95  # level: of the band


def covariance_of(model: Fit | Saved | Mechanism) -> Covariance | None:
    """Return the errors of identified values; None where nothing was identified."""
    if isinstance(model, Fit):
        names = tuple(model.columns.names[i] for i in model.estimate.base.independent)
        known = model.known_errors
        if not names or not np.isfinite(model.covariance).all():
            return known
        identified = Covariance(names, model.covariance)
        return identified if known is None else identified + known
    return model.covariance if isinstance(model, Mechanism) else model.mechanism.covariance


def band(
    machine: Machine, errors: Covariance, motion: Motion, edited: Mapping[str, float],
    window: float, progress: Progress | None = None,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """Return half of the width [rad | m] of the 95 % band of every log's logged joints.

    Args:
        machine: the edited one.
        errors: of the values of the fit.
        motion: whose states and torques every draw begins in and is driven by.
        edited: share of the error that a changed parameter keeps, by its name: 0 of one that is
            set, 0.5 of one that is half of the identified value.
        window: [s] from one restart to the next.
        progress: called with (what is being done, share done).

    Returns:
        One array (n, joints) a log; NaN where nothing was replayed.

    Raises:
        IdentError: if no more than one draw can be integrated.
    """
    from scipy.stats import t as student

    mechanism, bodies = machine.mechanism, machine.mechanism.bodies
    of_effects = {name for effect in mechanism.effects for name in effect.names}
    columns = {name: i for i, name in enumerate(bodies.names)}
    used = [
        i for i, name in enumerate(errors.names)
        if edited.get(name, 1.0) and (name in of_effects or name in columns)
    ]  # fmt: skip
    kept = np.array([edited.get(errors.names[i], 1.0) for i in used])
    root = kept[:, None] * errors.root[used]
    draws = np.random.default_rng(0).standard_normal((DRAWS, root.shape[1])) @ root.T
    centre = {name: x for name, x in machine.point.values.items() if name in of_effects}
    runs: list[list[np.ndarray]] = []
    for number, change in enumerate(draws):
        if progress:
            progress("band of the motion", number / DRAWS)
        values, pi = dict(centre), machine.point.pi.copy()
        for i, dx in zip(used, change, strict=True):
            name = errors.names[i]
            if name in of_effects:
                values[name] += dx
            else:
                pi[columns[name]] += dx
        try:
            drawn = Saved("draw", mechanism, point_of(mechanism, values, pi))
            logs = replay(drawn, motion=motion, window=window, most=WINDOWS).runs["draw"]
        except IdentError:  # forces do not determine the motion of a body of negative inertia
            continue
        runs.append([run.simulated for run in logs])
    if len(runs) < 2:
        raise IdentError(
            "no band: the identified values are too uncertain for their draws to be simulated"
        )
    factor = float(student.ppf((1 + LEVEL) / 2, len(runs) - 1) * np.sqrt(1 + 1 / len(runs)))
    widths = []
    for series in zip(*runs, strict=True):
        widths.append(factor * np.stack(series).std(axis=0, ddof=1))
    return tuple(widths)


def inseparable(
    model: Fit | Saved | Mechanism, values: Mapping[str, float], without: Sequence[str]
) -> dict[str, list[str]]:
    """Return edits that the log cannot vouch for: by edit, the parameters that it determines only
    together with others.
    """
    if isinstance(model, Mechanism):
        return {}
    together = {
        name
        for base in model.base_parameters
        for name in _terms(base.name)
        if base.name != name
    }  # fmt: skip
    edits = {name: [name] for name in values}
    effects = {effect.label: effect for effect in model.mechanism.effects}
    edits |= {label: list(effects[label].names) for label in without if label in effects}
    result = {edit: [name for name in names if name in together] for edit, names in edits.items()}
    return {edit: names for edit, names in result.items() if names}


def _terms(combination: str) -> list[str]:
    """Return the parameters of a base parameter such as `link2.my + 0.3 link3.m`."""
    return [word for word in combination.split() if "." in word and not _is_number(word)]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
