"""From a folder, a mechanism.toml or a bare URDF (or MuJoCo model) to a Mechanism.

The same mechanism may have absolute coordinates: every moving body free, every joint a closure.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from ident.effects import KINDS, PER_LOG, Effect, create, read_user_effect
from ident.errors import MechanismError, missing_file, one_of
from ident.files import TomlTable, is_number, read_toml, suffixes
from ident.log import Column
from ident.mechanism.calibration import read_calibration
from ident.mechanism.chains import (
    BASE,
    FOUR_TURNS,
    GIMBAL,
    ORDERS,
    chains_of,
    expand,
    floating_base,
    may_float,
    pose_names,
)
from ident.mechanism.closures import (
    Closure,
    Context,
    Frame,
    PrismaticClosure,
    RevoluteClosure,
    read_closure,
)
from ident.mechanism.description import (
    Description,
    Tree,
    align_z,
    build_tree,
    is_rotational,
    joint_axis,
    lock,
    parse_urdf,
    read_description,
)
from ident.mechanism.drives import read_drives
from ident.mechanism.idle import spins
from ident.mechanism.mechanism import Joint, Mechanism, multipliers
from ident.mechanism.motors import (
    Motor,
    add_motors,
    motors_of_file,
    moved_by,
    read_motors,
    starts_of,
)
from ident.mechanism.parameters import COUNT, Bodies, read_consistency, read_covariance
from ident.text import listed

TOP = (
    "urdf", "gravity", "base", "joints", "closure", "parameters", "multipliers", "log", "effect",
    "drives", "motors", "calibration",
)  # fmt: skip
GRAVITY = (0.0, 0.0, -9.81)  # range: [m/s²]
LIMITLESS = 1e8  # range: from which a limit of a URDF is none
CHANNELS = ("q", "v", "a", "tau")
WORDS = re.compile(
    r"hand|finger|thumb|gripper|knuckle|jaw|claw|(?<![a-z])(index|middle|pinky)(?![a-z])", re.I
)


def load(
    path: str | Path,
    *,
    allow_code: bool = False,
    locked: Mapping[str, float | None] | None = None,
    unmeasured: Collection[str] = (),
) -> Mechanism:
    """The mechanism of a folder with a mechanism.toml, of such a file, or of a bare URDF.

    In a URDF's place may stand a MuJoCo model (`.xml`) or a format of another package, with the
    loops it has. A folder that `ident identify --out` wrote is its model: with the identified
    values as its prior, and what was unknown is unknown again.

    Args:
        path: folder, `mechanism.toml`, `.urdf` or `.xml`.
        allow_code: whether closures of kind `function` and effects of one's own may run the Python
            files they name.
        locked: joints to hold at a coordinate [rad | m], beside those of [joints] locked; at their
            start where it is None.
        unmeasured: driven joints without a torque sensor, beside those of [joints] unmeasured.

    Raises:
        MechanismError: one line that names the file, what is wrong and what would be valid.
    """
    path = Path(path)
    if has_identified(path) and not (path / "mechanism.toml").exists():
        known = load(
            path / "identified", allow_code=allow_code, locked=locked, unmeasured=unmeasured
        )
        return _unknown_again(known, path / "fit.json")
    mechanism = _read(path, allow_code, locked or {}, unmeasured)
    turned = spins(mechanism)
    if not turned:
        return mechanism
    start = mechanism.found_start  # so that the same configuration is found again
    angles = {spin.joint: spin.value for spin in turned}
    mechanism = _read(path, allow_code, locked or {}, unmeasured, angles, start)
    unseen = {name for spin in turned for name in spin.unseen} & {*mechanism.unknown}
    rods = listed(dict.fromkeys(link for spin in turned for link in spin.links))
    at = listed(f"{name} = {value:.4g}" for name, value in angles.items())
    note = f"{rods} can turn about themselves, which moves nothing else: {at} rad held"
    if unseen:
        note += f", and {len(unseen)} parameters that only such a turn shows stay as they are"
    return replace(
        mechanism,
        unknown=tuple(name for name in mechanism.unknown if name not in unseen),
        notes=(*mechanism.notes, note),
    )


def _read(
    path: Path,
    allow_code: bool,
    locked: Mapping[str, float | None],
    unmeasured: Collection[str],
    idle: Mapping[str, float] | None = None,
    begin: Mapping[str, float] | None = None,
) -> Mechanism:
    """Return the mechanism as `load` does; `idle` turns of rods are locked there as well, and the
    search for an assembled configuration may `begin` elsewhere than the file says.
    """
    idle = idle or {}
    toml = _toml_of(path)
    top, urdf, name = TomlTable(str(path)), path, path.stem
    if toml is not None:
        top, name = read_toml(toml), _name_of(toml.parent.resolve())
        top.check(*TOP)
        if "urdf" not in top:
            raise top.error("has no key 'urdf'; write urdf = \"<name>.urdf\"")
        urdf = toml.parent / top.text("urdf")
        if not urdf.is_file():
            raise top.error(f"urdf = '{top.data['urdf']}': no such file in {toml.parent}")
    for key in ("base", "joints", "parameters", "multipliers", "log", "calibration", "motors"):
        top.table(key)
    closures, effects = (top.tables(key) for key in ("closure", "effect"))
    source = read_description(urdf, sidecars="closure" not in top.data)
    loops = (TomlTable(f"{urdf}: loop {i}", table) for i, table in enumerate(source.closures, 1))
    top = replace(top, data=stated(top.data, source))
    robot = parse_urdf(source.urdf, str(urdf))
    to_lock = _locked(top.table("joints"), {**locked, **idle})
    if begin:
        joints_data = {**top.data["joints"], "start": {**begin}}
        top = replace(top, data={**top.data, "joints": joints_data})
    floats = "" if "kind" in top.table("base") else may_float(robot)
    chained = _expanded(robot, str(urdf), top, to_lock)
    tied = bool(source.closures or closures or robot.find("joint/mimic") is not None)
    motor_notes: tuple[str, ...] = ()
    if "motors" in top:
        motors = read_motors(top.table("motors"), robot, to_lock, tied)
    else:
        rows = TomlTable(str(urdf), dict(source.motors))
        motors, motor_notes = motors_of_file(rows, robot, to_lock, tied)
    top = _started(top, motors)
    ties = [TomlTable("[motors]", table) for table in add_motors(robot, motors, to_lock)]
    locks, outside = lock(robot, to_lock, str(urdf))
    tree = build_tree(robot, top.vector("gravity", 3), str(urdf))
    mimics = (TomlTable(f"{urdf}: mimic {table['joints'][0]}", table) for table in tree.mimics)
    bodies, joints = Bodies(tree.links), _tree_joints(tree)
    logged = _columns(top.table("log"), [*(joint.name for joint in joints), *locks])
    folder = (toml or urdf).parent
    context = Context(tree.model, folder, allow_code, bool(locks))
    passive, start = _passive_and_start(top.table("joints"), tree, joints, locks)
    passive |= ({*chained.passive} | moved_by(motors)) - {*locks}
    basis, parameters = top.table("multipliers"), top.table("parameters")
    basis.check("basis", "spacing")
    parameters.check("unknown", "known", "bounds", "total_mass", "covariance")
    rotors = [motor.link for motor in motors]
    massless = {*source.auxiliary, *chained.links, *rotors}
    asked = [link for link in bodies.links if link not in massless]
    if "unknown" in parameters:  # links of locked joints are part of others
        locked_joints = (joint for joint in robot.findall("joint") if joint.get("name") in locks)
        parts = {joint.find("child").get("link") for joint in locked_joints}
        every = parameters.words("unknown")
        asked = [x for x in every if x not in parts and x.rpartition(".")[0] not in parts]
    known = {*bodies.select(parameters.words("known"), parameters.where)}
    constraints = tuple(
        read_closure(table, context) for table in (*loops, *closures, *mimics, *ties)
    )
    driven = tuple(joint.name for joint in joints if joint.name not in passive)
    without = _unmeasured(
        top.table("joints"),
        unmeasured if isinstance(unmeasured, str) else {*unmeasured, *chained.gimbals},
        driven,
        locks,
        bool(passive),
    )
    if without and constraints:
        raise top.table("joints").error(
            f"unmeasured: {listed(without)}: closures pass its torque on to all equations, so none "
            "can do without it; put it among the passive joints if it has no motor"
        )
    mechanism = Mechanism(
        name=name,
        model=tree.model,
        bodies=bodies,
        joints=joints,
        closures=constraints,
        driven=driven,
        passive=tuple(joint.name for joint in joints if joint.name in passive),
        start=start,
        unknown=tuple(x for x in bodies.select(asked, parameters.where) if x not in known),
        multipliers=multipliers(
            basis.text("basis", "free"), basis.number("spacing", 0.0), basis.where
        ),
        columns={
            name: replace(column, required=name.partition(".")[2] not in locks)
            for name, column in logged.items()
        },
        urdf=urdf,
        toml=toml,
        locked=locks,
        idle=tuple(idle),
        chains=chains_of(robot, str(urdf)),
        unmeasured=without,
        motors=motors,
        consistency=read_consistency(parameters, bodies),
        covariance=read_covariance(parameters, folder),
        calibration=read_calibration(
            top.table("calibration"),
            [*(joint.name for joint in joints), *(closure.name for closure in constraints)],
        ),
        plausible=tree.plausible,
    )
    names = [closure.name for closure in mechanism.closures]
    if twice := [name for name in names if names.count(name) > 1]:
        raise top.error(f"two closures are named '{twice[0]}'")
    still = {name: value for name, value in locks.items() if name not in idle}
    at = ", ".join(f"{name} at {value:.4g}" for name, value in still.items())
    locking = f"locked: {at}" if at else ""
    of_source = (*source.notes, *motor_notes, *tree.notes)
    remarks = [unused_toml(urdf, toml), *of_source, floats, locking, *outside]
    closure_joints = (
        Joint(joint.name, joint.rotational, index, in_tree=False)
        for index, joint in enumerate(mechanism.kinematics.closure_joints)
    )
    notes = (*filter(None, remarks), *_remarks(mechanism))
    mechanism = replace(mechanism, notes=notes, joints=(*joints, *closure_joints))
    for column in mechanism.columns:  # a mapped name that nothing reads would be ignored
        prefix, _, joint = column.partition(".")
        named = {*mechanism.joint_index, *locks, *pose_names(mechanism.chains)}
        if prefix in CHANNELS and joint not in named:
            valid = one_of(joint, mechanism.joint_index)
            raise top.error(f"[log] \"{column}\": no joint '{joint}'; {valid}")
    if "drives" in top:
        for drive in read_drives(top.table("drives"), mechanism.driven):
            mechanism = mechanism + drive
    without_joint: list[str] = []
    for table in effects:
        kind, joints = table.text("kind"), table.data.get("joint", "")
        if kind not in KINDS and "file" not in table:
            valid = f'{one_of(kind, KINDS)}; one of your own needs file = "….py"'
            raise table.error(f"there is no effect '{kind}'; {valid}")
        if isinstance(joints, str) and {*locks} & {*joints.replace(" ", "").split(",")}:
            without_joint.append(f"{kind}:{joints}")  # its file is not run
            continue
        try:
            effect = _effect(table, context)
            if effect.label in {present.label for present in mechanism.effects}:
                raise MechanismError(f"has the effect '{effect.label}' already")
            mechanism = mechanism + effect
        except MechanismError as error:
            raise (error if table.where in str(error) else table.error(str(error))) from None
    if without_joint:
        note = f"left out, since a locked joint does not move: {listed(without_joint)}"
        mechanism = replace(mechanism, notes=(*mechanism.notes, note))
    return mechanism


def source_of(mechanism: Mechanism) -> Description:
    """Return what the file behind a mechanism says, and loops beside it if `load` reads them."""
    toml = mechanism.toml
    sidecars = toml is None or "closure" not in read_toml(toml)
    return read_description(mechanism.urdf, sidecars=sidecars)


def has_identified(path: Path) -> bool:
    """Return whether a folder has a fit and what it identified, as `identify` and `grow` write."""
    return all((path / x).is_file() for x in ("fit.json", "identified/mechanism.toml"))


def _name_of(folder: Path) -> str:
    """Return a folder's name, of the `identified` one beside a fit that of the fitted mechanism."""
    if folder.name == "identified":
        with suppress(OSError, ValueError, KeyError, TypeError):
            return str(json.loads((folder.parent / "fit.json").read_text("utf-8"))["mechanism"])
    return folder.name


