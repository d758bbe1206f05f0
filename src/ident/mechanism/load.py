"""From files to a Mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ident.description.urdf import parse_urdf, read_source
from ident.effects import KINDS, Effect, read_user_effect
from ident.effects import create as create_effect
from ident.errors import MechanismError, one_of
from ident.log import Column
from ident.mechanism.closures import AnyClosure, Linear
from ident.mechanism.consistency import read_consistency
from ident.mechanism.forward import is_rotational
from ident.mechanism.mechanism import DEGREES, Joint, Mechanism, Multipliers
from ident.mechanism.model import Tree, build_tree
from ident.mechanism.parameters import Bodies
from ident.mechanism.read_closure import read_closure
from ident.mechanism.settings import (
    GRAVITY,
    Settings,
    check_keys,
    number,
    read_settings,
    text,
    with_source,
    words,
)


def load(path: str | Path, *, allow_code: bool = False) -> Mechanism:
    """The mechanism of a folder with a mechanism.toml, of such a file, or of a bare URDF.

    In a URDF's place may stand a MuJoCo model (`.xml`) or an SDF, with the loops it has.

    Args:
        path: folder, `mechanism.toml`, `.urdf`, `.xml` or `.sdf`.
        allow_code: whether closures of kind `function` and effects of one's own may run the Python
            files they name.

    Raises:
        MechanismError: one line that names the file, what is wrong and what would be valid.
    """
    settings = read_settings(Path(path))
    where = settings.where
    source = read_source(settings.urdf)
    settings = with_source(settings, source)
    urdf = str(settings.urdf)
    tree = build_tree(parse_urdf(source.urdf, urdf), settings.gravity or GRAVITY, urdf)
    tree = replace(
        tree,
        auxiliary=(*tree.auxiliary, *source.auxiliary),
        notes=(*source.notes, *tree.notes),
    )
    joints = _tree_joints(tree)
    names = [joint.name for joint in joints]
    check_keys(settings.joints, ("passive", "start"), f"{where}: [joints]")
    given = words(settings.joints, "passive", f"{where}: [joints]") or ()
    for name in given:
        if name not in names:
            raise MechanismError(
                f"{where}: [joints] passive: no joint '{name}'; {one_of(name, names)}"
            )
    mimicking = [mimic.joint for mimic in tree.mimics]
    passive = tuple(name for name in names if name in given or name in mimicking)
    bodies = Bodies(tree.links)
    mechanism = Mechanism(
        name=_name(Path(path), settings),
        model=tree.model,
        bodies=bodies,
        joints=joints,
        closures=_closures(settings, tree, joints, allow_code),
        driven=tuple(name for name in names if name not in passive),
        passive=passive,
        start=_start(settings, tree, joints),
        unknown=_unknown(settings, bodies, tree.auxiliary),
        multipliers=_multipliers(settings),
        columns=_columns(settings),
        urdf=settings.urdf,
        toml=settings.toml,
        notes=tree.notes,
        consistency=read_consistency(settings.parameters, bodies, f"{where}: [parameters]"),
    )
    mechanism = replace(
        mechanism, notes=(*tree.notes, *_undriven(mechanism), *_massless(mechanism))
    )
    mechanism = with_own_joints(mechanism)
    _check_columns(mechanism, settings)
    return _with_effects(mechanism, settings, allow_code)


def _name(path: Path, settings: Settings) -> str:
    if settings.urdf == path:
        return path.stem
    return settings.folder.resolve().name


def _tree_joints(tree: Tree) -> tuple[Joint, ...]:
    model = tree.model
    joints = []
    for index in range(1, model.njoints):
        at = model.idx_vs[index]
        joints.append(
            Joint(
                name=model.names[index],
                rotational=is_rotational(model, index),
                index=at,
                lower=_limit(model.lowerPositionLimit[at]),
                upper=_limit(model.upperPositionLimit[at]),
                velocity=_limit(model.upperVelocityLimit[at]),
                effort=_limit(model.upperEffortLimit[at]),
            )
        )
    return tuple(joints)


def _limit(value: float) -> float:
    return float(value) if abs(value) < 1e8 else float(np.copysign(np.inf, value))


def _closures(
    settings: Settings, tree: Tree, joints: tuple[Joint, ...], allow_code: bool
) -> tuple[AnyClosure, ...]:
    found: list[AnyClosure] = []
    rotational = {joint.name: joint.rotational for joint in joints}
    places = [f"{settings.urdf}: loop {i + 1}" for i in range(len(settings.beside))]
    places += [f"{settings.where}: closure {i + 1}" for i in range(len(settings.closures))]
    for table, where in zip((*settings.beside, *settings.closures), places, strict=True):
        closure = read_closure(table, where, tree.model, rotational, settings.folder, allow_code)
        if closure.name in {other.name for other in found}:
            raise MechanismError(f"{settings.where}: two closures are named '{closure.name}'")
        found.append(closure)
    for mimic in tree.mimics:
        found.append(
            Linear(
                f"mimic.{mimic.joint}",
                (mimic.joint, mimic.of),
                (1.0, -mimic.multiplier),
                mimic.offset,
                rotational[mimic.joint],
            )
        )
    return tuple(found)


def with_own_joints(mechanism: Mechanism) -> Mechanism:
    """The mechanism with the closures' own joints among its joints, passive."""
    own = tuple(
        Joint(joint.name, joint.rotational, index, in_tree=False)
        for index, joint in enumerate(mechanism.kinematics.own)
        if joint.name not in mechanism.joint_index
    )
    return replace(mechanism, joints=(*mechanism.joints, *own)) if own else mechanism


