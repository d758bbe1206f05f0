"""KUKA KR300 R2500, two logs of 10 s: shared data, of JonasWeigand/Robot_Identification."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

from machines import Machine

SOURCE, COMMIT = "kuka_kr300", ""
PUBLISHED = "counterbalance of a2, elastic gears of a1 to a3"

# robot_model/model_KUKA_Quantec_Ultra_KR300.m of the source, commit 9e403c0, of each body
DH = np.array([  # d, a [m], α, offset [rad]: standard Denavit-Hartenberg, on a base turned over
    (-0.675, 0.350, np.pi / 2, 0), (-0.189, 1.15, 0, 0), (0.189, 0.041, -np.pi / 2, np.pi / 2),
    (-1, 0, np.pi / 2, 0), (0, 0, -np.pi / 2, 0), (-0.24, 0, np.pi, 0),
])  # fmt: skip
START = np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])  # robot_dynamics.m: where the logs are zero
MASS = (395.40, 339.12, 105.21, 35.80, 31.46, 200 + 17.78)  # kg, the last with the load of 200 kg
CENTRE = np.array([  # m, in the frame of the body's DH row
    (-0.353, 0.174, -0.004), (-0.709, -0.001, 0.023), (-0.018, -0.018, -0.076), (0, 0.236, 0.001),
    (0, -0.080, -0.009), (0, 0, (200 * 0.1 - 17.78 * 0.05) / MASS[5]),
])  # fmt: skip
INERTIA = 1e-6 * np.array([  # kg m² about the centre: xx, yy, zz, xy, yz, xz; of the load not given
    (16733765, 29799119, 32814954, -1703664, 129384, 4404062),
    (7507819, 88886691, 88673761, 430046, 173157, -4396607),
    (10783798, 10186135, 1943179, 118474, -606384, -101950),
    (425035, 217993, 428465, -4, -11353, -27), (283826, 229562, 258266, -4, -19521, -120),
    (0, 0, 0, 0, 0, 0),
])  # fmt: skip


def convert(source: Path, folder: Path) -> Machine:
    """Identified from A, judged on B."""
    return Machine(source, (source / "A.csv",), (source / "B.csv",))


def with_bodies(source: Path, folder: Path) -> Path:
    """Writes a mechanism with the published bodies into a folder; only the last, a6's, is unknown.

    The URDF has the authors' joints, but frames of its own. As both begin at the same pose, a
    body's frame in that of the URDF's joint is what it is there, and at any other pose.
    """
    urdf = source / "kr300.urdf"
    model, tree = pin.buildModelFromUrdf(str(urdf)), ET.parse(urdf)
    for i, (here, there) in enumerate(zip(frames(model, 0), frames(model, 1), strict=True)):
        if not np.allclose(here.homogeneous, there.homogeneous, atol=1e-6):
            raise ValueError(f"a{i + 1} of {urdf} turns about another line than the authors' does")
        xx, yy, zz, xy, yz, xz = INERTIA[i]
        about = np.array([(xx, xy, xz), (xy, yy, yz), (xz, yz, zz)])
        link = tree.find(f"link[@name='l{i + 1}']")
        link.remove(link.find("inertial"))
        link.append(inertial(here.act(pin.Inertia(MASS[i], CENTRE[i], about))))
    tree.write(folder / "kr300.urdf")
    (folder / "mechanism.toml").write_text(
        'urdf = "kr300.urdf"\n[parameters]\nunknown = ["l6"]\n', encoding="utf-8"
    )
    return folder


def frames(model: pin.Model, q: float) -> list[pin.SE3]:
    """Frames of the DH rows in those of the URDF's joints, all joints at q [rad]."""
    data = model.createData()
    pin.forwardKinematics(model, data, np.full(model.nq, q))
    place, found = pin.SE3(turned(np.pi, 0), np.zeros(3)), []
    for i, (d, a, alpha, offset) in enumerate(DH):
        place = place * pin.SE3(turned(0, q + START[i] + offset), np.array([0, 0, 0]))
        place = place * pin.SE3(turned(alpha, 0), np.array([a, 0, d]))
        found.append(data.oMi[i + 1].actInv(place))
    return found


def inertial(body: pin.Inertia) -> ET.Element:
    """The element of a URDF."""
    x, y, z = body.lever
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = body.inertia
    return ET.fromstring(
        f'<inertial><origin xyz="{x} {y} {z}"/><mass value="{body.mass}"/><inertia ixx="{ixx}" '
        f'iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="{ixz}" iyz="{iyz}"/></inertial>'
    )


def turned(roll: float, yaw: float) -> np.ndarray:
    return np.asarray(pin.rpy.rpyToMatrix(roll, 0, yaw))
