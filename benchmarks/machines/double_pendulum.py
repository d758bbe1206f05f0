"""A double pendulum that swings freely: dynamicslab/MultiArm-Pendulum (Kaheman, 2022)."""

import io
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from machines import Checkout, Machine, chain, write_log

SOURCE, COMMIT = "dynamicslab/MultiArm-Pendulum", "e99a7e1"
PUBLISHED = "centres of mass, inertias and viscous friction from simulated positions"
FOLDER = "ParameterEstimation/DoublePendulum/"
EVERY = 5  # rows of 1 ms
LENGTH = 0.1727  # m, of arm 1: EstimatedParameters_DoublePendulum.mat
ARM2 = 0.1376, 0.1168  # kg, and m to its centre, ibid.: what states the scale of all values


def convert(source: Path, folder: Path) -> Machine:
    """The first 69 s of one swing are for training, the last 11 s to judge on, as the authors'."""
    checkout = Checkout(source, COMMIT)
    file = checkout.read(f"{FOLDER}DoublePendulumDataForParameterEstimation.mat")
    pieces, logs = loadmat(io.BytesIO(file)), []
    for name, suffix in (("train", "id"), ("validate", "vad")):
        t = np.concatenate([x.ravel() for x in pieces[f"Time_{suffix}"].ravel()])[::EVERY]
        absolute = np.hstack(list(pieces[f"Y_{suffix}"].ravel()))[:2, ::EVERY]  # from upright
        channels = {"q_arm1": absolute[0] + np.pi / 2, "q_arm2": absolute[1] - absolute[0]}
        channels |= {"tau_arm1": np.zeros_like(t), "tau_arm2": np.zeros_like(t)}
        logs.append(write_log(folder / f"{name}.csv", t=t, **channels))
    origins = np.array([(0, 0, 0, np.pi / 2, 0, 0), (LENGTH, 0, 0, 0, 0, 0)])
    chain(folder / "pendulum.urdf", ("arm1", "arm2"), origins, masses={"arm2": ARM2})
    toml = folder / "mechanism.toml"
    toml.write_text(
        'urdf = "pendulum.urdf"\n[parameters]\nknown = ["link_arm2.m", "link_arm2.mx"]\n'
    )
    return Machine(folder, (logs[0],), (logs[1],))
