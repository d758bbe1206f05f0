"""The mechanism: a tree, its closures, what drives it, what is known of it, and its effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from markupsafe import Markup

from ident.effects import KINDS, Effect, parse
from ident.effects import create as create_effect
from ident.errors import MechanismError, one_of
from ident.log import Column
from ident.mechanism.closures import AnyClosure
from ident.mechanism.consistency import Consistency
from ident.mechanism.kinematics import Kinematics, rank_of
from ident.mechanism.parameters import Bodies, dynamic_parameters
from ident.show.html import Shown, definitions, folded, items, strong, table

if TYPE_CHECKING:
    from ident.show.view3d import View


@dataclass(frozen=True)
class Joint:
    """One scalar coordinate: of the tree (`index` into q and v) or of a closure (`index` into own).

    Attributes:
        lower, upper: [rad | m]; infinite where the URDF gives none.
        velocity: [rad/s | m/s]; effort: [N m | N].
    """

    name: str
    rotational: bool
    index: int
    in_tree: bool = True
    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf

    @property
    def unit(self) -> str:
        """Of the coordinate."""
        return "rad" if self.rotational else "m"

    @property
    def force_unit(self) -> str:
        """Of the torque or force."""
        return "N m" if self.rotational else "N"


@dataclass(frozen=True)
class Multipliers:
    """The time basis of λ(t): `free` (one value a sample) or splines of a spacing [s]."""

    basis: str = "free"
    spacing: float = 0.0

    @property
    def degree(self) -> int:
        """Of the basis functions; −1 for `free`."""
        return DEGREES[self.basis]


AWAY = 0.05  # [rad | m] from the assembled configuration to one in general position
DEGREES = {"free": -1, "linear": 1, "cubic": 3, "quintic": 5}


@dataclass(frozen=True, eq=False)
class Mechanism(Shown):
    """What is known of a machine before the log is looked at. `mechanism + effect` is a new one.

    Attributes:
        name: of the folder or URDF.
        model: Pinocchio's, with gravity; its inertias are the prior.
        bodies: names of the moving bodies.
        joints: every named coordinate, of the tree and of closures.
        closures: constraint functions.
        passive: joints whose torque is zero; all other joints of `joints_driven` are driven.
        start: (nq,) near where the loops are assembled.
        unknown: names of the dynamic parameters to identify.
        effects: beyond rigid bodies.
        multipliers: the time basis of the closures' forces.
        columns: this robot's names of log columns.
        urdf: path of the URDF; toml: of its mechanism.toml, if it has one.
        notes: what was understood otherwise than it is written.
        consistency: bounds on parameters and the total mass, for a consistent fit.
    """

    name: str
    model: pin.Model
    bodies: Bodies
    joints: tuple[Joint, ...]
    closures: tuple[AnyClosure, ...]
    driven: tuple[str, ...]
    passive: tuple[str, ...]
    start: np.ndarray
    unknown: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    multipliers: Multipliers = Multipliers()
    columns: Mapping[str, Column] = field(default_factory=dict)
    urdf: Path = Path()
    toml: Path | None = None
    notes: tuple[str, ...] = ()
    consistency: Consistency = field(default_factory=Consistency)

    @cached_property
    def kinematics(self) -> Kinematics:
        """Φ, J and J̇v as compiled functions."""
        tree = {joint.name: joint.index for joint in self.joints if joint.in_tree}
        return Kinematics(self.model, self.closures, tree)

    @cached_property
    def prior(self) -> np.ndarray:
        """Dynamic parameters (10 · bodies,) of the URDF, in Γ's order."""
        return dynamic_parameters(self.model)

    @cached_property
    def joint_index(self) -> Mapping[str, int]:
        """Where a joint stands in `joints`, by name."""
        return {joint.name: i for i, joint in enumerate(self.joints)}

    def joint(self, name: str) -> Joint:
        """The joint called `name`.

        Raises:
            MechanismError: if there is none, with the nearest name.
        """
        if name not in self.joint_index:
            raise MechanismError(
                f"{self.name}: no joint '{name}'; {one_of(name, self.joint_index)}"
            )
        return self.joints[self.joint_index[name]]

    @cached_property
    def degrees_of_freedom(self) -> int:
        """nv − rank J in general position."""
        return self.model.nv - self.rank

    @cached_property
    def rank(self) -> int:
        """Rank of J in general position, where its redundant equations show."""
        if not self.closures:
            return 0
        J = self.kinematics.closure_rows(self.general[None]).rate[0]
        return rank_of(J)

    @cached_property
    def general(self) -> np.ndarray:
        """A configuration (nq,) near the assembled one that is in no special position.

        Machines are often drawn in one: stretched, folded, at a dead centre.
        """
        q, random = self.assembled, np.random.default_rng(0)
        if not self.closures:
            return q
        J = self.kinematics.closure_rows(q[None]).rate[0]
        free = np.linalg.svd(J)[2][rank_of(J) :]  # directions in which it moves
        step = random.normal(size=len(free)) @ free
        away = pin.integrate(
            self.model, q, AWAY * step / max(np.abs(step).max(initial=0.0), 1e-300)
        )
        found, left = self.kinematics.assemble(away)
        return found if left < 1e-9 else q

    @cached_property
    def assembled(self) -> np.ndarray:
        """The configuration (nq,) nearest to `start` at which all closures hold.

        Raises:
            MechanismError: if the loops cannot be assembled from `start`.
        """
        q, left = self.kinematics.assemble(self.start)
        if left < 1e-9:
            return q
        worst = np.abs(self.kinematics.closure_rows(q[None]).value[0])
        at = int(worst.argmax())
        name, unit = self.kinematics.multipliers[at], self.kinematics.units[at]
        unit = {"N": " m", "N m": " rad"}.get(unit, "")  # what λ does work along
        raise MechanismError(
            f"{self.name}: the loops do not close from [joints] start: the equation '{name}' is "
            f"left at {worst.max():.3g}{unit}; give a start near an assembled position, and check "
            "the closures' frames"
        )

    def with_effect(self, text: str, values: Mapping[str, float] | None = None) -> Mechanism:
        """This mechanism with the effect(s) that `kind:joint[,joint]` or `kind` names.

        `kind` alone stands for every driven joint that does not have it yet, or for the whole
        mechanism, where the effect has no joint. One that it has with known values is unknown then.

        Args:
            text: names it.
            values: parameters that are known, by short name.

        Raises:
            MechanismError: for a kind or joint that is not there, or an effect it has already.
        """
        kind, joints = parse(text)
        cls = KINDS[kind]
        if joints or cls.sits == "mechanism":
            return self + create_effect(kind, joints, values)
        everywhere = {"link": self.bodies.links, "closure": [c.name for c in self.closures]}
        sites = everywhere.get(cls.sits, self.driven)
        if cls.arity != 1 or cls.sits == "place":
            create_effect(kind, joints)  # says how many it needs
        present = {effect.label for effect in self.effects}
        missing = [name for name in sites if f"{kind}:{name}" not in present]
        if not missing:
            what = "link" if cls.sits == "link" else "driven joint"
            raise MechanismError(f"{self.name}: every {what} has '{kind}' already")
        grown = self
        for name in missing:
            grown = grown + create_effect(kind, name, values)
        return grown

    def without(self, label: str) -> Mechanism:
        """This mechanism without one of its effects, named as `kind:joint`.

        Args:
            label: of the effect.

        Raises:
            MechanismError: if it has no such effect.
        """
        labels = [effect.label for effect in self.effects]
        if label not in labels:
            raise MechanismError(f"{self.name}: has no effect '{label}'; {one_of(label, labels)}")
        return replace(self, effects=tuple(e for e in self.effects if e.label != label))

    def __add__(self, effect: Effect) -> Mechanism:
        if not isinstance(effect, Effect):
            return NotImplemented
        rotational = self._sits(effect)
        new = replace(effect, rotational=rotational)
        labels = [own.label for own in self.effects]
        if effect.label not in labels:
            return replace(self, effects=(*self.effects, new))
        at = labels.index(effect.label)
        if effect.known or not self.effects[at].known:
            raise MechanismError(f"{self.name}: has the effect '{effect.label}' already")
        # what was known is known no more
        return replace(self, effects=(*self.effects[:at], new, *self.effects[at + 1 :]))

    def _sits(self, effect: Effect) -> bool:
        """Whether what an effect sits on turns; refuses what it cannot sit on."""
        if effect.sits == "link":
            valid: Sequence[str] = self.bodies.links
        elif effect.sits == "closure":
            valid = [closure.name for closure in self.closures]
        elif effect.sits == "place":
            from ident.mechanism.places import places  # it moves mechanisms, so it knows this file

            valid = places(self)
        else:
            joints = [self.joint(name) for name in effect.joints]
            if effect.sits == "driven":
                undriven = [joint.name for joint in joints if joint.name not in self.driven]
                if undriven:
                    raise MechanismError(
                        f"{self.name}: effect '{effect.label}' is of a drive, and "
                        f"'{undriven[0]}' has none; {one_of(undriven[0], self.driven)}"
                    )
            return joints[0].rotational if joints else True
        for name in effect.joints:
            if name not in valid:
                raise MechanismError(
                    f"{self.name}: effect '{effect.label}': no {effect.sits} '{name}'; "
                    f"{one_of(name, valid)}"
                )
        return True

    def with_model(self, model: pin.Model) -> Mechanism:
        """The mechanism with another model of the same kinematics: other gravity or inertias."""
        other = replace(self, model=model)
        other.__dict__["kinematics"] = self.kinematics  # compiled functions of q alone
        return other

    def __getstate__(self) -> dict[str, object]:
        """Its fields: other processes compile their functions themselves."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def view(self) -> View:
        """The mechanism in 3-D, as it is assembled: a recording in a notebook, `.serve()` a page.

        Loops that do not close are shown as they start, with a note of what is left open.
        """
        from ident.mechanism.shown import view_of  # it looks at mechanisms, so it knows this file

        return view_of(self)

    def _freedom(self) -> str:
        try:
            return f"of rank {self.rank}, {self.degrees_of_freedom} degrees of freedom"
        except MechanismError as error:  # what cannot be assembled can still be printed
            return f"that do not close: {error}"

    def __str__(self) -> str:
        lines = [
            f"mechanism {self.name}: {self.model.nv} coordinates, "
            f"{len(self.kinematics.multipliers)} closure equations {self._freedom()}",
            f"  driven:   {', '.join(self.driven) or 'none'}",
            f"  passive:  {', '.join(self.passive) or 'none'}",
        ]
        lines += [f"  closure:  {closure.name} ({closure.kind})" for closure in self.closures]
        lines += [f"  effect:   {effect.label}" for effect in self.effects]
        lines += [f"  unknown:  {len(self.unknown)} of {len(self.bodies.names)} dynamic parameters"]
        return "\n".join([*lines, *(f"  note:     {note}" for note in self.notes)])

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        said = {
            "Coordinates": str(self.model.nv),
            "Closures": f"{len(self.kinematics.multipliers)} equations {self._freedom()}"
            if self.closures else "",
            "Closed by": ", ".join(f"{each.name} ({each.kind})" for each in self.closures),
            "Effects": ", ".join(each.label for each in self.effects) or "none",
            "Unknown": f"{len(self.unknown)} of {len(self.bodies.names)} dynamic parameters",
        }  # fmt: skip
        rows = [["joint", "", "lower", "upper", "unit"]]
        for joint in self.joints:
            state = "driven" if joint.name in self.driven else "passive"
            rows.append([joint.name, state, f"{joint.lower:.4g}", f"{joint.upper:.4g}", joint.unit])
        notes = folded("Notes", items(self.notes)) if self.notes else Markup("")
        return strong(f"Mechanism {self.name}"), definitions(said), table(rows, "Joints"), notes
