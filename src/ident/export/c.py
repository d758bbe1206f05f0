"""A machine as one C header for controllers: inverse dynamics, gravity, regressor, motion.

Straight-line code from CasADi's expressions (`equations`), and a small runtime that integrates the
motion with dry friction that sticks (`runtime.h`). C99, no heap, no library but libm.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files

import casadi as ca
import numpy as np

from ident.errors import IdentError, MechanismError
from ident.export.c_print import body, constant, used
from ident.export.equations import DRY, POSITION, Equations
from ident.export.laws import DRIVES, Vocabulary
from ident.export.machine import Machine
from ident.export.target import Job, Product, Target, translated

HELD = 64  # range: cycles whose commands are held, for drives that follow late
SMOOTH = 0.01  # range: [rad/s | m/s] over which dry friction changes its sign, of the inverse
STEP = 2.5e-4  # range: [s] longest step of the integration
EFFECTS = {
    "viscous": "inverse_dynamics", "coulomb": "inverse_dynamics, friction",
    "rotor_inertia": "mass_matrix", "drag": "friction", "spring": "gravity", "cable": "gravity",
    "torque_offset": "gravity", "torque_gain": "gain", "encoder_offset": "offset",
    "payload": "all", "coupling": "friction, mass_matrix", "gravity_tilt": "gravity",
    "geometry": "all", **dict.fromkeys((*DRIVES, "command_delay"), "drives_torque"),
    **dict.fromkeys(DRY, "friction"), **dict.fromkeys(POSITION, "gravity"),
}  # fmt: skip
CLOSURES = dict.fromkeys(
    ("point", "revolute", "prismatic", "cylindrical", "universal", "planar", "fixed", "distance",
     "linear", "function"), "independent coordinates",
)  # fmt: skip
WORDS = Vocabulary(EFFECTS, CLOSURES, degree=7)


def write(job: Job) -> Product:
    """Return the header of a job."""
    real = str(job.settings.get("real", "double"))
    if real not in ("double", "float"):
        raise IdentError(f"real = {real!r}; valid: double, float")
    translation = translated(job, WORDS)
    text = header(Equations(translation, SMOOTH), symbol(job.out.stem), real)
    return Product({job.out.name: text.encode()}, translation)


def symbol(text: str) -> str:
    """Return a name as C may have it."""
    result = re.sub(r"\W", "_", text)
    return result if result[:1].isalpha() else f"m_{result}"


def header(equations: Equations, name: str, real: str = "double") -> str:
    """Return the text of the header."""
    machine = equations.machine
    independent = equations.independent
    if not independent or len(independent) != machine.drawing.degrees_of_freedom:
        raise MechanismError(
            f"{machine.name}: no joints of the tree determine its motion, so there are no "
            "coordinates for a controller"
        )
    functions = equations.functions
    parts = [_head(equations, name, real)]
    for key, f in functions.items():
        inputs = [_input(f, i) for i in range(f.n_in())]
        outputs = ["out"] if f.n_out() == 1 else ["phi", "J"]
        signature = ", ".join(
            [f"const {real} {x}[]" for x in inputs] + [f"{real} {x}[]" for x in outputs]
        )
        unused = "".join(
            f"    (void){x};\n" for x, is_used in zip(inputs, used(f), strict=True) if not is_used
        )
        code = body(f, inputs, outputs, real)
        parts.append(f"static void {name}_{key}_tree({signature})\n{{\n{unused}{code}\n}}\n")
    parts += [_tree(equations, name, real), _public(equations, name, real), _runtime(name, real)]
    parts += [_drives(machine, independent, name, real)]
    parts.append(f"#ifdef __cplusplus\n}}\n#endif\n\n#endif /* {name.upper()}_H */\n")
    return "\n".join(parts)


def _input(f: ca.Function, i: int) -> str:
    """Return the name of a function's argument: q, v and a in this order, v alone for friction."""
    return "v" if f.name() in ("friction", "dry_friction") else "qva"[i]


def _array(name: str, values: object, real: str) -> str:
    numbers = np.ravel(np.asarray(values, dtype=float))
    kind = real if real in ("double", "float") else "int"
    words = [constant(x, real) if kind != "int" else str(int(x)) for x in numbers]
    return f"static const {kind} {name}[{len(words)}] = {{{', '.join(words)}}};"