def _start(settings: Settings, tree: Tree, joints: tuple[Joint, ...]) -> np.ndarray:
    q = pin.neutral(tree.model)
    table = settings.joints.get("start", {})
    where = f"{settings.where}: [joints] start"
    if not isinstance(table, dict):
        raise MechanismError(f"{where} = {table!r}; write {{ joint = 0.0, … }}")
    names = {joint.name: joint.index for joint in joints}
    for name in table:
        if name not in names:
            raise MechanismError(f"{where}: no joint '{name}'; {one_of(name, names)}")
        q[names[name]] = number(table, name, where)
    return q


def _undriven(mechanism: Mechanism) -> list[str]:
    """Whether no torque would be measured."""
    if mechanism.driven or not mechanism.passive:
        return []
    return [
        "nothing is driven: [joints] passive names every joint, so no torque is compared with a "
        "model; leave out the joints whose torque is logged"
    ]


def _massless(mechanism: Mechanism) -> list[str]:
    """Bodies to be identified of which the URDF says nothing."""
    asked = {name.rsplit(".", 1)[0] for name in mechanism.unknown}
    return [
        f"link '{link}' has no <inertial>; its prior is massless"
        for link in mechanism.bodies.links
        if link in asked and not mechanism.prior[mechanism.bodies.columns(link)].any()
    ]


def _unknown(settings: Settings, bodies: Bodies, auxiliary: tuple[str, ...]) -> tuple[str, ...]:
    where = f"{settings.where}: [parameters]"
    check_keys(settings.parameters, ("unknown", "bounds", "total_mass"), where)
    patterns = words(settings.parameters, "unknown", where)
    if patterns is None:
        patterns = tuple(link for link in bodies.links if link not in auxiliary)
    return bodies.select(patterns, where)


def _multipliers(settings: Settings) -> Multipliers:
    where = f"{settings.where}: [multipliers]"
    check_keys(settings.multipliers, ("basis", "spacing"), where)
    basis = text({"basis": "free", **settings.multipliers}, "basis", where)
    return multipliers(basis, number(settings.multipliers, "spacing", where, 0.0), where)


def multipliers(basis: str, spacing: float, where: str) -> Multipliers:
    """A checked time basis.

    Raises:
        MechanismError: for a basis that is not there, or one that needs a spacing [s] and has none.
    """
    if basis not in DEGREES:
        raise MechanismError(f"{where}: basis = '{basis}'; {one_of(basis, DEGREES)}")
    if basis != "free" and not 0 < spacing < np.inf:
        raise MechanismError(
            f"{where}: basis '{basis}' needs a spacing above 0 s, such as 0.01; given: {spacing:g}"
        )
    return Multipliers(basis, spacing)


def _columns(settings: Settings) -> Mapping[str, Column]:
    found = {}
    for name, entry in settings.log.items():
        where = f'{settings.where}: [log] "{name}"'
        if isinstance(entry, str):
            entry = {"column": entry}
        if not isinstance(entry, dict):
            raise MechanismError(f'{where} = {entry!r}; write {{ column = "…", scale = 1.0 }}')
        check_keys(entry, ("column", "scale", "offset"), where)
        scale = number(entry, "scale", where, 1.0)
        if scale == 0:
            raise MechanismError(f"{where}: scale = 0 would erase the column")
        found[name] = Column(
            text(entry, "column", where), scale, number(entry, "offset", where, 0.0)
        )
    return found


def _check_columns(mechanism: Mechanism, settings: Settings) -> None:
    """A mapped name that nothing reads would be silently ignored."""
    for name in mechanism.columns:
        prefix, _, joint = name.partition(".")
        if prefix in ("q", "v", "a", "tau") and joint not in mechanism.joint_index:
            raise MechanismError(
                f"{settings.where}: [log] \"{name}\": no joint '{joint}'; "
                f"{one_of(joint, mechanism.joint_index)}"
            )


def _with_effects(mechanism: Mechanism, settings: Settings, allow_code: bool) -> Mechanism:
    for i, table in enumerate(settings.effects):
        where = f"{settings.where}: effect {i + 1}"
        try:
            effect = _effect(table, where, settings.folder, allow_code)
            if effect.label in {own.label for own in mechanism.effects}:
                raise MechanismError(f"has the effect '{effect.label}' already")
            mechanism = mechanism + effect
        except MechanismError as error:
            message = str(error)
            raise MechanismError(message if where in message else f"{where}: {message}") from None
    return mechanism


def _effect(table: Mapping[str, Any], where: str, folder: Path, allow_code: bool) -> Effect:
    """The effect of one [[effect]]: of the library, or with `file` one of the user's own."""
    kind = text(table, "kind", where)
    values = {
        key: number(table, key, where) for key in table if key not in ("kind", "joint", "file")
    }
    if "file" in table:
        file = folder / text(table, "file", where)
        joints = tuple(part.strip() for part in text(table, "joint", where).split(","))
        return read_user_effect(file, kind, allow_code=allow_code, where=where)(joints, values)
    if kind not in KINDS:
        raise MechanismError(
            f"{where}: there is no effect '{kind}'; {one_of(kind, KINDS)}; one of your own needs "
            'file = "….py"'
        )
    alone = KINDS[kind].arity == 0 and "joint" not in table
    return create_effect(kind, "" if alone else text(table, "joint", where), values)
