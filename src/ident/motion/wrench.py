"""Measured external wrenches as generalised forces."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ident.errors import MotionError, one_of
from ident.mechanism.mechanism import Mechanism


def wrenches(
    mechanism: Mechanism, name: str, columns: Mapping[str, np.ndarray], q: np.ndarray
) -> np.ndarray | None:
    """Generalised forces (n, nv) of `wrench.<link>.<fx…mz>`, in the link's own frame.

    Args:
        mechanism: the mechanism.
        name: of the log, for messages.
        columns: of the log, each (n,).
        q: (n, nq) its configurations.
    """
    parts = ("fx", "fy", "fz", "mx", "my", "mz")
    frames: dict[str, np.ndarray] = {}
    for column in columns:
        if not column.startswith("wrench."):
            continue
        frame, _, part = column[len("wrench.") :].rpartition(".")
        if part not in parts or not frame:
            raise MotionError(f"{name}: column '{column}': write wrench.<link>.<{'|'.join(parts)}>")
        if not mechanism.model.existFrame(frame, pin.FrameType.BODY):
            known = [f.name for f in mechanism.model.frames if f.type == pin.FrameType.BODY]
            raise MotionError(
                f"{name}: column '{column}': no link '{frame}'; {one_of(frame, known)}"
            )
        wrench = frames.setdefault(frame, np.zeros((len(q), 6)))
        wrench[:, parts.index(part)] = columns[column]
    if not frames:
        return None
    model, data = mechanism.model, mechanism.model.createData()
    total = np.zeros((len(q), model.nv))
    for frame, wrench in frames.items():
        index = model.getFrameId(frame, pin.FrameType.BODY)
        for k in range(len(q)):
            J = pin.computeFrameJacobian(model, data, q[k], index, pin.LOCAL)
            total[k] += J.T @ wrench[k]
    return total
