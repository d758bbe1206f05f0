"""What the numbers of a body say about their units, held against the machine's own length.

    ρ = √(tr I / 2m)       radius of gyration of a body of mass m and inertia I about its centre c

A body of a machine of length L, by its joints and their travel, has ρ and |c| of at most about L. A
URDF in which one of them is a thousand times larger has another unit, as CAD programs export them;
the unit that makes ρ a share of L that bodies have is named. Such numbers count as zero as a prior;
as known values, and where they are written, they stay what they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TOO_LARGE = 2.0  # range: times the machine's length, beyond which a body's size cannot be
ANY_MACHINE = 100.0  # range: m, a radius of gyration of no body of any machine
SHORT = 0.02  # range: m, below which a machine's length says nothing of its bodies
SIZES = 0.03, 1.0  # range: of the machine's length, radii of gyration of its bodies
DENSE = 1e6  # range: kg/m³, of a body that cannot be; osmium has 22,600
DENSITIES = 50.0, 23_000.0  # range: kg/m³, of bodies
LIGHTEST = 1e-3  # range: kg, of a body; dummies for simulators are lighter
INERTIA_UNITS = {"kg mm²": 1e-6, "g mm²": 1e-9, "kg cm²": 1e-4, "g cm²": 1e-7}


@dataclass(frozen=True)
class BodyVerdict:
    """Why the numbers of a body cannot be, and which of them count as zero as a prior."""

    text: str
    cause: str  # its unit, `placeholder` or `dummy`; bodies of one cause are said together
    inertia: bool = False  # whether the inertia counts as zero
    centre: bool = False  # whether the centre of mass does

    @property
    def dummy(self) -> bool:
        """Whether it stands for no body at all, so that its inertia is no known value either."""
        return self.cause == "dummy"


def verdict_of(mass: float, centre: np.ndarray, trace: float, length: float) -> BodyVerdict | None:
    """Judge a body of mass [kg], centre of mass (3,) [m] in its link's frame and trace of the
    inertia [kg m²] in a machine of some length [m]; None where nothing contradicts it.
    """
    if not mass > 0:
        return None
    gyration, offset = float(np.sqrt(max(trace, 0.0) / (2 * mass))), float(np.linalg.norm(centre))
    known = length > SHORT
    machine = f" on a machine {length:.3g} m long" if known else ""
    if known and offset > TOO_LARGE * length and _fits(1e-3 * offset, length):
        return BodyVerdict(
            f"a centre of mass {offset:.3g} m from its frame{machine}: in mm? times 0.001 it is "
            f"{1e-3 * offset:.2g} m; as a prior it counts as zero",
            "mm",
            centre=True,
        )
    largest = min(TOO_LARGE * max(length, offset), ANY_MACHINE) if known else ANY_MACHINE
    if gyration > largest:
        light = mass < LIGHTEST
        units = {} if light else INERTIA_UNITS
        unit = next((u for u, f in units.items() if _fits(gyration * f**0.5, length)), "")
        size = f"an inertia of {trace / 3:.3g} kg m² at {mass:.3g} kg has a radius of gyration of "
        size += f"{gyration:,.3g} m{machine}" if gyration < 1e3 else f"{gyration:,.0f} m{machine}"
        if unit:
            f = INERTIA_UNITS[unit]
            why = f"in {unit}? times {f:g} it is {gyration * f**0.5:.2g} m; as a prior it counts as"
            return BodyVerdict(f"{size}: {why} zero", unit, inertia=True)
        cause = "dummy" if light and gyration > ANY_MACHINE else "placeholder"
        why = "counts as zero" if cause == "dummy" else "counts as zero as a prior"
        return BodyVerdict(f"{size}: a placeholder, which {why}", cause, inertia=True)
    if gyration > 0 and _density(mass, gyration) > DENSE:
        grams = _density(1e-3 * mass, (1e3 * gyration**2) ** 0.5)
        if known and DENSITIES[0] < grams < DENSITIES[1]:
            return BodyVerdict(
                f"{mass:.4g} kg with a radius of gyration of {gyration:.2g} m is "
                f"{_density(mass, gyration):.1e} kg/m³: a mass in g? times 0.001 it is "
                f"{1e-3 * mass:.3g} kg",
                "g",
            )
    return None


def _fits(size: float, length: float) -> bool:
    return SIZES[0] * length <= size <= SIZES[1] * length


def _density(mass: float, gyration: float) -> float:
    """Return the density [kg/m³] of a solid ball of that radius of gyration: ρ² = 3/5 r²."""
    return float(mass / (4 / 3 * np.pi * (gyration / 0.6**0.5) ** 3))
