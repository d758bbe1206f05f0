"""A serial arm of seven joints with friction, made here, for timings."""

import sys
import tempfile
from pathlib import Path

import numpy as np

import ident

LENGTHS = (0.16, 0.18, 0.16, 0.20, 0.16, 0.10, 0.08)
AXES = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1")


def urdf() -> str:
    """The arm's seven links and joints."""
    links = ['<link name="base"/>']
    joints = []
    for i, (length, axis) in enumerate(zip(LENGTHS, AXES, strict=True), start=1):
        mass = 5.0 - 0.6 * i
        links.append(
            f'<link name="link_{i}"><inertial><origin xyz="0.01 -0.02 {length / 2}"/>'
            f'<mass value="{mass}"/><inertia ixx="{0.02 / i}" iyy="{0.021 / i}" izz="{0.01 / i}" '
            f'ixy="0.001" ixz="-0.0005" iyz="0.0004"/></inertial></link>'
        )
        parent = "base" if i == 1 else f"link_{i - 1}"
        joints.append(
            f'<joint name="joint_{i}" type="revolute"><origin xyz="0 0 {length}"/>'
            f'<parent link="{parent}"/><child link="link_{i}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="200" velocity="4"/></joint>'
        )
    return f'<robot name="arm7">{"".join(links + joints)}</robot>'


def mechanism() -> ident.Mechanism:
    """Rigid bodies with viscous and Coulomb friction on all seven joints."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm7.urdf"
        path.write_text(urdf())
        return ident.load(path).with_effect("viscous").with_effect("coulomb")


def log(model: ident.Mechanism, samples: int, noise: float, seed: int = 0) -> ident.Log:
    """`samples` at 1 kHz of a rich motion, torques with noise (share of each torque)."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / 1000.0
    columns = {}
    for name in model.driven:
        w = 2 * np.pi * rng.uniform(0.1, 0.8, 4)[:, None]
        phase = rng.uniform(0, 2 * np.pi, 4)[:, None]
        size = 0.35
        columns[f"q.{name}"] = size * np.sin(w * t + phase).sum(axis=0)
        columns[f"v.{name}"] = size * (w * np.cos(w * t + phase)).sum(axis=0)
        columns[f"a.{name}"] = size * (-(w**2) * np.sin(w * t + phase)).sum(axis=0)
    motion = ident.Log.from_arrays("arm7", t, columns)
    values = {name: 0.5 for effect in model.effects for name in effect.names}
    made, _ = ident.simulate(
        model, motion, values=values, noise=[ident.Noise("tau", noise, True)] if noise else []
    )
    return made


if __name__ == "__main__":
    sys.exit("run benchmarks/stream.py")
