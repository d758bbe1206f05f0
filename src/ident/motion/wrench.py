"""Measured external wrenches as generalised forces."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ident.errors import MotionError, one_of
from ident.mechanism.mechanism import Mechanism
from ident.motion.measure import Signals
from ident.motion.motion import Experiment


def wrenches(mechanism: Mechanism, signals: Signals, experiment: Experiment) -> np.ndarray | None:
    """Generalised forces (n, nv) of `wrench.<link>.<fx…mz>`, in the link's own frame."""
    parts = ("fx", "fy", "fz", "mx", "my", "mz")
    frames: dict[str, np.ndarray] = {}
    for column in signals.columns:
        if not column.startswith("wrench."):
            continue
        frame, _, part = column[len("wrench.") :].rpartition(".")
        if part not in parts or not frame:
            raise MotionError(
                f"{signals.log.name}: column '{column}': write wrench.<link>.<{'|'.join(parts)}>"
            )
        if not mechanism.model.existFrame(frame, pin.FrameType.BODY):
            known = [f.name for f in mechanism.model.frames if f.type == pin.FrameType.BODY]
            raise MotionError(
                f"{signals.log.name}: column '{column}': no link '{frame}'; {one_of(frame, known)}"
            )
        wrench = frames.setdefault(frame, np.zeros((len(experiment), 6)))
        wrench[:, parts.index(part)] = signals.columns[column]
    if not frames:
        return None
    model, data = mechanism.model, mechanism.model.createData()
    total = np.zeros((len(experiment), model.nv))
    for frame, wrench in frames.items():
        index = model.getFrameId(frame, pin.FrameType.BODY)
        for k in range(len(experiment)):
            J = pin.computeFrameJacobian(model, data, experiment.q[k], index, pin.LOCAL)
            total[k] += J.T @ wrench[k]
    return total
