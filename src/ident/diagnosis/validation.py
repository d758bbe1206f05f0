"""What the rungs of a ladder leave on validation logs, which have no say in the search.

A rung raises the error of a joint on a log if, beside the best rung so far there,

    D_k = |e_k now|² − |e_k of the best|²        e_k: errors in motion of a block k of time

are above zero by more standard errors than chance makes of any of so many joints and logs
(`surely_t`), and their sum is more than what matters of the torque. The best so far and not the
rung before: many small rises are one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.problem import information_of
from ident.fit import Fit
from ident.information.estimate import MATERIAL
from ident.information.evidence import surely_t, zscore
from ident.motion import Motion

Place = tuple[int, int]
"""(log, coordinate)."""


@dataclass(frozen=True, eq=False)
class ValidationErrors:
    """Errors of a model on validation logs.

    Attributes:
        squares: by log and coordinate, what is left in motion in each block of time [(N m)² | N²].
        torque: by log and coordinate, the squares of the measured torque.
        names: by log and coordinate, those of the joint and the log.
    """

    squares: Mapping[Place, Mapping[int, float]]
    torque: Mapping[Place, float]
    names: Mapping[Place, tuple[str, str]]

    @classmethod
    def of(cls, fit: Fit, validate: Motion | None) -> ValidationErrors:
        """Return those of a fit; none without a validation log."""
        squares, torque = dict[Place, dict[int, float]](), dict[Place, float]()
        names = dict[Place, tuple[str, str]]()
        if validate is not None:
            rows = information_of(fit.mechanism, fit.columns, validate, fit.problem.point)
            for key, block in rows.blocks.items():
                one, u = replace(rows, blocks={key: block}), block.coordinate
                remaining, tau, _ = one.squares(fit.estimate.x).in_motion
                place = block.log, u
                squares.setdefault(place, {})[block.block] = float(remaining[u])
                torque[place] = torque.get(place, 0.0) + float(tau[u])
                names[place] = validate.independent[u], validate.experiments[block.log].name
        return cls(squares, torque, names)

    def best(self, other: ValidationErrors) -> ValidationErrors:
        """Return the smaller errors of two models, by log and coordinate."""
        pairs = ((place, x, other.squares.get(place, x)) for place, x in self.squares.items())
        least = {place: min(x, y, key=lambda z: sum(z.values())) for place, x, y in pairs}
        return replace(self, squares=least)

    def increased_error(self, best: ValidationErrors) -> str:
        """Return in which joint and log the error is above that of the best rungs so far by more
        than the scatter of blocks makes by chance of any of them; "" in none.
        """
        for place, now in self.squares.items():
            before, torque = best.squares.get(place, {}), max(self.torque[place], 1e-300)
            both = [(before[block], x) for block, x in now.items() if block in before]
            old, new = np.array(both).reshape(-1, 2).T
            if len(both) < 2 or new.sum() - old.sum() <= MATERIAL**2 * torque:
                continue
            if zscore(new - old) > surely_t(len(self.squares), len(both)):
                was, is_ = (100 * float(np.sqrt(x.sum() / torque)) for x in (old, new))
                joint, log = self.names[place]
                return f"the error of {joint} on {log} would rise from {was:.3g} to {is_:.3g} %"
        return ""
