"""A serial arm of six joints with known friction and one effect hidden, made here, for timings."""

import sys
import tempfile
from pathlib import Path

import numpy as np

import ident

# length [m], axis, mass [kg], moments of inertia about the centre of mass [kg m²]
LINKS = (
    (0.12, "0 0 1", 7.0, (0.06, 0.055, 0.04)),
    (0.32, "0 1 0", 6.0, (0.08, 0.085, 0.015)),
    (0.17, "0 1 0", 3.5, (0.012, 0.02, 0.018)),
    (0.16, "1 0 0", 1.8, (0.002, 0.008, 0.008)),
    (0.08, "0 1 0", 1.0, (0.0012, 0.0018, 0.0016)),
    (0.05, "1 0 0", 0.8, (0.001, 0.0012, 0.0013)),
)
HIDDEN = "coupling:joint_5,joint_6"
RATE = 500.0  # Hz


def mechanism() -> ident.Mechanism:
    """Rigid bodies with viscous and Coulomb friction at all six joints."""
    links = ['<link name="base"/>']
    joints = []
    for i, (length, axis, mass, (xx, yy, zz)) in enumerate(LINKS, start=1):
        links.append(
            f'<link name="link_{i}"><inertial><origin xyz="{length / 2} -0.012 0.02"/>'
            f'<mass value="{mass}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xx / 20}" '
            f'ixz="{-xx / 30}" iyz="{xx / 25}"/></inertial></link>'
        )
        parent, before = ("base", 0.3) if i == 1 else (f"link_{i - 1}", LINKS[i - 2][0])
        place = f"0 0 {before}" if i < 3 else f"{before} 0.01 0"
        joints.append(
            f'<joint name="joint_{i}" type="revolute"><origin xyz="{place}"/>'
            f'<parent link="{parent}"/><child link="link_{i}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="200" velocity="6"/></joint>'
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm6.urdf"
        path.write_text(f'<robot name="arm6">{"".join(links + joints)}</robot>')
        return ident.load(path).with_effect("viscous").with_effect("coulomb")


def log(
    model: ident.Mechanism, samples: int, hidden: str | None = HIDDEN, seed: int = 0
) -> ident.Log:
    """Positions with encoder noise and torques with 1 % of noise, of a rich motion."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / RATE
    columns = {}
    for name in model.driven:
        w = 2 * np.pi * rng.uniform(0.1, 0.7, 4)[:, None]
        phase = rng.uniform(0, 2 * np.pi, 4)[:, None]
        columns[f"q.{name}"] = 0.4 * np.sin(w * t + phase).sum(axis=0)
        columns[f"v.{name}"] = 0.4 * (w * np.cos(w * t + phase)).sum(axis=0)
        columns[f"a.{name}"] = 0.4 * (-(w**2) * np.sin(w * t + phase)).sum(axis=0)
    true = model if hidden is None else model.with_effect(hidden)
    size = np.linspace(1.0, 0.15, len(model.driven))  # friction falls towards the wrist
    values = {
        name: 0.3 * size[model.driven.index(effect.joints[0])]
        for effect in true.effects
        for name in effect.names
    }
    made, _ = ident.simulate(
        true,
        ident.Log.from_arrays("arm6", t, columns),
        values=values,
        noise=[ident.Noise("tau", 0.01, True), ident.Noise("q", 1e-5)],
        columns=["q", "tau"],
        seed=seed,
    )
    return made


if __name__ == "__main__":
    sys.exit("run benchmarks/diagnosis.py")
