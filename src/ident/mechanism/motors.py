"""Motors that do not sit at the joints: [motors] of mechanism.toml.

    [motors]
    j2 = "j2"                                     # joint j2 has a motor of its own
    m3 = "j2 + j3"                                # m3 stands on the base: q_m3 = q_j2 + q_j3
    m1 = { j1 = 9.5 }                             # a belt
    m_l = { closure = "rod_l", joints = ["pitch", "roll"] }      # a [[closure]] relates them

A motor is a coordinate of its own, that of a rotor without a mass on the base, which a `linear`
closure ties to its joints. So q, v, τ, friction and rotor inertia of motors are logged, fitted and
named as the motors', and by virtual work τ = Aᵀ τ_m for m = A q. The joints of a motor are passive.
Source: B. Siciliano, L. Sciavicco, L. Villani, G. Oriolo, Robotics, 2009, sect. 3.5 and 8.1.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree

from ident.errors import MechanismError, one_of
from ident.files import TomlTable, is_number
from ident.mechanism.description import UNLIMITED

ROTOR = "_rotor"  # what the link of a motor is called behind the motor's name
SINGULAR = 1e-9  # numerics: smallest singular value of a motor matrix over its largest
NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
TERM = (  # of a sum, whose joint is one of %(names)s; a factor stands on either side
    rf"\s*(?P<sign>[+-]?)\s*(?:(?P<top>{NUMBER})\s*(?:/\s*(?P<below>{NUMBER})\s*)?\*?\s*)??"
    rf"(?P<joint>%(names)s)(?:\s*\*\s*(?P<times>{NUMBER}))?(?:\s*/\s*(?P<over>{NUMBER}))?\s*"
)
WORD = r"[A-Za-z_][\w.]*(?:-\w+)*"  # a joint that is not there, to be named in the message
EXAMPLE = 'write m3 = "j2 + j3", m1 = { j1 = 9.5 }, or j2 = "j2" for a joint with its own motor'


@dataclass(frozen=True)
class Motor:
    """A motor's coordinate m = Σ ratio q, or what the closure that is named says.

    Attributes:
        name: of the motor, and of its joint.
        ratios: by joint of the tree; 1 of each where a closure relates them.
        turns: whether its coordinate is an angle.
        closure: of the [[closure]] that relates it to its joints; "" for Σ ratio q.
    """

    name: str
    ratios: Mapping[str, float]
    turns: bool = True
    closure: str = ""

    @property
    def is_joint(self) -> bool:
        """Whether it sits at the joint of its name."""
        return self.name in self.ratios

    @property
    def link(self) -> str:
        """Name of its rotor, a link without mass."""
        return f"{self.name}{ROTOR}"

    @property
    def formula(self) -> str:
        """Return Σ ratio q as text, as "j2 + 0.5 * j3"."""
        terms = ""
        for joint, ratio in self.ratios.items():
            sign = " - " if ratio < 0 else " + "
            factor = "" if abs(ratio) == 1 else f"{abs(ratio):.6g} * "
            terms += f"{sign}{factor}{joint}"
        return terms.removeprefix(" + ").replace(" - ", "-", 1 if terms.startswith(" - ") else 0)

    def table(self) -> dict[str, Any]:
        """Return its [[closure]] table."""
        return {
            "name": self.name,
            "kind": "linear",
            "joints": [self.name, *self.ratios],
            "ratios": [1.0, *(-ratio for ratio in self.ratios.values())],
        }


def read_motors(
    section: TomlTable, robot: etree._Element, locked: Collection[str], tied: bool = False
) -> tuple[Motor, ...]:
    """Return the motors of [motors] of a `<robot>`, whose joints closures may have `tied` already.

    Raises:
        MechanismError: for a joint that is not there, a row without a joint, or motors that cannot
            move all their joints by themselves.
    """
    moving = {j.get("name"): j for j in robot.findall("joint") if j.get("type") != "fixed"}
    turning = {name for name, joint in moving.items() if joint.get("type") != "prismatic"}
    motors = tuple(_motor(section, name, moving, turning) for name in section.data)
    related = [motor for motor in motors if not motor.closure]
    joints = list(dict.fromkeys(joint for motor in related for joint in motor.ratios))
    A = np.array([[motor.ratios.get(joint, 0.0) for joint in joints] for motor in related])
    if len(related) < len(joints) and not tied:
        raise section.error(
            f"{_count(len(related), 'motor')} for {len(joints)} joints ({', '.join(joints)}); a "
            f'joint with a motor of its own is a row too, as {joints[0]} = "{joints[0]}"'
        )
    if joints and not tied:
        _, values, Vt = np.linalg.svd(A)
        if values[-1] <= SINGULAR * values[0]:
            still = Vt[-1] / np.abs(Vt[-1]).max()
            terms = [
                f"{x:+.3g} {joint}"
                for x, joint in zip(still, joints, strict=True)
                if abs(x) > SINGULAR
            ]
            rows = "; ".join(f"{motor.name} = {motor.formula}" for motor in related)
            raise section.error(
                f"the motor matrix is singular: {rows}: a motion along {' '.join(terms)} turns no "
                f"motor, so no torque is known of it; give {len(joints)} independent rows"
            )
    for name in locked:
        if any(name in motor.ratios and motor.closure for motor in motors):
            raise section.error(
                f"joint '{name}' of a motor with a closure is locked; take the motor out"
            )
    return motors


def motors_of_file(
    section: TomlTable, robot: etree._Element, locked: Collection[str], tied: bool = False
) -> tuple[tuple[Motor, ...], tuple[str, ...]]:
    """Return the motors on tendons of a model's file, and a note on them; none where they cannot
    move all their joints, which then count as joints with motors of their own.
    """
    if not section.data:
        return (), ()
    try:
        motors = read_motors(section, robot, locked, tied)
    except MechanismError as error:
        note = f"motors on tendons are left out, so torques are those of the joints: {error}"
        return (), (note,)
    if pulled := [motor.name for motor in motors if not motor.is_joint]:
        return motors, (
            f"{', '.join(pulled)}: pulls a tendon, so it is a motor with coordinates of its "
            f"own: q.{pulled[0]} and tau.{pulled[0]} of the log; [motors] says otherwise",
        )
    return motors, ()


def add_motors(
    robot: etree._Element, motors: Sequence[Motor], locked: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Add the rotors of motors to a `<robot>`; return the closures that tie them to their joints.

    A joint that is locked keeps its share in the motor's coordinate.
    """
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}
    links = [link.get("name") for link in robot.findall("link")]
    root = next((name for name in links if name not in children), "world")
    tables = []
    for motor in motors:
        if motor.is_joint or not {*motor.ratios} - {*locked}:
            continue
        etree.SubElement(robot, "link", name=motor.link)
        kind = "revolute" if motor.turns else "prismatic"
        joint = etree.SubElement(robot, "joint", name=motor.name, type=kind)
        etree.SubElement(joint, "parent", link=root)
        etree.SubElement(joint, "child", link=motor.link)
        etree.SubElement(joint, "axis", xyz="0 0 1")
        limit = {"lower": -UNLIMITED, "upper": UNLIMITED, "effort": UNLIMITED}
        etree.SubElement(
            joint, "limit", {k: f"{x}" for k, x in {**limit, "velocity": UNLIMITED}.items()}
        )
        if not motor.closure:
            table = motor.table()
            free = [name not in locked for name in table["joints"]]
            offset = sum(
                motor.ratios[name] * locked[name] for name in motor.ratios if name in locked
            )
            for key in ("joints", "ratios"):
                table[key] = [x for x, moves in zip(table[key], free, strict=True) if moves]
            tables.append({**table, "offset": float(offset)})
    return tables