def _unknown_again(known: Mechanism, file: Path) -> Mechanism:
    """Return an identified mechanism in which what its fit.json estimated is unknown."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        name, bodies = str(data["mechanism"]), [str(body["name"]) for body in data["parameters"]]
        values = [value for effect in data["effects"] for value in effect["parameters"]]
        free = {value["name"] for value in values if value["stderr"] != 0.0}  # 0: it was given
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MechanismError(
            f"{file}: is no complete fit.json ({error}); identify again, or give {file.parent}/"
            "identified, in which everything is known"
        ) from None
    unknown = known.bodies.select(bodies, str(file))
    estimated = {*unknown, *free}
    errors = known.covariance and known.covariance.without(estimated)
    return replace(known.freed(estimated), name=name, covariance=errors, plausible=None)


def unused_toml(urdf: Path, toml: Path | None) -> str:
    """Return the note on a mechanism.toml beside a bare URDF; "" where there is none."""
    toml_beside = urdf.parent / "mechanism.toml"
    if toml is not None or urdf == Path() or not toml_beside.is_file():
        return ""
    return (
        f"{toml_beside} is there, and is not used with {urdf.name}: give the folder, {urdf.parent}"
    )


def _toml_of(path: Path) -> Path | None:
    if path.is_dir():
        if not (path / "mechanism.toml").is_file():
            raise MechanismError(
                f"{path}: the folder has no mechanism.toml; give a URDF or add one"
            )
        return path / "mechanism.toml"
    if not path.exists():
        raise MechanismError(
            f"{path}: {missing_file(path)}; give a folder, a mechanism.toml or a .urdf"
        )
    if path.suffix.lower() == ".toml":
        return path
    if path.suffix.lower() in suffixes("mechanism"):
        return None
    raise MechanismError(
        f"{path}: is no mechanism; give a folder, a mechanism.toml, or a file of "
        f"{', '.join(suffixes('mechanism'))}"
    )


def stated(data: Mapping[str, Any], source: Description) -> dict[str, Any]:
    """The [joints] and gravity of a mechanism.toml, and where it is silent those of its URDF."""
    given = data.get("joints", {})
    joints = {**({"passive": list(source.passive)} if source.passive else {}), **given}
    if source.start and isinstance(given.get("start", {}), dict):
        joints["start"] = {**source.start, **given.get("start", {})}
    gravity = data.get("gravity", list(source.gravity or GRAVITY))
    return {**data, "joints": joints, "gravity": gravity}


def _started(top: TomlTable, motors: Sequence[Motor]) -> TomlTable:
    """Return the mechanism.toml with the starts of motors, which follow from those of joints."""
    if not motors:
        return top
    joints = top.data.get("joints", {})
    start = joints.get("start", {})
    if not isinstance(start, dict):
        return top
    joints = {**joints, "start": {**starts_of(motors, start), **start}}
    return replace(top, data={**top.data, "joints": joints})


def _effect(table: TomlTable, context: Context) -> Effect:
    kind = table.text("kind")
    words = ("kind", "joint", "frame", "file", "signal", "per", "log")
    values = {key: table.number(key) for key in table.data if key not in words}
    per, log = (table.text(key) if key in table else "" for key in ("per", "log"))
    if "file" in table:
        file = context.folder / table.text("file")
        at_frame = "frame" in table
        joints = tuple(x.strip() for x in table.text("frame" if at_frame else "joint").split(","))
        read = read_user_effect(
            file, kind, allow_code=context.allow_code, where=table.where, at_frame=at_frame
        )
        return replace(read(joints, values), per=per or (log and PER_LOG), log=log)
    alone = KINDS[kind].arity == 0 and "joint" not in table
    signal = table.text("signal") if "signal" in table else ""
    site = "frame" if KINDS[kind].sits == "frame" and "joint" not in table else "joint"
    return create(kind, "" if alone else table.text(site), values, signal=signal,
        per=per or (log and PER_LOG), log=log,
    )  # fmt: skip


def _tree_joints(tree: Tree) -> tuple[Joint, ...]:
    m = tree.model
    limits = np.stack(
        [m.lowerPositionLimit, m.upperPositionLimit, m.upperVelocityLimit, m.upperEffortLimit], 1
    )
    limits = np.where(np.abs(limits) < LIMITLESS, limits, np.copysign(np.inf, limits))
    return tuple(
        Joint(m.names[i], is_rotational(m, i), m.idx_vs[i], True, *limits[m.idx_vs[i]].tolist())
        for i in range(1, m.njoints)
    )


def _locked(section: TomlTable, asked: Mapping[str, float | None]) -> dict[str, float]:
    """Return the joints to hold and where, those of [joints] locked and those asked for."""
    start, given = _coordinates(section, "start"), _coordinates(section, "locked")
    locked = {name: given.number(name) for name in given.data}
    return locked | {
        name: start.number(name, 0.0) if value is None else value for name, value in asked.items()
    }


def _coordinates(section: TomlTable, key: str) -> TomlTable:
    """Return a table of [joints] that has a coordinate [rad | m] by joint."""
    given = section.data.get(key)
    names = given if given and isinstance(given, list) else ["joint"]
    return section.table(key, ", ".join(f"{name} = 0.0" for name in names))


def _passive_and_start(
    section: TomlTable, tree: Tree, joints: tuple[Joint, ...], locked: Collection[str]
) -> tuple[set[str], np.ndarray]:
    section.check("passive", "start", "locked", "unmeasured", "order")
    q, places = pin.neutral(tree.model), {joint.name: joint.index for joint in joints}
    start = section.table("start")
    passive: list[str] = []
    for word in section.words("passive"):  # a joint of several coordinates stands for all of them
        chain = [name for name in places if name.rpartition(".")[0] == word and word not in places]
        passive += chain or [word]
    for key, names in (("passive", passive), ("start", start.data)):
        for name in names:
            if name not in places and name not in locked and name.rpartition(".")[0] not in locked:
                raise section.error(f"{key}: no joint '{name}'; {one_of(name, places)}")
    for name in {*start.data} & {*places}:
        q[places[name]] = start.number(name)
    return {*passive, *(mimic["joints"][0] for mimic in tree.mimics)}, q


@dataclass(frozen=True)
class _Chained:
    """Scalar joints in the place of joints of several coordinates, and the links between them."""

    passive: tuple[str, ...]
    links: tuple[str, ...]
    gimbals: tuple[str, ...]  # turns that are prescribed, without an equation of their own


def _expanded(
    robot: etree._Element, where: str, top: TomlTable, locked: Collection[str]
) -> _Chained:
    """Replace floating, planar and ball joints of a `<robot>` by chains, with those of [base]."""
    base, section = top.table("base", 'kind = "floating"'), top.table("joints")
    base.check("kind", "order")
    kind = base.text("kind", "fixed")
    if kind not in ("fixed", "floating"):
        raise base.error(f"kind = '{kind}'; {one_of(kind, ('floating', 'fixed'))}")
    if kind == "floating":
        floating_base(robot, where)
    orders = section.table("order", 'ball = "zyx"')
    named = {name: orders.text(name) for name in orders.data}
    if "order" in base:
        named[BASE] = base.text("order")
    for name, order in named.items():
        if order not in (*ORDERS, *FOUR_TURNS):
            valid = f"{one_of(order, ORDERS)}; of a body that tumbles four, as xzyx"
            raise section.error(f"order of '{name}' = '{order}'; {valid}")
    before = {joint.get("name") for joint in robot.findall("joint")}
    starts = {k: x for k, x in section.data.get("start", {}).items() if is_number(x)}
    links = expand(robot, where, locked, named, starts)
    after = (joint.get("name") for joint in robot.findall("joint"))
    new = [name for name in after if name not in before]
    gimbals = tuple(name for name in new if name.rpartition(".")[2] == GIMBAL)
    return _Chained(tuple(x for x in new if x not in gimbals), tuple(links), gimbals)


def _unmeasured(
    section: TomlTable,
    asked: Collection[str],
    driven: Sequence[str],
    locked: Collection[str],
    passive: bool,
) -> tuple[str, ...]:
    """Return the driven joints without a torque sensor, of [joints] unmeasured and asked for; all,
    where others are `passive`, as of a car whose steering is logged.
    """
    if isinstance(asked, str):
        raise section.error(f"unmeasured = '{asked}'; give a list of joints, as ['{asked}']")
    names = {*section.words("unmeasured"), *asked} - {*locked}
    for name in sorted(names - {*driven}):
        raise section.error(f"unmeasured: '{name}' is no driven joint; {one_of(name, driven)}")
    if names and names == {*driven} and not passive:
        raise section.error("unmeasured: names every driven joint, so no torque is left")
    return tuple(name for name in driven if name in names)


def _remarks(mechanism: Mechanism) -> list[str]:
    asked = {name.rsplit(".", 1)[0] for name in mechanism.unknown}
    remarks = [
        f"link '{link}' has no <inertial>; its prior is massless"
        for link in mechanism.bodies.links
        if link in asked and not mechanism.prior[mechanism.bodies.columns(link)].any()
    ]
    if mechanism.has_dummy_bodies:
        mass = float(mechanism.prior[::COUNT].max())
        remarks.append(
            f"all bodies have the same mass ({mass:.3g} kg) and inertia, at their frames: "
            "placeholders, against which the size of no torque is held"
        )
    if not mechanism.driven:
        remarks.append(
            "nothing is driven: [joints] passive names every joint, so all torques are taken as 0 "
            "and the machine swings freely; leave out the joints whose torque is logged"
        )
    return remarks


def _columns(table: TomlTable, joints: Sequence[str]) -> dict[str, Column]:
    """Return the columns of [log]; `*` makes one of every joint that has none of its own."""
    columns: dict[str, Column] = {}
    for name, entry in table.data.items():
        where = f'{table.where} "{name}"'
        if isinstance(entry, str):
            entry = {"column": entry}
        if not isinstance(entry, dict):
            raise MechanismError(f'{where} = {entry!r}; write {{ column = "…", scale = 1.0 }}')
        column = TomlTable(where, entry)
        column.check("column", "scale", "offset")
        scale = column.number("scale", 1.0)
        if scale == 0:
            raise column.error("scale = 0 would erase the column")
        columns[name] = Column(column.text("column"), scale, column.number("offset", 0.0))
    taken = {column.column for name, column in columns.items() if "*" not in name}
    for pattern in [name for name in columns if "*" in name]:
        source, (before, _, after) = columns.pop(pattern), pattern.partition("*")
        channel, _, begin = before.partition(".")
        matching = [x for x in joints if len(x) >= len(begin + after)]
        matching = [x for x in matching if x.startswith(begin) and x.endswith(after)]
        if "." not in before or "*" in after or source.column.count("*") != 1:
            raise MechanismError(
                f'{table.where} "{pattern}" = "{source.column}": one * of each stands for the '
                'name of a joint, or its rest, as in "q.*" = "position.*"'
            )
        if not matching:
            raise MechanismError(
                f'{table.where} "{pattern}": is the name of no joint; {one_of(begin, joints)}'
            )
        for joint in matching:
            word = joint[len(begin) : len(joint) - len(after)]
            if source.column.replace("*", word) in taken:  # it is another's by its own entry
                continue
            new = replace(source, column=source.column.replace("*", word), group=pattern)
            if columns.setdefault(f"{channel}.{joint}", new).group not in ("", pattern):
                raise MechanismError(
                    f'{table.where} "{pattern}": {channel}.{joint} is also made by '
                    f'"{columns[f"{channel}.{joint}"].group}"; leave out one of them'
                )
    return columns


def unlogged_hands(mechanism: Mechanism, columns: Iterable[str]) -> tuple[str, ...]:
    """Return driven joints of hands and fingers of which a log with these columns has none: their
    own name, their link's or that of an unlogged joint before is a word for one.
    """
    given = {*columns}
    given |= {name for name, column in mechanism.sources.items() if column.column in given}
    logged = {
        joint for prefix, _, joint in (name.partition(".") for name in given) if prefix in CHANNELS
    }
    if given and not logged:
        return ()  # columns are not mapped yet
    model, hands = mechanism.model, set[int]()
    for i, link in enumerate(mechanism.bodies.links, 1):
        is_hand = any(map(WORDS.search, (model.names[i], link)))
        free = logged.isdisjoint(model.names[j] for j in model.subtrees[i])
        if free and (is_hand or model.parents[i] in hands):
            hands.add(i)
    return tuple(model.names[i] for i in sorted(hands) if model.names[i] in mechanism.driven)


HALF_TURN = np.pi + 0.01  # range: [rad] with room for limits written as 3.15


def absolute(mechanism: Mechanism) -> Mechanism:
    """The mechanism restated with six coordinates a body; parameters, joints and logs are the same.

    A turning joint becomes a `revolute` closure and a sliding one a `prismatic` closure, whose own
    joint carries the joint's name: its angle is the joint's coordinate, the logged torque acts on
    it, and effects sit on it as before. The joint's multipliers are named `joint.<joint>.<x|…>`.

    Args:
        mechanism: in joint coordinates.

    Returns:
        One with 6 · bodies coordinates and the same degrees of freedom.

    Raises:
        MechanismError: for gears between joints that turn by more than half a turn.
    """
    for closure in mechanism.closures:
        tied = map(mechanism.joint, closure.tied)
        if any(j.rotational and max(-j.lower, j.upper) > HALF_TURN for j in tied):
            raise MechanismError(
                f"{mechanism.name}: closure '{closure.name}' ties joints that turn by more than "
                "half a turn, which absolute coordinates do not count; use joint coordinates, or "
                "give these joints limits within ±3.14 rad"
            )
    tree = mechanism.model
    model = pin.Model()
    model.name = tree.name
    model.gravity = tree.gravity
    for index, link in enumerate(mechanism.bodies.links, start=1):
        added = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), link)
        model.appendBodyToJoint(added, tree.inertias[index], pin.SE3.Identity())
    for f in tree.frames:
        if f.type == pin.FrameType.FIXED_JOINT or (
            f.type == pin.FrameType.BODY and not model.existBodyName(f.name)
        ):
            frame = pin.Frame(f.name, f.parentJoint, f.placement, f.type, f.inertia)
            model.addFrame(frame, False)
    data = tree.createData()
    pin.forwardKinematics(tree, data, mechanism.assembled)
    return replace(
        mechanism,
        name=f"{mechanism.name} (absolute)",
        model=model,
        joints=tuple(
            replace(joint, index=i, in_tree=False) for i, joint in enumerate(mechanism.joints)
        ),
        closures=(
            *(_closure(mechanism, index) for index in range(1, tree.njoints)),
            *mechanism.closures,
        ),
        start=np.concatenate([pin.SE3ToXYZQUAT(data.oMi[i]) for i in range(1, tree.njoints)]),
    )


def _closure(mechanism: Mechanism, index: int) -> Closure:
    tree = mechanism.model
    align = pin.SE3(align_z(joint_axis(tree, index)), np.zeros(3))
    links = ("world", *mechanism.bodies.links)
    parent, joint = tree.parents[index], mechanism.joint(tree.names[index])
    a = Frame(links[parent], parent, tree.jointPlacements[index] * align)
    kind = RevoluteClosure if joint.rotational else PrismaticClosure
    return kind(f"joint.{joint.name}", a, Frame(links[index], index, align), joint.name)
