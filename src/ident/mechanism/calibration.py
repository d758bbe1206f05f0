"""What may be a little wrong with sensors and drawing of a machine: causes with priors.

    [calibration]                     one standard deviation; "exact" where nothing is wrong
    clock = "1 %"                     true over logged time
    tau = "3 %"                       gain of each torque; or { elbow = "0.5 %" }
    q = "1 deg"                       zero of each position; "1 mm" where a joint slides
    length = "1 %"                    of each length of the drawing that is not zero
    lateness = "1 sample"             of each torque and position against the others

A prior is a normal distribution about 0: a type B uncertainty (JCGM 100, GUM, sect. 4.3).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.errors import MechanismError, one_of
from ident.files import TomlTable

EXACT = "exact"
AMOUNT = re.compile(r"\s*([+]?[0-9.]+(?:e[-+]?[0-9]+)?)\s*([a-zA-Zµ%°]*)\s*", re.I)
PERCENT = {"%": (1e-2, "1"), "ppm": (1e-6, "1")}
ANGLE = {"deg": (np.pi / 180, "rad"), "°": (np.pi / 180, "rad"), "rad": (1.0, "rad"),
         "mrad": (1e-3, "rad")}  # fmt: skip
LENGTH = {"m": (1.0, "m"), "mm": (1e-3, "m"), "cm": (1e-2, "m"), "µm": (1e-6, "m"),
          "um": (1e-6, "m")}  # fmt: skip
TIME = {"s": (1.0, "s"), "ms": (1e-3, "s"), "µs": (1e-6, "s"), "us": (1e-6, "s"),
        "sample": (1.0, "sample"), "samples": (1.0, "sample")}  # fmt: skip


@dataclass(frozen=True)
class Amount:
    """One standard deviation: a number ≥ 0 with its unit, `1`, `rad`, `m`, `s` or `sample`."""

    number: float
    unit: str


@dataclass(frozen=True)
class Kind:
    """A kind of calibration error.

    Attributes:
        name: the key of [calibration]; words: what is wrong, before the name of a place.
        default: amounts, by the unit of what it is an error of; source: why these.
        units: factor and unit of what may stand behind a number.
    """

    name: str
    words: str
    default: tuple[Amount, ...]
    units: Mapping[str, tuple[float, str]]
    example: str
    source: str


KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "clock", "the clock", (Amount(0.01, "1"),), PERCENT, "1 %",
            "a nominal rate in place of time stamps: timers of controllers are up to 2 % off",
        ),
        Kind(
            "tau", "gain of", (Amount(0.03, "1"),), PERCENT, "3 %",
            "torque constants of catalogues are up to 5 % off (uniform: 3 %)",
        ),
        Kind(
            "q", "zero of", (Amount(np.pi / 180, "rad"), Amount(1e-3, "m")), ANGLE | LENGTH,
            "1 deg",
            "joints set to marks by eye are 1 to 2 degrees off (uniform: 1 degree)",
        ),
        Kind(
            "length", "length", (Amount(0.01, "1"),), PERCENT | LENGTH, "1 %",
            "drawings without a kinematic calibration (Hollerbach, Khalil, Gautier, Springer "
            "Handbook of Robotics, ch. 6)",
        ),
        Kind(
            "lateness", "lateness of", (Amount(1.0, "sample"),), TIME, "1 sample",
            "channels of one record that are read one after the other, or filtered",
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Calibration:
    """What is stated of a machine's calibration; for all else the defaults hold.

    Attributes:
        stated: amounts by kind (`tau`) or kind and place (`tau.elbow`, `lateness.q.elbow`).
        source: of what is stated.
    """

    stated: Mapping[str, Amount] = field(default_factory=dict)
    source: str = "[calibration]"

    @classmethod
    def of(cls, text: str, names: Sequence[str] = ()) -> Calibration:
        """Return what a text states, as `tau=0.5%,q=0.1deg,clock=exact` or `exact`.

        Args:
            text: entries `KIND=AMOUNT` or `KIND.PLACE=AMOUNT`, parted by commas; `all=exact`.
            names: places that there are; any, if none are given.

        Raises:
            MechanismError: for an entry that is none, with a valid one.
        """
        stated: dict[str, Amount] = {}
        for entry in filter(None, (part.strip() for part in text.split(","))):
            key, equals, amount = entry.partition("=")
            key, amount = key.strip(), amount.strip()
            if not equals and key == EXACT:
                key, amount = "all", EXACT
            elif not equals:
                raise MechanismError(f"--calibrated {entry}: write KIND=AMOUNT, as tau=0.5%")
            kind, _, place = key.partition(".")
            where = f"--calibrated {entry}"
            if key == "all":
                if amount != EXACT:
                    raise MechanismError(f"{where}: of all together only all=exact is valid")
                stated |= {name: read_amount(EXACT, name, where) for name in KINDS}
                continue
            if kind not in KINDS:
                raise MechanismError(f"{where}: {one_of(kind, [*KINDS, 'all'])}")
            _check_place(place, names, where)
            stated[key] = read_amount(amount, kind, where)
        return cls(stated, "--calibrated")

    def __or__(self, other: Calibration) -> Calibration:
        """Return both; what `other` states of a kind counts for all its places."""
        kinds = {key for key in other.stated if key in KINDS}
        rest = {k: x for k, x in self.stated.items() if k.partition(".")[0] not in kinds}
        return replace(other, stated={**rest, **other.stated})

    @property
    def exact(self) -> bool:
        """Whether nothing is wrong with anything."""
        none = all(name in self.stated for name in KINDS)
        return none and not any(amount.number for amount in self.stated.values())

    def amount(self, kind: str, *places: str, unit: str = "") -> tuple[Amount, str]:
        """Return the standard deviation of a kind at the first of some places of which any is
        stated, and its source; `unit` chooses among defaults.
        """
        for key in (*(f"{kind}.{place}" for place in places), kind):
            if key in self.stated:
                return self.stated[key], self.source
        defaults = KINDS[kind].default
        chosen = next((x for x in defaults if x.unit == unit), defaults[0])
        return chosen, KINDS[kind].source


def read_amount(text: object, kind: str, where: str) -> Amount:
    """Return the amount of a text such as `3 %`, of one of `KINDS`.

    Raises:
        MechanismError: if it is none, with one that would be.
    """
    of = KINDS[kind]
    if text == EXACT:
        return Amount(0.0, of.default[0].unit)
    match = AMOUNT.fullmatch(str(text)) if isinstance(text, str) else None
    try:
        factor, base = of.units[match[2] if match else ""]
        number = float(match[1]) * factor if match else np.nan
    except (KeyError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        valid = ", ".join(of.units)
        raise MechanismError(
            f"{where}: {text!r} is no standard deviation of '{kind}'; write a number with its unit "
            f'({valid}), as "{of.example}", or "exact"'
        )
    return Amount(number, base)


def read_calibration(table: TomlTable, names: Sequence[str]) -> Calibration:
    """Return what [calibration] states; `names`: of joints and closures, for messages."""
    table.check(*KINDS)
    stated: dict[str, Amount] = {}
    for kind, value in table.data.items():
        where = f"{table.where} {kind}"
        if not isinstance(value, dict):
            stated[kind] = read_amount(value, kind, where)
            continue
        for place, amount in value.items():
            _check_place(place, names, where)
            stated[f"{kind}.{place}"] = read_amount(amount, kind, f"{where} {place}")
    return Calibration(stated)


def _check_place(place: str, names: Sequence[str], where: str) -> None:
    """Refuse a joint or closure that is not there; `tau.elbow`, `elbow.x` are of elbow."""
    bare = place.removeprefix("tau.").removeprefix("q.")
    owners = {bare, bare.partition(".")[0]}
    if place and names and not owners & {*names}:
        raise MechanismError(f"{where}: {one_of(bare, names)}")
