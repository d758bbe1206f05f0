"""Logs of arms whose motors do not sit at their joints: Pinocchio's inverse dynamics, own motions.

m = A q, τ_m = A⁻ᵀ τ + Ia m̈ + Fv ṁ + Fc sign(ṁ): friction and rotors are the motors'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

ARM = """<robot name="arm"><link name="base"/>{links}{joints}</robot>"""
LINK = """<link name="{name}"><inertial><origin xyz="{x:.4f} 0 {z:.4f}"/><mass value="{m:.4f}"/>
<inertia ixx="{a:.5f}" ixy="0" ixz="0" iyy="{b:.5f}" iyz="0" izz="{c:.5f}"/></inertial></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}"/><axis xyz="{axis}"/>
<limit lower="-3" upper="3" velocity="9" effort="900"/></joint>"""
AXES = ("0 0 1", "0 1 0", "0 1 0")  # of a palletizer: yaw, and two parallel joints
WRIST = ("0 0 1", "0 1 0", "1 0 0")  # the last two are those of a differential


@dataclass(frozen=True)
class Machine:
    """An arm of three joints with motors elsewhere."""

    matrix: np.ndarray  # A (3, 3)
    axes: tuple[str, str, str] = AXES
    Ia: tuple[float, float, float] = (4.0, 6.0, 3.0)  # kg m² at the motor
    Fv: tuple[float, float, float] = (12.0, 15.0, 9.0)  # N m s/rad
    Fc: tuple[float, float, float] = (9.0, 14.0, 8.0)  # N m

    def urdf(self, off: float = 0.0) -> str:
        """Return its URDF, masses and inertias a share `off` larger."""
        sizes = ((30.0, 0.0, 0.2, 0.9), (14.0, 0.31, 0.0, 0.75), (9.0, 0.28, 0.02, 0.42))
        places = ("0 0 0", "0.1 0 0.6", "0.7 0 0")
        links = joints = ""
        for i, (m, x, z, inertia) in enumerate(sizes):
            big = inertia * (1 + off)
            links += LINK.format(
                name=f"l{i + 1}", x=x, z=z, m=m * (1 - off / 2), a=big / 5, b=big, c=big
            )
            joints += JOINT.format(
                name=f"j{i + 1}", parent=f"l{i}" if i else "base", child=f"l{i + 1}",
                xyz=places[i], axis=self.axes[i],
            )  # fmt: skip
        return ARM.format(links=links, joints=joints)

    def log(self, seed: int, seconds: float = 10.0, rate: float = 150.0) -> dict[str, np.ndarray]:
        """Return t, and q and tau of the motors by the names of the joints."""
        rng = np.random.default_rng(seed)
        n = round(seconds * rate)
        t = np.arange(n) / rate
        k = 2 * np.pi * np.arange(1, 7) / seconds
        q, v, a = np.zeros((3, n, 3))
        for j, (middle, most) in enumerate(((0.0, 0.75), (-0.6, 0.6), (1.2, 0.7))):
            s, c = rng.normal(size=(2, 6)) / (2 + np.arange(6))
            wave = np.sin(np.outer(t, k)) @ s + np.cos(np.outer(t, k)) @ c
            size = most / np.abs(wave - wave.mean()).max()
            q[:, j] = middle + size * (wave - wave.mean())
            v[:, j] = size * (np.cos(np.outer(t, k)) @ (s * k) - np.sin(np.outer(t, k)) @ (c * k))
            a[:, j] = -size * (
                np.sin(np.outer(t, k)) @ (s * k**2) + np.cos(np.outer(t, k)) @ (c * k**2)
            )
        model = pin.buildModelFromXML(self.urdf())
        data = model.createData()
        tau = np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])
        A = self.matrix
        m, vm, am = q @ A.T, v @ A.T, a @ A.T
        motors = tau @ np.linalg.inv(A) + am * self.Ia + vm * self.Fv + np.sign(vm) * self.Fc
        motors += rng.normal(size=(n, 3)) * (0.5, 1.0, 0.6)
        m = m + 2e-5 * rng.normal(size=(n, 3))
        channels = {f"q.j{j + 1}": m[:, j] for j in range(3)}
        return {"t": t, **channels, **{f"tau.j{j + 1}": motors[:, j] for j in range(3)}}


SUM = np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]])
DIFFERENCE = np.array([[1.0, 0, 0], [0, 1, 0], [0, -1, 1]])
DIFFERENTIAL = np.array([[1.0, 0, 0], [0, 1, 1], [0, 1, -1]])
MACHINES = {
    "palletizer": Machine(SUM),
    "difference": Machine(DIFFERENCE),
    "differential": Machine(DIFFERENTIAL, WRIST),
    "belt": Machine(np.diag([1.0, 2.5, 1.0])),
    "none": Machine(np.eye(3)),
    "wrist": Machine(np.eye(3), WRIST),
}
