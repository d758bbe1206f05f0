"""What is watched: the rows of the reference with every body open and everything that could change.

    r = b − A x_ref          A: columns of all bodies' parameters and of all suspects, x_ref: known

A suspect is a cause and its columns of A: an effect's own, or for a payload those of its link.
Nothing else is needed of a model: what has changed, how much and how sure, is arithmetic on these.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.diagnose.sites import candidates
from ident.effects import Correcting, Effect, Unknown
from ident.effects.payload import WORDS, Payload
from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.equations.rows import Rows, rows
from ident.equations.scene import Scene
from ident.errors import FitError, one_of
from ident.fit import Fit
from ident.mechanism.mechanism import Mechanism
from ident.monitor.interval import Piece
from ident.monitor.lift import lift
from ident.motion import Experiment, Motion

KINDS = (
    "viscous", "coulomb", "payload", "torque_offset", "torque_gain", "encoder_offset",
    "closure_compliance", "gravity_tilt",
)  # fmt: skip
MORE = (  # that can be watched for, too
    "load_friction", "drag", "spring", "rotor_inertia", "coupling", "delay", "elasticity",
    "backlash", "geometry",
)  # fmt: skip
TOGETHER = ("viscous", "coulomb")  # of one joint: a bearing rarely changes in one of them alone
STICKING = 0.02  # share of a row that may come from standstill, where dry friction is open


@dataclass(frozen=True, eq=False)
class Suspect:
    """A cause that could change, and its k columns.

    Attributes:
        effects: kind and place; several that change together.
        places: (k,) of its columns among all.
        parameters: (k,) what they are; names, units: (k,) of them.
    """

    effects: tuple[Effect, ...]
    places: np.ndarray
    parameters: tuple[Unknown, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]

    @classmethod
    def of(cls, effects: tuple[Effect, ...], columns: Columns) -> Suspect:
        """The suspect whose columns are those of some effects."""
        parameters: list[Unknown] = []
        full: list[str] = []
        for effect in effects:
            open_ = effect.unknowns or effect.shapes
            parameters += open_
            known = zip(effect.names, effect.parameters, strict=True)
            names = [name for name, each in known if each in open_]
            if isinstance(effect, Payload):  # its columns are the link's own
                names = [f"{effect.joints[0]}.{word}" for word in WORDS]
            full += names
        places = np.array([columns.index[name] for name in full])
        units = tuple(columns.units[i] for i in places)
        return cls(effects, places, tuple(parameters), tuple(p.name for p in parameters), units)

    @property
    def label(self) -> str:
        """`coulomb:elbow`, `viscous:elbow + coulomb:elbow`."""
        return " + ".join(effect.label for effect in self.effects)

    @property
    def payload(self) -> bool:
        """Whether it is a body on a link."""
        return isinstance(self.effects[0], Payload)

    def contains(self, other: Suspect) -> bool:
        """Whether it is the other one and more."""
        return set(map(int, other.places)) < set(map(int, self.places))


@dataclass(frozen=True, eq=False)
class Watched:
    """The reference, opened for everything that could change.

    Attributes:
        mechanism: with all suspects; columns: its k unknowns; point: where rows are evaluated.
        reference: (k,) x_ref.
        suspects: what could change.
        joints: of the d coordinates in which torques are compared.
        cutoff: of the rows' filter [Hz].
    """

    mechanism: Mechanism
    columns: Columns
    point: Point
    reference: np.ndarray
    suspects: tuple[Suspect, ...]
    joints: tuple[str, ...]
    cutoff: float | None

    @classmethod
    def of(cls, reference: Fit | Mechanism, motion: Motion, kinds: Sequence[str]) -> Watched:
        """The reference with the suspects of some kinds.

        Args:
            reference: a fit, or a mechanism of which everything is known.
            motion: of normal running.
            kinds: of effects that could change.

        Raises:
            FitError: for a kind that cannot be watched for, or a reference of which something is
                not known.
        """
        for kind in kinds:
            if kind not in (*KINDS, *MORE):
                valid = one_of(kind, (*KINDS, *MORE))
                raise FitError(f"no change of '{kind}' can be watched for; {valid}")
        known, values = _known(reference)
        whole = replace(known, unknown=known.bodies.names, effects=())
        point = Point(values.pi, dict(values.values))
        for effect in known.effects:
            whole = whole + (effect.freed if effect.kind in kinds else effect)
        found = [each for each in candidates(known, motion) if each.kind in kinds]
        shapes: dict[str, float] = {}
        for effect in found:
            if isinstance(effect, Payload):
                continue
            if effect.label not in {own.label for own in whole.effects}:
                whole = whole + effect
            if isinstance(effect, Correcting):
                shapes |= {name: point.values.get(name, 0.0) for name in effect.names}
        point = point.with_values(shapes)
        columns = Columns.of(whole)
        x = np.array([point.values.get(name, 0.0) for name in columns.names])
        x[: len(columns.rigid)] = point.pi[columns.rigid]
        return cls(
            whole, columns, point, x, _suspects(found, columns),
            motion.independent, motion.band.cutoff,
        )  # fmt: skip

    def scene(self, e: Experiment) -> Scene:
        """An experiment as these equations see it."""
        return Scene.of(self.mechanism, self.columns, e, self.point, self.cutoff)

    def pieces(self, e: Experiment) -> Iterator[Piece]:
        """All rows of an experiment."""
        scene = self.scene(e)
        for part in rows(scene, self.cutoff, STICKING):
            yield self.piece(part, scene.e.q[part.sample])

    def piece(self, part: Rows, q: np.ndarray | None = None) -> Piece:
        """Rows with the reaction of the multipliers at the configurations q (n, nq), if given."""
        joints = self.joints
        m = len(self.mechanism.kinematics.multipliers)
        G = np.zeros((len(part.t), m, len(joints)))
        if q is not None:
            G = lift(self.mechanism, joints, q)
        return Piece(part.t, part.A, part.b, part.tau, part.informed, G)

    @property
    def errors(self) -> tuple[str, ...]:
        """(d + m,) names of the joints and multipliers whose errors are watched."""
        return (*self.joints, *self.mechanism.kinematics.multipliers)

    def __str__(self) -> str:
        alone = (s.effects[0].kind for s in self.suspects if len(s.effects) == 1)
        return ", ".join(f"{kind} ({count})" for kind, count in Counter(alone).items())


def _known(reference: Fit | Mechanism) -> tuple[Mechanism, Point]:
    """The mechanism with its effects at known values, and all values."""
    if isinstance(reference, Fit):
        effects = []
        for effect, solution in reference.effect_solution:
            named = zip(effect.parameters, solution, strict=True)
            values = {each.name: float(v) for each, v in named}
            effects.append(replace(effect, values={**effect.values, **values}))
        mechanism = replace(reference.mechanism, effects=tuple(effects), unknown=())
        return mechanism, Point(reference.point.pi, Point.prior(mechanism).values)
    open_ = [*reference.unknown, *(e.label for e in reference.effects if not e.known)]
    if open_:
        raise FitError(
            f"{reference.name}: a reference must be known, and {open_[0]} is not; give a fit, or "
            "the folder identified/ that a fit writes"
        )
    return reference, Point.prior(reference)


def _suspects(effects: Sequence[Effect], columns: Columns) -> tuple[Suspect, ...]:
    """Every effect alone, and the friction of every joint together."""
    groups: list[tuple[Effect, ...]] = [(effect,) for effect in effects]
    for name in dict.fromkeys(e.joints[0] for e in effects if e.kind in TOGETHER):
        pair = tuple(e for e in effects if e.kind in TOGETHER and e.joints[0] == name)
        groups += [pair] if len(pair) > 1 else []
    return tuple(Suspect.of(group, columns) for group in groups)
