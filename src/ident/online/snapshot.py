"""What is known at one instant: a noun that prints itself and does not change any more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ident.errors import one_of
from ident.fit.values import BaseValue, Value
from ident.online.reactions import Multipliers
from ident.residual.error import Error
from ident.tables import percent, rounded, table

SHOWN = 6  # parameters in one line


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Parameters, reaction forces and errors after some samples. Made by `Online.snapshot`.

    Attributes:
        t: of the last sample whose equations are in it [s].
        samples: how many have come; rows: how many equations a coordinate count, old ones less.
        parameters: unknown dynamic parameters, then those of effects. One that is not identifiable
            stays at its prior or, where it was known and its information is forgotten, at its last
            value, with a standard error that grows.
        base_parameters: the combinations that the rows determine.
        held: names of the parameters that are held at their last value.
        multipliers: λ of the last sample; none for a tree.
        errors: by joint, of the rows that count, with these parameters.
        ahead: by joint, of the rows since the snapshot before, predicted by its parameters.
        rank: number of base parameters; condition_number: of their columns.
        lag: by how much `t` is behind the last sample at most [s].
        notes: what a person should know.
    """

    t: float
    samples: int
    rows: float
    parameters: tuple[Value, ...]
    base_parameters: tuple[BaseValue, ...]
    held: tuple[str, ...]
    multipliers: Multipliers | None
    errors: Mapping[str, Error]
    ahead: Mapping[str, Error]
    rank: int
    condition_number: float
    lag: float
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Value:
        """A parameter by its name.

        Raises:
            KeyError: with the nearest name.
        """
        own = {value.name: value for value in self.parameters}
        if name not in own:
            raise KeyError(f"no parameter '{name}'; {one_of(name, own)}")
        return own[name]

    @property
    def identified(self) -> tuple[Value, ...]:
        """The parameters that the data determine, or did."""
        return tuple(v for v in self.parameters if v.identifiable or v.name in self.held)

    @property
    def line(self) -> str:
        """What is identified, the multipliers and the errors, in one line."""
        known = self.identified
        said = [str(value) for value in known[:SHOWN]]
        said += [f"… ({len(known) - SHOWN} more)"] if len(known) > SHOWN else []
        said += [str(self.multipliers)] if self.multipliers is not None else []
        said += [f"error of {name} {percent(e.relative)}" for name, e in self.errors.items()]
        return f"t = {self.t:.6g} s: {', '.join(said)}; lag {1e3 * self.lag:.3g} ms"

    def __str__(self) -> str:
        lines = [
            f"at t = {self.t:.6g} s: {self.samples} samples, {self.rows:.6g} equations a "
            f"coordinate, {self.rank} base parameters, condition number "
            f"{self.condition_number:.3g}; lag {1e3 * self.lag:.3g} ms"
        ]
        rows = [["parameter", "value", "prior", "unit", ""]]
        for v in self.identified:
            state = "held" if v.name in self.held else ""
            rows.append([v.name, rounded(v.value, v.stderr), f"{v.prior:.5g}", v.unit, state])
        lines += table(rows) if len(rows) > 1 else ["  no parameter is determined by itself"]
        if self.multipliers is not None:
            lines.append(f"  {self.multipliers}")
        rows = [["error", "all", "ahead", "rms", "unit"]]
        for name, e in self.errors.items():
            ahead = self.ahead.get(name)
            rows.append(
                [
                    name, percent(e.relative), percent(ahead.relative if ahead else None),
                    f"{e.rms:.4g}", e.unit,
                ]
            )  # fmt: skip
        return "\n".join([*lines, *table(rows), *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__