def moved_by(motors: Collection[Motor]) -> set[str]:
    """Return the joints that motors elsewhere move: they are passive."""
    driven = {motor.name for motor in motors if motor.is_joint}
    return {joint for motor in motors for joint in motor.ratios} - driven


def starts_of(motors: Sequence[Motor], start: Mapping[str, Any]) -> dict[str, float]:
    """Return the coordinates at which motors start where their joints do."""
    return {
        motor.name: float(
            sum(r * start[j] for j, r in motor.ratios.items() if is_number(start.get(j)))
        )
        for motor in motors
        if not motor.is_joint and not motor.closure and motor.name not in start
    }


def parallel_joints(motors: Collection[Motor]) -> set[str]:
    """Return the joints that one motor moves alone: whatever acts in them acts in the motor."""
    related = [motor for motor in motors if not motor.closure]
    joints = list(dict.fromkeys(joint for motor in related for joint in motor.ratios))
    if not joints:
        return set()
    A = np.array([[motor.ratios.get(joint, 0.0) for joint in joints] for motor in related])
    rows = np.abs(np.linalg.pinv(A)) > SINGULAR  # q = A⁺ m
    lone = {joint for joint, row in zip(joints, rows, strict=True) if row.sum() == 1}
    return lone & moved_by(motors)