def _head(equations: Equations, name: str, real: str) -> str:
    machine, independent = equations.machine, equations.independent
    n, d = equations.n, len(independent)
    suffix = "f" if real == "float" else ""
    joints = sorted(machine.links, key=lambda link: link.joint.index)
    places = [machine.by_joint[x].joint.index for x in independent]
    friction = [
        any([equations.translation.laws[x].coulomb,
             *(machine.values.get(kind, {}).get((x,)) for kind in DRY)])
        for x in independent
    ]  # fmt: skip
    order = ", ".join(f"{link.joint.name} [{link.joint.unit}]" for link in joints)
    units = ", ".join(f"{x}" for x in independent)
    rest, tiny, short = (1e-12, 1e-14, 1e-9) if real == "double" else (1e-6, 1e-9, 1e-4)
    lines = [
        f"/* {machine.name}: dynamics, written by ident from its identified model.",
        "",
        f"   Coordinates of the {n} joints: {order}.",
        f"   Arguments are those of the {d} independent ones: {units}.",
        "   Units: rad, rad/s, rad/s^2, N m (m, m/s, m/s^2, N of sliding joints). Coordinates are",
        "   those of the log; torques are the drives' as they are logged. */",
        f"#ifndef {name.upper()}_H\n#define {name.upper()}_H\n",
        "#include <math.h>\n",
        '#ifdef __cplusplus\nextern "C" {\n#endif\n',
        f"#if defined(__GNUC__)\n#define {name}_API static __attribute__((unused))\n#else\n"
        f"#define {name}_API static\n#endif\n",
        f"#define {name}_DOF {d}\n#define {name}_JOINTS {n}",
        f"#define {name}_SMOOTH {constant(equations.smooth, real)}",
        f"#define {name}_STEP {constant(STEP, real)}",
        f"#define {name}_REST {constant(rest, real)}\n#define {name}_TINY {constant(tiny, real)}",
        f"#define {name}_SHORT {constant(short, real)}\n#define {name}_MOST 100000",
        f"#define {name}_HALVINGS {50 if real == 'double' else 20}",
        f"#define {name}_abs fabs{suffix}\n#define {name}_tanh tanh{suffix}\n",
        _array(f"{name}_independent", places, "int"),
        _array(f"{name}_is_independent", [i in places for i in range(n)], "int"),
        _array(f"{name}_has_friction", friction, "int"),
        _array(f"{name}_offset", equations.offsets, real),
        _array(f"{name}_gain", equations.gains[places], real),
        _array(f"{name}_assembled", machine.start, real) + "\n",
    ]
    return "\n".join(lines)


SOLVE = "static int NAME_solve(int n, int k, REAL *a, REAL *b);\n"
PLAIN = {
    "inverse_dynamics": (("q", "v", "a"), "tau", "Torques of a motion, with all friction"),
    "gravity": (("q",), "tau", "Torques that hold still: gravity, springs, offsets"),
    "friction": (("v",), "tau", "Torques of friction; give a wanted v to compensate it"),
    "regressor": (("q", "v", "a"), "Y", "Y (joints, 10 bodies), column by column"),
}


def _tree(equations: Equations, name: str, real: str) -> str:
    loops = bool(equations.machine.drawing.closures)
    rank = str(equations.n - len(equations.independent))
    text = _resource("loops.h" if loops else "tree.h").replace("RANK", rank)
    closed = "1e-12" if real == "double" else "1e-5F"
    return _named((SOLVE + text if loops else text).replace("CLOSED", closed), name, real)


def _public(equations: Equations, name: str, real: str) -> str:
    """Return the functions that a controller calls."""
    parts = []
    loops = bool(equations.machine.drawing.closures)
    moved = any(equations.offsets)
    for key, (inputs, out, says) in PLAIN.items():
        signature = ", ".join([f"const {real} {x}[]" for x in inputs] + [f"{real} {out}[]"])
        if loops:
            continue
        head = f"/* {says}. */\n{name}_API void {name}_{key}({signature})\n{{\n"
        if moved and "q" in inputs:
            head += (
                f"    {real} tree[{name}_JOINTS];\n"
                f"    for (int j = 0; j < {name}_JOINTS; j++) tree[j] = q[j] + {name}_offset[j];\n"
            )
        given = ", ".join("tree" if x == "q" and moved else x for x in inputs)
        parts.append(f"{head}    {name}_{key}_tree({given}, {out});\n}}\n")
    if loops:
        parts.append(_named(_resource("reduced.h"), name, real))
    return "\n".join(parts)


def _runtime(name: str, real: str) -> str:
    return _named(_resource("runtime.h").replace("HALF", constant(0.5, real)), name, real)


def _drives(machine: Machine, independent: Sequence[str], name: str, real: str) -> str:
    """Return the drives' code, nothing for a machine without drives.

    τ = scale · command(t − delay) + follows · rate(t − delay) − stiffness q − damping v
    """
    rows = []
    for joint in independent:
        at = {kind: machine.values.get(kind, {}).get((joint,)) for kind in DRIVES}
        late = sum(
            x["d"] for on, x in machine.values.get("command_delay", {}).items() if joint in on
        )
        if servo := at["servo"]:
            follows = servo["kd"] if servo["follows_velocity"] else 0.0
            numbers = servo["kp"], follows, servo["kp"], servo["kd"], servo["delay"] + late
        elif motor := at["motor_current"]:
            numbers = motor["kt"], 0.0, 0.0, 0.0, 0.0
        elif motor := at["motor_voltage"]:
            numbers = motor["gain"], 0.0, 0.0, motor["kb"], motor["delay"] + late
        else:
            numbers = 0.0, 0.0, 0.0, 0.0, 0.0
        drive = next((x for x in at.values() if x), None)
        limit = drive["limit"] if drive else 0.0
        rows.append((*numbers, min(limit, 1e30), float(drive is not None)))
    names = ("scale", "follows", "stiffness", "damping", "delay", "limit", "driven")
    if not any(row[-1] for row in rows):
        return ""
    columns = zip(names, zip(*rows, strict=True), strict=True)
    lines = [f"#define {name}_HELD {HELD}", f"#define {name}_ZERO {constant(0.0, real)}"]
    lines += [_array(f"{name}_{key}", x, "int" if key == "driven" else real) for key, x in columns]
    return "\n".join([*lines, "", _named(_resource("drives.h"), name, real)])


def _resource(name: str) -> str:
    """Return a part of the header that is the same for all machines."""
    return (files("ident.export") / name).read_text(encoding="utf-8")


def _named(text: str, name: str, real: str) -> str:
    return text.replace("NAME", name).replace("REAL", real)


C = Target("c", "a C header", ".h", WORDS, write, settings=("real",))
