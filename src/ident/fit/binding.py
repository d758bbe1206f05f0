"""What the limits of a consistent fit did to it, and the notes that say so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.errors import FitError
from ident.fit.bodies import MARGIN, VERIFIED, smallest_eigenvalue
from ident.fit.consistent import Program
from ident.information.cone import Point
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, Consistency

PUSHED = 0.1  # standard errors of white noise by which a limit must push to count as active
WORTH = 0.05  # of the error: a rise that asks for an explanation


@dataclass(frozen=True)
class Binding:
    """Where a consistent fit touches its limits, and what that costs.

    Attributes:
        asked: bounds and total mass that were asked for.
        edge: links whose body is at the edge of what is possible.
        at_bound: parameters that are at a bound, by name.
        active: all limits that hold the fit back, as a person reads them.
        repaired: links whose prior is no possible body.
        eigenvalues: by link with unknowns, the smallest one of its pseudo-inertia in units of the
            prior's ball (`fit.bodies`), looked at in the result.
        rise: of the error over that of the fit without limits, as a share: root of the mean over
            joints of the squared ratio; held_out_rise: the same of held-out errors.
    """

    asked: Consistency
    edge: tuple[str, ...]
    at_bound: frozenset[str]
    active: tuple[str, ...]
    repaired: tuple[str, ...]
    eigenvalues: Mapping[str, float]
    rise: float
    held_out_rise: float | None = None

    def notes(self) -> list[str]:
        """What a person should know of it."""
        said = []
        if self.repaired:
            said.append(
                f"the prior of {', '.join(self.repaired)} is that of no possible body; the nearest "
                "possible one stands in for it"
            )
        if max(self.rise, self.held_out_rise or 0.0) > WORTH:
            said.append(
                "these data contradict what is physically possible: something is missing from the "
                "model, or a sign, unit or bound is wrong; see ident diagnose"
            )
        return said

    def json(self) -> dict[str, Any]:
        """For fit.json."""
        return {
            "bounds": {
                name: [low if np.isfinite(low) else None, high if np.isfinite(high) else None]
                for name, (low, high) in self.asked.bounds.items()
            },
            "total_mass": self.asked.total_mass,
            "active": list(self.active),
            "at_bound": sorted(self.at_bound),
            "repaired_priors": list(self.repaired),
            "smallest_eigenvalues": dict(self.eigenvalues),
            "rise": {"train": self.rise, "held_out": self.held_out_rise},
        }

    def __str__(self) -> str:
        if not self.active:
            return "physically consistent, without any limit holding it back"
        rises = [f"error {_signed(self.rise)}"]
        if self.held_out_rise is not None:
            rises.append(f"held-out error {_signed(self.held_out_rise)}")
        return f"physically consistent ({', '.join(rises)}); held back by: {'; '.join(self.active)}"


def _signed(rise: float) -> str:
    return f"{100 * rise:+.2g} %" if rise < 1 else f"{1 + rise:.2g}-fold"


def binding_of(
    mechanism: Mechanism,
    asked: Consistency,
    program: Program,
    point: Point,
    pi: np.ndarray,
    rise: float,
    held_out_rise: float | None,
) -> Binding:
    """What limits did, with the eigenvalues of all bodies looked at anew.

    Raises:
        FitError: if a body that could move is no possible one after all.
    """
    links = mechanism.bodies.links
    asking = {name.rpartition(".")[0] for name in mechanism.unknown}
    seen = {
        link: smallest_eigenvalue(mechanism, i, pi[COUNT * i : COUNT * (i + 1)])
        for i, link in enumerate(links)
        if link in asking
    }
    least = VERIFIED * MARGIN - 1e-9
    if broken := [link for link, smallest in seen.items() if not smallest >= least]:
        raise FitError(f"no consistent fit was found: {', '.join(broken)} is no possible body")
    pushing = [
        limit for limit, push in zip(program.limits, point.push, strict=True) if push > PUSHED
    ]
    before = [
        smallest_eigenvalue(mechanism, i, mechanism.prior[COUNT * i : COUNT * (i + 1)])
        for i in range(len(links))
    ]
    edge = tuple(dict.fromkeys(limit.of for limit in pushing if limit.kind == "psd"))
    bounds = [limit for limit in pushing if limit.kind != "psd"]
    return Binding(
        asked=asked,
        edge=edge,
        at_bound=frozenset(limit.of for limit in bounds if limit.of),
        active=(
            *([f"possible bodies ({', '.join(edge)})"] if edge else []),
            *(limit.name for limit in bounds),
        ),
        repaired=tuple(
            link for link, e in zip(links, before, strict=True) if link in asking and e < -1e-9
        ),
        eigenvalues=seen,
        rise=rise,
        held_out_rise=held_out_rise,
    )


def impossible_known(mechanism: Mechanism) -> list[str]:
    """Notes on bodies that are known, and impossible: nothing that is identified repairs them."""
    asking = {name.rpartition(".")[0] for name in mechanism.unknown}
    found = [
        link
        for i, link in enumerate(mechanism.bodies.links)
        if link not in asking
        and smallest_eigenvalue(mechanism, i, mechanism.prior[COUNT * i : COUNT * (i + 1)]) < -1e-9
    ]
    return found and [
        f"{', '.join(found)} is known, and that of no possible body (its pseudo-inertia has a "
        "negative eigenvalue): a simulator may refuse it; correct the URDF, or make it unknown"
    ]