def _motor(
    section: TomlTable, name: str, moving: Mapping[str, etree._Element], turning: Collection[str]
) -> Motor:
    entry = section.data[name]
    where = TomlTable(f"{section.where} {name}", entry if isinstance(entry, dict) else {})
    closure, turns = "", None
    if isinstance(entry, dict) and {"closure", "formula", "kind"} & {*entry}:
        where.check("closure", "joints", "formula", "kind")
        if "kind" in entry:
            word = where.text("kind")
            if word not in ("revolute", "prismatic"):
                raise where.error(f"kind = '{word}'; {one_of(word, ('revolute', 'prismatic'))}")
            turns = word == "revolute"
        if "closure" in entry:
            closure = where.text("closure")
            ratios = dict.fromkeys(where.words("joints"), 1.0)
        else:
            ratios = _terms(where, where.text("formula"), moving)
    elif isinstance(entry, dict):
        ratios = {joint: where.number(joint) for joint in entry}
    elif isinstance(entry, str):
        ratios = _terms(where, entry, moving)
    else:
        raise where.error(f"{entry!r}; {EXAMPLE}")
    if not ratios:
        raise where.error(f"has no joints; {EXAMPLE}")
    for joint, ratio in ratios.items():
        if joint not in moving:
            raise where.error(f"no joint '{joint}'; {one_of(joint, moving)}")
        if ratio == 0:
            raise where.error(f"{joint} = 0; leave out a joint that it does not move")
    if name in moving and ratios != {name: 1.0}:
        raise where.error(
            f"'{name}' is a joint; give the motor another name, as m_{name} = … (and map the "
            f'log\'s columns: [log] "q.m_{name}" = "q.{name}")'
        )
    if turns is None:
        turns = bool({*ratios} & {*turning})
    return Motor(name, ratios, turns, closure)


def _terms(where: TomlTable, text: str, names: Collection[str]) -> dict[str, float]:
    """Return the ratios by joint of a sum such as "j2 + 0.5 * j3"; a hyphen is of a name where one
    of `names` has it, and else a minus.
    """
    longest_first = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    known = re.compile(TERM % {"names": rf"(?:{longest_first})(?![\w.])"})
    unknown = re.compile(TERM % {"names": WORD})
    ratios: dict[str, float] = {}
    at = 0
    while at < len(text):
        match = (known.match(text, at) if names else None) or unknown.match(text, at)
        if match is None or (ratios and not match["sign"]) or match["joint"] in ratios:
            raise where.error(f"'{text}' is no sum of joints at '{text[at:].strip()}'; {EXAMPLE}")
        above, below = (
            float(match[one] or 1) * float(match[two] or 1)
            for one, two in (("top", "times"), ("below", "over"))
        )
        if below == 0:
            raise where.error(f"'{text}' divides by 0; {EXAMPLE}")
        ratios[match["joint"]] = above / below * (-1.0 if match["sign"] == "-" else 1.0)
        at = match.end()
    return ratios


def _count(n: int, what: str) -> str:
    return f"{n} {what}" + "s" * (n != 1)
